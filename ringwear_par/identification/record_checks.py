"""Checks of single records: readings that cannot be what they are called, or oppose the model."""

from collections.abc import Sequence

import numpy as np
from scipy.stats import f as f_distribution
from scipy.stats import qmc

from ringwear_par.arrays import BoolArray, FloatArray
from ringwear_par.errors import InputError, legible
from ringwear_par.identification.definition.problem import Experiment, Nuisance, Problem, Series
from ringwear_par.identification.definition.reading_kinds import READING_KINDS
from ringwear_par.identification.histories import HistoryError, Readings, cases_at
from ringwear_par.identification.readings import growth, nuisance_columns

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
_HARMLESS = ("offset", "level", "tilt", "thermal")
#: parts of a record at its ends that are compared with the model's sign grow by 1 / this of it
_PARTS = 40


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
    points = case_points(problem)
    every = np.tile(start, (len(problem.experiments), 1))
    models, slopes = readings.jacobians(every)
    faults = _without_response(problem, slopes)
    felt = _felt(problem, slopes)
    for point in points:
        if felt.all():
            break
        felt |= _felt(problem, readings.jacobians(np.tile(point, (len(every), 1)))[1])
    faults += [
        f"{problem.name}: no readings respond to {parameter.key}, at the start "
        f"({_start_values(problem)}) or anywhere within its bounds; some must: is a threshold "
        "(p0) above all pressures?"
        for parameter, responds in zip(problem.parameters, felt.tolist(), strict=True)
        if not responds and parameter.prior is None
    ]
    faults += _reversed(problem, models)
    if faults:
        raise InputError(*faults)


def case_points(problem: Problem) -> FloatArray:
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


def _records(problem: Problem) -> list[tuple[int, Experiment, Series, slice]]:
    """Return the number of each test, the test, its series, and where its readings are."""
    records = []
    for number, test in enumerate(problem.experiments):
        start = 0
        for series in test.series:
            records.append((number, test, series, slice(start, start + series.n)))
            start += series.n
    return records


def _without_response(problem: Problem, slopes: Sequence[FloatArray]) -> list[str]:
    """Return faults of series that respond to no key at the start."""
    low, high = problem.unknown_bounds
    return [
        f'{problem.name}: experiment "{legible(test.name)}": {series.name}: does not respond to '
        f"any parameter at the start ({_start_values(problem)}); must respond to at least one"
        for number, test, series, rows in _records(problem)
        if not (series.censored is not None and series.censored.all())
        and np.linalg.norm(slopes[number][rows] * (high - low) / series.sd[:, None]) < _NO_RESPONSE
    ]


def _felt(problem: Problem, slopes: Sequence[FloatArray]) -> BoolArray:
    """Tell which keys (m,) change some readings in ways that nuisances do not, by (n, m) slopes.

    Where there is no history, all do.
    """
    low, high = problem.unknown_bounds
    reach = np.where([p.log for p in problem.parameters], 1.0, _WIDTHS * (high - low))
    squares = np.zeros(len(low))
    for number, test, series, rows in _records(problem):
        columns = slopes[number][rows] / series.sd[:, None]
        nuisances = nuisance_columns(series, test.case) / series.sd[:, None]
        squares += np.square(_rest(nuisances, columns)).sum(axis=0)
    felt: BoolArray = ~(np.sqrt(squares) * reach <= _NOT_FELT)
    return felt


def _rest(columns: FloatArray, rows: FloatArray) -> FloatArray:
    """Return rows (n, ...) less what columns (n, k) explain of them."""
    if not columns.size:
        return rows
    basis, values, _ = np.linalg.svd(columns, full_matrices=False)
    basis = basis[:, values > 1e-10 * values.max(initial=0.0)]
    rest: FloatArray = rows - basis @ (basis.T @ rows)
    return rest


def _start_values(problem: Problem) -> str:
    return ", ".join(f"{key} = {value:g}" for key, value in problem.start.items())


def _reversed(problem: Problem, models: Sequence[FloatArray]) -> list[str]:
    """Return faults of depths and masses that go against the model, but for their nuisances.

    Those that do so only once a drift or a compliance is fitted too may be right but for a part,
    of which a doubt tells; so may records that change as the model in total.
    """
    faults = []
    for number, test, series, rows in _records(problem):
        model = models[number][rows]
        if series.planned or not READING_KINDS[series.kind].of_wear or np.isnan(model).any():
            continue
        record = Record(test, series, model)
        if not record.follows and record.opposes() and record.opposes(harmless=True):
            faults.append(
                f'{problem.name}: experiment "{legible(test.name)}": {series.name}: '
                "has the wrong sign: readings fall where the model rises; must be positive where "
                "material is lost"
            )
    return faults


class Record:
    """Readings (n,) of a series and the model's without nuisances, over their noise."""

    def __init__(self, experiment: Experiment, series: Series, model: FloatArray) -> None:
        self._series, sd = series, series.sd
        self._nuisances = [*series.linear_nuisances]
        columns = [*nuisance_columns(series, experiment.case).T]
        time = series.growth_time
        if time is not None:  # growth with any of some time constants
            low, high = time.bounds
            for constant in (time.start, low, 0.5 * (low + high), high):
                if np.isfinite(constant) and constant > 0.0:
                    grown = growth(time, experiment.case, series.x, constant)
                    columns.append(series.factor * grown)
                    self._nuisances.append(Nuisance("thermal"))
        self._columns = np.array(columns).reshape(-1, series.n).T / sd[:, None]
        self._both = np.stack([series.value, model], axis=1) / sd[:, None]

    def opposes(self, rows: slice = slice(None), *, harmless: bool = False) -> bool:
        """Tell whether readings fall where the model's rise, whatever the (harmless) nuisances."""
        numbers = [i for i, n in enumerate(self._nuisances) if not harmless or n.kind in _HARMLESS]
        columns, both = self._columns[rows, numbers], self._both[rows]
        for column, i in enumerate(numbers):  # priors are one reading more, of the nuisance itself
            prior = self._nuisances[i].prior
            if prior is not None:
                columns = np.vstack([columns, np.eye(len(numbers))[column] / prior.sd])
                both = np.vstack([both, [prior.mean / prior.sd, 0.0]])
        both = _rest(columns, both)
        (data, wear), sizes = both.T, np.linalg.norm(both, axis=0)
        return bool(
            data @ wear < _OPPOSITE * sizes.prod()
            and -data @ wear > _SURE * sizes[1]
            and sizes[1] > _SEEN
        )

    @property
    def follows(self) -> bool:
        """Whether readings in time change as the model does, in total."""
        data, wear = self._both[-1] - self._both[0]
        return not self._series.profile and data * wear > 0.0

    @property
    def exclude(self) -> tuple[float, float] | None:
        """The shortest early or late part, s, without which readings do not oppose the model."""
        x, n = self._series.x, self._series.n
        for count in np.unique(np.arange(1, _PARTS // 2 + 1) * n // _PARTS).tolist():
            if count and not self.opposes(slice(count, None)):
                return 0.0, float(x[count - 1])
            if count and not self.opposes(slice(0, n - count)):
                return float(x[n - count]), float(x[-1])
        return None
