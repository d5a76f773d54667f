"""Regression with errors that remember, and the steady part of records that are known."""

import numpy as np
import pytest
from rig_records import FORCE, RADIUS, RATE, RUNNING_IN, START, record
from scipy.signal import lfilter

from ringwear_par.measuring.analysis.steady_part import (
    Blocks,
    block_means,
    change_from,
    count_blocks,
    regress,
    steady_part,
    steady_start,
)


def test_uncertainties_count_what_errors_remember():
    """Means of AR(1) series scatter by sd sqrt((1 + phi)/(1 - phi)/n): white intervals miss it."""
    rng, n, phi, inside, white_inside = np.random.default_rng(3), 150, 0.7, 0, 0
    for _ in range(300):
        noise = lfilter([1.0], [1.0, -phi], rng.standard_normal(n + 50))[50:]
        found = regress(np.ones((n, 1)), noise)
        inside += abs(found.coefficients[0]) <= 2.0 * np.sqrt(found.covariance[0, 0])
        white_inside += abs(noise.mean()) <= 2.0 * noise.std() / np.sqrt(n)
    assert 0.91 <= inside / 300 <= 0.99
    assert white_inside / 300 < 0.75


def test_autocorrelation_is_that_of_the_errors():
    noise = lfilter([1.0], [1.0, -0.6], np.random.default_rng(1).standard_normal(20_000))
    assert regress(np.ones((20_000, 1)), noise).autocorrelation == pytest.approx(0.6, abs=0.02)
    trend = np.cumsum(np.ones(100))
    assert regress(np.ones((100, 1)), trend).autocorrelation == 0.95


def test_block_means():
    time = np.arange(0.0, 901.0)
    blocks = block_means(time, 2.0 * time)
    assert len(blocks.time) == count_blocks(901) == 200
    assert blocks.value == pytest.approx(2.0 * blocks.time)
    values = np.where((time > 300) & (time < 600), np.nan, 1.0)
    sparse = block_means(time, values)
    assert not ((sparse.time > 301) & (sparse.time < 599)).any()
    assert (sparse.value == 1.0).all()


@pytest.mark.parametrize("start", [0.0, 40.0])
def test_changes_of_a_parabola_and_of_a_line(start):
    time = np.linspace(0.0, 100.0, 101)
    change = change_from(Blocks(time, 5.0 + 0.3 * time + 0.01 * time**2), start, 2)
    middle = 0.5 * (start + 100.0)
    assert change.value == pytest.approx(0.3 + 0.02 * middle)
    assert change.change == pytest.approx(0.02 * (100.0 - start))
    change = change_from(Blocks(time, 5.0 + 0.3 * time), start, 1)
    assert (change.value, change.change) == pytest.approx((5.0 + 0.3 * middle, 0.3 * (100 - start)))


def test_steadiness_is_the_sd_of_a_uniform_distribution_as_wide_as_the_change():
    change = change_from(Blocks(np.arange(50.0), np.arange(50.0) ** 2), 0.0, 2)
    assert change.steadiness_u == pytest.approx((abs(change.change) + change.change_u) / 12**0.5)


def steady(duration, seed):
    """Return the part of a record, the rate in its middle with u, and the true one at its end."""
    hours, depths, torques = record(duration, seed)
    time = 3600.0 * hours
    wear = block_means(time, depths)
    friction = block_means(time, 1e3 * torques / (FORCE * RADIUS))
    part = steady_part(wear, friction, time[-1], wear_limit=0.15, friction_limit=0.05)
    change = change_from(wear, part.start, 2)
    true = RATE * (1.0 + (START - 1.0) * np.exp(-duration / RUNNING_IN))
    u = np.hypot(change.value_u, change.steadiness_u)
    return part, 3600.0 * change.value, 3600.0 * u, true


@pytest.mark.parametrize(
    ("duration", "least", "most"), [(2.5, 0.0, 0.0), (5.0, 0.0, 0.03), (10.0, 0.02, 0.3),
                                    (20.0, 1.0, 1.0)]
)  # fmt: skip
def test_short_and_noisy_records_are_not_steady_for_want_of_evidence(duration, least, most):
    records = [steady(duration, seed) for seed in range(40)]
    share = np.mean([part.steady for part, *_ in records])
    assert least <= share <= most
    if duration >= 10.0:
        near = [abs(rate - true) <= 2.0 * u for part, rate, u, true in records if part.steady]
        assert all(near)
    if duration == 20.0:
        bias = np.mean([rate / true - 1.0 for _, rate, _, true in records])
        assert 0.0 < bias < 0.03  # what is left of running-in


def test_fewer_than_twenty_blocks_are_never_steady():
    time = np.linspace(0.0, 100.0, 57)
    assert steady_start(block_means(time, time), 2, 0.15) is None


def test_the_later_of_both_counts_and_one_channel_is_enough():
    time = np.linspace(0.0, 100.0, 600)
    line = block_means(time, time + 0.01 * np.sin(time))
    falling = block_means(time, 1.0 + np.exp(-time / 8.0))
    both = steady_part(line, falling, 100.0, wear_limit=0.15, friction_limit=0.05)
    assert both.steady
    assert both.start == both.friction > both.wear
    alone = steady_part(line, None, 100.0, wear_limit=0.15, friction_limit=0.05)
    assert (alone.start, alone.friction) == (both.wear, None)
    never = steady_part(line, block_means(time, time), 100.0, wear_limit=0.15, friction_limit=0.05)
    assert (never.steady, never.of, never.wear) == (False, "last third", both.wear)
    assert never.start == pytest.approx(200.0 / 3.0)
    said = steady_part(line, None, 100.0, wear_limit=0.15, friction_limit=0.05, start=30.0)
    assert (said.steady, said.of, said.start) == (True, "given part", 30.0)
