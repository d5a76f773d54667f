"""Histories that wear through layers: balances, accuracy, thresholds."""

import numpy as np
import pytest
from paths import CASES
from tracing import ALONE, trace

import ringwear_par as rw
from ringwear_par.history.elastic import assemble
from ringwear_par.history.layers import layer_left, layer_volumes

CASE = CASES / "wear_through.toml"
LAYER = {"thickness": 0.003, "young": 10e3, "poisson": 0.3}
SOFT = {"law": "threshold", "k": 1e-7, "p0": 0.0}
FIXED = {"time.scheme": "implicit", "time.end": None}
SCHEMES = {
    "adaptive": {"time.end": 120.0},
    "implicit": {**FIXED, "time.step": 4.0, "time.steps": 30},
    "explicit": {**FIXED, "time.scheme": "explicit", "time.step": 0.5, "time.steps": 240},
}


def case_of(layer=None, layers=None, **changes):
    """A small case whose layers have the body's own moduli."""
    own = {"wear": {"law": "threshold", "k": 2e-8}, **LAYER, **(layer or {})}
    keys = {"lower.layers": [own] if layers is None else layers, "mesh.contact_elements": 24}
    return rw.read_case(CASE, {**keys, "mesh.grading": 1.5, **changes})


@pytest.fixture(scope="module")
def pair():
    return assemble(case_of(), ALONE)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_energy_goes_into_the_layers_one_after_the_other(pair, scheme):
    """V_c / k_c + V_s / k_s is the energy, of both bodies, through two layers of lower."""
    two = [{**LAYER, "thickness": 5e-4, "wear": {**SOFT, "k": 3e-7}}, {**LAYER, "wear": SOFT}]
    upper = [{**LAYER, "thickness": 2e-4, "wear": {**SOFT, "k": 1e-8}}]
    case = case_of(
        layers=two, **{"upper.layers": upper, "wear.upper.law": "archard", "wear.upper.k": 2e-9},
        **{"wear.lower.k": 4e-7}, **SCHEMES[scheme],
    )  # fmt: skip
    history = trace(case, pair)
    last, area = history.last, history.line.area
    assert history.balances.energy < 1e-12
    ends = [body.ends for body in history.block.wearing]
    lower, upper = (layer_volumes(area, ends[i], last.wear[i][None])[0] for i in (0, 1))
    energy = lower / [3e-7, 1e-7, 4e-7]
    assert energy.sum() == pytest.approx(last.energy, rel=1e-12)
    assert (upper / [1e-8, 2e-9 / 0.1]).sum() == pytest.approx(last.energy, rel=1e-12)
    assert (energy > 0.01 * last.energy).all()  # it is in the body itself by now
    assert np.isfinite(last.through).all()
    for i in (0, 1):
        left = [(s.time, layer_left(ends[i], s.wear[i][None]).min()) for s in history.states]
        before = [time for time, least in left if least > 0.0]
        after = [time for time, least in left if least <= 0.0]
        assert before[-1] <= last.through[i] <= after[0]


@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_layer_that_wears_as_the_body_is_none(pair, scheme):
    layered = trace(case_of({"wear": SOFT}, **SCHEMES[scheme]), pair)
    plain = trace(case_of(layers=[], **SCHEMES[scheme]), pair)
    near = {"atol": 5e-6} if scheme == "adaptive" else {"rtol": 1e-6}
    np.testing.assert_allclose(layered.last.wear, plain.last.wear, **near)
    assert layered.last.energy == pytest.approx(plain.last.energy, rel=1e-5)


def test_nothing_wears_under_a_layer_of_a_body_that_does_not(pair):
    own, wear = {"wear": {**SOFT, "k": 4e-7}}, {"wear.lower": None}
    last = trace(case_of(own, **wear, **{"time.end": 30.0}), pair).last
    assert (last.layer == 1).all()
    assert last.wear[0] == pytest.approx(0.003, rel=1e-9)


@pytest.mark.parametrize("factor", [1.0, 1.02])
def test_no_thin_layer_is_passed_over(pair, factor):
    """Though it wears like the one above: the body below wears 50 times as fast."""
    of_thick, of_thin = ({"law": "threshold", "k": k} for k in (2e-8, factor * 2e-8))
    two = [
        {**LAYER, "thickness": 2.8e-3, "wear": of_thick},
        {**LAYER, "thickness": 2e-4, "wear": of_thin},
    ]
    keys = {"wear.lower.k": 1e-6, **SCHEMES["adaptive"]}
    history = trace(case_of(layers=two, **keys), pair)
    assert history.balances.energy < 1e-12
    if factor == 1.0:
        one = trace(case_of(**keys), pair)
        np.testing.assert_allclose(history.last.wear, one.last.wear, atol=5e-6)


def test_an_element_at_the_end_of_its_layer_but_for_round_off_is_in_the_next(pair):
    keys = {**FIXED, "time.scheme": "explicit", "time.step": 0.02, "time.steps": 1}
    plain = trace(case_of({"thickness": 1.0}, **keys), pair).last
    element = plain.wear[0].argmax()
    layer = {"thickness": float(plain.wear[0, element]) * (1.0 + 2e-14)}
    last = trace(case_of(layer, **{"wear.lower.k": 1e-6}, **keys), pair).last
    assert last.rates[0, element] == pytest.approx(50.0 * plain.rates[0, element], rel=1e-3)
    assert last.through[0] == pytest.approx(0.02)


@pytest.mark.parametrize(
    ("p0", "k", "of_body", "end"),
    [
        (0.0, 2e-8, 1e-7, 160.0),
        (85.0, 2e-8, 1e-7, 160.0),
        (110.0, 4e-8, 1e-6, 160.0),  # islands near their threshold, and what is under them at once
        (120.0, 3e-8, 5e-7, 400.0),
    ],
)
def test_adaptive_steps_find_when_elements_get_through(pair, p0, k, of_body, end):
    """Within 0.02 um of a converged history at any time, the mean pressure being 80 MPa."""
    times = np.linspace(end / 80, end, 80).tolist()
    wear = {"wear": {**SOFT, "k": k, "p0": p0}}
    case = case_of(wear, **{"time.end": end, "output.times": times, "wear.lower.k": of_body})

    def depths(tolerance):
        history = trace(case.replace({"time.tolerance": tolerance}), pair)
        return np.array([history.at(time).wear[0] for time in times]), history

    found, history = depths(1e-5)
    exact, fine = depths(2e-7)
    assert np.abs(found - exact).max() < 2e-5
    assert ((exact > 0.003).sum(axis=1) > 1).any()
    assert history.last.through[0] == pytest.approx(fine.last.through[0], rel=0.02)
    assert history.steps < 400


@pytest.mark.parametrize("step", [2.0, 60.0])
@pytest.mark.parametrize("p0", [60.0, 79.0, 100.0, 150.0])
def test_a_threshold_above_the_pressure_fails_no_step(pair, p0, step):
    """The load is borne by islands of the coating, at its threshold, as the body recedes."""
    case = case_of(
        {"wear": {**SOFT, "k": 1e-7, "p0": p0}, "thickness": 0.001},
        **{**FIXED, "time.step": step, "time.steps": 30, "wear.lower.k": 3e-7},
    )
    history = trace(case, pair)
    assert history.balances.force < 1e-8
    through = layer_left(history.block.wearing[0].ends, history.last.wear[:1]) <= 0.0
    assert through.any()
    assert (np.diff([state.wear[0] for state in history.states], axis=0) >= 0.0).all()
