"""Many histories that share a pair, through physics, schemes and balances: each as if alone."""

from dataclasses import astuple, replace

import numpy as np
import pytest

from ringwear_par.cases.case import Load
from ringwear_par.elasticity.geometry.mesh import Mesh
from ringwear_par.history.elastic.pairs import assemble
from ringwear_par.history.observers.balances import balances
from ringwear_par.history.physics import Physics
from ringwear_par.history.schemes import euler, sdirk2
from ringwear_par.history.start import initial_state
from ringwear_par.schedules import Table
from ringwear_par.verification.paper import OMEGA, paper_case
from ringwear_par.wear.laws.non_local import NonLocalLaw
from ringwear_par.wear.laws.running_in import RunningInLaw
from ringwear_par.wear.laws.threshold import ThresholdLaw

#: no rank of a batch knows of others
pytestmark = pytest.mark.serial
#: s, ends of two steps of each of three histories
ENDS = np.array([[0.5, 1.0, 2.0], [1.5, 3.0, 9.0]])
SCHEMES = {"explicit": euler.forward, "implicit": euler.backward, "adaptive": sdirk2.step}


@pytest.fixture(scope="module")
def base():
    return paper_case(Mesh(16, grading=1.0), k=(1e-7, 1e-8), p0=(40.0, 0.0))


@pytest.fixture(scope="module")
def pair(base, comm):
    return assemble(base, comm)


def variations(base):
    """Loads, speeds, friction and laws that differ, as numbers and as tables in time."""
    return {
        "laws and friction": [
            replace(base, friction=mu, wear_lower=ThresholdLaw(k, p0))
            for mu, k, p0 in ((0.1, 1e-7, 40.0), (0.2, 3e-7, 0.0), (0.3, 1e-8, 75.0))
        ],
        "loads and speeds": [
            replace(base, load=Load(omega, force))
            for omega, force in (
                (OMEGA, 30e3),
                (Table((0.0, 4.0), (0.0, 2.0)), 45e3),
                (1.0, Table((0.0, 5.0), (0.0, 60e3))),
            )
        ],
        "displacements": [
            replace(base, load=Load(OMEGA, displacement=d))
            for d in (0.03, 0.05, Table((0.0, 9.0), (0.06, 0.0)))
        ],
        "memory": [
            replace(base, wear_upper=RunningInLaw(1e-8, k, depth=d))
            for k, d in ((1e-7, 1e-3), (2e-7, 1e-4), (3e-7, 1e-2))
        ],
        "moduli": [
            replace(
                base, lower=replace(base.lower, young=1e4 * e), upper=replace(base.upper, young=u)
            )
            for e, u in ((1.0, 1e5), (3.0, 1e5), (1.0, 3e4))
        ],
        "non-local": [
            replace(base, wear_lower=NonLocalLaw(k, 10.0, length=0.3)) for k in (1e-7, 2e-7, 1e-8)
        ],
        "the same": [base] * 3,
    }


def parts(state):
    contact = state.contact
    return {
        "time": state.time, "wear": state.wear, "worn": state.worn, "energy": state.energy,
        "pressure": contact.pressure, "gap": contact.gap, "approach": contact.approach,
        "force": contact.force,
    }  # fmt: skip


def two_steps(cases, comm, pair, scheme, ends):
    """Both steps, the balances after them, and what the physics makes of the last pressures."""
    step = SCHEMES[scheme]
    physics = Physics.of(cases, pair)
    with physics.contacts() as contacts:
        steps = [step(physics, contacts, initial_state(physics, contacts), ends[0])]
        steps.append(step(physics, contacts, steps[0].state, ends[1]))
        p = steps[1].state.contact.pressure
        off = balances(physics, steps[1].state)
        return steps, off, {"torque": physics.torque(p), "twist": physics.twist(p)}


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("name", ["laws and friction", "loads and speeds", "displacements",
                                  "memory", "moduli", "non-local", "the same"])  # fmt: skip
def test_each_history_is_as_if_alone(base, pair, comm, scheme, name):
    """To the last bit as in a batch of one."""
    cases = variations(base)[name]
    steps, off, sums = two_steps(cases, comm, pair, scheme, ENDS)
    assert steps[1].state.wear.shape == (2, 3, 16)
    for i, case in enumerate(cases):
        one, off_one, sums_one = two_steps([case], comm, pair, scheme, ENDS[:, i : i + 1])
        for what, value in sums_one.items():
            assert sums[what][i] == value[0], what
        for together, apart in zip(steps, one, strict=True):
            for what, value in parts(apart.state).items():
                mine = parts(together.state)[what]
                body = what in ("wear", "worn")
                assert np.array_equal(
                    mine[:, i] if body else mine[i], value[:, 0] if body else value[0]
                ), what
            for of_all, of_one in zip(astuple(together)[1:], astuple(apart)[1:], strict=True):
                assert np.array_equal(np.broadcast_to(of_all, 3)[i], np.broadcast_to(of_one, 1)[0])
        for what, value in off_one.items():
            assert np.array_equal(np.broadcast_to(off[what], 3)[i], np.broadcast_to(value, 1)[0])


def test_loads_of_different_kinds_do_not_go_together(base, pair, comm):
    cases = [base, replace(base, load=Load(OMEGA, displacement=0.05))]
    with pytest.raises(ValueError, match="cannot be stacked"):
        Physics.of(cases, pair)


def test_the_volume_balance_sees_depths_that_are_not_those_of_the_rates(base, pair, comm):
    """The rate is integrated apart from the depths: what a step forgets to wear off is missed."""
    physics = Physics.of([base], pair)
    with physics.contacts() as contacts:
        sound = euler.backward(
            physics, contacts, initial_state(physics, contacts), np.ones(1)
        ).state
        assert balances(physics, sound)["volume"] < 1e-14
        wear = sound.wear.copy()
        wear[0, 0, 3] *= 1.01
        missed = wear[0, 0, 3] / 101.0 * physics.area[3] / (wear @ physics.area).max()
        spoilt = balances(physics, replace(sound, wear=wear))
    assert spoilt["volume"] == pytest.approx(missed, rel=1e-6)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_the_estimated_error_of_a_step_is_of_the_size_of_the_error(base, pair, comm, scheme):
    """Of one step from a state that has left the singular transient behind, against many."""
    step, start, end = SCHEMES[scheme], 30.0, 34.0
    physics = Physics.of([base], pair)
    with physics.contacts() as contacts:
        state = initial_state(physics, contacts)
        for time in np.linspace(0.0, start, 61)[1:]:
            state = sdirk2.step(physics, contacts, state, np.array([time])).state
        exact = state
        for time in np.linspace(start, end, 81)[1:]:
            exact = sdirk2.step(physics, contacts, exact, np.array([time])).state
        found = step(physics, contacts, state, np.array([end]))
    error = np.abs((found.state.wear - exact.wear).sum(axis=0)).max()
    assert 0.1 < found.wear_error / error < 10.0
