"""Budgets: GUM's sums of squares, and draws of Monte Carlo against them."""

import numpy as np
import pytest

from ringwear_par.measuring.analysis.budget import Estimate, Source, shortest_interval


def product(us=(0.1, 0.02)):
    """Return the budget of x y at x = 10, y = 2."""
    sources = Source("x", "A", us[0], "m", 2.0), Source("y", "B", us[1], "m", 10.0)
    return Estimate(20.0, "m2", sources)


def test_a_budget_is_the_sum_of_squares():
    estimate = product()
    assert estimate.u == pytest.approx(np.hypot(0.2, 0.2))
    assert estimate.interval == pytest.approx((20.0 - 2 * estimate.u, 20.0 + 2 * estimate.u))
    assert [estimate.share(source) for source in estimate.sources] == pytest.approx([0.5, 0.5])
    scaled = estimate.scaled(1e4, "cm2")
    assert (scaled.value, scaled.u) == pytest.approx((2e5, 1e4 * estimate.u))


def test_what_is_certain_is_an_interval_of_no_width():
    assert Estimate(1.0, "1", ()).to_dict()["interval"] == [1.0, 1.0]
    certain = Estimate(1.0, "1", (Source("x", "B", 0.0, "1", 1.0),))
    assert certain.share(certain.sources[0]) == 0.0


def test_monte_carlo_is_gum_where_the_measurand_is_linear():
    estimate = product()
    low, high = shortest_interval(lambda x, y: x * y, (10.0, 2.0), (0.1, 0.02))
    half = 1.96 * estimate.u
    assert (low, high) == pytest.approx((20.0 - half, 20.0 + half), abs=0.05 * half)
    assert Estimate(20.0, "m2", estimate.sources, (low, high)).agrees


def test_monte_carlo_is_not_gum_where_it_is_not():
    """1/x with x known to 20 %: its distribution leans, which two standard uncertainties hide."""
    source = Source("x", "B", 0.2, "1", -1.0)
    shortest = shortest_interval(lambda x: 1.0 / x, (1.0,), (0.2,))
    estimate = Estimate(1.0, "1", (source,), shortest)
    assert shortest[0] > estimate.interval[0]
    assert shortest[1] > estimate.interval[1]
    assert not estimate.agrees


def test_the_shortest_interval_of_a_leaning_distribution_is_shorter_than_its_quantiles():
    low, high = shortest_interval(np.exp, (0.0,), (1.0,))
    assert high - low < np.exp(1.96) - np.exp(-1.96)
    # the mode of densities at both ends: equal for the shortest
    density = [np.exp(-0.5 * np.log(x) ** 2) / x for x in (low, high)]
    assert density[0] == pytest.approx(density[1], rel=0.15)
