"""Readings of tests at many values of the fitted keys, in blocks that all ranks share.

A block is a list of (test, unknowns); each entry costs a history, of steps that are frozen, so that
readings depend smoothly on the keys. What decides which histories are wanted runs on the first rank
alone, so that ranks cannot part ways; the others serve it until it is done.
"""

import itertools
import math
import pickle
from collections.abc import Callable, Hashable, Sequence
from contextlib import closing, suppress
from typing import NamedTuple, TypeVar

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import Case
from ringwear_par.cases.numbers import Number, cases_with
from ringwear_par.cases.smooth_keys import is_elastic
from ringwear_par.elasticity.bem.pair import ContactPair
from ringwear_par.errors import ComputationError, InputError, reason_of
from ringwear_par.identification.definition.problem import Experiment, Problem
from ringwear_par.identification.readings import read
from ringwear_par.parallel import together
from ringwear_par.results.progress import Progress, StopSignals, name_of
from ringwear_par.studies.many import computed
from ringwear_par.studies.variations import split_key

T = TypeVar("T")
#: test and values of its keys
Entry = tuple[int, tuple[float, ...]]
#: readings (n,), or why there is no history
Row = FloatArray | str
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


class _Block(NamedTuple):
    """Histories that are computed by all ranks together."""

    #: tests by number, and values of the keys
    entries: Sequence[Entry]
    experiments: Sequence[Experiment]
    #: of a test; and factors on all rates of wear of lower and upper
    steps: int
    factors: tuple[float, float]


class StoppedError(ComputationError):
    """A fit that a signal asked to stop."""


class Readings:
    """What instruments read of the tests of a problem at any unknowns of its keys.

    The first rank of comm asks, within ``lead``; it may replace ``problem`` there by one with other
    inputs or series, of the same tests.
    """

    def __init__(self, problem: Problem, comm: MPI.Intracomm, signals: StopSignals) -> None:
        self.problem = problem
        self._comm, self._signals = comm, signals
        self._progress: Progress | None = None
        #: number of steps, see ``step_times``
        self.steps = STEPS
        #: histories computed, those that failed, and why the first one did
        self.count, self.failed, self.reason = 0, 0, ""
        #: operators of the last block
        self._pairs: dict[Hashable, ContactPair] = {}

    @property
    def same_as(self) -> list[int]:
        """The first test with the same conditions and readings, for each test: these share."""
        return _same_as(self.problem.experiments)

    def lead(self, job: Callable[[], T]) -> T:
        """Return the result of a job of the first rank, whose blocks all ranks compute.

        Collective. Raises StoppedError by a signal, and what the job or any rank raises.
        """
        comm, content = self._comm, b""
        with together(comm):
            if comm.rank == 0:
                try:
                    with closing(Progress()) as self._progress:
                        content = pickle.dumps(job(), pickle.HIGHEST_PROTOCOL)
                finally:
                    self._progress = None
                    comm.bcast(None)
            else:
                while (request := comm.bcast(None)) is not None:
                    with suppress(Exception):  # the first rank has it too, and ends the job
                        self._shared(request)
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
        experiments: Sequence[Experiment] | None = None,
        steps: int | None = None,
        factors: tuple[float, float] = (1.0, 1.0),
    ) -> list[FloatArray]:
        """Return readings (P, n) of each test at unknowns (P, m), NaN where there is no history.

        On the first rank, within ``lead``.

        Parameters
        ----------
        wanted : number of the test, and unknowns.
        experiments : instead of those of the problem.
        steps : instead of the usual number.
        factors : on all rates of wear of lower and upper.
        """
        tests = self.problem.experiments if experiments is None else experiments
        same_as = _same_as(tests)
        blocks = [
            [(same_as[test], tuple(values)) for values in self.problem.values(points).tolist()]
            for test, points in wanted
        ]
        # equal bodies together, whose operator is then assembled once
        entries = sorted({*itertools.chain(*blocks)}, key=lambda entry: (entry[1], entry[0]))
        request = _Block(entries, tests, steps or self.steps, factors)
        if self._comm.size > 1:
            self._comm.bcast(request)
        rows = dict(zip(entries, self._shared(request), strict=True))
        reasons = [row for row in rows.values() if isinstance(row, str)]
        self.count, self.failed = self.count + len(rows), self.failed + len(reasons)
        self.reason = self.reason or next(iter(reasons), "")
        found = []
        for (test, _), block in zip(wanted, blocks, strict=True):
            none = np.full(tests[test].n, np.nan)
            of_block = [none if isinstance(row := rows[entry], str) else row for entry in block]
            found.append(np.array(of_block).reshape(len(block), len(none)))
        return found

    def _shared(self, block: _Block) -> list[Row]:
        """Return the rows of all ranks on the first one, each of which computes a part. Collective.

        Raises an error of any rank on all, StoppedError on the first.
        """
        comm, rows = self._comm, list[Row]()
        ends = np.linspace(0, len(block.entries), comm.size + 1).astype(int)
        mine = block.entries[ends[comm.rank] : ends[comm.rank + 1]]
        with together(comm):
            if mine and not self._signals.received:
                rows = self._computed(block._replace(entries=mine))
        gathered = comm.gather((rows, self._signals.received)) or []
        if received := max((number for _, number in gathered), default=0):
            raise StoppedError(f"stopped by {name_of(received)}")
        return [row for part, _ in gathered for row in part]

    def _computed(self, block: _Block) -> list[Row]:
        """Return the readings of a block, by this rank alone."""
        entries, experiments, steps, factors = block
        owners = np.array([test for test, _ in entries])
        tests = np.unique(owners).tolist()
        grids = {test: step_times(experiments[test], steps) for test in tests}
        by_entry: dict[int, Case | InputError] = {}
        for test in tests:
            numbers = np.flatnonzero(owners == test).tolist()
            points = np.array([entries[i][1] for i in numbers])
            found = cases_at(experiments[test].case, self.problem.keys, points)
            by_entry |= zip(numbers, found, strict=True)
        cases = [by_entry[i] for i in range(len(entries))]
        paces = [np.repeat(np.array([factors]).T, len(grids[test]), axis=1) for test in owners]
        parts, failed = computed(
            cases, self._pairs, step_times=[grids[test].tolist() for test in owners],
            paces=None if factors == (1.0, 1.0) else paces,
        )  # fmt: skip
        rows: list[Row] = [reason_of(failed[i]) if i in failed else "" for i in range(len(cases))]
        for part in parts:
            columns, of_part = part.recorder.columns(part.failures), np.array(part.numbers)
            for number, reason in zip(part.numbers, columns.reason, strict=True):
                rows[number] = reason
            done = np.flatnonzero(np.array(columns.status) == "done")
            for test in np.unique(owners[of_part[done]]).tolist():
                places = done[owners[of_part[done]] == test]
                at = columns.offsets[places, None] + np.arange(len(grids[test]) + 1)
                data = {name: values[at] for name, values in columns.data.items()}
                numbers = of_part[places].tolist()
                readings = read(experiments[test], [cases[i] for i in numbers], data)
                for number, row in zip(numbers, readings, strict=True):
                    rows[number] = row
        return rows

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


def _same_as(tests: Sequence[Experiment]) -> list[int]:
    first: dict[Hashable, int] = {}
    return [
        first.setdefault(_conditions(test, number), number) for number, test in enumerate(tests)
    ]


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
    layered = any(len(laws) > 1 for laws in case.laws)  # readings have kinks
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


def cases_at(case: Case, keys: Sequence[str], points: FloatArray) -> list[Case | InputError]:
    """Return the cases (p,) at values (p, m) of keys, or why a case is refused in its place."""

    def read_anew(place: int) -> Case | InputError:
        try:
            return case.replace(dict(zip(keys, points[place].tolist(), strict=True)))
        except InputError as error:
            return error

    if is_elastic(case, keys):
        return [*map(read_anew, range(len(points)))]
    numbers: dict[Number, FloatArray] = {}
    for key, column in zip(keys, points.T, strict=True):
        path, entry = split_key(key)
        assert not isinstance(entry, int)
        numbers[path, entry] = column
    return cases_with(case, numbers, case.text, read_anew)
