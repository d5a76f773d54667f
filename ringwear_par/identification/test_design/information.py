"""The information of tests on the unknowns, nuisances of each test being eliminated."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import Case
from ringwear_par.identification.definition.problem import Experiment, Problem, Series
from ringwear_par.identification.model.noise import information_share, whitened
from ringwear_par.identification.model.readings import nuisance_columns
from ringwear_par.identification.model.rounds import Rounds
from ringwear_par.results.execution.stopping import StopSignals

#: singular values of nuisances' columns of unit length that are no more than round-off
_ROUND_OFF = 1e-10


def information_of_tests(
    problem: Problem, tests: Sequence[Experiment], draws: FloatArray, comm: MPI.Intracomm
) -> tuple[FloatArray, dict[int, str], int]:
    """Return the information of each test. Collective on comm; its ranks share each draw.

    Tests of one case, the same object, share its histories; series that they share are read once.

    Parameters
    ----------
    draws : (d, m) values of the keys.

    Returns
    -------
    (d, tests, m, m) of the unknowns, NaN of tests whose histories fail; why these fail, by number;
    and the histories computed.
    """
    groups: dict[int, list[int]] = {}
    for number, test in enumerate(tests):
        groups.setdefault(id(test.case), []).append(number)
    numbers = list(groups.values())
    whole = [_with_all_series([tests[number] for number in group]) for group in numbers]
    union_problem = replace(problem, experiments=tuple(whole), alternatives={})
    # signals are not waited for: there is nothing to keep
    rounds = Rounds(union_problem, comm, StopSignals())

    def compute() -> tuple[FloatArray, dict[int, str], int]:
        m = len(problem.parameters)
        matrices = np.full((len(draws), len(tests), m, m), np.nan)
        failures: dict[int, str] = {}
        for d, values in enumerate(draws):
            pairs = zip(problem.parameters, values.tolist(), strict=True)
            slopes = np.array([parameter.slope(value) for parameter, value in pairs])
            responses = rounds.responses_of(range(len(whole)), values)
            for group, test, response in zip(numbers, whole, responses, strict=True):
                if isinstance(response, Exception):
                    failures |= {n: str(response) for n in group if n not in failures}
                    continue
                by_series = _series_information(problem, test, response[:, 1:] * slopes)
                for number in group:
                    matrices[d, number] = sum(
                        by_series[id(series)] for series in tests[number].series
                    )
        return matrices, failures, rounds.count

    return rounds.lead(compute)


def _with_all_series(tests: Sequence[Experiment]) -> Experiment:
    """Return the test that has all series of some tests of one case."""
    series = {id(one): one for test in tests for one in test.series}
    return replace(tests[0], series=tuple(series.values()))


def _series_information(
    problem: Problem, test: Experiment, columns: FloatArray
) -> dict[int, FloatArray]:
    """Return the information (m, m) of each series of a test."""
    ends = np.cumsum([series.n for series in test.series])
    return {
        id(series): information(problem, test.case, series, columns[end - series.n : end])
        for series, end in zip(test.series, ends.tolist(), strict=True)
    }


def information(problem: Problem, case: Case, series: Series, columns: FloatArray) -> FloatArray:
    """Return the information (m, m) of a series, its nuisances eliminated.

    As nuisances are of one series, what several tell adds.

    Parameters
    ----------
    columns : (n, m) derivatives of its readings.
    """
    m = columns.shape[1]
    columns_and_nuisances = np.concatenate([columns, nuisance_columns(series, case)], axis=1)
    weighted = np.sqrt(information_share(problem.settings.loss)) * whitened(
        series, columns_and_nuisances / series.sd[:, None]
    )
    priors = [0.0 if n.prior is None else 1.0 / n.prior.sd for n in series.nuisances]
    stacked = np.concatenate([weighted, np.diag([*[0.0] * m, *priors])])
    size = np.linalg.norm(stacked, axis=0)
    stacked[:, m:] /= np.where(size > 0.0, size, 1.0)[m:]
    basis, values, _ = np.linalg.svd(stacked[:, m:], full_matrices=False)
    basis = basis[:, values > _ROUND_OFF]
    reduced: FloatArray = stacked[:, :m] - basis @ (basis.T @ stacked[:, :m])
    return reduced.T @ reduced
