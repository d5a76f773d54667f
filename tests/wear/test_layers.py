"""Elements in the layers of a body: which these are, and each by its own law."""

import numpy as np
import pytest
from parts import Table

from ringwear_par.wear.increment import Closing, WearIncrement
from ringwear_par.wear.laws.power import PowerLaw
from ringwear_par.wear.laws.running_in import RunningInLaw
from ringwear_par.wear.laws.threshold import ThresholdLaw
from ringwear_par.wear.layered import LayeredLaw, NoWear
from ringwear_par.wear.local_state import LocalState

N, STEP = 24, 5.0
R = np.linspace(28.5, 31.5, N)
COATING, UNDER, BODY = ThresholdLaw(2e-8, 30.0), PowerLaw(1e-10, 1.5), ThresholdLaw(3e-7)
PRESENT = np.arange(N) % 3
THICKNESSES = (1e-4, 2e-4)


def local(wear=0.0):
    speed = 3.5 * R
    return LocalState(0.0, R, speed, 0.1, np.full(N, wear), 0.0 * speed)


def law_of(laws, thicknesses=THICKNESSES):
    return LayeredLaw.of(thicknesses, laws[:-1], laws[-1])


def increment(laws, present=PRESENT, **more):
    law = law_of(laws).in_layers(present)
    return WearIncrement((law, None), (local(), local()), STEP, **more)


@pytest.mark.parametrize("short", [0.0, 1e-15, 5e-14])
def test_a_layer_of_which_round_off_is_left_is_worn_through(short):
    end = 1e-4
    law = law_of((COATING, BODY), (end,))
    assert (law.layers_at(np.full(N, end * (1.0 - short))) == 1).all()
    assert (law.layers_at(np.full(N, end * (1.0 - 1e-9))) == 0).all()


def test_layers_are_those_at_the_depth_that_is_worn_off():
    law = law_of((COATING, UNDER, BODY))
    layers = law.layers_at(np.array([0.0, 0.5e-4, 1e-4, 2.9e-4, 3e-4, 1.0]))
    assert layers.tolist() == [0, 0, 1, 1, 2, 2]
    np.testing.assert_allclose(law.end_of(layers), [1e-4, 1e-4, 3e-4, 3e-4, np.inf, np.inf])


CASES = {
    "one kind": (COATING, BODY, ThresholdLaw(5e-8, 10.0)),
    "several kinds": (COATING, UNDER, BODY),
    "powers": (UNDER, PowerLaw(1e-11, 2.0), PowerLaw(1e-9, 1.2)),
    "does not wear": (COATING, NoWear(), BODY),
    "remembers": (RunningInLaw(2e-8, 9e-8, 0.0, depth=1e-3), COATING, BODY),
    "in time": (ThresholdLaw(Table((0.0, 1.0), (1e-8, 2e-8)), 30.0), BODY, COATING),
}


@pytest.mark.parametrize("name", CASES)
def test_each_element_wears_by_the_law_of_its_layer(name):
    laws, p = CASES[name], np.linspace(0.0, 200.0, N)
    during = increment(laws)
    alone = [WearIncrement((law, None), (local(), local()), STEP) for law in laws]
    for method in ("depth", "d_depth_dp"):
        values = np.array([getattr(own, method)(p) for own in alone])
        expected = values[PRESENT, np.arange(N)]
        np.testing.assert_allclose(getattr(during, method)(p), expected, rtol=1e-13)


@pytest.mark.parametrize("closing", [False, True])
@pytest.mark.parametrize("name", CASES)
def test_depth_does_not_fall_and_has_its_slope_and_its_integral(name, closing):
    gap = np.where(np.arange(N) % 4 == 0, 3e-5, 0.0)
    more = {"closing": Closing(gap, np.full(N, STEP))} if closing else {}
    during = increment(CASES[name], **more)
    p = np.linspace(0.0, 200.0, 1001)[:, None] * np.ones(N)
    depths = np.array([during.depth(row) for row in p])
    assert (np.diff(depths, axis=0) >= -1e-18).all()
    rng = np.random.default_rng(2)
    tried, direction, h = rng.uniform(1.0, 200.0, N), rng.uniform(-1.0, 1.0, N), 1e-5
    change = (during.depth(tried + h * direction) - during.depth(tried - h * direction)) / (2 * h)
    off = np.abs(change - during.d_depth_dp(tried) * direction)
    assert np.median(off) <= 1e-6 * np.abs(change).max()
    assert (off <= 1e-4 * np.abs(change).max()).mean() > 0.9  # the others pass a kink
    rule = np.trapezoid if hasattr(np, "trapezoid") else np.trapz
    np.testing.assert_allclose(
        during.potential(p[-1]), rule(depths, p[:, 0], axis=0), rtol=2e-4, atol=1e-9
    )


def test_both_bodies_lose_what_the_share_of_the_step_leaves_them():
    """Energy, where a law is k mu p V: depths over k are the work of the time there is."""
    lower = law_of((ThresholdLaw(1e-8), ThresholdLaw(5e-8), ThresholdLaw(2e-7)))
    upper = law_of((ThresholdLaw(3e-8), ThresholdLaw(1e-7)), (5e-5,))
    layers = PRESENT, np.arange(N) % 2
    laws = lower.in_layers(layers[0]), upper.in_layers(layers[1])
    at, p = local(), np.linspace(10.0, 300.0, N)
    gap = np.where(np.arange(N) % 2 == 0, 2e-5, 0.0)
    during = WearIncrement(laws, (at, at), STEP, closing=Closing(gap, np.full(N, STEP)))
    inside = during.share(during.depth_if_always_in_contact(p))
    lost, work = during.depths(p), inside * STEP * at.power * p
    for law, present, depth in zip(laws, layers, lost, strict=True):
        k = np.array([own.k for own in law.laws])[present]
        np.testing.assert_allclose(depth / k, work, rtol=1e-13)
    np.testing.assert_allclose(lost.sum(axis=0), during.depth(p), rtol=1e-12, atol=1e-20)
