"""Many cases at once: those that fail do not disturb the others."""

from dataclasses import replace

import numpy as np
import pytest
from agreement import assert_agree
from parts import (
    Load,
    Stepping,
    Table,
    parse_case,
    restored,
    simulate_one,
)
from swept import CASE

import ringwear_par as rw
from ringwear_par.studies import together
from ringwear_par.studies.many import simulate_all

KINDS = [rw.FailedResult, rw.Result, rw.FailedResult]


@pytest.fixture(scope="module")
def case():
    return parse_case(CASE, "case", {"time.steps": 2})


class BadLaw:
    """Good enough for a trial, but not for a history."""

    def rate(self, p, at):
        """Raise at any time but the first."""
        if at.time > 0.0:
            raise ValueError("no such\nmaterial")
        return 1e-7 * at.power * p


def test_a_law_that_raises_fails_its_case_only(case, comm):
    bad = replace(case, wear_lower=BadLaw())
    found = simulate_all([bad, case, bad], comm)
    assert [type(each) for each in found] == KINDS
    assert isinstance(found[0].error, rw.ComputationError)
    assert r"ValueError: no such\nmaterial" in str(found[0].error)
    assert found[0].case == bad.stored_text != bad.text


def test_an_assembly_that_raises_fails_its_group_only(case, comm, monkeypatch):
    other, assemble = case.replace({"upper.r": [28.0, 32.0]}), together.assemble

    def failing(case, comm):
        if case == other:
            raise MemoryError("no room")
        return assemble(case, comm)

    monkeypatch.setattr(together, "assemble", failing)
    found = simulate_all([other, case, other], comm)
    assert [type(each) for each in found] == KINDS
    assert all("no room" in str(each.error) for each in found[::2])


@pytest.mark.parametrize("key", ["mesh.contact_elements", "time.steps"])
def test_a_case_without_memory_for_it_fails_alone(case, comm, with_memory, key):
    """The first of its group; its own assembly, or what it stores, would take all memory."""
    with_memory(2e9)
    huge = case.replace({key: 6_000 if key == "mesh.contact_elements" else 10**9})
    found = simulate_all([huge, case, huge], comm)
    assert [type(each) for each in found] == KINDS
    for each in found[::2]:
        assert isinstance(each.error, rw.InputError)
        assert "memory" in str(each.error)
        assert each.case == huge.text


class FirstElements:
    """A law that was written for one history: it takes rows for elements."""

    def rate(self, p, local):
        """Return the rate, none at the first elements."""
        rate = 1e-7 * local.friction * local.speed * p
        rate[:4] = 0.0
        return rate


def test_a_law_that_was_written_for_one_history_has_it_to_itself(case, comm):
    cases = [replace(case, friction=mu, wear_lower=FirstElements()) for mu in (0.1, 0.2, 0.3)]
    for one, found in zip(cases, simulate_all(cases, comm), strict=True):
        alone = rw.simulate(one, comm)
        assert not alone.profiles["wear_lower"][-1, :4].any()
        assert alone.profiles["wear_lower"][-1, 4:].all()
        assert_agree(found, alone)


def test_a_history_that_ends_without_load_goes_on(case, comm):
    """From the result of many histories, as one of a single history would."""
    force = case.load.force
    load = Load(case.load.omega, Table((0.0, 20.0, 40.0), (force, 0.0, force)))
    short, long = (
        replace(case, load=load, time=Stepping("adaptive", until=until)) for until in (20.0, 40.0)
    )
    found, single = simulate_all([short, short], comm)[0], rw.simulate(short, comm)
    assert found.histories["force"][-1] == 0.0
    ends = []
    for first in (restored(found), restored(single)):
        seen = []
        simulate_one(long, comm, seen.append, first=first)
        ends.append(seen[-1].state.wear[0, 0])
    end, exact = ends
    assert np.abs(end - exact).max() <= 1e-2 * case.time.tolerance
    assert (end > found.profiles["wear_lower"][-1]).all()
