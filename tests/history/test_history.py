"""Wear histories: balances, steady laws, schemes, stability."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI
from parts import Load, Mesh, Stepping, ThresholdLaw
from reference_cases import paper_case
from ringwear_par.history.observers.trace import trace
from ringwear_par.history.physics import Physics
from ringwear_par.history.refusals.stable_steps import stable_steps

from ringwear_par.history.elastic import assemble, young


@pytest.fixture
def stepped(paper_pair, comm):
    """Function that runs the paper's case with some parts replaced and returns all states."""

    def stepped(pair=None, **parts):
        case = replace(paper_pair[0], **parts)
        history = trace(case, comm, pair=pair or paper_pair[1])
        return history, history.states

    return stepped


def steps(scheme, step, number):
    return Stepping(scheme, step, number)


@pytest.mark.parametrize("scheme", ["implicit", "explicit"])
def test_balances_at_every_step(stepped, scheme):
    step = 1.0 if scheme == "implicit" else 0.1
    history, states = stepped(wear_lower=ThresholdLaw(1e-7), time=steps(scheme, step, 100))
    worst = history.balances
    assert worst.force <= 1e-10
    assert worst.volume <= 1e-12
    assert 0 < worst.energy <= 1e-10
    assert 0 < worst.torque <= 1e-4  # of the boundary elements: they vanish with the mesh
    assert 0 < worst.reaction <= 1e-4
    assert worst.residual <= 1e-9
    # recomputed from the states themselves
    line, case = history.physics.line, history.physics.case
    energy = 0.0
    for before, after in itertools.pairwise(states):
        p = (after if scheme == "implicit" else before).contact.pressure
        energy += step * case.friction * case.load.omega * (line.area * line.arm) @ p
        assert line.area @ after.contact.pressure == pytest.approx(case.load.force, rel=1e-10)
        assert line.area @ after.wear[0] == pytest.approx(1e-7 * energy, rel=1e-10)


def test_twenty_steps_nearly_serve_for_two_hundred(stepped):
    """The worn volume, to 0.02 % at p0 = 0 and 0.4 % at 40 MPa; the penetrations of figure 2."""
    for p0, depth, tolerance in ((0.0, 18.2, 2e-4), (40.0, 9.7, 4e-3)):
        volumes, depths = [], []
        for number in (20, 200):
            history, states = stepped(
                wear_lower=ThresholdLaw(1e-7, p0), time=steps("implicit", 200.0 / number, number)
            )
            volumes.append(history.physics.integrals(states[-1].wear)[0])
            depths.append(states[-1].contact.approach - states[0].contact.approach)
        assert volumes[0] == pytest.approx(volumes[1], rel=tolerance)
        assert 1e3 * depths[1] == pytest.approx(
            depth, abs=0.05
        )  # um; the paper's curves end near 18, 10


def test_fixed_approach_unloads(stepped):
    load = Load(85 / 24, displacement=0.0585)
    _, states = stepped(load=load, wear_lower=ThresholdLaw(1e-7), time=steps("implicit", 20.0, 50))
    forces = [state.contact.force for state in states]
    assert all(a > b > 0 for a, b in itertools.pairwise(forces))
    assert all(state.contact.approach == 0.0585 for state in states)
    # with a threshold, what is left everywhere is the threshold
    _, states = stepped(load=load, time=steps("implicit", 1e4, 50))
    assert states[-1].contact.pressure.max() == pytest.approx(40.0, rel=1e-3)


def test_both_schemes_are_of_first_order_and_meet(stepped):
    """Against a fine run, at 20 s on a coarse mesh, where explicit steps are stable."""
    case = paper_case(Mesh(16, grading=1.0), p0=(0.0, None))
    pair = assemble(case, MPI.COMM_SELF)

    def wear(scheme, number):
        _, states = stepped(
            pair,
            mesh=case.mesh,
            wear_lower=ThresholdLaw(1e-7),
            time=steps(scheme, 20.0 / number, number),
        )
        return states[-1].wear[0]

    exact = 2 * wear("implicit", 1600) - wear("implicit", 800)
    for scheme in ("implicit", "explicit"):
        errors = [np.abs(wear(scheme, n) - exact).max() for n in (40, 80, 160)]
        orders = np.log2(np.array(errors[:-1]) / errors[1:])
        assert orders == pytest.approx([1, 1], abs=0.15)


def test_explicit_limit_separates_smooth_from_oscillating(stepped, paper_pair, comm):
    physics = Physics.of([paper_pair[0]], paper_pair[1])
    with physics.contacts() as contacts:
        (limit,) = stable_steps(physics, contacts)

    def roughness(factor):
        _, states = stepped(
            wear_lower=ThresholdLaw(1e-7), time=steps("explicit", factor * limit, 400)
        )
        p = states[-1].contact.pressure
        return np.abs(np.diff(p, 2)).max() / p.mean()

    assert roughness(0.98) < 0.1
    assert roughness(1.05) > 1.0


def test_implicit_steps_of_any_length_are_smooth(stepped):
    for step in (0.01, 1.0, 1e2, 5e3):
        history, states = stepped(wear_lower=ThresholdLaw(1e-7), time=steps("implicit", step, 20))
        sign = np.diff(states[-1].wear[0])
        assert np.count_nonzero(np.diff(np.sign(sign))) <= 1  # one maximum, in the middle
        assert history.balances.force <= 1e-10


def test_torque_of_uniform_pressure_and_of_the_steady_state(stepped, paper_pair):
    history, states = stepped(wear_lower=ThresholdLaw(1e-7), time=steps("implicit", 40.0, 200))
    uniform = np.full(history.physics.line.n, 80.0)
    exact = 0.1 * 80.0 * 2 * np.pi / 3 * (31.5**3 - 28.5**3)
    line = history.physics.line
    # elements bear c / r, of which a uniform pressure is so much of another torque
    other = 0.1 * line.area @ (uniform * (line.uniform_arm - line.arm))
    assert history.physics.torque(uniform) + other == pytest.approx(exact, rel=1e-13)
    worn = history.physics.torque(2400.0 / line.r)
    assert worn == pytest.approx(0.1 * 2400.0 * np.pi * (31.5**2 - 28.5**2), rel=1e-13)
    # p = c/r: the friction force acts at the mean radius
    steady = history.physics.torque(states[-1].contact.pressure)
    assert steady == pytest.approx(0.1 * history.physics.case.load.force * 30.0, rel=1e-10)


def test_twist_of_the_upper_ring_alone(paper_pair, comm):
    """On a rigid lower body, traction proportional to r turns a hollow cylinder by T h/(G J)."""
    case = replace(paper_pair[0], lower=replace(paper_pair[0].lower, young=1e15))
    pair = assemble(case, comm)
    line = pair.line
    torque = (line.area * line.arm) @ line.r
    angle = torque * 20.0 / (case.upper.young / 2.6 * 0.5 * np.pi * (31.5**4 - 28.5**4))
    assert pair.compliance(young(case)).twist @ line.r == pytest.approx(
        angle * (line.area @ line.r) / line.area.sum(), rel=1e-3
    )
