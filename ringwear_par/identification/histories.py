"""Histories of all experiments at some values of the fitted keys, with derivatives.

One small door: who fits asks ``Histories.responses`` and does not know how derivatives are found.
Here they are differences of histories that step side by side.
"""

from collections import defaultdict
from collections.abc import Hashable, Sequence

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import Case
from ringwear_par.contact.batch import load_batch_kernels
from ringwear_par.elasticity.pair import ContactPair
from ringwear_par.errors import ComputationError, reason_of
from ringwear_par.history.bodies import operator_key
from ringwear_par.history.pairs import assemble
from ringwear_par.identification.problem import FittedParameter, Problem
from ringwear_par.identification.readings import Reader
from ringwear_par.identification.trajectory import Trajectory
from ringwear_par.results.result import Result
from ringwear_par.studies.batches import computed

#: of adaptive steps, mm and of the mean pressure: differences must not see them
_STEPPING = {"time.tolerance": 2.5e-7, "time.pressure_tolerance": 0.03}
#: of differences, of the unknown's own size
_STEP = 1e-2


class Histories:
    """What the experiments of a problem would read, at any values of the fitted keys.

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
        self._parameters = problem.parameters
        self._cases = [e.case.replace(_STEPPING) for e in problem.experiments]
        self._readers = [Reader(experiment) for experiment in problem.experiments]
        self._keys: list[Hashable] = [operator_key(case) for case in self._cases]
        self._pairs: dict[Hashable, ContactPair] = {}
        for key, case in zip(self._keys, self._cases, strict=True):
            if key not in self._pairs:
                self._pairs[key] = assemble(case, comm)
        load_batch_kernels(comm)
        #: histories computed so far
        self.count = 0

    def responses(self, points: FloatArray) -> list[FloatArray | ComputationError]:
        """Return readings and derivatives of all experiments at some points. Not collective.

        Histories of all points and experiments step side by side.

        Parameters
        ----------
        points : (p, m) values of the fitted keys.

        Returns
        -------
        For each point (n, 1 + m), the readings of all experiments, one after another, and their
        derivatives with respect to the values; or why there are none.
        """
        stencils = [_stencil(self._parameters, point) for point in points]
        wanted = [(i, e) for i in range(len(points)) for e in range(len(self._cases))]
        cases = [self._with(e, row) for i, e in wanted for row in stencils[i][0]]
        owners = [e for i, e in wanted for _ in stencils[i][0]]
        results = iter(self._computed(cases, owners))
        found: list[list[FloatArray]] = [[] for _ in points]
        failures: dict[int, Exception] = {}
        for i, e in wanted:
            rows, weights = stencils[i]
            own = [next(results) for _ in rows]
            failed = next((one for one in own if isinstance(one, Exception)), None)
            if failed is not None:
                failures.setdefault(i, failed)
                continue
            read = [self._readers[e].read(_trajectory(r)) for r in own if isinstance(r, Result)]
            found[i].append(np.concatenate(read, axis=1) @ weights)
        return [
            ComputationError(reason_of(failures[i])) if i in failures else np.concatenate(parts)
            for i, parts in enumerate(found)
        ]

    def _with(self, experiment: int, values: FloatArray) -> Case:
        """Return the case of an experiment at some values."""
        keys = (parameter.key for parameter in self._parameters)
        return self._cases[experiment].replace(dict(zip(keys, values.tolist(), strict=True)))

    def _computed(self, cases: Sequence[Case], owners: Sequence[int]) -> list[Result | Exception]:
        """Return the results of cases of some experiments, or their failures."""
        groups: dict[Hashable, list[int]] = defaultdict(list)
        for number, owner in enumerate(owners):
            groups[self._keys[owner]].append(number)
        found: dict[int, Result | Exception] = {}
        for key, numbers in groups.items():
            own = [cases[number] for number in numbers]
            for block in computed(own, self._pairs[key], keep_ends=True):
                for place, result in zip(block.numbers, block.results(), strict=True):
                    found[numbers[place]] = result
        self.count += len(cases)
        return [found[number] for number in range(len(cases))]


def _stencil(
    parameters: Sequence[FittedParameter], point: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return where histories are needed for differences, (k, m), and their weights (k, 1 + m).

    Differences are central, or one-sided of second order at a bound.
    """
    m = len(parameters)
    rows, weights = [point], np.zeros((1 + 2 * m, 1 + m))
    weights[0, 0] = 1.0
    for j, parameter in enumerate(parameters):
        low, high = parameter.bounds
        size = abs(point[j]) if parameter.log else max(abs(point[j]), 0.05 * (high - low))
        h = _STEP * size
        at = np.array([-h, h])
        if point[j] - h < low:
            at = np.array([h, 2.0 * h])
        elif point[j] + h > high:
            at = np.array([-h, -2.0 * h])
        a, b = at.tolist()
        for k, (own, other) in enumerate(((a, b), (b, a))):
            row = point.copy()
            row[j] += own
            rows.append(row)
            weights[1 + 2 * j + k, 1 + j] = -other / (own * (own - other))
        weights[0, 1 + j] = -(a + b) / (a * b)
    return np.array(rows), weights


def _trajectory(result: Result) -> Trajectory:
    histories = result.histories
    volume = np.stack([histories["worn_volume_lower"], histories["worn_volume_upper"]])
    wear = np.stack([result.profiles["wear_lower"], result.profiles["wear_upper"]])
    return Trajectory(
        histories["time"], histories["approach"][:, None], histories["torque"][:, None],
        volume[..., None], wear[..., None],
    )  # fmt: skip
