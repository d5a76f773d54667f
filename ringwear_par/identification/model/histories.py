"""Histories of all tests at values of the fitted keys, with derivatives, side by side.

Their time steps are frozen, so that readings depend smoothly on the keys.
"""

import itertools
import math
from collections import defaultdict
from collections.abc import Hashable, Sequence

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import BoolArray, FloatArray
from ringwear_par.cases.case import Case
from ringwear_par.cases.numbers import Number, needs_reading, with_numbers
from ringwear_par.elasticity.bem.pair import ContactPair
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.errors import ComputationError, InputError, reason_of
from ringwear_par.history.derivatives.keys import is_elastic
from ringwear_par.history.elastic.bodies import operator_key
from ringwear_par.history.elastic.interpolated_pairs import InterpolatedPairs, interpolate
from ringwear_par.history.elastic.pairs import assemble
from ringwear_par.identification.definition.problem import Experiment, Problem, body_of_wear
from ringwear_par.identification.model.readings import Reader, trajectory
from ringwear_par.schedules import Table, in_time
from ringwear_par.studies.definition.variations import split_key
from ringwear_par.studies.execution.batches import computed

#: most pairs kept of points that have some of their own
_MOST_PAIRS = 64
#: bodies assembled for a search by start: each of its some ten points would need three or more
_BODIES_A_START = 16
#: of a test with constant conditions
STEPS = 40
#: of rough histories, which only show a search where to go
ROUGH_STEPS = 10
#: sd, by which steps half as long may move what a fit seeks
MOST_SHIFT_SD = 0.2
#: by which there are more, equal ones where layers may be worn through
_EQUAL = 4
#: of them, fewest of a piece between two bends of schedules; fewest of any piece
_SHARE, _FEWEST = 0.3, 3
#: pieces from which on one step of each short one will do
_MANY = 100
#: shares of the test: its first step, half of one after a bend; a piece that is short
_FIRST, _SHORT = 2e-4, 1e-2
#: times closer than this share of the test are one
_CLOSE = 1e-7


class Operators:
    """Contact pairs of the experiments of a problem. Making them is collective on comm.

    ``owners`` tell of each experiment what its pair at the starts has in common with those of
    others. Raises ComputationError where the assembly fails.
    """

    def __init__(self, problem: Problem, comm: MPI.Comm) -> None:
        self._problem = problem
        self.owners: list[Hashable] = [operator_key(e.case) for e in problem.experiments]
        #: experiments of which each value of a fitted key has an operator of its own
        self._elastic = {
            i for i, e in enumerate(problem.experiments) if is_elastic(e.case, problem.keys)
        }
        self._pairs: dict[Hashable, ContactPair] = {}
        #: those of the last points
        self._at_points: dict[tuple[Hashable, bool], ContactPair] = {}
        #: where those of other points may come from in a search
        self._interpolated: dict[Hashable, InterpolatedPairs] = {}
        for key, experiment in zip(self.owners, problem.experiments, strict=True):
            if key not in self._pairs:
                self._pairs[key] = assemble(experiment.case, comm)

    @property
    def order(self) -> list[int]:
        """The number of each experiment's pair, as they were assembled."""
        pairs = list(self._pairs)
        return [pairs.index(owner) for owner in self.owners]

    def interpolate(self, comm: MPI.Comm) -> None:
        """Prepare operators for a search, between exact ones, where these pay. Collective."""
        bounds = {parameter.key: parameter.bounds for parameter in self._problem.parameters}
        most = _BODIES_A_START * self._problem.settings.starts
        for experiment in sorted(self._elastic):
            owner = self.owners[experiment]
            if owner in self._interpolated:
                continue
            case = self._problem.experiments[experiment].case
            pairs = interpolate(case, self._pairs[owner], bounds, most, comm)
            if pairs is not None:
                self._interpolated[owner] = pairs

    @property
    def are_interpolated(self) -> bool:
        """Whether there are operators for a search."""
        return bool(self._interpolated)

    def of(self, experiment: int, case: Case, exact: bool) -> ContactPair:
        """Return the pair of a case of an experiment.

        Where each value has its own, it is interpolated, or assembled by this rank alone.
        """
        owner = self.owners[experiment]
        if experiment not in self._elastic:
            return self._pairs[owner]
        exact = exact or owner not in self._interpolated
        key = operator_key(case)
        if exact and key in self._pairs:
            return self._pairs[key]
        if (key, exact) not in self._at_points:
            while len(self._at_points) >= _MOST_PAIRS:
                del self._at_points[next(iter(self._at_points))]
            self._at_points[key, exact] = (
                assemble(case, MPI.COMM_SELF, use_kept=False)
                if exact
                else self._interpolated[owner].of(case)
            )
        return self._at_points[key, exact]


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


#: a point, and an experiment
Pair = tuple[int, int]


class HistoryError(ComputationError):
    """There is no history at some values of the fitted keys: no case, or its computation fails."""


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


class Histories:
    """Model readings of the experiments of a problem, at any values of the fitted keys.

    Making one is collective on comm, whose ranks share the assembly, and raises ComputationError;
    all else is done by each rank for itself.
    """

    def __init__(self, problem: Problem, comm: MPI.Comm) -> None:
        self._experiments = problem.experiments
        self._keys = problem.keys
        #: of derivatives: also of factors on measured inputs, and on all rates of bodies whose
        #: wear is random
        self._numbers = (*problem.keys, *problem.factors, *problem.settings.process)
        clocks = [BODIES.index(body_of_wear(key)) for key in problem.settings.process]
        self._clocks = clocks
        self._readers = [Reader(experiment, clocks) for experiment in problem.experiments]
        self.operators = Operators(problem, comm)
        #: histories computed so far
        self.count = 0

    def responses(
        self,
        points: FloatArray,
        steps: int = STEPS,
        *,
        derivatives: bool = True,
        exact: bool = True,
    ) -> list[FloatArray | HistoryError]:
        """Return for each point (p, m) the readings of all experiments, or why there are none.

        One after another, (n, 1 + m), with derivatives by the values, or (n, 1) without. Operators
        may be interpolated unless ``exact``. Not collective.
        """
        every, m = range(len(self._experiments)), len(self._keys)
        pairs = [(i, e) for i in range(len(points)) for e in every]
        parts = dict(zip(pairs, self.read(points, pairs, steps, derivatives, exact), strict=True))
        responses: list[FloatArray | HistoryError] = []
        for i in range(len(points)):
            parts_of_point = [parts[i, e] for e in every]
            failed = [part for part in parts_of_point if isinstance(part, HistoryError)]
            arrays = [part for part in parts_of_point if not isinstance(part, HistoryError)]
            responses.append(failed[0] if failed else np.concatenate(arrays)[:, : 1 + m])
        return responses

    def allowed(self, points: FloatArray) -> BoolArray:
        """Return at which points (p, m) every experiment is a case, (p,). Not collective."""
        good = np.ones(len(points), dtype=bool)
        for experiment in range(len(self._experiments)):
            case = self._experiments[experiment].case
            good &= [isinstance(at, Case) for at in cases_at(case, self._keys, points)]
        return good

    def read(
        self,
        points: FloatArray,
        pairs: Sequence[Pair],
        steps: int = STEPS,
        derivatives: bool = True,
        exact: bool = True,
    ) -> list[FloatArray | HistoryError]:
        """Return the readings at some of the points, of an experiment each, or why not.

        All step side by side; none depends on the others. After its derivatives by the values
        follow those by factors on measured inputs, then, for each body whose wear is random, that
        by a factor on its rates, and then for each its mean worn depth, mm.
        """
        by_experiment: dict[int, list[int]] = defaultdict(list)
        for number, (_, experiment) in enumerate(pairs):
            by_experiment[experiment].append(number)
        readings: dict[int, FloatArray | HistoryError] = {}
        cases: dict[int, Case] = {}
        operators: dict[int, ContactPair] = {}
        for experiment, numbers in by_experiment.items():
            at = points[[pairs[number][0] for number in numbers]]
            at_values = cases_at(self._experiments[experiment].case, self._keys, at)
            for number, case in zip(numbers, at_values, strict=True):
                try:
                    if isinstance(case, HistoryError):
                        raise case
                    cases[number] = case
                    operators[number] = self.operators.of(experiment, case, exact)
                except ComputationError as error:
                    readings[number] = HistoryError(reason_of(error))
        groups: dict[Hashable, list[int]] = defaultdict(list)
        for number in sorted(operators):
            groups[self.operators.owners[pairs[number][1]]].append(number)
        keys = self._numbers if derivatives else ()
        grids = {e: step_times(self._experiments[e], steps).tolist() for e in by_experiment}
        for numbers in groups.values():
            parts = computed(
                [cases[number] for number in numbers], [operators[number] for number in numbers],
                results=True, derivatives=keys,
                step_times=[grids[pairs[number][1]] for number in numbers],
            )  # fmt: skip
            for part in parts:
                for place, result in zip(part.numbers, part.results(), strict=True):
                    number = numbers[place]
                    if isinstance(result, Exception):
                        readings[number] = HistoryError(reason_of(result))
                    else:
                        reader = self._readers[pairs[number][1]]
                        readings[number] = reader.read(trajectory(result, cases[number], keys))
        self.count += len(pairs)
        return [readings[number] for number in range(len(pairs))]

    def renew_inputs(self, values: FloatArray) -> tuple[Experiment, ...]:
        """Return the experiments, friction now as their torques tell it at values of the keys.

        By the radius at which friction acts in their histories there; HistoryError for none. Not
        collective.
        """
        experiments = list(self._experiments)
        for number, experiment in enumerate(experiments):
            if experiment.torque_input is None:
                continue
            (case,) = cases_at(experiment.case, self._keys, values[None])
            if isinstance(case, HistoryError):
                raise case
            (part,) = computed(
                [case], [self.operators.of(number, case, exact=True)], results=True,
                step_times=[step_times(experiment).tolist()],
            )  # fmt: skip
            self.count += 1
            (result,) = part.results()
            if isinstance(result, Exception):
                raise HistoryError(reason_of(result))
            time, force, torque = (result.histories[n] for n in ("time", "force", "torque"))
            pressed = force > 0.0
            at = time[pressed]
            radius = torque[pressed] / (in_time(case.friction, at) * force[pressed])
            experiments[number] = experiment.with_radius(
                Table(tuple(at.tolist()), tuple(radius.tolist()))
            )
        self.change_cases(tuple(experiments))
        return self._experiments

    def change_cases(self, experiments: tuple[Experiment, ...]) -> None:
        """Take the experiments with other cases, of the same bodies."""
        self._experiments = experiments
        self._readers = [Reader(experiment, self._clocks) for experiment in experiments]
