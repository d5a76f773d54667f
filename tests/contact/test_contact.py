"""Contact against an independent active-set solver; every TAO type; force and displacement."""

import active_set
import numpy as np
import pytest
from one_contact import OneContact
from petsc4py import PETSc
from wearing import step_wear

from ringwear_par.contact import newton
from ringwear_par.contact.engine import TAO_TYPES
from ringwear_par.errors import ComputationError
from ringwear_par.history.elastic.bodies import young
from ringwear_par.wear.laws.threshold import ThresholdLaw

N = 40
FORCE = 45000.0


@pytest.fixture
def problem(paper_pair):
    """A small contact line: the paper's rings, every other element joined to its neighbour."""
    from ringwear_par.elasticity.mesh import ContactLine

    case, pair = paper_pair
    keep = np.sort(np.random.default_rng(3).choice(np.arange(1, 64), N - 1, replace=False))
    edges = np.concatenate([[0], keep, [64]])
    parts = np.zeros((N, 64))
    for i in range(N):
        parts[i, edges[i] : edges[i + 1]] = 1.0
    line = ContactLine(pair.line.edges[edges])
    return line, parts @ pair.compliance(young(case)).matrix @ parts.T


def gaps(n):
    """Gaps (mm): flat, half open, a crown, rough."""
    x = np.linspace(-1, 1, n)
    rng = np.random.default_rng(7)
    return {
        "flat": np.zeros(n),
        "half open": np.where(x > 0, 0.5, 0.0),
        "crown": 0.08 * x**2,
        "rough": 0.05 * rng.random(n),
    }


@pytest.fixture
def tao_type(request):
    options = PETSc.Options()
    options["contact_tao_type"] = request.param
    yield request.param
    del options["contact_tao_type"]


@pytest.mark.parametrize("tao_type", TAO_TYPES, indirect=True)
@pytest.mark.parametrize("shape", ["flat", "half open", "crown", "rough"])
def test_every_type_agrees_with_the_independent_solver(problem, comm, tao_type, shape):
    line, stiffness = problem
    gap = gaps(N)[shape]
    with OneContact(stiffness, line.area) as solver:
        state = solver.solve(gap, force=FORCE)
        p, delta = active_set.solve(stiffness, line.area, gap, force=FORCE)
        assert np.abs(state.pressure - p).max() <= 1e-8 * p.max()
        assert state.approach == pytest.approx(delta, rel=1e-8)
        assert abs(state.force / FORCE - 1) <= 1e-10
        assert state.residual <= 1e-9
        assert (state.gap >= -1e-9 * delta).all()
        assert (state.gap * state.pressure).max() <= 1e-8 * delta * p.max()
        given = solver.solve(gap, approach=0.7 * delta)
        p, _ = active_set.solve(stiffness, line.area, gap, approach=0.7 * delta)
        assert np.abs(given.pressure - p).max() <= 1e-8 * p.max()


@pytest.mark.parametrize("plain", [newton.PLAIN_ITERATIONS, 0], ids=["plain", "damped"])
def test_random_problems(problem, comm, monkeypatch, plain):
    """By plain steps, or by those of histories whose sets cycle."""
    monkeypatch.setattr(newton, "PLAIN_ITERATIONS", plain)
    line, stiffness = problem
    rng = np.random.default_rng(11)
    with OneContact(stiffness, line.area) as solver:
        for number in range(60):
            gap = rng.choice([0.0, 0.01, 0.1]) * rng.random(N)
            laws = tuple(ThresholdLaw(10 ** rng.uniform(-8, -5), rng.uniform(0, 150)) for _ in "ab")
            power, step = 0.35 * line.arm, 10 ** rng.uniform(-1, 2)
            force = 10 ** rng.uniform(2, 5)
            wear = step_wear(laws, power, step)
            state = solver.solve(gap, force=force, wear=wear)
            p, delta = active_set.solve(
                stiffness, line.area, gap, force=force,
                laws=[law.p0 for law in laws], rise=[step * law.k * power for law in laws],
            )  # fmt: skip
            assert np.abs(state.pressure - p).max() <= 1e-8 * p.max()
            assert state.approach == pytest.approx(delta, rel=1e-8)
            assert abs(state.force / force - 1) <= 1e-10
            if number % 10 == 0:
                again = solver.solve(gap, approach=delta, wear=wear)
                assert np.abs(again.pressure - p).max() <= 1e-8 * p.max()


@pytest.mark.parametrize("tao_type", TAO_TYPES, indirect=True)
@pytest.mark.parametrize("shape", ["flat", "half open", "crown", "rough"])
def test_light_loads_between_wide_gaps(problem, comm, tao_type, shape):
    line, stiffness = problem
    gap = gaps(N)[shape]
    with OneContact(stiffness, line.area) as solver:
        for force in (1e-6, 1e-3, 1.0):
            p, _ = active_set.solve(stiffness, line.area, gap, force=force)
            state = solver.solve(gap, force=force)
            assert np.abs(state.pressure - p).max() <= 1e-5 * p.max()
            assert abs(state.force / force - 1) <= 1e-10


def test_violent_wear(problem, comm):
    line, stiffness = problem
    wear = step_wear((ThresholdLaw(1e3),), 0.35 * line.arm, 1.0)
    with OneContact(stiffness, line.area) as solver:
        state = solver.solve(np.zeros(N), force=FORCE, wear=wear)
    # elasticity is nothing against this: all elements wear alike, p r is constant
    steady = FORCE / (line.area / line.arm).sum()
    assert state.pressure * line.arm == pytest.approx(np.full(N, steady), rel=1e-6)


def test_linear_in_the_load_while_all_is_in_contact(problem, comm):
    line, stiffness = problem
    with OneContact(stiffness, line.area) as solver:
        one = solver.solve(np.zeros(N), force=1.0)
        many = solver.solve(np.zeros(N), force=1e6)
    assert many.pressure == pytest.approx(1e6 * one.pressure, rel=1e-12)
    assert (one.pressure > 0).all()


def test_no_contact_at_a_small_approach(problem, comm):
    line, stiffness = problem
    with OneContact(stiffness, line.area) as solver:
        state = solver.solve(np.full(N, 0.1), approach=0.05)
    assert state.force == 0.0
    assert state.gap == pytest.approx(np.full(N, 0.05))


def test_failure_is_an_error_that_names_reason_and_residual(problem, comm):
    line, stiffness = problem
    options = PETSc.Options()
    options["contact_tao_max_it"] = 1
    try:
        with (
            OneContact(stiffness, line.area) as solver,
            pytest.raises(
                ComputationError, match=r"reason \w+ \(-?\d+\) after 1 iterations.*residual"
            ),
        ):
            solver.solve(gaps(N)["rough"], force=FORCE)
    finally:
        del options["contact_tao_max_it"]


def test_warm_steps_take_one_iteration(paper_pair, comm):
    case, pair = paper_pair
    matrix = pair.compliance(young(case)).matrix
    with OneContact(matrix, pair.line.area, pair.line.arm) as solver:
        gap = np.zeros(pair.line.n)
        wear = step_wear((case.wear_lower,), case.friction * case.load.omega * pair.line.arm, 1.0)
        counts = []
        for _ in range(10):
            state = solver.solve(gap, force=case.load.force, wear=wear)
            gap = gap + wear.depth(state.pressure)
            counts.append(state.iterations)
    assert counts[3:] == [1] * 7
