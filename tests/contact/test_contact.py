"""Contacts by TAO and in blocks: against closed forms, a dense active set, and each other."""

import time
from dataclasses import replace

import active_set
import numpy as np
import pytest
from parts import BlockSolver, Line, Material, Mesh, PowerLaw, TaoContact, ThresholdLaw
from petsc4py import PETSc
from reference_cases import paper_case
from tracing import ALONE, trace

from ringwear_par.batched import take
from ringwear_par.contact import _rows
from ringwear_par.contact.problem import Compliance
from ringwear_par.elasticity.bem.pair import assemble_pair
from ringwear_par.elasticity.mesh import contact_line
from ringwear_par.elasticity.sections import Body, Section
from ringwear_par.history.block import Block
from ringwear_par.history.elastic import assemble

N = 32


@pytest.fixture(scope="module")
def paper():
    case = paper_case(Mesh(N))
    return case, assemble(case, ALONE)


def in_blocks(block, *problem, relative=1e-9):
    """Return contacts by the block solver, from no pressures."""
    gap, load, _ = problem
    solver = BlockSolver(block.compliance, block.by_force, np.full(len(gap), np.inf), relative)
    return solver.solve(*problem, np.zeros_like(gap), np.zeros_like(load))


def by_tao(block, *problem):
    """Return contacts by TAO, from no pressures."""
    gap, load, _ = problem
    with TaoContact(block.compliance, block.by_force) as tao:
        return tao.solve(*problem, np.zeros_like(gap), np.zeros_like(load))


SOLVERS = {"block": in_blocks, "tao": by_tao}


def drawn(paper, count, seed, law=None, by_force=True):
    """Return a block of random moduli and wear on random faces, and its contact problems.

    Faces are curved, wavy and rough; some do not wear in the step, some above a threshold only.
    """
    (case, pair), rng = paper, np.random.default_rng(seed)
    n, size = pair.line.n, (count, 1)
    p0 = rng.uniform(0.0, 60.0, (2, count)) * (rng.random((2, count)) < 0.5)
    k = 10 ** rng.uniform(-8.0, -2.0, (2, count)) * (rng.random((2, count)) < 0.8) / 100.0
    law = law or (lambda k, p0: ThresholdLaw(k, p0))
    cases = [
        replace(
            case, wear_lower=law(k[0, i], p0[0, i]), wear_upper=law(k[1, i], p0[1, i]),
            lower=replace(case.lower, young=float(10 ** rng.uniform(3.3, 6.0))),
            upper=replace(case.upper, young=float(10 ** rng.uniform(3.3, 6.0))),
        )
        for i in range(count)
    ]  # fmt: skip
    block = Block.of(cases, [pair] * count)
    x = (pair.line.r - 30.0) / 1.5
    curved = np.abs(rng.normal(size=size)) * 10 ** rng.uniform(-5.0, -1.0, size)
    gap = curved * (x - rng.uniform(-1.0, 1.0, size)) ** 2
    wave = np.cos(x * rng.uniform(1.0, 12.0, size) + rng.uniform(0.0, 6.0, size))
    gap += 10 ** rng.uniform(-6.0, -2.5, size) * wave
    gap += 10 ** rng.uniform(-7.0, -4.5, size) * rng.normal(size=(count, n))
    load = 10 ** rng.uniform(-1.0, 2.3, count) * pair.line.area.sum()
    if not by_force:
        block = replace(block, by_force=False)
        load = gap.min(axis=1) + 10 ** rng.uniform(-4.0, -1.5, count)
    zero, ones = np.zeros(count), np.ones(count)
    wear = np.zeros((2, count, n))
    step = block.step_wear(wear.astype(int), zero, (2.0 * ones, 0.1 * ones), wear, ones)
    return block, (gap, load, step)


def apart(one, other):
    """Return the largest differences of pressures over the largest pressure, (B,)."""
    largest = other.pressure.max(axis=1) + 1e-300
    return np.abs(one.pressure - other.pressure).max(axis=1) / largest


@pytest.mark.parametrize("by_force", [True, False])
def test_block_and_tao_agree_on_random_problems(paper, by_force):
    """300 of them, and those of a law whose slope grows; the rows that C leaves go to TAO."""
    law = lambda k, p0: PowerLaw(k, 1.6 if p0 else 1.0, 1.0)  # noqa: E731
    for count, of in ((150, None), (50, law)):
        block, problem = drawn(paper, count, (1, by_force), of, by_force)
        found, exact = in_blocks(block, *problem), by_tao(block, *problem)
        both = ~exact.failed & ~found.failed
        assert np.count_nonzero(~both) <= 0.01 * count
        assert apart(found, exact)[both].max() < 1e-7
        np.testing.assert_allclose(found.approach[both], exact.approach[both], rtol=1e-6, atol=1e-9)
        gap = block.compliance.gap(problem[0], found.pressure, found.approach)
        gap += problem[2].depths(found.pressure).sum(axis=0)
        assert block.compliance.residual(gap, found.pressure)[both].max() < 1e-5


@pytest.mark.parametrize("name", SOLVERS)
def test_a_dense_active_set_finds_the_same(paper, name):
    """Of thresholds on both bodies, at a force and at an approach."""
    block, (gap, load, step) = drawn(paper, 30, 2)
    found, area = SOLVERS[name](block, gap, load, step), block.line.area
    const, slope = step.lines(found.pressure)
    at_approach = SOLVERS[name](replace(block, by_force=False), gap, found.approach, step)
    assert apart(at_approach, found).max() < 1e-6
    for i in range(len(gap)):
        matrix, rise = area[:, None] * block.compliance.matrix(i), slope[:, i]
        p0 = [-c[0] / s[0] if s[0] else 0.0 for c, s in zip(const[:, i], rise, strict=True)]
        p, d = active_set.solve(matrix, area, gap[i], force=load[i], laws=p0, rise=rise)
        assert np.abs(found.pressure[i] - p).max() < 1e-7 * p.max()
        assert found.approach[i] == pytest.approx(d, rel=1e-7)
        assert area @ found.pressure[i] == pytest.approx(load[i], rel=1e-8)


def spring(stiffness):
    """Return the compliance of elements that give way by their own pressures alone."""
    n = 12
    units = np.stack([np.eye(n) / stiffness, np.zeros((n, n))])[None]
    line = Line((None,), np.linspace(1.0, 2.0, n), np.linspace(0.5, 1.5, n), None, units, units)
    return Compliance.of(line, np.zeros(1, int), np.ones((1, 2)))


@pytest.mark.parametrize("name", SOLVERS)
def test_springs_have_a_closed_form(name):
    """P = (d - gap) / c where positive, c the compliance and the wear of the step per MPa."""
    bed = spring(2e3)
    x, area = np.linspace(0.0, 1.0, 12), bed.line.area
    gap = 0.01 * x[None] ** 2
    block = replace_of(bed)
    exact = np.maximum(0.005 - gap, 0.0) * 2e3
    found = SOLVERS[name](block(False), gap, np.array([0.005]), None)
    assert found.pressure == pytest.approx(exact, rel=1e-8, abs=1e-9)
    force = exact @ area
    found = SOLVERS[name](block(True), gap, force, None)
    assert found.approach == pytest.approx(0.005, rel=1e-7)
    assert found.pressure == pytest.approx(exact, rel=1e-6, abs=1e-9)
    lifted = SOLVERS[name](block(True), gap + 0.1, np.zeros(1), None)
    assert not lifted.pressure.any()
    assert lifted.approach == pytest.approx(0.1)  # the bodies just touch
    apart = SOLVERS[name](block(False), gap + 0.1, np.array([0.05]), None)
    assert not apart.pressure.any()


def replace_of(compliance):
    """Return what solvers need to know of a block, by its control."""

    class Bed:
        def __init__(self, by_force):
            self.compliance, self.by_force = compliance, by_force

    return Bed


UPPER = Body(Section((28.5, 31.5), 20.0), 1e5, 0.3, "clamped")
WIDE = (20.0, 40.0)


def _layered(*layers):
    """Return a ring of 10 GPa with layers of thickness (mm), E (MPa) and nu."""
    sizes, materials = tuple(h for h, *_ in layers), tuple(Material(e, nu) for _, e, nu in layers)
    return Body(Section(WIDE, 20.0, layers=sizes), 1e4, 0.3, "clamped", materials)


def _plain(r, height, young):
    return Body(Section(r, height), young, 0.3, "clamped")


#: pairs whose compliances are the least symmetric, or nearly singular
HARD = {
    "pin with the axis on a disc": (_plain((0.0, 40.0), 20.0, 1e4), _plain((0.0, 5.0), 20.0, 1e5)),
    "equal discs": (_plain((0.0, 10.0), 10.0, 1e5), _plain((0.0, 10.0), 10.0, 1e5)),
    "soft film, 20 um": (_layered((0.02, 10.0, 0.499)), UPPER),
    "soft film, 1 um": (_layered((0.001, 10.0, 0.4999)), UPPER),
    "incompressible film": (_layered((0.1, 10.0, 0.4999)), UPPER),
    "hard film": (_layered((0.003, 5e5, 0.2)), UPPER),
    "two films": (_layered((0.003, 1e5, 0.3), (0.003, 5e4, 0.3)), UPPER),
    "thin disc": (_plain((0.0, 30.0), 1.4, 500.0), _plain((10.0, 20.0), 20.0, 1e5)),
    "washer": (_plain((5.0, 40.0), 0.5, 1e4), _plain((5.0, 40.0), 5.0, 1e5)),
}


@pytest.mark.parametrize("name", HARD)
def test_hard_pairs(paper, name):
    lower, upper = HARD[name]
    mesh = Mesh(48)
    pair = assemble_pair((lower, upper), contact_line(upper.section.r, mesh), mesh, ALONE)
    count, n, rng = 12, 48, np.random.default_rng(20261128)
    line = Line.of([pair])
    moduli = np.tile([1.0 / lower.young, 1.0 / upper.young], (count, 1))
    block = replace_of(Compliance.of(line, np.zeros(count, int), moduli))(True)
    x = (line.r - line.r.mean()) / (0.5 * np.ptp(line.r))
    scale, size = 50.0 * block.compliance.matrix(0).sum(axis=1).mean(), (count, 1)
    gap = rng.uniform(0.0, 2.0, size) * scale * (x - rng.uniform(-1.0, 1.0, size)) ** 2
    gap *= rng.random(size) < 0.7
    load = 10 ** rng.uniform(-0.5, 2.0, count) * line.area.sum()
    found, exact = in_blocks(block, gap, load, None), by_tao(block, gap, load, None)
    assert not found.failed.any()
    good = ~exact.failed
    assert np.count_nonzero(good) >= count - 1
    assert apart(found, exact)[good].max() < 1e-6
    assert np.all(np.abs(found.pressure @ line.area / load - 1.0) < 1e-8)


def test_histories_of_a_block_leave_each_other_alone(paper):
    """NaN of one of them, and two pairs of bodies; moduli of their own have been above."""
    block, (gap, load, step) = drawn(paper, 8, 3)
    found = in_blocks(block, gap, load, step, relative=1e-4)
    broken = gap.copy()
    broken[3, 5] = np.nan
    again, others = in_blocks(block, broken, load, step, relative=1e-4), np.arange(8) != 3
    assert again.failed.tolist() == [False] * 3 + [True] + [False] * 4
    assert np.array_equal(again.pressure[others], found.pressure[others])
    case, pair = paper
    steel = replace(case, lower=replace(case.lower, poisson=0.45))
    two = [pair, assemble(steel, ALONE)]
    mixed = Block.of([case, steel, case], [two[0], two[1], two[0]])
    zero, force = np.zeros_like(mixed.gap), np.full(3, case.load.force)
    together = in_blocks(mixed, zero, force, None)
    assert np.array_equal(together.pressure[0], together.pressure[2])
    assert np.abs(together.approach[1] / together.approach[0] - 1.0) > 0.01
    for i in (0, 1):
        rows = np.array([i])
        alone = in_blocks(take(mixed, rows), zero[:1], force[:1], None)
        assert np.array_equal(alone.pressure[0], together.pressure[i])
        own = Block.of([mixed.cases.every[i]], [two[i]])
        np.testing.assert_allclose(by_tao(own, zero[:1], force[:1], None).pressure[0],
                                   together.pressure[i], rtol=1e-7)  # fmt: skip


def test_the_solver_of_one_history_is_an_option(paper):
    """Its states are those by TAO to the residuals that it allows, in other iterations."""
    from parts import simulate_one

    case, options, found = replace(paper[0], time=replace(paper[0].time, steps=5)), {}, {}
    options = PETSc.Options("contact_")
    for solver in ("tao", "block"):
        options["solver"] = solver
        states = []
        try:
            simulate_one(case, ALONE, lambda instant: states.append(instant.state), pair=paper[1],
                         every=True)  # fmt: skip
        finally:
            options.delValue("solver")
        found[solver] = states[-1]
    one, other = found["tao"], found["block"]
    assert np.abs(one.pressure - other.pressure).max() < 1e-3 * one.pressure.max()
    assert one.iterations[0] != other.iterations[0]
    assert trace(case, paper[1], tao=True).last.approach == one.approach[0]


def test_the_loops_in_c_are_vectorised(paper):
    """80 products of each history, against as many by NumPy: a plain loop takes 4 times longer."""
    block, _ = drawn((paper_case(Mesh(64)), assemble(paper_case(Mesh(64)), ALONE)), 50, 4)
    compliance, n = (
        Compliance.of(block.line, block.compliance.pair, np.ones_like(block.compliance.softness)),
        64,
    )
    matrix, inverse = compliance.matrix(0), 1.0 / compliance.diagonal
    rng = np.random.default_rng(0)
    gap, x, none = rng.normal(size=(50, n)), np.empty((50, n)), np.zeros((50, n))

    def seconds(work):
        best = np.inf
        for _ in range(7):
            before = time.process_time()
            work()
            best = min(best, time.process_time() - before)
        return best

    in_c = seconds(lambda: _rows.respond(compliance, True, inverse, none, 0.0, gap.copy(), x))
    vectors = rng.normal(size=(n, 80))
    in_numpy = seconds(lambda: [matrix @ vectors for _ in range(50)])
    print(in_c, in_numpy)
    assert in_c < 10.0 * in_numpy
