"""Contacts by TAO and in blocks: against closed forms, a dense active set, and each other."""

import time
from dataclasses import replace

import active_set
import numpy as np
import pytest
from contact_problems import HARD, Bed, drawn, spring
from parts import BlockSolver, Compliance, Line, Mesh, PowerLaw, TaoContact, simulate_one, take
from petsc4py import PETSc
from reference_cases import paper_case
from tracing import ALONE, trace

from ringwear_par.contact._rows import respond
from ringwear_par.elasticity.bem.pair import assemble_pair
from ringwear_par.elasticity.mesh import contact_line
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


@pytest.mark.parametrize("name", SOLVERS)
def test_springs_have_a_closed_form(name):
    """P = (d - gap) / c where positive, c the compliance and the wear of the step per MPa."""
    bed = spring(2e3)
    x, area = np.linspace(0.0, 1.0, 12), bed.line.area
    gap = 0.01 * x[None] ** 2
    force, approach = Bed(bed, True), Bed(bed, False)
    exact = np.maximum(0.005 - gap, 0.0) * 2e3
    found = SOLVERS[name](approach, gap, np.array([0.005]), None)
    assert found.pressure == pytest.approx(exact, rel=1e-8, abs=1e-9)
    off = exact * (1.0 + 0.01 * (np.arange(12) == 3))
    residual = bed.residual(bed.gap(gap, off, np.array([0.005])), off)
    assert residual == pytest.approx(0.01 * exact[0, 3] / exact.max(), rel=1e-6)
    found = SOLVERS[name](force, gap, exact @ area, None)
    assert found.approach == pytest.approx(0.005, rel=1e-7)
    assert found.pressure == pytest.approx(exact, rel=1e-6, abs=1e-9)
    lifted = SOLVERS[name](force, gap + 0.1, np.zeros(1), None)
    assert not lifted.pressure.any()
    assert lifted.approach == pytest.approx(0.1)  # the bodies just touch
    apart = SOLVERS[name](approach, gap + 0.1, np.array([0.05]), None)
    assert not apart.pressure.any()


@pytest.mark.parametrize("name", HARD)
def test_hard_pairs(paper, name):
    lower, upper = HARD[name]
    mesh = Mesh(48)
    pair = assemble_pair((lower, upper), contact_line(upper.section.r, mesh), mesh, ALONE)
    count, rng = 12, np.random.default_rng(20261128)
    line = Line.of([pair])
    moduli = np.tile([1.0 / lower.young, 1.0 / upper.young], (count, 1))
    block = Bed(Compliance.of(line, np.zeros(count, int), moduli), True)
    x = (line.r - line.r.mean()) / (0.5 * np.ptp(line.r))
    scale, size = 50.0 * block.compliance.matrix(0).sum(axis=1).mean(), (count, 1)
    gap = rng.uniform(0.0, 2.0, size) * scale * (x - rng.uniform(-1.0, 1.0, size)) ** 2
    gap *= rng.random(size) < 0.7
    load = 10 ** rng.uniform(-0.5, 2.0, count) * line.area.sum()
    found, exact = in_blocks(block, gap, load, None), by_tao(block, gap, load, None)
    assert not found.failed.any()
    good = ~exact.failed
    assert np.count_nonzero(good) >= count - 1
    assert apart(found, exact)[good].max() < 1e-7
    assert np.all(np.abs(found.pressure @ line.area / load - 1.0) < 1e-8)


@pytest.mark.parametrize("by_force", [True, False])
def test_one_that_is_no_number_fails_and_leaves_the_bits_of_the_others(paper, by_force):
    block, (gap, load, step) = drawn(paper, 8, 3, None, by_force)
    found = in_blocks(block, gap, load, step, relative=1e-4)
    broken = gap.copy()
    broken[3, 5] = np.nan
    again, others = in_blocks(block, broken, load, step, relative=1e-4), np.arange(8) != 3
    assert again.failed.tolist() == [False] * 3 + [True] + [False] * 4
    assert np.array_equal(again.pressure[others], found.pressure[others])


def test_two_pairs_of_bodies_in_a_block(paper):
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
    case, options, states = (
        replace(paper[0], time=replace(paper[0].time, steps=5)), PETSc.Options("contact_"), [],
    )  # fmt: skip

    def save(instant):
        states.append(instant.state)

    for solver in ("tao", "block"):
        options["solver"] = solver
        try:
            simulate_one(case, ALONE, save, pair=paper[1], every=True)
        finally:
            options.delValue("solver")
    one, other = states[len(states) // 2 - 1], states[-1]
    assert np.abs(one.pressure - other.pressure).max() < 1e-3 * one.pressure.max()
    assert one.iterations[0] != other.iterations[0]
    assert trace(case, paper[1], tao=True).last.approach == one.approach[0]


def test_the_loops_in_c_are_vectorised():
    """80 iterations of each history take 1.8 times as long as 80 products by NumPy, or 6 times."""
    n, count, rng = 64, 50, np.random.default_rng(0)
    modes = np.linalg.qr(rng.normal(size=(n, n)))[0]
    matrix = modes * 10.0 ** np.linspace(0.0, 8.0, n) @ modes.T  # no iteration ends early
    bed = spring(1.0, count, matrix)
    inverse, gap, none = 1.0 / bed.diagonal, rng.normal(size=(count, n)), np.zeros((count, n))
    x, vectors = np.empty((count, n)), rng.normal(size=(n, 80))

    def seconds(work):
        best = np.inf
        for _ in range(9):
            before = time.process_time()
            work()
            best = min(best, time.process_time() - before)
        return best

    in_c = seconds(lambda: respond(bed, False, inverse, none, 0.0, gap.copy(), x))
    assert in_c < 3.5 * seconds(lambda: [matrix @ vectors for _ in range(count)])
