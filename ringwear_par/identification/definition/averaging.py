"""Long records, averaged in blocks of equal time."""

from dataclasses import replace

import numpy as np

from ringwear_par.identification.definition.problem import Series

#: blocks of equal time of a test, in which the readings of a long record are averaged
BLOCKS = 500


def averaged(series: Series, end: float) -> Series:
    """Return a record averaged in blocks of equal time; one of correlated noise is thinned.

    No block reaches across an excluded part. Blocks are those of the test, whenever the record
    ends: while it grows, all but the last one stay as they are. Profiles and limits stay too.

    Parameters
    ----------
    end : s, of the test.
    """
    limits = series.censored is not None and series.censored.any()
    if series.profile or limits or series.n < 2:
        return series
    block = series.x // (end / BLOCKS)
    parts_before = (series.x[:, None] > np.array([low for low, _ in series.excluded])).sum(axis=1)
    is_first = (np.diff(block, prepend=-1.0) != 0) | (np.diff(parts_before, prepend=-1) != 0)
    first = np.flatnonzero(is_first)
    if first.size == series.n:
        return series
    counts = np.diff(first, append=series.n)
    if series.correlation_time:
        return series.part(first + counts - 1)
    weights = series.sd**-2
    total = np.add.reduceat(weights, first)
    single = counts == 1  # to the last bit, so that a record that grows stays what it was
    x, value = (
        np.where(single, column[first], np.add.reduceat(weights * column, first) / total)
        for column in (series.x, series.value)
    )
    sd = np.where(single, series.sd[first], total**-0.5)
    return replace(series, x=x, value=value, sd=sd, lines=None, censored=None)
