"""Fits of numbers of which each value has an operator of its own: searches between exact ones."""

import coating_fit
import numpy as np
import pytest
from mpi4py import MPI

from ringwear_par.identification.definition.fit_file import read_fit
from ringwear_par.identification.fit import fit
from ringwear_par.identification.model import histories as operators_room
from ringwear_par.identification.model.histories import ROUGH_STEPS, Histories
from ringwear_par.identification.model.rounds import Rounds
from ringwear_par.results.execution.stop_signals import StopSignals

pytestmark = pytest.mark.serial

ELEMENTS = 8
#: narrow bounds need few nodes
BOUNDS = {
    "lower.layers[0].thickness": [0.04, 0.09],
    "lower.layers[0].young": [5e4, 1.2e5],
    "lower.layers[0].wear.k": [3e-8, 2e-7],
}
NARROW = {key: {**entry, "bounds": BOUNDS[key]} for key, entry in coating_fit.START.items()}


@pytest.fixture
def tables(shared_path):
    """A function that makes the fit file of a coating's thickness, modulus and k, as a dict."""
    if MPI.COMM_WORLD.rank == 0:
        coating_fit.write_readings(shared_path, ELEMENTS)
    MPI.COMM_WORLD.barrier()
    return lambda starts, keys=tuple(NARROW): coating_fit.fit_tables(
        shared_path, ELEMENTS, starts=starts, parameters={key: NARROW[key] for key in keys}
    )


def numbers(result):
    """Return estimates and standard deviations, (2, keys)."""
    return np.array([[p.estimate, p.sd] for p in result.parameters]).T


def test_a_search_between_operators_ends_at_the_optimum_of_exact_ones(tables, comm, monkeypatch):
    keys = "lower.layers[0].thickness", "lower.layers[0].wear.k"
    between = fit(tables(2, keys), comm)
    assert between.n_at_best == len(between.starts) == 2
    assert all(start.converged for start in between.starts)
    monkeypatch.setattr(operators_room, "interpolate", lambda *_: None)
    exact = fit(tables(1, keys), comm)
    (estimates, sds), (expected, expected_sds) = numbers(between), numbers(exact)
    assert (np.abs(estimates - expected) <= 0.01 * expected_sds).all()
    np.testing.assert_allclose(sds, expected_sds, rtol=1e-3)
    assert between.chi2 == pytest.approx(exact.chi2, rel=1e-6)
    # the search itself was on rougher histories
    assert between.starts[0].optimum != exact.starts[0].optimum


@pytest.mark.several
def test_readings_between_operators_are_those_of_one_rank(tables, comm):
    """To the last bit: ranks share the operators at the nodes, and a search all histories."""
    problem = read_fit(tables(2))
    points = np.outer([0.9, 1.1], list(problem.start.values()))
    rounds, alone = Rounds(problem, comm, StopSignals()), Histories(problem, MPI.COMM_SELF)
    rounds.operators.interpolate(comm)
    alone.operators.interpolate(MPI.COMM_SELF)
    assert rounds.operators.are_interpolated
    together = rounds.lead(lambda: rounds.responses(points, ROUGH_STEPS, exact=False))
    for one, other in zip(together, alone.responses(points, ROUGH_STEPS, exact=False), strict=True):
        np.testing.assert_array_equal(one, other)


def test_operators_between_others_are_those_of_a_search_only(tables, comm):
    """Whoever asks for readings without saying how gets exact ones."""
    problem = read_fit(tables(2))
    histories = Histories(problem, comm)
    point = 0.9 * np.array([list(problem.start.values())])
    (before,) = histories.responses(point)
    histories.operators.interpolate(comm)
    assert histories.operators.are_interpolated
    (after,) = histories.responses(point)
    (between,) = histories.responses(point, exact=False)
    np.testing.assert_array_equal(before, after)
    assert 0.0 < np.abs(between[:, 0] - before[:, 0]).max() < 1e-3 * before[:, 0].max()
