"""Histories of all experiments at values of the fitted keys, with derivatives, side by side."""

from collections import defaultdict
from collections.abc import Hashable, Sequence

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import BoolArray, FloatArray
from ringwear_par.cases.case import Case
from ringwear_par.cases.numbers import Number, needs_reading, with_numbers
from ringwear_par.elasticity.bem.pair import ContactPair
from ringwear_par.elasticity.stress.boundary_fields import BODIES
from ringwear_par.errors import ComputationError, InputError, reason_of
from ringwear_par.history.derivatives.elastic_numbers import is_elastic
from ringwear_par.history.elastic.bodies import operator_key
from ringwear_par.history.elastic.pairs import assemble
from ringwear_par.identification.definition.problem import Problem
from ringwear_par.identification.model.readings import Reader, Trajectory, lost_mass
from ringwear_par.identification.model.steps import STEPS, step_times
from ringwear_par.results.result import Result
from ringwear_par.studies.definition.variations import split_key
from ringwear_par.studies.execution.batches import computed

#: most operators kept of points that have some of their own
_MOST_PAIRS = 32
#: a point, and an experiment
Pair = tuple[int, int]


class Histories:
    """Model readings of the experiments of a problem, at any values of the fitted keys.

    Making one is collective on comm; all else is done by each rank for itself.

    Parameters
    ----------
    problem : the problem.
    comm : of the ranks that share the assembly.

    Raises
    ------
    ComputationError : the assembly.
    """

    def __init__(self, problem: Problem, comm: MPI.Comm) -> None:
        self._experiments = problem.experiments
        self._keys = problem.keys
        self._readers = [Reader(experiment) for experiment in problem.experiments]
        self._owners: list[Hashable] = [operator_key(e.case) for e in problem.experiments]
        #: experiments of which each value of a fitted key has an operator of its own
        self._elastic = {
            i for i, e in enumerate(problem.experiments) if is_elastic(e.case, problem.keys)
        }
        self._pairs: dict[Hashable, ContactPair] = {}
        #: those of the last points
        self._at_points: dict[Hashable, ContactPair] = {}
        for key, experiment in zip(self._owners, problem.experiments, strict=True):
            if key not in self._pairs:
                self._pairs[key] = assemble(experiment.case, comm)
        #: histories computed so far
        self.count = 0

    def responses(
        self, points: FloatArray, steps: int = STEPS, *, derivatives: bool = True
    ) -> list[FloatArray | ComputationError]:
        """Return readings and derivatives of all experiments at some points. Not collective.

        Histories of all points and experiments step side by side; none depends on the others.

        Parameters
        ----------
        points : (p, m) values of the fitted keys.
        steps : about how many a history makes.
        derivatives : whether they are asked for.

        Returns
        -------
        For each point (n, 1 + m), the readings of all experiments, one after another, and their
        derivatives with respect to the values, or (n, 1) without; or why there are none.
        """
        every = range(len(self._experiments))
        pairs = [(i, e) for i in range(len(points)) for e in every]
        parts = dict(zip(pairs, self._read(points, pairs, steps, derivatives), strict=True))
        responses: list[FloatArray | ComputationError] = []
        for i in range(len(points)):
            parts_of_point = [parts[i, e] for e in every]
            failed = [part for part in parts_of_point if isinstance(part, ComputationError)]
            arrays = [part for part in parts_of_point if not isinstance(part, ComputationError)]
            responses.append(failed[0] if failed else np.concatenate(arrays))
        return responses

    def responses_of(
        self, experiments: Sequence[int], values: FloatArray
    ) -> list[FloatArray | ComputationError]:
        """Return the responses of some experiments, one each, at values (m,). Not collective."""
        return self._read(values[None], [(0, e) for e in experiments], STEPS, True)

    def allowed(self, points: FloatArray) -> BoolArray:
        """Return at which points (p, m) every experiment is a case, (p,). Not collective."""
        good = np.ones(len(points), dtype=bool)
        for experiment in range(len(self._experiments)):
            good &= [isinstance(case, Case) for case in self._cases(experiment, points)]
        return good

    def _cases(self, experiment: int, points: FloatArray) -> list[Case | ComputationError]:
        """Return the cases of an experiment at some values (p, m), or why there are none."""
        case = self._experiments[experiment].case
        numbers: dict[Number, FloatArray] = {}
        for key, column in zip(self._keys, points.T, strict=True):
            path, entry = split_key(key)
            assert not isinstance(entry, int)
            numbers[path, entry] = column
        if experiment in self._elastic:
            return [self._case(case, point) for point in points]
        doubts = needs_reading(case, numbers)
        lists = {number: values.tolist() for number, values in numbers.items()}
        cases: list[Case | ComputationError] = [
            *with_numbers(case, lists, [case.text] * len(points))
        ]
        for i in np.flatnonzero(doubts):
            cases[i] = self._case(case, points[i])
        return cases

    def _case(self, case: Case, point: FloatArray) -> Case | ComputationError:
        """Return a case at values (m,), or why there is none: each is good, not all together."""
        try:
            return case.replace(dict(zip(self._keys, point.tolist(), strict=True)))
        except InputError as error:
            return ComputationError(reason_of(error))

    def _read(
        self, points: FloatArray, pairs: Sequence[Pair], steps: int, derivatives: bool
    ) -> list[FloatArray | ComputationError]:
        """Return the readings at some of the points, of an experiment each, or why not."""
        grids = {e: step_times(self._experiments[e], steps).tolist() for _, e in pairs}
        groups: dict[Hashable, list[int]] = defaultdict(list)
        wanted: dict[int, Case] = {}
        readings: dict[int, FloatArray | ComputationError] = {}
        for experiment in grids:
            numbers_of_experiment = [
                number for number, (_, e) in enumerate(pairs) if e == experiment
            ]
            cases = self._cases(
                experiment, points[[pairs[number][0] for number in numbers_of_experiment]]
            )
            for number, case in zip(numbers_of_experiment, cases, strict=True):
                if isinstance(case, ComputationError):
                    readings[number] = case
                else:
                    wanted[number] = case
        for number in sorted(wanted):
            experiment = pairs[number][1]
            changes = experiment in self._elastic
            owner = operator_key(wanted[number]) if changes else self._owners[experiment]
            groups[owner].append(number)
        for key, numbers in groups.items():
            try:
                pair = self._pair(key, wanted[numbers[0]])
            except ComputationError as error:
                readings |= dict.fromkeys(numbers, error)
                continue
            keys = self._keys if derivatives else ()
            parts = computed(
                [wanted[number] for number in numbers], pair, results=True, derivatives=keys,
                step_times=[grids[pairs[number][1]] for number in numbers],
            )  # fmt: skip
            for part in parts:
                for place, result in zip(part.numbers, part.results(), strict=True):
                    number = numbers[place]
                    if isinstance(result, Exception):
                        readings[number] = ComputationError(reason_of(result))
                    else:
                        reader = self._readers[pairs[number][1]]
                        readings[number] = reader.read(_trajectory(result, wanted[number], keys))
        self.count += len(pairs)
        return [readings[number] for number in range(len(pairs))]

    def _pair(self, key: Hashable, case: Case) -> ContactPair:
        """Return the pair of a case, assembled by this rank alone where there is none yet."""
        if key in self._pairs:
            return self._pairs[key]
        if key not in self._at_points:
            while len(self._at_points) >= _MOST_PAIRS:
                del self._at_points[next(iter(self._at_points))]
            self._at_points[key] = assemble(case, MPI.COMM_SELF, use_kept=False)
        return self._at_points[key]


def _trajectory(result: Result, case: Case, keys: Sequence[str]) -> Trajectory:
    """Return values of a history and derivatives, if it has any, (..., 1 + m)."""

    def both(name: str, values: FloatArray) -> FloatArray:
        if not result.derivatives:
            return values[..., None]
        slopes = np.moveaxis(result.derivatives[f"d_{name}"], 0, -1)
        return np.concatenate([values[..., None], slopes], axis=-1)

    histories, profiles = result.histories, result.profiles
    wear = np.stack([both(f"wear_{b}", profiles[f"wear_{b}"]) for b in BODIES])
    return Trajectory(
        histories["time"],
        both("approach", histories["approach"]),
        both("torque", histories["torque"]),
        np.stack([both(f"worn_volume_{b}", histories[f"worn_volume_{b}"]) for b in BODIES]),
        wear,
        np.stack([lost_mass(case, i, of_body, keys) for i, of_body in enumerate(wear)]),
    )
