"""Single steps of all schemes: the balance of volume, and their estimates of errors."""

from dataclasses import replace

import numpy as np
import pytest
from parts import Mesh
from reference_cases import paper_case
from ringwear_par.history.observers.balances import balances
from ringwear_par.history.physics import Physics
from ringwear_par.history.start import initial_state

from ringwear_par.history.elastic import assemble
from ringwear_par.history.schemes import euler, sdirk2

SCHEMES = {"explicit": euler.forward, "implicit": euler.backward, "adaptive": sdirk2.step}


@pytest.fixture(scope="module")
def base():
    return paper_case(Mesh(16, grading=1.0), k=(1e-7, 1e-8), p0=(40.0, 0.0))


@pytest.fixture(scope="module")
def pair(base, comm):
    return assemble(base, comm)


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
