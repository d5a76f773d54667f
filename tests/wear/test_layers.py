"""A step that wears through layers: how its time divides, and what a contact asks of it."""

from dataclasses import replace

import numpy as np
import pytest

from ringwear_par.contact.problem import on_curve
from ringwear_par.wear.increment import Closing, WearIncrement
from ringwear_par.wear.laws.power import PowerLaw
from ringwear_par.wear.laws.running_in import RunningInLaw
from ringwear_par.wear.laws.threshold import ThresholdLaw

from ringwear_par.wear.layered import LayeredLaw
from ringwear_par.wear.local_state import LocalState

N, STEP = 24, 5.0
R = np.linspace(28.5, 31.5, N)
COATING, UNDER, BODY = ThresholdLaw(2e-8, 30.0), PowerLaw(1e-10, 1.5), ThresholdLaw(3e-7)


def local(wear=0.0):
    speed = 3.5 * R
    return LocalState(0.0, R, speed, 0.1, np.full(N, wear), 0.0 * speed)


def increment(laws, wear=0.0, thicknesses=(1e-4, 2e-4), **more):
    law = LayeredLaw.of(thicknesses, laws[:-1], laws[-1])
    return WearIncrement((law, None), (local(wear), local(wear)), STEP, **more)


@pytest.mark.parametrize("short", [0.0, 1e-15, 5e-14])
def test_a_layer_of_which_round_off_is_left_is_worn_through_in_the_step_and_after_it(short):
    end = 1e-4
    worn = np.full((2, 1), end * (1.0 - short))
    gone = split(worn, np.full((1, 1), end), 1.0)
    law = LayeredLaw.of((end,), (COATING,), BODY)
    assert gone.worn_through.all()
    assert gone.depths[0] == end
    assert (law.remaining(worn[0]) == 0.0).all()
    assert (law.present(worn[0]) == 1).all()


def test_time_divides_among_all_layers_that_a_step_passes():
    full = np.array([[1.0, 1.0, 0.0, 4.0], [2.0, 2.0, 1.0, 6.0], [8.0, 8.0, 8.0, 8.0]])
    left = np.array([[2.0, 0.5, 1.0, 1.0], [1.0, 1.0, 1.0, 3.0]])
    gone = split(full, left, 1.0)
    np.testing.assert_allclose(gone.times.sum(axis=0), 1.0, rtol=1e-15)
    np.testing.assert_allclose(
        gone.depths, [[1.0, 0.5, 0.0, 1.0], [0.0, 1.0, 0.0, 3.0], [0.0, 0.0, 0.0, 2.0]], rtol=1e-15
    )
    np.testing.assert_allclose(gone.depths, gone.times * full, rtol=1e-15)
    # a share that ends at an interface gets there
    share = np.array([0.1, 0.3, 0.7]) / np.array([0.3, 0.7, 0.9])
    a, c = np.array([[0.3, 0.7, 0.9], [1.0, 1.0, 1.0]]), np.array([[0.1, 0.3, 0.7]])
    assert split(a, c, share).worn_through.all()


def test_derivatives_of_a_passage_are_those_of_its_depth():
    rng = np.random.default_rng(1)
    full, left = rng.uniform(0.1, 2.0, (3, N)), rng.uniform(0.0, 1.0, (2, N))
    d_full, d_left, d_share = rng.normal(size=(3, N)), rng.normal(size=(2, N)), rng.normal(size=N)
    share = rng.uniform(0.5, 2.0, N)

    def depth(h):
        return split(full + h * d_full, left + h * d_left, share + h * d_share).depths.sum(axis=0)

    found = d_split(full, d_full, split(full, left, share), share, d_share, d_left)
    np.testing.assert_allclose((depth(1e-7) - depth(-1e-7)) / 2e-7, found, rtol=1e-6, atol=1e-7)


CASES = {
    "through two": ((COATING, UNDER, BODY), 0.0),
    "begun": ((COATING, UNDER, BODY), 0.5e-4),
    "soft under hard": ((BODY, COATING, BODY), 0.0),
    "little left": ((COATING, BODY, BODY), 1e-4 - 1e-9),
    "remembers": ((RunningInLaw(2e-8, 9e-8, 0.0, depth=1e-3), COATING, BODY), 0.2e-4),
}


@pytest.mark.parametrize("closing", [False, True])
@pytest.mark.parametrize("name", CASES)
def test_depth_does_not_fall_and_has_its_slope_and_its_integral(name, closing):
    laws, wear = CASES[name]
    gap = np.where(np.arange(N) % 3 == 0, 3e-5, 0.0)
    more = {"closing": Closing(gap, np.full(N, STEP))} if closing else {}
    during = increment(laws, wear, **more)
    p = np.linspace(0.0, 200.0, 4001)[:, None] * np.ones(N)
    depths = np.array([during.depth(row) for row in p])
    assert (np.diff(depths, axis=0) >= -1e-18).all()
    rng = np.random.default_rng(2)
    tried, direction, h = rng.uniform(1.0, 200.0, N), rng.uniform(-1.0, 1.0, N), 1e-5
    change = (during.depth(tried + h * direction) - during.depth(tried - h * direction)) / (2 * h)
    off = np.abs(change - during.d_depth_dp(tried) * direction)
    assert np.median(off) <= 1e-6 * np.abs(change).max()
    assert (off <= 1e-4 * np.abs(change).max()).mean() > 0.9  # the others pass an interface
    rule = np.trapezoid if hasattr(np, "trapezoid") else np.trapz
    np.testing.assert_allclose(
        during.potential(p[-1]), rule(depths, p[:, 0], axis=0), rtol=2e-4, atol=1e-9
    )


def test_both_bodies_lose_what_the_share_of_the_step_leaves_them():
    """Energy, where a law is k mu p V: depths by layer over k are the work of the time there is."""
    lower = LayeredLaw.of(
        (1e-4, 2e-4), (ThresholdLaw(1e-8), ThresholdLaw(5e-8)), ThresholdLaw(2e-7)
    )
    upper = LayeredLaw.of((5e-5,), (ThresholdLaw(3e-8),), ThresholdLaw(1e-7))
    at, p = local(), np.linspace(10.0, 300.0, N)
    gap = np.where(np.arange(N) % 2 == 0, 2e-5, 0.0)
    during = WearIncrement((lower, upper), (at, at), STEP, closing=Closing(gap, np.full(N, STEP)))
    inside = during.share(during.depth_in_present_layer(p))
    lost, work = during.depths(p), inside * STEP * at.power * p
    for law, depth in zip((lower, upper), lost, strict=True):
        starts = np.concatenate([[[0.0]], law.depths])
        ends = np.append(law.depths, [[np.inf]], axis=0)
        parts = np.clip(depth, starts, ends) - starts
        by_layer = sum(part / own.k for part, own in zip(parts, law.laws, strict=True))
        np.testing.assert_allclose(by_layer, work, rtol=1e-13)
    np.testing.assert_allclose(lost.sum(axis=0), during.depth(p), rtol=1e-15)
    np.testing.assert_allclose(during.integrated_rates(p, lost, inside), lost, rtol=1e-14)


def test_layers_of_one_law_are_no_layers():
    at, p = local(), np.linspace(0.0, 300.0, N)
    plain = WearIncrement((BODY, None), (at, at), STEP)
    layered = increment((BODY, BODY, BODY))
    np.testing.assert_allclose(layered.depths(p), plain.depths(p), rtol=1e-14)
    np.testing.assert_allclose(layered.d_depth_dp(p), plain.d_depth_dp(p), rtol=1e-13)


def test_a_step_is_put_back_on_a_curve_that_almost_jumps():
    """1e-10 mm of a coating left that does not wear below 60 MPa, on a body that does."""
    during = increment((ThresholdLaw(1e-8, 60.0), BODY), 1e-4 - 1e-10, (1e-4,))
    ones = np.ones(N)
    scale, weight = ones, 1e6 * ones
    before, after = 59.0 * ones, 64.0 * ones
    there = on_curve(during, before, after, scale, weight)
    total = after + weight * during.depth(before)
    np.testing.assert_allclose(there + weight * during.depth(there), total, rtol=1e-8)
    assert (during.depth(there) < 1e-5).all()
    assert (during.depth(after) > 3e-4).all()
    straight = replace(during, laws=(BODY, None))
    assert on_curve(straight, before, after, scale, weight) is after
