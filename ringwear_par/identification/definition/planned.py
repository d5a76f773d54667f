"""Readings that are planned: where they are to be taken, before any test has been made."""

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from ringwear_par.identification.estimation.least_squares import LeastSquares


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
