"""Long records are averaged in blocks of equal time of the test."""

from dataclasses import replace

import numpy as np
import pytest

from ringwear_par.identification.definition.problem import Series
from ringwear_par.identification.definition.series import BLOCKS, averaged


def test_long_records_are_averaged():
    x = np.arange(1.0, 5001.0) / 50.0
    series = Series("z", "penetration", x, 2.0 * x, np.full(5000, 0.5))
    short = averaged(series, 100.0)
    assert short.n == pytest.approx(BLOCKS, abs=1)
    assert short.value == pytest.approx(2.0 * short.x)
    assert short.sd[3] == pytest.approx(0.5 / np.sqrt(10), rel=0.06)
    assert averaged(short, 100.0).n == short.n
    assert averaged(replace(series, quantity="profile.lower"), 100.0).n == series.n
    assert averaged(replace(series, censored=np.full(5000, -1)), 100.0).n == series.n
    x = np.append(np.arange(1, 200) + 0.5, 199.51)  # the last block grows, all others stay
    y = np.random.default_rng(0).standard_normal(200)
    before, after = (
        averaged(Series("z", "penetration", x[:n], y[:n], np.full(n, 0.3)), 500.0)
        for n in (199, 200)
    )
    assert after.n == before.n
    assert np.array_equal(after.value[:-1], before.value[:-1])


def test_no_block_reaches_across_an_excluded_part():
    """Here the rig jumped by 8 while nobody read it, within one block of 1 s."""
    excluded = ((40.3, 40.5), (60.0, 60.1))
    x = np.arange(0.05, 500.0, 0.1)
    x = x[((x < 40.3) | (x > 40.5)) & ((x < 60.0) | (x > 60.1))]
    jumped = Series("z", "penetration", x, 8.0 * (x > 40.4), np.full(len(x), 0.3))
    series = replace(jumped, excluded=excluded)
    short = averaged(series, 500.0)
    assert set(short.value.tolist()) == {0.0, 8.0}
    assert short.n == averaged(jumped, 500.0).n + 1
    thinned = averaged(replace(series, correlation_time=2.0), 500.0)
    assert thinned.n == short.n
    assert np.isin(thinned.x, x).all()
