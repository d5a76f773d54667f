"""The contact problem by itself: its derivatives, its residual, and what it does not import."""

import subprocess
import sys

import numpy as np
import pytest

from ringwear_par.contact.problem import ContactProblem

N = 12


class _Cubic:
    """Wear of a step in proportion to the cube of an average pressure."""

    def __init__(self, average=None):
        self.local, self.average = average is None, np.eye(N) if average is None else average

    def depth(self, p):
        return 1e-3 * self.average @ (self.average @ p) ** 3

    def d_depth_dp(self, p):
        return np.diag(self.jacobian(p))

    def jacobian(self, p):
        return 1e-3 * (self.average * 3.0 * (self.average @ p) ** 2) @ self.average

    def potential(self, p):
        return 1e-3 * (self.average @ p) ** 4 / 4.0


@pytest.fixture
def parts():
    rng = np.random.default_rng(2)
    root, area = rng.random((N, N)), rng.uniform(1.0, 2.0, N)
    # area integrals of averages are those of the values: diag(area) times the average is symmetric
    near = np.exp(-((np.arange(N)[:, None] - np.arange(N)) ** 2))
    average = near / area[:, None]
    return 0.05 * root @ root.T + np.eye(N), area, rng.random(N), average, rng.uniform(0.5, 1.5, N)


def hessian_of(problem, scaled, q):
    """The Hessian as the solver puts it together."""
    problem.linearise(q)
    hessian = scaled.copy()
    problem.add_coupling(q, hessian)
    hessian[np.diag_indices(N)] = problem.diagonal
    return hessian


@pytest.mark.parametrize("wear", ["none", "local", "non-local"])
def test_gradient_and_hessian_are_derivatives(parts, wear):
    compliance, area, gap, average, q = parts
    problem = ContactProblem(compliance, area)
    assert np.diag(problem.scaled(compliance)) == pytest.approx(np.ones(N), rel=1e-15)
    growth = {"none": None, "local": _Cubic(), "non-local": _Cubic(average)}[wear]
    problem.pose(gap, 0.7, growth)
    scaled = problem.scaled(compliance)

    def objective(q):
        return problem.objective(q, scaled @ q)[0]

    def gradient(q):
        product = scaled @ q
        problem.add_gradient(q, product)
        return product

    assert gradient(q) == pytest.approx(problem.objective(q, scaled @ q)[1], rel=1e-14)
    hessian, h = hessian_of(problem, scaled, q), 1e-5
    for e in range(N):
        step = h * np.eye(N)[e]
        slope = (objective(q + step) - objective(q - step)) / (2 * h)
        assert slope == pytest.approx(gradient(q)[e], abs=1e-7 * np.abs(gradient(q)).max())
        column = (gradient(q + step) - gradient(q - step)) / (2 * h)
        assert column == pytest.approx(hessian[:, e], abs=1e-8 * np.abs(hessian).max())


def test_the_hessian_changes_only_when_it_does(parts):
    compliance, area, gap, average, q = parts
    problem = ContactProblem(compliance, area)
    problem.pose(gap, 0.7, None)
    assert problem.linearise(q) == (False, False)
    problem.pose(gap, 0.7, _Cubic())
    assert problem.linearise(q) == (True, False)
    assert problem.linearise(q) == (False, False)
    problem.pose(gap, 0.7, _Cubic(average))
    assert problem.linearise(q) == (True, True)
    assert problem.linearise(q) == (True, True)
    problem.pose(gap, 0.7, None)
    assert problem.linearise(q) == (True, True)  # all entries are put back
    assert problem.linearise(q) == (False, False)


def test_residual_of_a_solution_and_of_none(parts):
    compliance, area, _, _, _ = parts
    problem = ContactProblem(compliance, area)
    gap = np.where(np.arange(N) < 6, 0.0, 9.0)
    problem.pose(gap, 1.0, None)
    assert not problem.apart
    touching, p = gap == 0.0, np.zeros(N)
    p[touching] = np.linalg.solve(compliance[np.ix_(touching, touching)], area[touching])
    assert (p[touching] > 0).all()
    q = problem.scale * p
    gradient = problem.scaled(compliance) @ q
    problem.add_gradient(q, gradient)
    assert gradient / problem.weights == pytest.approx(compliance @ p / area + gap - 1.0, abs=1e-12)
    problem.linearise(q)
    worst, largest = problem.defect(q, gradient)
    assert largest == q.max()
    assert worst <= 1e-14 * largest
    assert problem.defect(1.01 * q, gradient + 0.01)[0] > 1e-3
    assert problem.defect(q, gradient * np.nan)[0] == np.inf
    problem.pose(gap + 2.0, 1.0, None)
    assert problem.apart


@pytest.mark.serial
def test_starts_neither_mpi_nor_petsc_nor_compiled_code():
    text = (
        "import sys; import ringwear_par.contact.problem, ringwear_par.contact.approach; "
        "import ringwear_par.options, ringwear_par.version; "
        "heavy = ('mpi4py.MPI', 'petsc4py', 'numba', 'scipy', 'h5py'); "
        "print([name for name in heavy if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
