"""Deferred correction: pressures are those of the collocated, unsymmetric equations."""

import itertools
from dataclasses import replace

import active_set
import numpy as np
import pytest
import random_cases
from one_contact import OneContact
from paths import CASES

from ringwear_par.cases.case import Stepping
from ringwear_par.cases.files.reading import make_case, read_case
from ringwear_par.contact import correction
from ringwear_par.contact.engine import ContactEngine
from ringwear_par.errors import ComputationError, HistoriesError
from ringwear_par.history.elastic.bodies import young
from ringwear_par.history.elastic.pairs import assemble
from ringwear_par.history.loop import method_of
from ringwear_par.history.observers.trace import trace
from ringwear_par.history.physics import Physics
from ringwear_par.history.start import initial_state
from ringwear_par.schedules import in_time
from ringwear_par.wear.laws.threshold import ThresholdLaw

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
        found[number] = case, assemble(case, comm)
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


@pytest.mark.parametrize("number", NUMBERS)
def test_each_correction_leaves_a_fraction(cases, number, comm):
    """A factor of 0.2 or better in the mean of all corrections, in any one of them of 0.25."""
    case, pair = cases[number]
    exact, _ = active_set.solve(
        weighted(case, pair), pair.line.area, case.initial_gap, **loads(case, 0)
    )
    excess = pair.compliance(young(case)).excess
    p, off = np.zeros(pair.line.n), []
    for _ in range(5):
        p = plain_pressure(case, pair, case.initial_gap - excess @ p, comm)
        off.append(errors(p, exact, pair.line.area).max())
    assert (off[-1] / off[0]) ** (1.0 / 4.0) < 0.2
    assert all(b < 0.25 * a for a, b in itertools.pairwise(off))


def test_corrections_end_once_there_is_nothing_to_correct(cases, comm, monkeypatch):
    case, pair = cases[12]
    solve, calls = ContactEngine.solve, []

    def counted(self, *args, **kwargs):
        calls.append(1)
        return solve(self, *args, **kwargs)

    monkeypatch.setattr(ContactEngine, "solve", counted)
    nothing, start = np.zeros((2, 1, pair.line.n)), np.zeros(1)
    physics = Physics.of([case], pair)
    with physics.contacts() as contacts:
        p = contacts.solve(physics.contact_inputs(start, nothing), nothing[0], exact=True).pressure
        made = len(calls)
        assert 2 <= made <= 6
        again = contacts.solve(physics.contact_inputs(start, nothing), p, exact=True)
        # from the solution on: none to make
        assert len(calls) == made + 1
    assert errors(again.pressure[0], p[0], pair.line.area).max() < 1e-3


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


@pytest.mark.parametrize("number", NUMBERS)
def test_last_pressures_of_a_history_are_near_the_collocated_ones(cases, number, comm, monkeypatch):
    """The last step again, all its contacts corrected to the end."""
    case, pair = cases[number]
    history = trace(case, comm, pair=pair)
    told, e = history.snapshots[-1].contacts.largest_errors
    assert 0 <= e < pair.line.n
    assert told <= 1e-2
    scheme = method_of(case.time.scheme).scheme
    physics = Physics.of([case], pair)
    with physics.contacts() as contacts:
        solve = contacts.solve

        def corrected(inputs, near, already_solved=None, tangents=None):
            for _ in range(4):
                solution = solve(inputs, near, already_solved=already_solved, exact=True)
                near = solution.pressure
            return solution

        monkeypatch.setattr(contacts, "solve", corrected)
        before, last = (snapshot.state for snapshot in history.snapshots[-2:])
        right = scheme(physics, contacts, before, last.time).state.contact.pressure[0]
    assert errors(history.last.contact.pressure, right, pair.line.area).max() < 0.02


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
    case = read_case(CHAMFER.with_name(f"{name}.toml"), {
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
    case = read_case(CHAMFER, {
        "mesh.contact_elements": 24, "time": {"scheme": "explicit", "step": 0.1, "steps": 4},
        "load.pressure": [[0.0, 20.0], [0.2, 200.0], [0.3, 30.0], [0.4, 100.0]],
    })  # fmt: skip
    pair = assemble(case, comm)
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


def test_a_contact_that_corrections_do_not_settle_is_refused(cases, comm, monkeypatch):
    """Alone with its error; among others it leaves."""
    case, pair = cases[12]
    monkeypatch.setattr(correction, "_EXACT", 1e-30)
    told = r"after 10 corrections .* is off by .*allowed 1e-30"
    one, two = Physics.of([case], pair), Physics.of([case, case], pair)
    with one.contacts() as contacts, pytest.raises(ComputationError, match=told):
        initial_state(one, contacts)
    with two.contacts() as contacts, pytest.raises(HistoriesError) as failure:
        initial_state(two, contacts)
    assert failure.value.which.all()
