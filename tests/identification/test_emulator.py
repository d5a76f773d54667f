"""Emulators of readings: exact on polynomials, honest about errors, silent where nothing is."""

import numpy as np
import pytest
from linear_tests import box_of

from ringwear_par.identification.emulator import Box, emulate, nearness, orders_of

BOX = box_of([0.0, -2.0], [1.0, 2.0])
RNG = np.random.default_rng(0)


def within(count):
    """Return points (count, 2) in the box."""
    return RNG.uniform(BOX.low, BOX.high, (count, 2))


def cubic(x):
    """Return three readings, cubic in two unknowns."""
    a, b = x.T
    return np.column_stack([1 + a - b + a * b**2, 2e-3 * (a**3 - 3 * b), 50 * a * b - b**3])


def bent(x):
    """Return two readings that are no polynomials."""
    a, b = x.T
    return np.column_stack([np.exp(-2.0 * a) * np.cos(b), 1.0 / (1.5 + a + 0.4 * b)])


def test_polynomials_are_exact():
    points, sd = BOX.design(96), np.array([0.1, 1e-4, 5.0])
    found, left_out = emulate(BOX, points, cubic(points), sd, np.ones(96), 1e-9)
    assert (found.degree, found.error < 1e-9) == (3, True)
    x = within(200)
    np.testing.assert_allclose(found(x), cubic(x), atol=1e-9)
    np.testing.assert_allclose(left_out, cubic(points), atol=1e-8)
    assert len(orders_of(2, 3)) == 10


@pytest.mark.parametrize("tolerance", [1.0, 0.1, 1e-6])
def test_errors_at_points_left_out_are_those_at_new_ones(tolerance):
    points, sd, x = BOX.design(96), np.full(2, 0.01), within(2000)
    found, _ = emulate(BOX, points, bent(points), sd, np.ones(96), tolerance)
    true = np.sqrt(np.square((found(x) - bent(x)) / sd).mean(axis=0).max())
    assert found.error < max(tolerance, 0.02)  # the least of 96 points
    assert 0.5 < found.error / true < 4.0  # points are denser at faces, where errors are largest


def test_points_far_from_the_data_count_less():
    assert nearness(np.array([0.0, 1.0, 4.9])) == pytest.approx(1.0)
    assert nearness(np.array([1.0] * 20 + [50.0]))[-1] == pytest.approx(0.01)


def test_boxes_lie_along_correlations():
    low, high = np.array([-10.0, 0.0]), np.array([10.0, 1e-3])
    along = RNG.uniform(-8.0, 8.0, 500)
    draws = np.column_stack([along, 5e-4 + 5e-5 * along + 1e-6 * RNG.standard_normal(500)])
    box = Box.about(draws, low, high, 0.1)
    assert box.holds(draws).all()
    # an axis-parallel one is as large as the bounds of the draws
    assert 4 * abs(np.linalg.det(box.axes)) < 0.03 * np.ptp(draws, axis=0).prod()
    points = box.design(64)
    assert len(points) == 64
    assert box.holds(points).all()
    assert not box.holds(np.array([-5.0, 7e-4]))
    outer = Box.about(RNG.uniform(low, high, (500, 2)), low, high, 0.1)
    assert not outer.holds(np.array([10.1, 5e-4]))  # within the box, beyond a bound
    assert (outer.design(256) <= high).all()


def test_there_are_no_readings_near_histories_that_fail():
    points, x = BOX.design(96), within(2000)
    readings = np.where(points[:, :1] > 0.7, np.nan, bent(points))
    found, left_out = emulate(BOX, points, readings, np.full(2, 0.01), np.ones(
        int((points[:, 0] <= 0.7).sum())), 1e-6)  # fmt: skip
    assert np.isnan(left_out[points[:, 0] > 0.7]).all()
    held = found.holds(x)
    assert held[x[:, 0] < 0.5].all()
    assert not held[x[:, 0] > 0.85].any()
    assert np.abs(found(x[x[:, 0] < 0.5]) - bent(x[x[:, 0] < 0.5])).max() < 5e-3
