"""Many contact problems in lock step: derivatives, optimality, digits that are each one's own."""

import numpy as np
import pytest
from one_contact import OneContact

from ringwear_par.compiled.product_rows import Matrices
from ringwear_par.contact import hessians, newton
from ringwear_par.contact.engine import TAO_TYPES, ContactEngine
from ringwear_par.contact.problem import KKT_TOLERANCE
from ringwear_par.contact.row_products import RowProducts
from ringwear_par.contact.scaled_compliances import ScaledCompliances
from ringwear_par.errors import HistoriesError
from ringwear_par.wear.increment import WearIncrement
from ringwear_par.wear.law import stack_laws
from ringwear_par.wear.laws.non_local import NonLocalLaw, averaging
from ringwear_par.wear.laws.power import PowerLaw
from ringwear_par.wear.laws.threshold import ThresholdLaw
from ringwear_par.wear.local_state import LocalState

pytestmark = pytest.mark.serial

N, B = 19, 11
R = np.linspace(28.5, 31.5, N)
AREA = 2 * np.pi * R * np.gradient(R)
RNG = np.random.default_rng(5)
#: mm^3/MPa, of two pairs of moduli
COMPLIANCES = np.array(
    [c * AREA[:, None] * AREA * np.exp(-np.abs(R[:, None] - R)) for c in (1e-6, 3e-6)]
)
WHICH = np.arange(B) % 2
CROWN = 1e-3 * (R - 30.0) ** 2
GAP = CROWN + RNG.uniform(0.0, 1e-5, (B, N))
FORCE = 10.0 ** RNG.uniform(1.0, 5.0, B)
LAWS = {
    "threshold": [ThresholdLaw(k, p0) for k, p0 in zip(RNG.uniform(1e-8, 1e-6, B),
                                                       RNG.uniform(0, 40, B), strict=True)],
    "power": [PowerLaw(k, 1.7) for k in RNG.uniform(1e-10, 1e-9, B)],
    "non-local": [NonLocalLaw(k, length=0.3) for k in RNG.uniform(1e-8, 1e-6, B)],
}  # fmt: skip


def wear_of(name):
    """The wear of an implicit step of B histories."""
    laws = LAWS[name]
    speed = np.linspace(80.0, 120.0, B)[:, None] * np.ones(N)
    at = LocalState(np.zeros(B), R, speed, np.full(B, 0.1), np.zeros((B, N)), 0.0 * speed)
    average = averaging(R, AREA, laws[0].length) if laws[0].length else None
    return WearIncrement((stack_laws(laws), None), (at, at), np.linspace(1.0, 5.0, B),
                         (average, None))  # fmt: skip


def engine_of(which, tao_type=None):
    """An engine of histories that have these compliances."""
    return ContactEngine(ScaledCompliances.of(COMPLIANCES, AREA), which, tao_type)


@pytest.fixture
def solver():
    with engine_of(WHICH) as engine:
        yield engine


@pytest.mark.parametrize("name", LAWS)
def test_the_hessian_is_the_derivative_of_the_gradient(solver, name):
    """Products with a direction against differences of gradients."""
    solver.solve(GAP, force=FORCE, wear=wear_of(name))
    problem, blocks = solver._problem, solver._hessians
    problem.at_work = np.arange(B)
    q = RNG.uniform(0.5, 2.0, (B, N)) * solver.warm.scaled_pressure.max()
    direction, h = RNG.normal(size=(B, N)), 1e-5 * q.min()

    def gradient(unknowns):
        problem.unknowns[:] = unknowns
        problem.evaluate()
        return problem.gradients.copy()

    gradient(q)
    blocks.set_slopes(problem.at_work, *problem.slopes())
    products = np.array([blocks.matrix(i) @ d for i, d in enumerate(direction)])
    after, before = (gradient(q + sign * h * direction) for sign in (1.0, -1.0))
    found = (after - before) / (2.0 * h)
    assert found == pytest.approx(products, rel=1e-4, abs=1e-4 * np.abs(found).max())


def load_of(control):
    return {control: {"force": FORCE, "approach": np.linspace(-1e-3, 4e-3, B)}[control]}


@pytest.mark.parametrize("name", [None, *LAWS])
@pytest.mark.parametrize("control", ["force", "approach"])
@pytest.mark.parametrize("way", ["bases", "factors", "damped", *TAO_TYPES[1:]])
def test_every_history_meets_its_conditions(monkeypatch, comm, name, control, way):
    """Pressures >= 0, gaps >= 0, one of them 0, the load; and as it is found alone."""
    if way == "factors":
        monkeypatch.setattr(hessians, "LARGEST_WITH_BASES", 0)
    if way == "damped":
        monkeypatch.setattr(newton, "PLAIN_ITERATIONS", 0)
    ours = way not in TAO_TYPES
    wear, load = None if name is None else wear_of(name), load_of(control)
    with engine_of(WHICH, None if ours else way) as engine:
        found = engine.solve(GAP, **load, wear=wear)
    monkeypatch.undo()
    touched = 0
    for i in range(B):
        own = None if wear is None else wear.take(np.array([i]))
        p = found.pressure[i]
        gap = GAP[i] - found.approach[i] + COMPLIANCES[WHICH[i]] @ p / AREA
        gap += 0.0 if own is None else own.depth(p[None])[0]
        size = np.abs(GAP[i] - found.approach[i]).max()
        assert (p >= 0.0).all()
        assert gap.min() >= -1e-9 * size
        assert np.abs(np.where(p > 0.0, gap, 0.0)).max() <= 1e-9 * size
        assert np.abs(found.gap[i] - gap).max() <= 1e-9 * size
        touched += 0 < np.count_nonzero(p) < N
        if control == "force":
            assert AREA @ p == pytest.approx(FORCE[i], rel=1e-12 if ours else 1e-10)
        with OneContact(COMPLIANCES[WHICH[i]], AREA) as single:
            exact = single.solve(GAP[i], **{control: load[control][i]}, wear=own)
        error = 2e-11 if ours else 1e-9
        assert np.abs(p - exact.pressure).max() <= error * max(exact.pressure.max(), 1e-300)
        assert found.approach[i] == pytest.approx(exact.approach, rel=error)
    assert touched > 2  # some are in partial contact
    assert found.residual.max() <= KKT_TOLERANCE


@pytest.mark.parametrize("control", ["force", "approach"])
@pytest.mark.parametrize("way", ["damped", *TAO_TYPES[1:]])
def test_what_follows_a_solution_does_not_depend_on_the_way_to_it(
    monkeypatch, solver, control, way
):
    """Its response to gaps, and the solution of the next problem."""
    wear, change = wear_of("threshold"), RNG.uniform(0.0, 1e-5, (B, N))
    exact = solver.solve(GAP, **load_of(control), wear=wear), solver.derivatives.response(change)
    if way == "damped":
        monkeypatch.setattr(newton, "PLAIN_ITERATIONS", 0)
    with engine_of(WHICH, way if way in TAO_TYPES else None) as engine:
        found = (
            engine.solve(GAP, **load_of(control), wear=wear),
            engine.derivatives.response(change),
        )
        monkeypatch.undo()
        again = engine.solve(GAP, **load_of(control), wear=wear)
    size = exact[0].pressure.max(axis=1, keepdims=True)
    for state in (found[0], again):
        assert (np.abs(state.pressure - exact[0].pressure) <= 1e-9 * size).all()
    assert found[1] == pytest.approx(exact[1], rel=1e-9, abs=1e-9 * np.abs(exact[1]).max())


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("control", ["force", "approach"])
def test_digits_do_not_depend_on_the_company(solver, name, control):
    """Nor does the response: among others, alone, in another order, with some left out."""
    given, wear = load_of(control)[control], wear_of(name)
    change = RNG.uniform(0.0, 1e-5, (B, N))
    every = solver.solve(GAP, **{control: given}, wear=wear)
    response = solver.derivatives.response(change)
    for part in (np.array([3]), np.array([10, 0, 5]), np.arange(B)[::-1]):
        taken = engine_of(WHICH[part])
        own = taken.solve(GAP[part], **{control: given[part]}, wear=wear.take(part))
        for what, value in vars(own).items():
            assert np.array_equal(value, getattr(every, what)[part]), what
        assert np.array_equal(taken.derivatives.response(change[part]), response[part])
        taken.destroy()
    some = np.array([1, 4, 9])
    again = solver.take(np.arange(B))
    solver.solve(2.0 * GAP, **{control: given}, wear=wear, histories=some)
    left = np.setdiff1d(np.arange(B), some)
    assert np.array_equal(solver.warm.scaled_pressure[left], again.warm.scaled_pressure[left])
    assert np.array_equal(solver.derivatives.response(change)[left], response[left])
    again.destroy()


def test_no_force_is_no_pressure(solver):
    """The bodies just touch; and what comes after starts from there."""
    force = np.where(np.arange(B) == 4, 0.0, FORCE)
    for given in (force, FORCE, force):
        found = solver.solve(GAP, force=given, wear=wear_of("power"))
        assert found.force == pytest.approx(given, rel=1e-12)
    assert found.approach[4] == GAP[4].min()
    assert not found.pressure[4].any()
    assert not solver.derivatives.response(GAP)[4].any()


def test_who_cannot_be_solved_is_named(solver):
    gap = GAP.copy()
    gap[[2, 7]] = np.nan
    with pytest.raises(HistoriesError) as caught:
        solver.solve(gap, force=FORCE)
    assert np.flatnonzero(caught.value.which).tolist() == [2, 7]


def hessians_of(n, count):
    """Hessians of two compliances, n elements, with slopes in proportion to speeds on some."""
    base = np.exp(-np.abs(np.subtract.outer(np.arange(n), np.arange(n))) / 5.0)
    area, which = RNG.uniform(1.0, 2.0, n), np.arange(count) % 2
    speed = RNG.uniform(1.0, 2.0, (2, n))
    compliances = ScaledCompliances.of(np.array([base, 2.0 * base]), area, speed)
    made = hessians.Hessians(compliances, which)
    shape = compliances.speed[which]
    made.blocks.slopes[:] = np.where(RNG.uniform(size=(count, n)) < 0.7, shape, 0.0)
    made.blocks.slopes[::3] *= RNG.uniform(0.0, 1e3, (len(made.blocks.slopes[::3]), 1))
    return made, compliances.matrices, compliances.weights[which]


@pytest.mark.parametrize("n", [1, 7, 8, 37, 64])
@pytest.mark.parametrize("kind", ["speed", "any shape", "coupled"])
def test_inverses_are_those_of_each_system(n, kind):
    """On the elements in contact; steps carry the force that is missing."""
    made, matrices, weights = hessians_of(n, 16)
    free = RNG.uniform(size=(16, n)) < 0.8
    free[1] = free[:, 0] = True
    if kind == "any shape":
        made.blocks.slopes[:] = RNG.uniform(0.0, 1.0, (16, n))
    if kind == "coupled":
        coupling = RNG.uniform(-0.01, 0.01, (16, n, n))
        made.coupling = coupling + coupling.transpose(0, 2, 1)
    asked, right, missing = np.array([0, 1, 6, 9, 15]), RNG.normal(size=(5, n)), np.arange(5.0)
    made.refresh(asked, free)
    out = made.solve(asked, np.array([right, 2.0 * right]))
    steps, changes = made.steps(asked, right, missing, hessians.SOLVED)
    for place, i in enumerate(asked):
        on = np.flatnonzero(free[i])
        block = matrices[i % 2] + np.diag(made.blocks.slopes[i])
        if kind == "coupled":
            block = block + made.coupling[i]
        exact, border = np.zeros(n), np.zeros(n)
        exact[on] = np.linalg.solve(block[np.ix_(on, on)], right[place, on])
        border[on] = np.linalg.solve(block[np.ix_(on, on)], weights[i, on])
        assert out[:, place] == pytest.approx(np.array([exact, 2.0 * exact]), rel=1e-10, abs=1e-11)
        change = (missing[place] + weights[i] @ exact) / (weights[i] @ border)
        assert changes[place] == pytest.approx(change, rel=1e-10)
        assert steps[place] == pytest.approx(change * border - exact, abs=1e-10)
        assert weights[i] @ steps[place] == pytest.approx(missing[place], abs=1e-10)


def test_bases_that_no_history_has_any_more_are_forgotten():
    """A history whose contact grows has many sets, one after another."""
    made, matrices, _ = hessians_of(12, 3)
    right = RNG.normal(size=(3, 12))
    for _ in range(40):
        free = RNG.uniform(size=(3, 12)) < 0.7
        free[:, 0] = True
        made.refresh(np.arange(3), free)
        out = made.solve(np.arange(3), right)
        for i in range(3):
            on = np.flatnonzero(free[i])
            block = matrices[i % 2] + np.diag(made.blocks.slopes[i])
            exact = np.linalg.solve(block[np.ix_(on, on)], right[i, on])
            assert out[i, on] == pytest.approx(exact, rel=1e-9, abs=1e-10)
    assert len(made._stack.bases.psi) <= 12


@pytest.mark.parametrize("n", [12, 37, 64, 65, 100])
def test_digits_of_products_do_not_depend_on_the_other_rows(n):
    """Nor on how many right sides there are, nor on who else has the same matrix."""
    matrices, rows = RNG.normal(size=(3, n, n)), RNG.normal(size=(41, n))

    def products(rows, which):
        return RowProducts(np.asarray(which)).of(rows, Matrices.of(matrices))

    every = products(rows, np.full(41, 1))
    assert every == pytest.approx(rows @ matrices[1], abs=1e-10)
    for count in (1, 2, 7, 8, 9, 40):
        part = RNG.permutation(41)[:count]
        assert np.array_equal(products(rows[part], np.full(count, 1)), every[part])
        sides = products(np.array([rows[part], 2.0 * rows[part]]), np.full(count, 1))
        assert np.array_equal(sides[0], every[part])
        which = RNG.integers(0, 3, count)
        mixed = products(np.array([rows[part], rows[part]]), which)
        assert np.array_equal(mixed[1][which == 1], every[part][which == 1])
        for k in range(3):
            exact = rows[part][which == k] @ matrices[k]
            assert mixed[0][which == k] == pytest.approx(exact, abs=1e-10)
