"""Deferred correction: pressures are those of the collocated, unsymmetric equations."""

from dataclasses import replace

import active_set
import numpy as np
import pytest
import random_cases
from one_contact import OneContact
from parts import Physics, Stepping, ThresholdLaw, in_time, initial_state, make_case, trace, young
from paths import CASES

import ringwear_par as rw

CHAMFER = CASES / "chamfer.toml"
#: of the random cases with seed 1: contact that does not reach the edges, or has a corner
NUMBERS = (12, 120, 144)


@pytest.fixture(scope="module")
def cases(comm):
    """Random cases by number, with their pairs."""
    found = {}
    for number in NUMBERS:
        keys, _ = random_cases.random_case(np.random.default_rng((1, number)))
        case = make_case(keys, f"case {number}")
        found[number] = case, rw.assemble(case, comm)
    return found


def weighted(case, pair):
    """Return ``diag(m) C``, as the collocated equations have it."""
    return pair.line.area[:, None] * pair.compliance(young(case)).collocated


def loads(case, time):
    load = case.load
    if load.force is not None:
        return {"force": in_time(load.force, time)}
    return {"approach": in_time(load.displacement, time)}


def errors(found, exact, area):
    """Relative to the pressure or to its mean, whichever is larger."""
    mean = area @ exact / area[exact > 0.0].sum()
    return np.abs(found - exact) / np.maximum(exact, mean)


def plain_pressure(case, pair, gap, comm, time=0.0):
    """Of the symmetric compliance alone."""
    with OneContact(pair.compliance(young(case)).matrix, pair.line.area) as solver:
        return solver.solve(gap, **loads(case, time)).pressure


@pytest.mark.parametrize("number", NUMBERS)
def test_first_pressures_are_those_of_the_collocated_equations(cases, number, comm):
    case, pair = cases[number]
    m = pair.line.area
    exact, approach = active_set.solve(weighted(case, pair), m, case.initial_gap, **loads(case, 0))
    physics = Physics.of([case], pair)
    with physics.contacts() as contacts:
        first = initial_state(physics, contacts).contact
        told, _ = contacts.largest_errors
    assert errors(first.pressure, exact, m).max() < 1e-3
    assert told <= 1e-4
    assert first.approach == pytest.approx(approach, rel=1e-6)
    # what there is to correct, and where: nobody would see it in a balance
    plain = errors(plain_pressure(case, pair, case.initial_gap, comm), exact, m)
    assert plain.max() > 0.2
    assert plain.argmax() in (0, pair.line.n - 1)


@pytest.mark.parametrize("exact", [False, True])
def test_pressures_of_an_implicit_step_are_those_of_the_collocated_equations(cases, exact, comm):
    """Of gap and wear together, by an independent solver; steps go on from pressures near by."""
    case, pair = cases[12]
    law, step = ThresholdLaw(1e-6, 15.0), 2.0
    case = replace(case, wear_lower=law, wear_upper=None, time=Stepping("implicit", step, 10))
    omega = case.load.omega
    assert isinstance(omega, float)
    line = pair.line
    before = trace(case, comm, pair=pair).states[-2]
    physics = Physics.of([case], pair)
    with physics.contacts() as contacts:
        wear, end = before.wear[:, None], np.array([10.0 * step])
        during = physics.increment(end, physics.sliding(end), wear, np.array([step]))
        inputs = physics.contact_inputs(end, wear, during)
        found = contacts.solve(inputs, before.contact.pressure[None], exact=exact)
    rise = step * law.k * case.friction * omega * line.arm
    gap = case.initial_gap + before.wear.sum(axis=0)
    right, _ = active_set.solve(
        weighted(case, pair), line.area, gap, laws=[law.p0], rise=[rise],
        **loads(case, step * 10),
    )  # fmt: skip
    assert errors(found.pressure[0], right, line.area).max() < (2e-4 if exact else 1e-2)


@pytest.mark.parametrize(
    ("name", "load"),
    [
        ("overlap", {"load.displacement": [[0.0, 0.08], [4.0, 5e-6], [9.0, 5e-6]]}),
        ("sphere", {"load.displacement": [[0.0, 4e-3], [4.0, 4e-6], [9.0, 4e-6]]}),
        ("chamfer", {"load.pressure": [[0.0, 80.0], [4.0, 0.0], [9.0, 0.0]]}),
    ],
)
def test_contact_does_not_remember_the_load_before(name, load, comm):
    """Without wear, the same load gives the same contact, whatever was before it."""
    key = next(iter(load))
    case = rw.read_case(CHAMFER.with_name(f"{name}.toml"), {
        "wear.lower": None, "wear.upper": None, "load.force": None, "load.pressure": None,
        "mesh.contact_elements": 32, "time": {"scheme": "implicit", "step": 1.0, "steps": 6},
        "load.control": "force" if key == "load.pressure" else "displacement", **load,
    })  # fmt: skip
    states = trace(case, comm).states
    first, later = states[4].contact, states[5].contact
    size = max(first.pressure.max(), later.pressure.max(), 1e-12)
    assert np.abs(first.pressure - later.pressure).max() <= 2e-2 * size
    assert first.approach == pytest.approx(later.approach, rel=1e-4)


def test_explicit_steps_are_corrected_each(comm):
    """Their pressures are those of the collocated equations, though the load grows tenfold."""
    case = rw.read_case(CHAMFER, {
        "mesh.contact_elements": 24, "time": {"scheme": "explicit", "step": 0.1, "steps": 4},
        "load.pressure": [[0.0, 20.0], [0.2, 200.0], [0.3, 30.0], [0.4, 100.0]],
    })  # fmt: skip
    pair = rw.assemble(case, comm)
    history = trace(case, comm, pair=pair)
    m, matrix = pair.line.area, weighted(case, pair)
    plain = OneContact(pair.compliance(young(case)).matrix, m)
    before, uncorrected = np.zeros_like(m), []
    with plain:
        for state in history.states:
            gap = case.initial_gap + state.wear.sum(axis=0)
            exact, _ = active_set.solve(matrix, m, gap, **loads(case, state.time))
            assert errors(state.contact.pressure, exact, m).max() < 1e-2
            less = gap - pair.compliance(young(case)).excess @ before
            found = plain.solve(less, **loads(case, state.time)).pressure
            uncorrected.append(errors(found, exact, m).max())
            before = state.contact.pressure
    assert min(uncorrected) > 5e-4
