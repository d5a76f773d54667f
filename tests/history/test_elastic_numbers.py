"""Derivatives with respect to numbers of layers, which change the operator."""

import numpy as np
import pytest
from paths import CASES

import ringwear_par as rw

STEPS = {"time": None, "time.scheme": "implicit", "mesh.contact_elements": 24}
COATED = {**STEPS, "time.step": 10.0, "time.steps": 4}
#: through the coating everywhere
THROUGH = {**STEPS, "time.step": 5.0, "time.steps": 16}
KEYS = (
    "lower.layers[0].thickness", "lower.layers[0].young", "lower.layers[0].poisson", "lower.young",
)  # fmt: skip


def number(case, key):
    return case.lower.young if key == "lower.young" else getattr(case.lower.layers[0], key[16:])


def by_differences(case, key, share=3e-4):
    value = number(case, key)
    less, more = (rw.simulate(case.replace({key: value * by})) for by in (1 - share, 1 + share))
    found = {
        f"d_{name}": more.histories[name][-1] - less.histories[name][-1]
        for name in ("approach", "torque", "twist")
    }
    found["d_wear_lower"] = more.profiles["wear_lower"][-1] - less.profiles["wear_lower"][-1]
    return {name: change / (2 * share * value) for name, change in found.items()}


@pytest.mark.parametrize(
    ("name", "changes", "tolerance"),
    [("coated.toml", COATED, 1e-5), ("wear_through.toml", THROUGH, 2e-4)],
)
def test_derivatives_are_those_of_other_operators(name, changes, tolerance, comm):
    """Differences are so small that no element gets through in another step."""
    case = rw.read_case(CASES / name, changes)
    result = rw.simulate(case, comm, derivatives=KEYS)
    for row, key in enumerate(KEYS):
        for variable, expected in by_differences(case, key).items():
            found = result.derivatives[variable][row][-1]
            assert np.abs(found - expected).max() < tolerance * np.abs(expected).max(), key


def test_thickness_moves_the_interface(comm):
    """Where all of a coating is gone, so much more of it costs so much time."""
    case = rw.read_case(CASES / "wear_through.toml", {**THROUGH, "time.steps": 60})
    result = rw.simulate(case, comm, derivatives=[KEYS[0]])
    assert (result.layers["layer_left_lower"][-1] == 0.0).all()
    slope = result.derivatives["d_worn_volume_lower"][0][-1]
    k_coating, k_body = 2e-8, 1e-7
    # V = k_s W - A c (k_s / k_c - 1), whatever the pressures
    worked = k_body * result.derivatives["d_dissipated_energy"][0][-1]
    expected = worked - case.area * (k_body / k_coating - 1.0)
    assert slope == pytest.approx(expected, rel=1e-6)
