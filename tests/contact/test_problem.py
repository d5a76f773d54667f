"""The contact problem by itself: its derivatives, its residual, and what it does not import."""

import numpy as np
import pytest

from ringwear_par.contact.problem import ContactProblem
from ringwear_par.contact.scaled_compliances import ScaledCompliances

N, B = 12, 3


class _Cubic:
    """Wear of a step in proportion to the cube of an average pressure."""

    def __init__(self, average=None):
        self.local, self.average = average is None, np.eye(N) if average is None else average

    def depth(self, p):
        return 1e-3 * (p @ self.average.T) ** 3 @ self.average.T

    def d_depth_dp(self, p):
        return np.diagonal(self.jacobian(p), axis1=-2, axis2=-1)

    def jacobian(self, p):
        slope = 3.0 * (p @ self.average.T) ** 2
        return 1e-3 * (self.average * slope[..., None, :]) @ self.average

    def potential(self, p):
        return 1e-3 * (p @ self.average.T) ** 4 / 4.0

    def growth_of(self, histories):
        return self


@pytest.fixture
def problem():
    rng = np.random.default_rng(2)
    roots, area = rng.random((2, N, N)), rng.uniform(1.0, 2.0, N)
    symmetric = 0.05 * roots @ roots.transpose(0, 2, 1) + np.eye(N)
    posed = ContactProblem(ScaledCompliances.of(symmetric, area), np.array([0, 1, 0]))
    posed.symmetric = symmetric
    return posed


def wear_of(name, problem):
    """Wear of a step by name."""
    if name == "none":
        return None
    # area integrals of averages are those of the values: diag(area) times the average is symmetric
    near = np.exp(-((np.arange(N)[:, None] - np.arange(N)) ** 2))
    return _Cubic(near / problem.area[:, None] if name == "non-local" else None)


@pytest.mark.parametrize("wear", ["none", "local", "non-local"])
@pytest.mark.parametrize("at_work", [[0, 1, 2], [2, 1]], ids=["all", "some"])
def test_gradient_and_hessian_are_derivatives(problem, wear, at_work):
    rng = np.random.default_rng(3)
    gap, q = rng.random((B, N)), rng.uniform(0.5, 1.5, (len(at_work), N))
    approach = np.array([0.7, 0.9, 1.1])
    problem.pose(gap, None, approach, wear_of(wear, problem), np.array(at_work))

    def gradient_at(unknowns):
        problem.unknowns[at_work] = unknowns
        problem.evaluate()
        return problem.gradients[at_work]

    def objective_at(unknowns):
        problem.unknowns[at_work] = unknowns
        return problem.objective()

    gradient, h = gradient_at(q), 1e-5
    slope, coupling = problem.slopes()
    slope = problem.scaled_slopes(slope, np.array(at_work))
    assert (coupling is None) == (wear != "non-local")
    hessians = problem.compliances.matrices[problem.which[at_work]] + slope[..., None] * np.eye(N)
    hessians = hessians if coupling is None else hessians + coupling
    for place in range(len(at_work)):
        for e in range(N):
            step = np.zeros_like(q)
            step[place, e] = h
            difference = (objective_at(q + step) - objective_at(q - step)) / (2 * h)
            assert difference == pytest.approx(gradient[place, e], abs=1e-7 * abs(gradient).max())
            column = (gradient_at(q + step) - gradient_at(q - step)) / (2 * h)
            assert column[place] == pytest.approx(
                hessians[place, :, e], abs=1e-8 * abs(hessians).max()
            )
            assert not np.delete(column, place, axis=0).any()


def test_residuals_of_solutions_and_of_none(problem):
    every, area = np.arange(B), problem.area
    gap = np.where(np.arange(N) < 6, 0.0, 9.0) * np.ones((B, 1))
    apart = problem.pose(gap, None, np.ones(B), None, every)
    assert not apart.any()
    touching, q = gap[0] == 0.0, np.zeros((B, N))
    for i, compliance in enumerate(problem.symmetric[problem.which]):
        p = np.linalg.solve(compliance[np.ix_(touching, touching)], area[touching])
        assert (p > 0).all()
        q[i, touching] = problem.scale[i, touching] * p
    no_slope = np.zeros((B, N))
    problem.unknowns[:] = q
    problem.evaluate()
    p = q / problem.scale
    opening = np.einsum("bij,bj->bi", problem.symmetric[problem.which], p) / area + gap - 1.0
    assert problem.gaps_of(problem.gradients) == pytest.approx(opening, abs=1e-12)
    assert problem.residuals(every, no_slope).max() <= 1e-14
    problem.gradients[1] *= np.nan
    residuals = problem.residuals(np.array([1, 2]), no_slope)
    assert residuals[0] == np.inf
    assert residuals[1] <= 1e-14
    problem.unknowns[:] *= 1.01
    problem.gradients[:] += 0.01
    assert problem.residuals(every, no_slope).min() > 1e-3
    problem.unknowns[:] = 0.0
    assert (problem.residuals(every, no_slope) == np.inf).all()


def test_histories_that_need_no_pressure_are_not_at_work(problem):
    gap = np.ones((B, N)) * np.array([[0.5], [2.0], [0.5]])
    some = np.array([1, 2])
    apart = problem.pose(gap, None, np.ones(B), None, some)
    assert apart.tolist() == [False, True, False]
    assert problem.at_work.tolist() == [2]
    apart = problem.pose(gap, np.array([0.0, 0.0, 5.0]), None, None, some)
    assert apart.tolist() == [True, True, False]
    assert problem.approaches[1] == 2.0
    with pytest.raises(ValueError, match="force or approach"):
        problem.pose(gap, None, None, None, some)
