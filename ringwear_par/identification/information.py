"""What tests would tell of the unknowns, nuisances of each test being eliminated."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import FloatArray
from ringwear_par.identification.histories import Histories
from ringwear_par.identification.intervals import share_of_loss
from ringwear_par.identification.problem import Experiment, Problem
from ringwear_par.identification.readings import nuisance_columns, whitened
from ringwear_par.parallel import together

#: singular values of nuisances' columns of unit length that are no more than round-off
_ROUND_OFF = 1e-10


def informations(
    problem: Problem, tests: Sequence[Experiment], draws: FloatArray, comm: MPI.Intracomm
) -> tuple[FloatArray, dict[int, str], int]:
    """Return what each test tells. Collective on comm, whose ranks share the tests.

    Parameters
    ----------
    draws : (d, m) values of the keys.

    Returns
    -------
    (d, tests, m, m) of the unknowns, NaN of tests whose histories fail; why these fail, by number;
    and the histories computed.
    """
    own = list(range(len(tests)))[comm.rank :: comm.size]
    histories = Histories(replace(problem, experiments=tuple(tests), alternatives={}), comm)
    m = len(problem.parameters)
    found: dict[int, FloatArray] = {}
    failures: dict[int, str] = {}
    with together(comm):
        for d, values in enumerate(draws):
            pairs = zip(problem.parameters, values.tolist(), strict=True)
            slopes = np.array([parameter.slope(value) for parameter, value in pairs])
            for number, response in zip(own, histories.of(own, values), strict=True):
                told = found.setdefault(number, np.full((len(draws), m, m), np.nan))
                if isinstance(response, Exception):
                    failures.setdefault(number, str(response))
                else:
                    told[d] = information(problem, tests[number], response[:, 1:] * slopes)
    every: dict[int, FloatArray] = {}
    for part, failed in comm.allgather((found, failures)):
        every |= part
        failures |= failed
    whole = np.stack([every[number] for number in range(len(tests))], axis=1)
    return whole, failures, comm.allreduce(histories.count)


def information(problem: Problem, test: Experiment, columns: FloatArray) -> FloatArray:
    """Return what a test tells of the unknowns (m, m), its nuisances eliminated.

    Parameters
    ----------
    columns : (n, m) derivatives of its readings.
    """
    m, begin, rows, priors = columns.shape[1], 0, [], []
    counts = [len(series.nuisances) for series in test.series]
    for i, series in enumerate(test.series):
        part = slice(begin, begin + series.n)
        begin = part.stop
        own = np.zeros((series.n, m + sum(counts)))
        own[:, :m] = columns[part]
        first = m + sum(counts[:i])
        own[:, first : first + counts[i]] = nuisance_columns(series, test.case)
        rows.append(whitened(series, own / series.sd[:, None]))
        priors += [0.0 if n.prior is None else 1.0 / n.prior.sd for n in series.nuisances]
    told = np.sqrt(share_of_loss(problem.settings.loss)) * np.concatenate(rows)
    stacked = np.concatenate([told, np.diag([*[0.0] * m, *priors])])
    size = np.linalg.norm(stacked, axis=0)
    stacked[:, m:] /= np.where(size > 0.0, size, 1.0)[m:]
    basis, values, _ = np.linalg.svd(stacked[:, m:], full_matrices=False)
    basis = basis[:, values > _ROUND_OFF]
    left: FloatArray = stacked[:, :m] - basis @ (basis.T @ stacked[:, :m])
    return left.T @ left


def without_nuisances(matrix: FloatArray, m: int) -> FloatArray:
    """Return what information (u, u) tells of the first m unknowns alone, (m, m)."""
    size = np.sqrt(np.diag(matrix))
    size = np.where(size > 0.0, size, 1.0)
    scaled = matrix / np.outer(size, size)
    rest = scaled[:m, m:] @ np.linalg.pinv(scaled[m:, m:], rcond=_ROUND_OFF, hermitian=True)
    alone: FloatArray = scaled[:m, :m] - rest @ scaled[m:, :m]
    return 0.5 * (alone + alone.T) * np.outer(size[:m], size[:m])
