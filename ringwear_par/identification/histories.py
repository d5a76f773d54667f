"""Readings of tests at many values of the fitted keys, in blocks that all ranks share.

A block is a list of (test, unknowns); each entry costs a history, of steps that are frozen, so that
readings depend smoothly on the keys. What decides which histories are wanted runs on the first rank
alone, so that ranks cannot part ways; the others serve it until it is done.
"""

import itertools
import math
import pickle
from collections.abc import Callable, Hashable, Sequence
from contextlib import closing
from typing import Any, TypeVar

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import Case
from ringwear_par.cases.numbers import Number, needs_reading, with_numbers
from ringwear_par.cases.smooth_keys import is_elastic
from ringwear_par.elasticity.bem.pair import ContactPair
from ringwear_par.errors import ComputationError, InputError, reason_of
from ringwear_par.history.elastic import assemble, operator_key
from ringwear_par.identification.definition.problem import Experiment, Problem
from ringwear_par.identification.readings import Reader, trajectory
from ringwear_par.parallel import as_ours, together
from ringwear_par.results.progress import Progress, StopSignals, name_of
from ringwear_par.results.result import Result
from ringwear_par.studies.many import computed
from ringwear_par.studies.variations import split_key

T = TypeVar("T")
#: test and values of its keys
Entry = tuple[int, tuple[float, ...]]
#: the tests, and of which histories are wanted, number of steps, factors on rates
Request = tuple[tuple[Experiment, ...], list[Entry], int, tuple[float, float]]
Row = FloatArray | ComputationError
#: number of steps of a test with constant conditions
STEPS = 40
#: factor on the number of steps, equal ones, where layers may be worn through
_EQUAL = 4
#: share of the steps that a piece between two bends of schedules has at least; fewest steps of any
#: piece
_SHARE, _FEWEST = 0.3, 3
#: number of pieces above which each short one has one step
_MANY = 100
#: shares of the test: its first step, half of one after a bend; a piece that is short
_FIRST, _SHORT = 2e-4, 1e-2
#: share of the test below which the distance of two times counts as none
_CLOSE = 1e-7
#: share of its bounds by which a key is moved for a derivative
_DIFFERENCE = 1e-4


class HistoryError(ComputationError):
    """There is no history at some values of the fitted keys: no case, or its computation fails."""


class StoppedError(ComputationError):
    """A fit that a signal asked to stop."""


class Readings:
    """What instruments read of the tests of a problem at any unknowns of its keys.

    Making one is collective on comm, and raises ComputationError where the assembly fails. The
    first rank asks, within ``lead``; ``problem`` may be replaced there by one with other inputs or
    series, of the same tests.
    """

    def __init__(self, problem: Problem, comm: MPI.Intracomm, signals: StopSignals) -> None:
        self.problem, self._keys = problem, problem.keys
        self._comm, self._signals = comm, signals
        self._progress: Progress | None = None
        #: number of steps, see ``step_times``
        self.steps = STEPS
        #: histories computed, those that failed, and why the first one did
        self.count, self.failed, self.reason = 0, 0, ""
        #: operators of the tests, and those of the values of the last block
        self._kept: dict[Hashable, ContactPair] = {}
        self._pairs: dict[Hashable, ContactPair] = {}
        with together(comm):
            for test in problem.experiments:
                key = operator_key(test.case)
                if not is_elastic(test.case, problem.keys) and key not in self._kept:
                    self._kept[key] = assemble(test.case, comm)

    @property
    def same_as(self) -> list[int]:
        """The first test with the same conditions and readings, for each test: these share."""
        first: dict[Hashable, int] = {}
        return [
            first.setdefault(_conditions(test, number), number)
            for number, test in enumerate(self.problem.experiments)
        ]

    def lead(self, job: Callable[[], T]) -> T:
        """Return the result of a job of the first rank, whose blocks all ranks compute.

        Collective. Raises StoppedError by a signal, and what the job or any rank raises.
        """
        comm, content = self._comm, b""
        with together(comm):
            if comm.rank == 0:
                try:
                    with closing(Progress(pause=0.0)) as self._progress:
                        content = pickle.dumps(job(), pickle.HIGHEST_PROTOCOL)
                finally:
                    self._progress = None
                    comm.bcast(None)
            else:
                while (request := comm.bcast(None)) is not None:
                    self._share(request)
        with together(comm):
            answer: T = pickle.loads(comm.bcast(content))
        return answer

    def tell(self, state: str) -> None:
        """Tell the user, now and then, what the job is at. On the first rank."""
        if self._progress is not None:
            self._progress.show(self.count, "%s, %d histories", state, self.count)

    def __call__(
        self,
        wanted: Sequence[tuple[int, FloatArray]],
        *,
        steps: int | None = None,
        factors: tuple[float, float] = (1.0, 1.0),
    ) -> list[FloatArray]:
        """Return readings (P, n) of each test at unknowns (P, m), NaN where there is no history.

        On the first rank, within ``lead``.

        Parameters
        ----------
        wanted : number of the test, and unknowns.
        steps : instead of the usual number.
        factors : on all rates of wear of lower and upper.
        """
        problem, same_as = self.problem, self.same_as
        at = [
            [(same_as[test], tuple(problem.values(x).tolist())) for x in points]
            for test, points in wanted
        ]
        # equal bodies together, whose operator is then assembled once
        entries = sorted({*itertools.chain(*at)}, key=lambda entry: (entry[1], entry[0]))
        request: Request = (problem.experiments, entries, steps or self.steps, factors)
        if self._comm.size > 1:
            self._comm.bcast(request)
        found = dict(zip(entries, self._share(request), strict=True))
        failures = [row for row in found.values() if isinstance(row, ComputationError)]
        self.count, self.failed = self.count + len(found), self.failed + len(failures)
        self.reason = self.reason or next(map(reason_of, failures), "")
        blocks = []
        for (test, _), places in zip(wanted, at, strict=True):
            blocks.append(np.full((len(places), problem.experiments[test].n), np.nan))
            for line, entry in zip(blocks[-1], places, strict=True):
                row = found[entry]
                if not isinstance(row, ComputationError):
                    line[:] = row
        return blocks

    def _share(self, request: Request) -> list[Row]:
        """Return the rows of all ranks on the first one, each of which computes a part. Collective.

        Errors are raised on the first rank; the others go on to serve, as that ends the job.
        """
        comm, entries, rows, error = self._comm, request[1], [], None
        ends = np.linspace(0, len(entries), comm.size + 1).astype(int)
        mine = entries[ends[comm.rank] : ends[comm.rank + 1]]
        if mine and not self._signals.received:
            try:
                rows = self._computed(mine, *request)
            except Exception as failure:
                if comm.size == 1:
                    raise
                error = as_ours(failure)
        gathered = comm.gather((rows, self._signals.received, error)) or []
        if received := max((number for _, number, _ in gathered), default=0):
            raise StoppedError(f"stopped by {name_of(received)}")
        for _, _, failed in gathered:
            if failed is not None:
                raise failed
        return [row for part, _, _ in gathered for row in part]

    def _computed(
        self,
        entries: Sequence[Entry],
        experiments: Sequence[Experiment],
        _: Sequence[Entry],
        steps: int,
        factors: tuple[float, float],
    ) -> list[Row]:
        """Return the readings at each (test, values of the keys), by this rank alone."""
        tests = {test: experiments[test] for test, _ in entries}
        readers = {test: Reader(experiment) for test, experiment in tests.items()}
        grids = {test: step_times(experiment, steps) for test, experiment in tests.items()}
        rows: dict[int, Row] = {}
        found: dict[int, Any] = {}
        for test, experiment in tests.items():
            numbers = [i for i, (owner, _) in enumerate(entries) if owner == test]
            points = np.array([entries[i][1] for i in numbers])
            found |= zip(numbers, cases_at(experiment.case, self._keys, points), strict=True)
        owners = [entries[i][0] for i in found]
        paces = [np.repeat(np.array([factors]).T, len(grids[test]), axis=1) for test in owners]
        parts, failed = computed(
            [*found.values()], self._pairs, results=True,
            step_times=[grids[test].tolist() for test in owners],
            paces=None if factors == (1.0, 1.0) else paces,
        )  # fmt: skip
        used = {operator_key(case) for case in found.values() if isinstance(case, Case)}
        self._pairs = {k: pair for k, pair in self._pairs.items() if k in used | {*self._kept}}
        results: dict[int, Result | Exception] = {**failed}
        numbers = [*found]
        for part in parts:
            results |= part.results()
        for place, result in results.items():
            i = numbers[place]
            if isinstance(result, Result):
                rows[i] = readers[entries[i][0]].read(trajectory(result, found[i]))
            else:
                rows[i] = HistoryError(reason_of(result))
        return [rows[i] for i in range(len(entries))]

    def with_slopes(self, x: FloatArray) -> tuple[list[FloatArray], list[FloatArray]]:
        """Return readings (d, n) of each test at unknowns (d, m), and derivatives (n, d, m).

        By differences within the bounds, of one block of histories; NaN where there is no history.
        On the first rank, within ``lead``.
        """
        low, high = self.problem.unknown_bounds
        step = _DIFFERENCE * (high - low)
        step = np.where(x + step > high, -step, step)
        moved = x[:, None] + step[:, None] * np.eye(len(low))
        points = np.concatenate([x[:, None], moved], axis=1)
        every = points.reshape(-1, len(low))
        blocks = self([(i, every) for i in range(len(self.problem.experiments))])
        rows = [y.reshape(*points.shape[:2], y.shape[1]) for y in blocks]
        slopes = [np.moveaxis((y[:, 1:] - y[:, :1]) / step[..., None], 2, 0) for y in rows]
        return [y[:, 0] for y in rows], slopes


def _conditions(test: Experiment, number: int) -> Hashable:
    """Return what is the same for tests of the same readings at the same values of the keys."""
    if test.inputs:
        return number
    return test.conditions, *((s.quantity, s.at, s.density, s.x.tobytes()) for s in test.series)


def step_times(experiment: Experiment, steps: int = STEPS) -> FloatArray:
    """Return the ends of steps of a test, s; about ``steps`` where its schedules have no bends.

    After the start, and after every bend of a schedule, they grow geometrically: pressures change
    quickly there. Profiles are read at ends of steps. Pieces between bends share the steps of a
    test, but for a number that each needs. Where a body with layers wears, steps stay short to the
    end: rates change at once as a layer is worn through, whenever that is.
    """
    case = experiment.case
    end = case.time.end
    cuts = list(itertools.pairwise((0.0, *case.breakpoints, end)))
    long = sum(high - low > _SHORT * end for low, high in cuts)
    layered = experiment.bends_within
    pieces = []
    for low, high in cuts:
        length = high - low
        if length > _SHORT * end:
            proportional = round(steps * (0.4 / math.sqrt(long) + 0.6 * length / end))
            count = max(_FEWEST, round(_SHARE * steps), proportional)
            first = min((_FIRST if long == 1 else 2.0 * _FIRST) * end, length / count)
            grown = np.geomspace(first, length, count)
            pieces.append(low + (_limited(grown, _EQUAL * count) if layered else grown))
        else:
            count = max(_FEWEST, steps // 10) if len(cuts) <= _MANY else max(1, steps // STEPS)
            pieces.append(np.linspace(low, high, 1 + count)[1:])
    fixed = {*case.breakpoints, end, *(s.at for s in experiment.series if s.at is not None)}
    times: list[float] = []
    for time in sorted({*np.concatenate(pieces).tolist(), *fixed}):
        if times and time - times[-1] <= _CLOSE * end:
            times[-1] = time if time in fixed else times[-1]
        else:
            times.append(time)
    times[-1] = end
    return np.array(times)


def _limited(grown: FloatArray, count: int) -> FloatArray:
    """Return ends of growing steps until they are as long as ``count`` equal ones, then these."""
    equal = np.linspace(0.0, grown[-1], 1 + count)[1:]
    early = grown[np.diff(grown, prepend=0.0) < equal[0]]
    return np.concatenate([early, equal[equal > early.max(initial=0.0)]])


def cases_at(case: Case, keys: Sequence[str], points: FloatArray) -> list[Case | HistoryError]:
    """Return the cases (p,) at values (p, m) of keys, an error in place of each that is refused."""

    def read(point: FloatArray) -> Case | HistoryError:
        try:
            return case.replace(dict(zip(keys, point.tolist(), strict=True)))
        except InputError as error:
            return HistoryError(reason_of(error))

    if is_elastic(case, keys):
        return [read(point) for point in points]
    numbers: dict[Number, FloatArray] = {}
    for key, column in zip(keys, points.T, strict=True):
        path, entry = split_key(key)
        assert not isinstance(entry, int)
        numbers[path, entry] = column
    lists = {number: values.tolist() for number, values in numbers.items()}
    cases: list[Case | HistoryError] = [*with_numbers(case, lists, [case.text] * len(points))]
    for i in np.flatnonzero(needs_reading(case, numbers)):
        cases[i] = read(points[i])
    return cases
