"""Doubts of a fit: what its readings say against the model or the intervals, record by record."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.stats import f as f_distribution

from ringwear_par.arrays import FloatArray
from ringwear_par.identification.definition.problem import Experiment, Series
from ringwear_par.identification.estimation.least_squares import Evaluation, LeastSquares
from ringwear_par.identification.estimation.plausible import opposing

#: blocks of a record, and readings less nuisances that it needs
_BLOCKS, _ENOUGH = 10, 30
#: probability of noise whose blocks differ as much, below which it is none
_NO_NOISE = 1e-4


@dataclass(frozen=True)
class Doubt:
    """Something that speaks against taking the numbers of a fit as they are.

    Parameters
    ----------
    code : the same for doubts of a kind.
    text : a sentence.
    experiments, keys : which it is of; none where it is of all.
    values : numbers of the sentence, by name.
    """

    code: str
    text: str
    experiments: tuple[str, ...]
    keys: tuple[str, ...] = ()
    values: dict[str, Any] = field(default_factory=dict)


def doubts(squares: LeastSquares, x: FloatArray, evaluation: Evaluation) -> tuple[Doubt, ...]:
    """Return the doubts of a fit, whose unknowns are x at the optimum."""
    return (*_oppositions(squares, x), *_trends(squares, evaluation))


def _oppositions(squares: LeastSquares, x: FloatArray) -> list[Doubt]:
    """Return doubts of records that fall where the model's rise."""
    told = []
    for experiment, series, exclude in opposing(squares, x):
        kinds = " and ".join(n.kind for n in series.nuisances)
        beside = f"beside its {kinds}, " if kinds else ""
        said = f"{series.name} ({experiment.name}): {beside}readings fall where the model's rise"
        values: dict[str, Any] = {"series": series.name, "exclude": None}
        if exclude is None:
            said += "; look at their sign and at the test"
        else:
            first, last = exclude
            said += (
                f", because of those from {first:.10g} to {last:.10g} s; if these show something "
                f"else than wear, leave them out: exclude = [[{first:.10g}, {last:.10g}]]"
            )
            values["exclude"] = [first, last]
        told.append(Doubt("readings-oppose", said, (experiment.name,), values=values))
    return told


def _trends(squares: LeastSquares, evaluation: Evaluation) -> list[Doubt]:
    """Return doubts of records whose residuals are no noise."""
    told = []
    for (experiment, series), part in zip(squares.series, squares.parts, strict=True):
        probability = trend(series, -evaluation.noise[part])
        if probability < _NO_NOISE:
            told.append(_of_trend(experiment, series, probability))
    return told


def _of_trend(experiment: Experiment, series: Series, probability: float) -> Doubt:
    said = (
        f"readings of {experiment.name}, {series.name}, trend away from the model "
        f"(p = {probability:.1g}): "
    )
    if series.sd_fitted:
        said += "their sd is not noise; intervals are too narrow"
    else:
        said += "what they differ by is not noise of their sd; intervals are too narrow"
    values = {"series": series.name, "p": probability}
    return Doubt("residuals-trend", said, (experiment.name,), values=values)


def trend(series: Series, residuals: FloatArray) -> float:
    """Return how probable residuals in time are if they are noise, 1 for too few to tell.

    Sums of blocks are compared with differences of neighbours, which trends hardly change. Noise
    that is given is no smaller than that.

    Parameters
    ----------
    residuals : (n,) over their noise, uncorrelated.
    """
    n, own = len(residuals), len(series.nuisances)
    if series.profile or n - own < _ENOUGH:
        return 1.0
    noise = 0.5 * float(np.mean(np.diff(residuals) ** 2))
    if not series.sd_fitted:
        noise = max(noise, 1.0)
    blocks = np.array_split(residuals, _BLOCKS)
    between = sum(float(block.sum()) ** 2 / len(block) for block in blocks)
    freedom = max(_BLOCKS - own, 1)
    # degrees of freedom of the mean square of successive differences of white noise
    of_noise = 2.0 * (n - 1) ** 2 / (3 * n - 4)
    return float(f_distribution.sf(between / (freedom * noise), freedom, of_noise))
