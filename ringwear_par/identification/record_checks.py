"""Checks of single records: readings that no key can explain, or that oppose the model."""

from dataclasses import replace

import numpy as np
from scipy.stats import f as f_distribution

from ringwear_par.arrays import FloatArray
from ringwear_par.errors import InputError, legible
from ringwear_par.identification.definition.problem import Experiment, Series, records
from ringwear_par.identification.definition.reading_kinds import READING_KINDS
from ringwear_par.identification.histories import Readings
from ringwear_par.identification.likelihood import TestLikelihood
from ringwear_par.identification.noise import Setting

#: number of blocks of a record, and fewest readings, less nuisances, that it needs
_BLOCKS, _ENOUGH = 10, 30
#: share of the noise of all readings: a smaller change over the whole of all bounds is no response
_NO_RESPONSE = 1e-6
#: by how much log p must gain by the other sign, at least, and as a share of what it can gain
_SURE, _SHARE = 12.5, 0.25
#: factors on the model of a record: those of the wrong sign, none, and the right ones
_WRONG, _RIGHT = -np.geomspace(1e-4, 1e4, 65), np.append(0.0, np.geomspace(1e-4, 1e4, 65))
#: nuisances that leave the sign of a record as it is
_HARMLESS = ("offset", "level", "tilt")


def trend(residuals: FloatArray, n_nuisances: int = 0, least: float = 0.0) -> float:
    """Return how probable residuals (n,) in time are if they are noise, 1 for too few to tell.

    Sums of blocks are compared with differences of neighbours, which trends hardly change; the
    variance is at least ``least``.
    """
    n = len(residuals)
    if n - n_nuisances < _ENOUGH:
        return 1.0
    noise = max(0.5 * float(np.mean(np.diff(residuals) ** 2)), least)
    if not noise:
        return 1.0
    blocks = np.array_split(residuals, _BLOCKS)
    between = sum(float(block.sum()) ** 2 / len(block) for block in blocks)
    freedom = max(_BLOCKS - n_nuisances, 1)
    # degrees of freedom of the mean square of successive differences of white noise
    noise_freedom = 2.0 * (n - 1) ** 2 / (3 * n - 4)
    return float(f_distribution.sf(between / (freedom * noise), freedom, noise_freedom))


def refuse_unfit(readings: Readings) -> None:
    """Refuse series without response, and those of the wrong sign, before a search.

    On the first rank, within ``lead``.

    Raises
    ------
    InputError : all of them.
    """
    problem, faults = readings.problem, list[str]()
    start = problem.unknowns([*problem.start.values()])
    models, slopes = readings.with_slopes(start[None])
    values = ", ".join(f"{key} = {value:g}" for key, value in problem.start.items())
    low, high = problem.unknown_bounds
    for test, model, slope in zip(problem.experiments, models, slopes, strict=True):
        for series, rows in records(test.series):
            where = f'{problem.name}: experiment "{legible(test.name)}": {series.name}: '
            only_limits = series.censored is not None and series.censored.all()
            change = slope[rows, 0] * (high - low) / series.sd[:, None]
            if not only_limits and np.linalg.norm(change) < _NO_RESPONSE:
                faults.append(
                    f"{where}does not respond to any parameter at the start ({values}); must "
                    "respond to at least one"
                )
            if is_reversed(test, series, model[0, rows]):
                faults.append(
                    f"{where}has the wrong sign: readings fall where the model rises; must be "
                    "positive where material is lost"
                )
    if faults:
        raise InputError(*faults)


def is_reversed(test: Experiment, series: Series, model: FloatArray) -> bool:
    """Tell whether a depth or mass goes against the model (n,), whatever the size of that is.

    Its likelihood tells, with all nuisances and without those that may fall: a record that does so
    only once a drift, say, is fitted too may be right but for a part.
    """
    if series.planned or not READING_KINDS[series.kind].of_wear or np.isnan(model).any():
        return False
    few = tuple(n for n in series.nuisances if n.kind in _HARMLESS)
    for nuisances in (series.nuisances, few):
        same = replace(series, sd_fitted=False, censored=None, nuisances=nuisances)
        alone = replace(test, series=(same,), inputs=())
        likelihood = TestLikelihood(alone, Setting.before(alone), np.zeros(0))
        wrong, right = (likelihood(np.outer(sizes, model)) for sizes in (_WRONG, _RIGHT))
        (best,) = likelihood(series.value[None])
        if wrong.max() - right.max() <= max(_SURE, _SHARE * (best - right[0])):
            return False
    return True
