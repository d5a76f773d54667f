"""Derivatives of functions, by differences of histories with the same steps."""

import numpy as np
import pytest
from paths import CASES, PAPER

import ringwear_par as rw

ELEMENTS = {"mesh.contact_elements": 16}
ADAPTIVE = {**ELEMENTS, "time": {"scheme": "adaptive", "end": 30.0}}
RATES = ["wear.lower.k", "contact.friction", "load.omega"]


def derivatives(case, inputs, outputs, **more):
    """Values and derivatives at the numbers of a case."""
    f = rw.function(case, inputs, outputs, derivatives=True)
    x = {name: entry["value"] for name, entry in f.schema["inputs"].items()}
    return x, *f(x, **more)


@pytest.mark.parametrize(("name", "p0"), [("paper.toml", 15.0), ("crown.toml", 0.0)])
def test_wear_depends_on_a_product_of_k_friction_and_speed(name, p0):
    """Steps are those of an adaptive history: differences of two would be of their noise."""
    law = {"law": "threshold", "k": 1e-7, "p0": p0}
    changes = {"wear.lower": law, "wear.upper": None, "output.times": [6.0, 12.0]}
    case = rw.read_case(CASES / name, {**ADAPTIVE, **changes})
    outputs = ["worn_volume_lower", "penetration@12", "approach@all"]
    x, values, slopes = derivatives(case, RATES, outputs)
    assert values["worn_volume_lower"] == pytest.approx(
        rw.simulate(case).histories["worn_volume_lower"][-1], rel=1e-4
    )
    for output in outputs:
        of_k, *others = (x[key] * slopes[output, key] for key in RATES)
        for other in others:
            assert np.abs(other - of_k).max() < 1e-4 * np.abs(of_k).max()
        assert np.abs(of_k).max() > 0.0


def test_volume_is_k_times_energy():
    case = rw.read_case(PAPER, {**ADAPTIVE, "wear.lower.p0": 0.0})
    outputs, k = ["worn_volume_lower", "dissipated_energy"], "wear.lower.k"
    x, values, slopes = derivatives(case, [k], outputs)
    expected = values["dissipated_energy"] + x[k] * slopes["dissipated_energy", k]
    assert slopes["worn_volume_lower", k] == pytest.approx(expected, rel=1e-6)


def test_elastic_approach_goes_with_one_over_both_moduli():
    inputs = ["lower.young", "upper.young"]
    x, values, slopes = derivatives(rw.read_case(PAPER, ADAPTIVE), inputs, ["approach@0"])
    total = sum(x[key] * slopes["approach@0", key] for key in inputs)
    assert total == pytest.approx(-values["approach@0"], rel=1e-4)


def test_a_thicker_coating_costs_so_much_time():
    """Where all of a coating is gone: V = k_s W - A c (k_s / k_c - 1), whatever the pressures."""
    steps = {"time": {"scheme": "implicit", "step": 5.0, "steps": 60}, "mesh.contact_elements": 24}
    case = rw.read_case(CASES / "wear_through.toml", steps)
    outputs, key = ["worn_volume_lower", "dissipated_energy"], "lower.layers[0].thickness"
    _, _, slopes = derivatives(case, [key], outputs)
    k_coating, k_body = 2e-8, 1e-7
    worked = k_body * slopes["dissipated_energy", key]
    expected = worked - case.area * (k_body / k_coating - 1.0)
    assert slopes["worn_volume_lower", key] == pytest.approx(expected, rel=1e-4)


def test_a_number_at_its_largest_is_moved_the_other_way():
    case = rw.read_case(PAPER, {**ADAPTIVE, "lower.poisson": 0.3})
    f = rw.function(case, ["wear.lower.k"], ["penetration"], derivatives=True)
    values, slopes = f({"wear.lower.k": [1e-7, -1.0]})
    assert np.isnan(values["penetration"]).tolist() == [False, True]
    assert np.isnan(slopes["penetration", "wear.lower.k"]).tolist() == [False, True]
    assert list(f.errors) == [1]


@pytest.mark.parametrize(
    ("inputs", "changes", "words"),
    [
        (["upper.r[1]"], {}, "upper.r"),
        (["load.pressure"], {"mesh.geometry": "updated"}, "mesh.geometry"),
    ],
)
def test_inputs_without_derivatives(inputs, changes, words):
    with pytest.raises(rw.InputError, match=words):
        rw.function(rw.read_case(PAPER, changes), inputs, ["penetration"], derivatives=True)
