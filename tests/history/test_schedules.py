"""Speeds and friction that change in time, steps that are given, and paces of wear in them."""

import itertools

import numpy as np
import pytest
from parts import Table, bends, integral, key_numbers, results_of
from paths import CASES, PAPER
from tracing import ALONE, trace

import ringwear_par as rw
from ringwear_par.history.elastic import assemble

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
    (result,) = results_of([case], ALONE)
    time, wear = result.histories["time"], result.profiles["wear_lower"]
    start = int(np.searchsorted(time, 300.0))
    force, omega = case.load.force, case.load.omega
    a, b = case.contact
    depth = K * omega * force / (2.0 * np.pi * (b - a)) * integral(case.friction, 300.0, 450.0)
    np.testing.assert_allclose(wear[-1] - wear[start], depth, rtol=2e-4)
    torque = case.friction(time) * force * 0.5 * (a + b)
    np.testing.assert_allclose(result.histories["torque"][start:], torque[start:], rtol=1e-5)
    # force times distance
    slid = force * omega * 0.5 * (a + b) * time[-1]
    assert result.last_state.normal_work[0] == pytest.approx(slid, rel=2e-3)
    assert result.attributes["balance_energy"] < 1e-12


@pytest.mark.parametrize("every", [1, 10**6])
def test_a_specific_wear_rate_counts_sliding_without_friction(every):
    """Archard's law knows no friction: its k is the specific wear rate, however much is stored."""
    case = rw.read_case(CASES / "archard.toml", {
        "contact.friction": [[0.0, 0.0], [50.0, 0.0], [50.1, 0.1]], "output.every": every,
    })  # fmt: skip
    result = rw.simulate(case, ALONE)
    rates = [n.value for n in key_numbers(result) if n.name == "lower_specific_rate"]
    assert rates == pytest.approx([1e3 * case.laws[0][0].values["k"]], rel=1e-9)


def test_steps_end_where_friction_bends_and_nowhere_for_a_smooth_curve():
    assert {300.0, 330.0, 390.0} <= set(trace(case_of()).times)
    t = np.linspace(0.0, 450.0, 300)
    mu = (0.15 - 0.04 * np.exp(-t / 80.0)).tolist()
    curve = [[*point] for point in zip(t.tolist(), mu, strict=True)]
    assert case_of(**{"contact.friction": curve}).breakpoints == ()
    assert bends(Table(tuple(t.tolist()), tuple(-v for v in mu))) == (450.0,)


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
    (result,) = results_of([case], ALONE)
    assert result.attributes["balance_force"] < 1e-8
    assert result.attributes["balance_energy"] < 1e-10


def test_volume_per_energy_is_no_constant_of_a_law_without_friction():
    """Of k p V it changes with friction, of k mu p V it does not."""
    archard = rw.read_case(CASES / "archard.toml", {"contact.friction": MU})
    assert rw.simulate(archard, ALONE).attributes["energy_identity"] == 0
    assert rw.simulate(case_of(), ALONE).attributes["energy_identity"] == 1


def test_distance_and_energy_are_integrals_of_the_speed():
    """Steps end neither where it bends nor only at its start."""
    keys = {"load.omega": [[0.0, 1.0], [10.0, 3.0], [25.0, 0.5]], "mesh.contact_elements": 16,
            "time.step": 3.0, "time.steps": 11}  # fmt: skip
    result = rw.simulate(rw.read_case(PAPER, keys), ALONE)
    found, time = result.histories, result.histories["time"]
    first, then = np.minimum(time, 10.0), np.clip(time - 10.0, 0.0, 15.0)
    angle = first + 0.1 * first**2 + 3.0 * then - then**2 / 12.0 + 0.5 * np.maximum(time - 25.0, 0)
    distance = result.to_xarray()["sliding_distance"].values
    assert distance == pytest.approx(0.030 * angle, rel=1e-12)
    work = found["torque"][1:] * np.diff(angle)  # of implicit steps, at pressures of their ends
    assert np.diff(found["dissipated_energy"]) == pytest.approx(work, rel=1e-12)


def test_pulses_far_shorter_than_a_step_wear_as_their_angle_says():
    pulses = [[0.0, 0.0], [10.0, 0.0], [10.1, 50.0], [10.2, 50.0], [10.3, 0.0]]
    keys = {"load.omega": pulses, "time.step": 4.0, "time.steps": 5, "contact.friction": 0.1}
    history = trace(case_of("implicit", **keys, **{"wear.lower.k": 1e-13}))
    # so little wear leaves the pressure alone
    slid = history.line.r * 50.0 * 0.2
    exact = 1e-14 * history.states[0].pressure * slid
    assert history.last.wear[0] == pytest.approx(exact, rel=1e-3)


def test_steps_that_are_given():
    case = case_of()
    pair = assemble(case, ALONE)
    alone = trace(case, pair)
    again = trace(case, pair, step_times=alone.times[1:])
    assert again.times == alone.times
    assert again.last.wear == pytest.approx(alone.last.wear, rel=1e-6)
    ends = alone.times
    twice = sorted([*ends[1:], *(0.5 * (a + b) for a, b in itertools.pairwise(ends))])
    assert trace(case, pair, step_times=twice).times[1:] == twice


ENDS = np.array([2.0, 5.0, 15.0, 40.0, 60.0, 100.0])
FACTORS = np.array([0.5, 2.0, 1.3, 0.2, 1.0, 0.7])
CLOCK = np.cumsum(FACTORS * np.diff(ENDS, prepend=0.0))
PACED = {
    "threshold": {"wear.lower.k": 1e-7, "wear.lower.p0": 20.0},
    "both bodies": {"wear.lower.k": 1e-7, "wear.upper.law": "archard", "wear.upper.k": 5e-8},
    "through a layer": {
        "wear.lower.k": 1e-6, "lower.layers": [
            {"thickness": 2e-3, "young": 2e5, "poisson": 0.3, "wear": {"law": "archard", "k": 2e-7}}
        ],
    },
}  # fmt: skip


@pytest.mark.parametrize("law", PACED)
def test_a_pace_is_another_clock(law):
    changes = {
        "load.pressure": 60.0, "time.scheme": "adaptive", "time.step": None, "time.steps": None,
        "mesh.contact_elements": 16, **PACED[law],
    }  # fmt: skip
    case = rw.read_case(PAPER, {**changes, "time.end": ENDS[-1]})
    other = case.replace({"time.end": CLOCK[-1]})
    paces = [np.stack([FACTORS, FACTORS]), np.ones((2, len(ENDS)))]
    paced, even = results_of([case] * 2, ALONE, step_times=[ENDS] * 2, paces=paces)
    (on_clock,) = results_of([other], ALONE, step_times=[CLOCK])
    (plain,) = results_of([case], ALONE, step_times=[ENDS])
    for name in ("penetration", "worn_volume_lower", "worn_volume_upper", "torque"):
        expected = on_clock.histories[name]
        assert paced.histories[name] == pytest.approx(expected, rel=2e-5, abs=1e-9)
        exact = plain.histories[name]
        assert even.histories[name] == pytest.approx(exact, rel=1e-9, abs=1e-12)
