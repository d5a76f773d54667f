"""Checks of single records: readings that no key can explain, or that oppose the model."""

from dataclasses import replace

import numpy as np
from scipy.stats import f as f_distribution

from ringwear_par.arrays import FloatArray
from ringwear_par.errors import InputError, legible
from ringwear_par.identification.definition.problem import (
    READING_KINDS,
    Experiment,
    Series,
    records,
)
from ringwear_par.identification.histories import Readings
from ringwear_par.identification.noise import Noise, Setting

#: number of blocks of a record, and fewest readings, less nuisances, that it needs
_BLOCKS, _ENOUGH = 10, 30
#: by how much log p must gain by the other sign, at least, and as a share of what it can gain
_SURE, _SHARE = 12.5, 0.25
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
    """Refuse series of the wrong sign, before a search. On the first rank, within ``lead``.

    Raises
    ------
    InputError : all of them.
    """
    problem = readings.problem
    start, tests = (
        problem.unknowns([p.start for p in problem.parameters])[None],
        problem.experiments,
    )
    models = readings([(i, start) for i in range(len(tests))])
    faults = [
        f'{problem.name}: experiment "{legible(test.name)}": {series.name}: has the wrong sign: '
        "readings fall where the model rises; must be positive where material is lost"
        for test, (model,) in zip(tests, models, strict=True)
        for series, rows in records(test.series)
        if is_reversed(test, series, model[rows])
    ]
    if faults:
        raise InputError(*faults)


def is_reversed(test: Experiment, series: Series, model: FloatArray) -> bool:
    """Tell whether a depth or mass goes against the model (n,), whatever the size of that is.

    Squares tell, with all nuisances and without those that may fall: a record that does so only
    once a drift, say, is fitted too may be right but for a part.
    """
    if series.planned or not READING_KINDS[series.kind].of_wear or np.isnan(model).any():
        return False
    few = tuple(n for n in series.nuisances if n.kind in _HARMLESS)
    for nuisances in (series.nuisances, few):
        same = replace(series, sd_fitted=False, censored=None, nuisances=nuisances)
        alone = replace(test, series=(same,), inputs=())
        noise = Noise(alone, [0], Setting.before(alone), np.zeros(0))
        reduced = noise.reduced(np.column_stack([series.value, model]), np.array([1.0, 0.0]))
        (squares, along), (_, size) = reduced.grams().transpose(1, 2, 0)
        constants = reduced.log_constants
        # log p of the best factor on the model below 0 and above, and of no model
        wrong, right, none = (
            (constants - 0.5 * (squares - part**2 / np.maximum(size, 1e-300))).max()
            for part in (np.minimum(along, 0.0), np.maximum(along, 0.0), 0.0 * along)
        )
        if wrong - right <= max(_SURE, _SHARE * (constants.max() - none)):
            return False
    return True
