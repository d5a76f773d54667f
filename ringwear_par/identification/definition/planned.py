"""Readings that are planned: where they are to be taken, before any test has been made."""

import itertools
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.values import RejectedError, Values, is_number, number, whole

if TYPE_CHECKING:
    from ringwear_par.identification.estimation.least_squares import LeastSquares

#: of one series
MOST_READINGS = 100_000
_FROM_TO = frozenset({"from", "to", "count"})


def instants() -> Values:
    """Return lists of increasing numbers, and equal steps from one to another."""

    def read(value: Any) -> FloatArray:
        if isinstance(value, Mapping):
            if set(value) != _FROM_TO:
                raise RejectedError
            low, high = (number(-math.inf).read(value[key]) for key in ("from", "to"))
            count = whole(2, MOST_READINGS).read(value["count"])
            if low >= high:
                raise RejectedError
            return np.linspace(low, high, count)
        if not isinstance(value, list) or not 0 < len(value) <= MOST_READINGS:
            raise RejectedError
        if not all(is_number(v) and math.isfinite(v) for v in value):
            raise RejectedError
        if any(after <= before for before, after in itertools.pairwise(value)):
            raise RejectedError
        return np.array(value, dtype=float)

    told = (
        "{ from = a, to = b, count = n } with a < b and n from 2 to "
        f"{MOST_READINGS}, or a list of increasing numbers"
    )
    return Values("times", read, told)


def fill(squares: "LeastSquares") -> None:
    """Let planned readings be what the model has at the start, nuisances as their priors have them.

    Not collective.

    Raises
    ------
    ComputationError : a history.
    """
    plans = [
        (part, series)
        for (_, series), part in zip(squares.series, squares.parts, strict=True)
        if series.planned
    ]
    if not plans:
        return
    m = len(squares.problem.parameters)
    start = [p.unknown(p.start) for p in squares.problem.parameters]
    x = np.concatenate([start, np.zeros(len(squares.names) - m)])
    for j, prior in squares.priors:
        if j >= m:
            x[j] = prior.mean
    expected = squares.bare(x) + squares.nuisance_columns @ x[m:]
    for part, _ in plans:
        squares.data[part] = expected[part]
