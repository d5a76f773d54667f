"""Friction that changes in time: wear, energy and torque count it, steps end where it bends."""

import numpy as np
import pytest
from parts import Table, bends, integral, key_numbers
from paths import CASES, PAPER

import ringwear_par as rw

K = 4e-7
MU = [[0.0, 0.1], [300.0, 0.1], [330.0, 0.25], [390.0, 0.05]]
STEPPINGS = {
    "adaptive": {"time.end": 450.0},
    "implicit": {"time.step": 5.0, "time.steps": 90},
    "explicit": {"time.step": 0.5, "time.steps": 900},
}


def case_of(scheme="adaptive", **changes):
    return rw.read_case(PAPER, {
        "mesh.contact_elements": 12, "mesh.grading": 1.5, "time.scheme": scheme,
        "wear.lower.p0": 0.0, "contact.friction": MU, **STEPPINGS[scheme], **changes,
    })  # fmt: skip


@pytest.mark.parametrize("scheme", STEPPINGS)
def test_worn_in_rings_wear_by_the_integral_of_friction(scheme):
    """Pressure c / r stays: all depths are k p V times the integral of mu."""
    case = case_of(scheme, **{"wear.lower.k": K})
    result = rw.simulate(case)
    time, wear = result.histories["time"], result.profiles["wear_lower"]
    start = int(np.searchsorted(time, 300.0))
    force, omega = case.load.force, case.load.omega
    a, b = case.contact
    depth = K * omega * force / (2.0 * np.pi * (b - a)) * integral(case.friction, 300.0, 450.0)
    np.testing.assert_allclose(wear[-1] - wear[start], depth, rtol=1e-4)
    torque = case.friction(time) * force * 0.5 * (a + b)
    np.testing.assert_allclose(result.histories["torque"][start:], torque[start:], rtol=5e-6)
    # force times distance
    slid = force * omega * 0.5 * (a + b) * time[-1]
    assert result.checkpoint.state.normal_work == pytest.approx(slid, rel=2e-3)
    assert result.attributes["balance_energy"] < 1e-12
    assert result.attributes["balance_volume"] < 1e-12


@pytest.mark.parametrize("every", [1, 10**6])
def test_a_specific_wear_rate_counts_sliding_without_friction(every):
    """Archard's law knows no friction: its k is the specific wear rate, however much is stored."""
    case = rw.read_case(CASES / "archard.toml", {
        "contact.friction": [[0.0, 0.0], [50.0, 0.0], [50.1, 0.1]], "output.every": every,
    })  # fmt: skip
    rates = [n.value for n in key_numbers(rw.simulate(case)) if n.name == "lower_specific_rate"]
    assert rates == pytest.approx([1e3 * case.laws[0].values["k"]], rel=1e-9)


def test_steps_end_where_friction_bends_and_nowhere_for_a_smooth_curve():
    result = rw.simulate(case_of())
    assert {300.0, 330.0, 390.0} <= set(result.histories["time"].tolist())
    t = np.linspace(0.0, 450.0, 300)
    curve = [[*point] for point in zip(t.tolist(), (0.15 - 0.04 * np.exp(-t / 80.0)).tolist(),
                                       strict=True)]  # fmt: skip
    assert case_of(**{"contact.friction": curve}).breakpoints == ()
    negative = Table(tuple(t.tolist()), tuple(-v for _, v in curve))
    assert bends(negative) == (450.0,)


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("coated", {}),
        ("wear_through", {}),
        ("paper", {"wear.upper.law": "archard", "wear.upper.k": 1e-8}),
        ("paper", {"load.control": "displacement", "load.displacement": 0.05,
                   "load.pressure": None}),
    ],
)  # fmt: skip
def test_balances_hold_with_two_bodies_coatings_and_at_a_displacement(name, changes):
    table = [[0.0, 0.05], [20.0, 0.2], [60.0, 0.1]]
    case = rw.read_case(CASES / f"{name}.toml", {"contact.friction": table, **changes})
    result = rw.simulate(case)
    for balance in ("force", "volume", "energy", "residual"):
        assert result.attributes[f"balance_{balance}"] < 1e-10


def test_volume_per_energy_is_no_constant_of_a_law_without_friction():
    """Of k p V it changes with friction, of k mu p V it does not."""
    archard = rw.simulate(rw.read_case(CASES / "archard.toml", {"contact.friction": MU}))
    assert archard.attributes["energy_identity"] == 0
    assert rw.simulate(case_of()).attributes["energy_identity"] == 1
