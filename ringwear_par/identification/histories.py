"""Readings of tests at many values of the fitted keys, in blocks that all ranks share.

A block is a list of (test, unknowns); each entry costs a history, of steps that are frozen, so that
readings depend smoothly on the keys. What decides which histories are wanted runs on the first rank
alone, so that ranks cannot part ways; the others serve it until it is done.
"""

import itertools
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
from ringwear_par.parallel import as_on_first_rank, on_first_rank, together
from ringwear_par.results.progress import Progress, StopSignals, name_of
from ringwear_par.studies.many import computed
from ringwear_par.studies.variations import split_key

T = TypeVar("T")
#: number of steps of a test with constant conditions
STEPS = 40
#: factor on the number of steps, equal ones, where layers may be worn through
_EQUAL = 4
#: share of the test that its first step takes, and the first one after a bend of a schedule
_FIRST = 2e-4
#: share of the test below which the distance of two times counts as none
_CLOSE = 1e-7
#: share of its bounds by which a key is moved for a derivative
_DIFFERENCE = 1e-4


class _Block(NamedTuple):
    """Histories that are computed by all ranks together."""

    #: tests by number, and values of the keys
    entries: Sequence[tuple[int, tuple[float, ...]]]
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
        comm = self._comm
        while comm.rank and (block := comm.bcast(None)) is not None:
            with suppress(Exception):  # the first rank has it too, and ends the job
                self._shared(block)

        def leading() -> T:
            try:
                with closing(Progress()) as self._progress:
                    return job()
            finally:
                self._progress = None
                as_on_first_rank(comm, None)

        return on_first_rank(comm, leading)

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
        asked = [
            [(same_as[test], tuple(values)) for values in self.problem.values(points).tolist()]
            for test, points in wanted
        ]
        # equal bodies together, whose operator is then assembled once
        entries = sorted({*itertools.chain(*asked)}, key=lambda entry: (entry[1], entry[0]))
        block = _Block(entries, tests, steps or self.steps, factors)
        rows, reasons = self._shared(as_on_first_rank(self._comm, block))
        self.count, self.failed = self.count + len(rows), self.failed + len(reasons)
        self.reason = self.reason or next(iter(reasons), "")
        places = {entry: row for row, entry in enumerate(entries)}
        return [
            np.array([rows[places[entry]] for entry in of_test]).reshape(-1, tests[test].n)
            for (test, _), of_test in zip(wanted, asked, strict=True)
        ]

    def _shared(self, block: _Block) -> tuple[list[FloatArray], list[str]]:
        """Return the readings of a block, and why some are NaN, on the first rank. Collective.

        Each rank computes a part. Raises an error of any rank on all, StoppedError on the first.
        """
        comm, rows, reasons = self._comm, list[FloatArray](), list[str]()
        ends = np.linspace(0, len(block.entries), comm.size + 1).astype(int)
        mine = block.entries[ends[comm.rank] : ends[comm.rank + 1]]
        with together(comm):
            if mine and not self._signals.received:
                rows, reasons = self._computed(block._replace(entries=mine))
        parts = comm.gather((rows, reasons, self._signals.received)) or []
        if received := max((number for *_, number in parts), default=0):
            raise StoppedError(f"stopped by {name_of(received)}")
        return [row for of, _, _ in parts for row in of], [why for _, of, _ in parts for why in of]

    def _computed(self, block: _Block) -> tuple[list[FloatArray], list[str]]:
        """Return the readings of a block, and why some are NaN, by this rank alone."""
        tests, values = zip(*block.entries, strict=True)
        owners, experiments = np.array(tests), block.experiments
        grids, made = {}, {}
        for test in {*tests}:
            grids[test] = step_times(experiments[test], block.steps)
            points = np.array(values)[owners == test]
            made[test] = iter(cases_at(experiments[test].case, self.problem.keys, points))
        cases = [next(made[test]) for test in tests]
        parts, failed = computed(
            cases, self._pairs, step_times=[grids[test].tolist() for test in tests],
            paces=[np.outer(block.factors, np.ones(len(grids[test]))) for test in tests],
        )  # fmt: skip
        rows = [np.full(experiments[test].n, np.nan) for test in tests]
        reasons = [*map(reason_of, failed.values())]
        for part in parts:
            columns = part.recorder.columns(part.failures)
            reasons += [*map(reason_of, part.failures.values())]
            done = np.array([i for i in range(len(part.numbers)) if i not in part.failures], int)
            numbers = np.array(part.numbers)[done]
            for test in {*owners[numbers].tolist()}:
                of_test = owners[numbers] == test
                starts = columns.offsets[done[of_test], None]
                at = starts + np.arange(len(grids[test]) + 1)
                data = {name: column[at] for name, column in columns.data.items()}
                chosen = numbers[of_test].tolist()
                readings = read(experiments[test], [cases[i] for i in chosen], data)
                for number, row in zip(chosen, readings, strict=True):
                    rows[number] = row
        return rows, reasons

    def slopes(self, x: FloatArray) -> list[FloatArray]:
        """Return derivatives (n, d, m) of the readings of each test at unknowns (d, m).

        By differences within the bounds, of one block of histories; NaN where there is no history.
        On the first rank, within ``lead``.
        """
        low, high = self.problem.unknown_bounds
        step = _DIFFERENCE * (high - low)
        step = np.where(x + step > high, -step, step)
        moved = x[:, None] + step[:, None] * np.eye(1 + len(low), len(low), -1)
        points = moved.reshape(-1, len(low))
        blocks = self([(i, points) for i in range(len(self.problem.experiments))])
        rows = [y.reshape(*moved.shape[:2], -1) for y in blocks]
        return [np.moveaxis((y[:, 1:] - y[:, :1]) / step[..., None], 2, 0) for y in rows]


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
    quickly there. Profiles are read at ends of steps. Pieces between bends have steps by the root
    of their length. Where a body with layers wears, steps stay short to the end: rates change at
    once as a layer is worn through, whenever that is.
    """
    case, end = experiment.case, experiment.case.time.end
    layered = any(len(laws) > 1 for laws in case.laws)  # readings have kinks
    pieces = []
    for low, high in itertools.pairwise((0.0, *case.breakpoints, end)):
        length = high - low
        count = max(1, round(steps * np.sqrt(length / end)))
        grown = np.geomspace(length, min(_FIRST * end, length / count), count)[::-1]
        if layered:  # until they are as long as equal ones, then these
            equal = np.linspace(0.0, length, 1 + _EQUAL * count)[1:]
            early = grown[np.diff(grown, prepend=0.0) < equal[0]]
            grown = np.concatenate([early, equal[equal > early.max(initial=0.0)]])
        pieces.append(low + grown)
    times = np.array([*case.breakpoints, end])
    profiles = [np.array([s.at]) for s in experiment.series if s.at is not None]
    for more in (*profiles, np.concatenate(pieces)):
        distance = np.abs(np.subtract.outer(more, times)).min(axis=1)
        times = np.union1d(times, more[distance > _CLOSE * end])
    return times


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
