"""Checks of single records: readings that cannot be what they are called, or oppose the model."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.stats import f as f_distribution
from scipy.stats import qmc

from ringwear_par.arrays import BoolArray, FloatArray
from ringwear_par.errors import InputError, legible
from ringwear_par.identification.definition.problem import GROWTH_TIME, Experiment, Problem, records
from ringwear_par.identification.definition.reading_kinds import READING_KINDS
from ringwear_par.identification.histories import HistoryError, Readings, cases_at
from ringwear_par.identification.noise import Noise, Setting
from ringwear_par.identification.readings import growth

#: number of blocks of a record, and fewest readings, less nuisances, that it needs
_BLOCKS, _ENOUGH = 10, 30
#: share of the noise of all readings: a smaller change over the whole of all bounds is no response
_NO_RESPONSE = 1e-6
#: readings do not depend on a key if they change by less than this share of their noise over a
#: factor of e of it, where its logarithm is fitted, else over ten times the width of its bounds
_NOT_FELT, _WIDTHS = 0.5, 10.0
#: points at which responses are computed, and most that are tried to find so many cases
_POINTS, _TRIED = 8, 512
#: correlation of readings with the model below which they have the wrong sign, and at how many sd
_OPPOSITE, _SURE = -0.5, 5.0
#: change of the model, in sd, below which it has no sign
_SEEN = 0.1
#: nuisances that leave the sign of a record as it is
_HARMLESS = ("offset", "level", "tilt", "thermal", GROWTH_TIME)


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
    """Refuse series and keys without response, and records of the wrong sign, before a search.

    On the first rank, within ``lead``.

    Raises
    ------
    InputError : all of them.
    """
    problem = readings.problem
    start = problem.unknowns([*problem.start.values()])
    points = _case_points(problem)
    models, slopes = readings.with_slopes(start[None])
    values = ", ".join(f"{key} = {value:g}" for key, value in problem.start.items())
    faults = []
    low, high = problem.unknown_bounds
    for i, test in enumerate(problem.experiments):
        for number, (series, rows) in enumerate(records(test.series)):
            where = f'{problem.name}: experiment "{legible(test.name)}": {series.name}: '
            only_limits = series.censored is not None and series.censored.all()
            change = slopes[i][rows, 0] * (high - low) / series.sd[:, None]
            if not only_limits and np.linalg.norm(change) < _NO_RESPONSE:
                faults.append(
                    f"{where}does not respond to any parameter at the start ({values}); must "
                    "respond to at least one"
                )
            if _is_reversed(test, number, models[i][0, rows]):
                faults.append(
                    f"{where}has the wrong sign: readings fall where the model rises; must be "
                    "positive where material is lost"
                )
    felt = _felt(problem, slopes)
    for point in points:
        if felt.all():
            break
        felt |= _felt(problem, readings.with_slopes(point[None])[1])
    faults += [
        f"{problem.name}: no readings respond to {parameter.key}, at the start ({values}) or "
        "anywhere within its bounds; some must: is a threshold (p0) above all pressures?"
        for parameter, responds in zip(problem.parameters, felt.tolist(), strict=True)
        if not responds and parameter.prior is None
    ]
    if faults:
        raise InputError(*faults)


def _case_points(problem: Problem) -> FloatArray:
    """Return Sobol' points (p, m) within the bounds of the unknowns, that are cases.

    InputError where hardly any is one, for a law has rules for its numbers together.
    """
    low, high = problem.unknown_bounds
    drawn = low + (high - low) * qmc.Sobol(len(low), seed=0).random(_TRIED)
    values = np.array([problem.values(x) for x in drawn])
    good = np.ones(len(drawn), dtype=bool)
    for case in {test.conditions: test.case for test in problem.experiments}.values():
        found = cases_at(case, problem.keys, values)
        good &= [not isinstance(entry, HistoryError) for entry in found]
    if good.sum() < _POINTS:
        bounds = [(p.key, *p.bounds) for p in problem.parameters]
        keys = ", ".join(f"{key} = [{low:g}, {high:g}]" for key, low, high in bounds)
        raise InputError(
            f"{problem.name}: bounds of {keys}: {good.sum()} of {_TRIED} points within them are "
            "cases; must leave room for what the wear laws allow of their numbers together"
        )
    return drawn[good][:_POINTS]


def _noise(test: Experiment, numbers: Sequence[int]) -> Noise:
    """Return the noise of some series of a test, limits as if they were readings."""
    every = tuple(replace(series, censored=None) for series in test.series)
    test = replace(test, series=every)
    return Noise(test, numbers, Setting.before(test), np.zeros(0))


def _felt(problem: Problem, slopes: Sequence[FloatArray]) -> BoolArray:
    """Tell which keys (m,) change some readings in ways that nuisances do not, by (n, 1, m) slopes.

    Where there is no history, all do.
    """
    low, high = problem.unknown_bounds
    reach = np.where([p.log for p in problem.parameters], 1.0, _WIDTHS * (high - low))
    rows = [
        _noise(test, range(len(test.series)))(slope[:, 0])
        for test, slope in zip(problem.experiments, slopes, strict=True)
    ]
    felt: BoolArray = ~(np.linalg.norm(np.concatenate(rows), axis=0) * reach <= _NOT_FELT)
    return felt


def _is_reversed(test: Experiment, number: int, model: FloatArray) -> bool:
    """Tell whether a depth or mass goes against the model (n,), whatever its nuisances are.

    A record that does so only once a drift or a compliance is fitted too may be right but for a
    part; so may one that changes as the model in total.
    """
    series = test.series[number]
    if series.planned or not READING_KINDS[series.kind].of_wear or np.isnan(model).any():
        return False
    total = (series.value[-1] - series.value[0]) * (model[-1] - model[0])
    if not series.profile and total > 0.0:
        return False
    few = tuple(n for n in series.nuisances if n.kind in _HARMLESS)
    return all(
        _opposes(replace(test, series=(replace(series, nuisances=nuisances),)), model)
        for nuisances in (series.nuisances, few)
    )


def _opposes(test: Experiment, model: FloatArray) -> bool:
    """Tell whether the readings of a test with one series fall where the model's (n,) rise."""
    (series,), noise = test.series, _noise(test, (0,))
    both = noise(np.column_stack([noise.data(series.value), model]))
    if (time := series.growth_time) is not None:  # growth with any of some time constants
        low, high = time.bounds
        constants = [c for c in (time.start, low, 0.5 * (low + high), high) if 0.0 < c < np.inf]
        grown = np.column_stack([growth(time, test.case, series.x, c) for c in constants])
        basis, values, _ = np.linalg.svd(noise(grown), full_matrices=False)
        basis = basis[:, values > 1e-10 * values.max(initial=0.0)]
        both -= basis @ (basis.T @ both)
    (data, wear), sizes = both.T, np.linalg.norm(both, axis=0)
    along = float(data @ wear)
    return bool(along < _OPPOSITE * sizes.prod() and -along > _SURE * sizes[1] and sizes[1] > _SEEN)
