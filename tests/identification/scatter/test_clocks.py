"""The random clock of wear against dense covariances: kernels, blocks, what is smoothed."""

from dataclasses import replace

import numpy as np
import pytest

from ringwear_par.identification.definition.problem import Series
from ringwear_par.identification.model.noise import whitened
from ringwear_par.identification.scatter.likelihood import LinearisedTest, reduce_test
from ringwear_par.identification.scatter.linearisation import Blocks, projected_precision
from ringwear_par.identification.scatter.linearisation import TestClocks as Clocks

SIZE = 0.04


def record(n, correlation_time=0.0, excluded=()):
    x = np.linspace(1.0, 100.0, n)
    keep = np.ones(n, dtype=bool)
    for low, high in excluded:
        keep &= (x < low) | (x > high)
    x = x[keep]
    return Series(
        "z", "penetration", x, np.zeros(len(x)), np.full(len(x), 0.2),
        correlation_time=correlation_time, excluded=tuple(excluded),
    )  # fmt: skip


def rates(n, rng):
    """How readings answer to their clock, and where it is."""
    return rng.uniform(0.7, 1.3, (n, 1)), np.linspace(0.1, 15.0, n)[:, None]


def covariance_of(series):
    apart = np.abs(np.subtract.outer(series.x, series.x))
    time = series.correlation_time
    return np.outer(series.sd, series.sd) * (np.exp(-apart / time) if time else apart == 0.0)


def test_series_share_a_clock_beside_noise_in_time():
    """A record with AR(1) noise and a weighing, against their dense covariance."""
    rng = np.random.default_rng(2)
    both = [
        record(30, 4.0),
        replace(record(1), name="m", quantity="mass.lower", x=np.array([90.0])),
    ]
    answer, depth = rates(31, rng)
    clocks = Clocks(both, np.full(31, 0.2), np.ones(31), answer, depth)
    noise = np.zeros((31, 31))
    noise[:30, :30], noise[30, 30] = covariance_of(both[0]), 0.04
    whole = noise + SIZE * np.outer(answer, answer) * np.minimum.outer(depth[:, 0], depth[:, 0])
    (kernel,) = clocks.kernels
    white = np.linalg.slogdet(np.eye(31) + SIZE * kernel)[1]
    assert white == pytest.approx(np.linalg.slogdet(whole)[1] - np.linalg.slogdet(noise)[1])


@pytest.mark.parametrize("correlation_time", [0.0, 20.0])
def test_blocks_have_the_covariance_of_their_readings(correlation_time):
    """1,500 readings in 500 blocks, whatever the noise, beside a weighing."""
    n, rng = 1500, np.random.default_rng(4)
    both = [record(n, correlation_time), replace(record(1), x=np.array([50.0]))]
    answer, depth = rates(n + 1, rng)
    depth[n] = depth[749]
    sd, roots = rng.uniform(0.1, 0.3, n + 1), rng.uniform(0.5, 1.0, n + 1)
    clocks = Clocks(both, sd, roots, answer, depth)

    def of_blocks(rows):
        white = np.concatenate([whitened(both[0], rows[:n]), rows[n:]])
        return clocks.combine(roots[:, None] * white)

    half = of_blocks(answer / sd[:, None] * np.minimum.outer(depth[:, 0], depth[:, 0]))
    kernel = of_blocks((half * answer[:, 0] / sd).T)
    assert len(kernel) == 501 + (correlation_time > 0.0)
    assert clocks.kernels[0] == pytest.approx(kernel, rel=1e-9, abs=1e-12 * kernel.max())


def linearised(series, clocks, jacobian, z):
    rows = clocks.combine(np.column_stack([z, jacobian, np.ones(series.n)]) / series.sd[:, None])
    return LinearisedTest(
        rows[:, 0], rows[:, 1:2], rows[:, 2:], np.zeros((0, 1)), np.zeros(0), 0.0, clocks.kernels
    )


def test_blocks_say_the_same():
    """1,500 readings in 500 blocks: the information on k, and the likelihood of sizes."""
    rng = np.random.default_rng(3)
    n, excluded = 1500, ((40.0, 50.03),)
    series = record(n, excluded=excluded)
    answer, depth = np.ones((series.n, 1)), 0.15 * series.x[:, None]
    z = depth[:, 0] + np.cumsum(rng.normal(0.0, np.sqrt(SIZE * 0.01), series.n))
    z += 0.2 * rng.standard_normal(series.n)
    clocks = Clocks([series], series.sd, np.ones(series.n), answer, depth)
    test = linearised(series, clocks, depth, z)
    assert 440 < len(test.readings) < 510
    assert np.searchsorted(series.x, 45.0) in Blocks.of(series, series.sd).first
    sizes = np.array([[0.25 * SIZE], [SIZE], [4.0 * SIZE]])
    found = reduce_test(test, sizes)
    loss, lost = [], []
    for of_blocks, (size,) in zip(found, sizes, strict=True):
        whole = 0.04 * np.eye(series.n) + size * np.minimum.outer(depth[:, 0], depth[:, 0])
        inverse = np.linalg.inv(whole)
        columns = np.column_stack([depth[:, 0], np.ones(series.n)])
        normal = columns.T @ inverse @ columns
        rest = z - columns @ np.linalg.solve(normal, columns.T @ inverse @ z)
        information = normal[0, 0] - normal[0, 1] ** 2 / normal[1, 1]
        loss.append(rest @ inverse @ rest + np.linalg.slogdet(whole)[1] + np.log(normal[1, 1]))
        assert of_blocks.information[0, 0] == pytest.approx(information, rel=2e-3)
        best = of_blocks.square - of_blocks.score[0] ** 2 / of_blocks.information[0, 0]
        lost.append(best + of_blocks.log_volume + of_blocks.log_nuisances - loss[-1])
    # what differences within blocks say of the size has a sd of some 0.7
    assert np.diff(lost) == pytest.approx([0.0, 0.0], abs=1.5)
    assert np.abs(np.diff(loss)).min() > 20.0


def test_what_a_body_has_worn_more_is_the_conditional_mean():
    rng = np.random.default_rng(5)
    series = record(40)
    answer, depth = rates(40, rng)
    jacobian, z = answer[:, 0] * depth[:, 0], rng.standard_normal(40)
    clocks = Clocks([series], series.sd, np.ones(40), answer, depth)
    test = linearised(series, clocks, jacobian, z)
    # k is known to 0.1, an offset not at all: as a prior that is very wide
    precision = projected_precision(test, [SIZE], np.array([[0.0]]))
    excess, sd = clocks.smoothed([SIZE], precision @ test.readings, precision)
    shared = SIZE * np.minimum.outer(depth[:, 0], depth[:, 0])
    across = shared * answer[:, 0]
    whole = 0.04 * np.eye(40) + answer * across + 1e6
    expected = across @ np.linalg.solve(whole, z)
    assert excess[:, 0] == pytest.approx(expected, abs=1e-5)
    variance = np.diag(shared - across @ np.linalg.solve(whole, across.T))
    assert sd[:, 0] == pytest.approx(np.sqrt(variance), abs=1e-5)
