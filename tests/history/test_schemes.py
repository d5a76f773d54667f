"""Time schemes: orders, balances of every step, steady states, stability, estimates of errors."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from parts import (
    BlockSolver,
    Load,
    Mesh,
    NonLocalLaw,
    PowerLaw,
    RunningInLaw,
    Stepping,
    ThresholdLaw,
)
from reference_cases import paper_case
from tracing import ALONE, first_contact, trace, traces

from ringwear_par.history import schemes
from ringwear_par.history.block import Block
from ringwear_par.history.checks import instability
from ringwear_par.history.elastic import assemble
from ringwear_par.history.loop import simulate


@pytest.fixture
def stepped(paper_pair):
    """Function that runs the paper's case with some parts replaced."""

    def stepped(pair=None, **parts):
        return trace(replace(paper_pair[0], **parts), pair or paper_pair[1])

    return stepped


@pytest.mark.parametrize("tao", [False, True])
@pytest.mark.parametrize("scheme", ["implicit", "explicit"])
def test_balances_at_every_step(paper_pair, scheme, tao):
    """Contacts hold to 1e-8 by TAO, in blocks to 1e-4 beside wear; all else to round-off."""
    step = 1.0 if scheme == "implicit" else 0.1
    time = Stepping(scheme, step, 100)
    case = replace(paper_pair[0], wear_lower=ThresholdLaw(1e-7), time=time)
    history = trace(case, paper_pair[1], tao=tao)
    worst, states, line = history.balances, history.states, history.line
    assert worst.force <= 1e-8
    assert 0 < worst.energy <= 1e-12
    assert 0 < worst.torque <= 1e-4  # of the boundary elements: they vanish with the mesh
    assert 0 < worst.reaction <= 1e-4
    assert worst.residual <= (1e-8 if tao else 1e-3)
    # recomputed from the states themselves
    energy = 0.0
    for before, after in itertools.pairwise(states):
        p = (after if scheme == "implicit" else before).pressure
        energy += step * case.friction * case.load.omega * (line.area * line.r) @ p
        assert after.force == pytest.approx(case.load.force, rel=1e-8)
        assert line.area @ after.wear[0] == pytest.approx(1e-7 * energy, rel=1e-10)


def test_twenty_steps_nearly_serve_for_two_hundred(stepped):
    """The worn volume, to 0.02 % at p0 = 0 and 0.4 % at 40 MPa; the penetrations of figure 2."""
    for p0, depth, tolerance in ((0.0, 18.2, 2e-4), (40.0, 9.7, 4e-3)):
        volumes, depths = [], []
        for number in (20, 200):
            time = Stepping("implicit", 200.0 / number, number)
            history = stepped(wear_lower=ThresholdLaw(1e-7, p0), time=time)
            last = history.last
            volumes.append(history.line.area @ last.wear[0])
            depths.append(last.approach - last.first_approach)
        assert volumes[0] == pytest.approx(volumes[1], rel=tolerance)
        # um; the paper's curves end near 18, 10
        assert 1e3 * depths[1] == pytest.approx(depth, abs=0.05)


def test_fixed_approach_unloads(stepped):
    load = Load(85 / 24, displacement=0.0585)
    time = Stepping("implicit", 20.0, 50)
    states = stepped(load=load, wear_lower=ThresholdLaw(1e-7), time=time).states
    assert all(a.force > b.force > 0 for a, b in itertools.pairwise(states))
    assert all(state.approach == 0.0585 for state in states)
    # with a threshold, what is left everywhere is the threshold
    last = stepped(load=load, time=Stepping("implicit", 1e4, 50)).last
    assert last.pressure.max() == pytest.approx(40.0, rel=1e-3)


ORDERS = {"implicit": 1.0, "explicit": 1.0, "sdirk2": 2.0}


@pytest.mark.parametrize("name", ORDERS)
def test_orders(name):
    """Of steps of equal length from a state that has left the singular transient behind."""
    case = paper_case(Mesh(16, grading=1.0), p0=(0.0, 0.0), k=(1e-7, 3e-8),
                      stepping=Stepping("adaptive", until=40.0, tolerance=1e-6))  # fmt: skip
    block, last = Block.of([case], [assemble(case, ALONE)]), []
    simulate(block, lambda instant: last.append(instant.state))
    solver = BlockSolver(block.compliance, True, np.full(1, np.inf), 1e-10)

    def wear(scheme, number):
        state = last[-1]
        for i in range(number):
            end = np.array([40.0 + 20.0 * (i + 1) / number])
            state = scheme(block, solver, state, end).state
        return state.wear

    exact = wear(schemes.sdirk2, 512)
    errors = [np.abs(wear(getattr(schemes, name), n) - exact).max() for n in (40, 80, 160)]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert orders == pytest.approx([ORDERS[name]] * 2, abs=0.15)


def test_the_estimated_error_of_a_step_is_of_the_size_of_the_error():
    """Of one step from a state that has left the singular transient behind, against many."""
    stepping = Stepping("adaptive", until=30.0, tolerance=1e-5)
    case = paper_case(Mesh(16, grading=1.0), k=(1e-7, 1e-8), p0=(40.0, 0.0), stepping=stepping)
    block, last = Block.of([case], [assemble(case, ALONE)]), []
    simulate(block, lambda instant: last.append(instant.state))
    solver, exact = BlockSolver(block.compliance, True, np.full(1, np.inf), 1e-9), last[-1]
    for end in np.linspace(30.0, 34.0, 81)[1:]:
        exact = schemes.sdirk2(block, solver, exact, np.array([end])).state
    found = schemes.sdirk2(block, solver, last[-1], np.array([34.0]))
    error = np.abs((found.state.wear - exact.wear).sum(axis=0)).max()
    assert 0.1 < found.error.max() / error < 3.0


@pytest.mark.parametrize(
    "law",
    [
        PowerLaw(2e-10, 1.7, 1.2),
        RunningInLaw(5e-8, 4e-7, 20.0, depth=0.002),
        RunningInLaw(5e-8, 4e-7, 20.0, distance=3000.0),
        NonLocalLaw(1e-7, 40.0, length=0.2),
    ],
)
def test_other_laws_converge_to_the_same_from_all_schemes(stepped, law):
    def adaptive(tolerance):
        time = Stepping("adaptive", until=60.0, tolerance=tolerance)
        return stepped(time=time, wear_lower=law).last.wear

    exact, errors = adaptive(1e-7), []
    assert np.abs(adaptive(2e-6) - exact).max() <= 2e-6
    for number in (50, 100):
        history = stepped(time=Stepping("implicit", 60.0 / number, number), wear_lower=law)
        errors.append(np.abs(history.last.wear - exact).max())
        assert history.balances.force <= 1e-8
    assert errors[1] < 0.6 * errors[0]
    assert errors[1] < 0.02 * exact.max()


def test_explicit_limit_separates_smooth_from_oscillating(stepped, paper_pair):
    case, pair = paper_pair
    case = replace(case, wear_lower=ThresholdLaw(1e-7), time=Stepping("explicit", 1.0, 1))
    states = []
    block = Block.of([case], [pair])
    simulate(block, lambda instant: states.append(instant.state))
    ratio, (limit,) = instability(block, states[0])
    assert ratio == pytest.approx(1.0 / limit)

    def roughness(factor):
        time = Stepping("explicit", factor * limit, 400)
        p = stepped(wear_lower=case.wear_lower, time=time).last.pressure
        return np.abs(np.diff(p, 2)).max() / p.mean()

    assert roughness(0.98) < 0.1
    assert roughness(1.05) > 1.0


@pytest.mark.parametrize("step", [0.01, 1.0, 1e2, 5e3])
def test_implicit_steps_of_any_length_are_smooth(stepped, step):
    history = stepped(wear_lower=ThresholdLaw(1e-7), time=Stepping("implicit", step, 20))
    slope = np.diff(history.last.wear[0])
    assert np.count_nonzero(np.diff(np.sign(slope))) <= 1  # one maximum, in the middle
    assert history.balances.force <= 1e-8


def test_the_steady_pressure_and_its_torque(stepped):
    """With p = c / r the friction force acts at the mean radius."""
    history = stepped(wear_lower=ThresholdLaw(1e-7), time=Stepping("implicit", 40.0, 200))
    case, line, p = history.block.cases.every[0], history.line, history.last.pressure
    c = case.load.force / (2.0 * np.pi * 3.0)
    assert p == pytest.approx(c / line.pairs[0].line.arm, rel=1e-5)
    torque = case.friction * history.torque_over_friction(p)
    assert torque == pytest.approx(case.friction * case.load.force * 30.0, rel=1e-8)


def test_the_first_contact_is_the_first_state(paper_pair):
    case, pair = paper_pair
    first, contact = trace(case, pair, tao=True).states[0], first_contact(case)
    assert np.array_equal(first.pressure, contact.pressure)
    (whole,), failures = traces([case], [pair])
    assert not failures
    assert whole.states[0].pressure == pytest.approx(contact.pressure, rel=1e-3)
