"""Fits of numbers of which each value has an operator of its own: searches between exact ones."""

import coating_fit
import numpy as np
import pytest
from mpi4py import MPI

from ringwear_par.identification.definition.fit_file import read_fit
from ringwear_par.identification.fit import fit
from ringwear_par.identification.model import histories as histories_room
from ringwear_par.identification.model.histories import Histories

ELEMENTS = 12


@pytest.fixture
def tables(shared_path):
    """A function that makes the fit file of a coating's thickness, modulus and k, as a dict."""
    if MPI.COMM_WORLD.rank == 0:
        coating_fit.write_readings(shared_path, ELEMENTS)
    MPI.COMM_WORLD.barrier()
    return lambda **settings: coating_fit.fit_tables(shared_path, ELEMENTS, **settings)


def numbers(result):
    """Return estimates and standard deviations, (2, keys)."""
    return np.array([[p.estimate, p.sd] for p in result.parameters]).T


def test_a_search_between_operators_ends_at_the_optimum_of_exact_ones(tables, comm, monkeypatch):
    between = fit(tables(starts=4), comm)
    if comm.size > 1:
        alone = fit(tables(starts=4), MPI.COMM_SELF)
        np.testing.assert_array_equal(numbers(between), numbers(alone))
        assert [s.objective for s in between.starts] == [s.objective for s in alone.starts]
    assert between.n_at_best == len(between.starts) == 4
    assert all(start.converged for start in between.starts)
    monkeypatch.setattr(histories_room, "interpolate", lambda *_: None)
    exact = fit(tables(starts=1), comm)
    (estimates, sds), (expected, expected_sds) = numbers(between), numbers(exact)
    assert (np.abs(estimates - expected) <= 0.01 * expected_sds).all()
    np.testing.assert_allclose(sds, expected_sds, rtol=1e-3)
    assert between.chi2 == pytest.approx(exact.chi2, rel=1e-6)
    # the search itself was on rougher histories
    assert between.starts[0].optimum != exact.starts[0].optimum


def test_operators_between_others_are_those_of_a_search_only(tables, comm):
    """Whoever asks for readings without saying how gets exact ones."""
    problem = read_fit(tables(starts=4))
    histories = Histories(problem, comm)
    point = 0.9 * np.array([list(problem.start.values())])
    (before,) = histories.responses(point)
    histories.interpolate(problem, comm)
    assert histories.are_interpolated
    (after,) = histories.responses(point)
    (between,) = histories.responses(point, exact=False)
    np.testing.assert_array_equal(before, after)
    assert 0.0 < np.abs(between[:, 0] - before[:, 0]).max() < 1e-3 * before[:, 0].max()
