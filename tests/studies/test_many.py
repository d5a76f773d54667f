"""Many cases at once: those that fail do not disturb the others, and ranks share the work."""

from dataclasses import replace

import numpy as np
import pytest
from swept import CASE

from ringwear_par.cases.case import Load, Stepping
from ringwear_par.cases.files.reading import parse_case
from ringwear_par.errors import InputError, RingwearError
from ringwear_par.history.loop import simulate_one
from ringwear_par.history.observers.trace import Trace
from ringwear_par.results.execution.simulate import simulate
from ringwear_par.results.result import FailedResult, Result
from ringwear_par.results.storage.result_files import restored
from ringwear_par.schedules import Table
from ringwear_par.studies.execution import many
from ringwear_par.studies.execution.many import simulate_all
from ringwear_par.wear.laws.threshold import ThresholdLaw


@pytest.fixture(scope="module")
def case():
    return parse_case(CASE, "case", {"time.steps": 2})


@pytest.fixture
def computed(monkeypatch):
    """The cases that this rank computes."""
    noted, compute = [], many.computed

    def computed(cases, *words, **how):
        noted.extend(cases)
        return compute(cases, *words, **how)

    monkeypatch.setattr(many, "computed", computed)
    return noted


class BadLaw(ThresholdLaw):
    """Good enough for a trial, but not for a history."""

    def rate(self, p, at):
        """Raise at any time but the first."""
        if np.max(at.time) > 0.0:
            raise ValueError("no such\nmaterial")
        return super().rate(p, at)


def test_a_law_that_raises_fails_its_case_only(case, comm):
    """Under MPI, on one of the ranks; what is stored of a changed case says that it is changed."""
    bad = replace(case, wear_lower=BadLaw(1e-7, 40.0))
    found = simulate_all([case, bad, *[case] * comm.size], comm)
    assert [type(each) for each in found] == [Result, FailedResult, *[Result] * comm.size]
    assert type(found[1].error) is RingwearError
    assert str(found[1].error) == r"ValueError: no such\nmaterial"
    assert found[1].case == bad.stored_text != bad.text
    assert found[1].error.__traceback__ is None


def test_an_assembly_that_raises_fails_its_group_only(case, comm, monkeypatch):
    """On one of the ranks: the others hear of it."""
    other, assemble = case.replace({"upper.r": [28.0, 32.0]}), many.assemble

    def failing(case, comm):
        pair = assemble(case, comm)
        if case == other and comm.rank == comm.size - 1:
            raise MemoryError("no room")
        return pair

    monkeypatch.setattr(many, "assemble", failing)
    found = simulate_all([other, case, other], comm)
    assert [type(each) for each in found] == [FailedResult, Result, FailedResult]
    assert {str(found[i].error) for i in (0, 2)} == {"not enough memory: no room"}


def test_a_case_that_cannot_be_is_refused_before_any_assembly(case, comm, monkeypatch, with_memory):
    """Its own assembly would take all memory."""
    huge, assemble = case.replace({"mesh.contact_elements": 6_000}), many.assemble
    with_memory(2e9)

    def modest(case, comm):
        assert case.mesh.contact_elements < 6_000
        return assemble(case, comm)

    monkeypatch.setattr(many, "assemble", modest)
    found = simulate_all([huge, case, huge], comm)
    assert [type(each) for each in found] == [FailedResult, Result, FailedResult]
    for each in found[::2]:
        assert isinstance(each.error, InputError)
        assert "GB of memory" in str(each.error)
        assert each.case == huge.text


def test_a_bad_case_does_not_take_its_group_along(case, comm, with_memory):
    """The first of those that share a pair stores too much."""
    with_memory(2e9)
    bad = case.replace({"time.steps": 10**9})
    found = simulate_all([bad, case], comm)
    assert "GB of memory" in str(found[0].error)
    assert isinstance(found[1], Result)


@pytest.mark.parametrize("shapes", [2, 5])
def test_ranks_share_the_cases_whatever_their_shapes(case, comm, computed, shapes):
    """And all of them get all results, in order."""
    cases = [
        case.replace({"upper.r": [28.0 + 0.1 * (i % shapes), 32.0], "title": f"case {i}"})
        for i in range(5)
    ]
    found = simulate_all(cases, comm)
    assert [each.attributes["title"] for each in found] == [one.title for one in cases]
    counts = comm.allgather(len(computed))
    assert sum(counts) == 5
    assert max(counts) - min(counts) <= 1


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
        alone = simulate(one, comm).profiles["wear_lower"]
        assert not alone[-1, :4].any()
        assert alone[-1, 4:].all()
        assert found.profiles["wear_lower"] == pytest.approx(alone, rel=1e-12)


def test_a_history_that_ends_without_load_goes_on(case, comm):
    """From the result of many histories, as one of a single history would."""
    force = case.load.force
    load = Load(case.load.omega, Table((0.0, 20.0, 40.0), (force, 0.0, force)))
    short, long = (
        replace(case, load=load, time=Stepping("adaptive", until=until)) for until in (20.0, 40.0)
    )
    found, single = simulate_all([short] * (1 + comm.size), comm)[0], simulate(short, comm)
    assert found.histories["force"][-1] == 0.0
    ends = []
    for start in (restored(found), restored(single)):
        seen = Trace()
        simulate_one(long, comm, start=start, observers=[seen])
        ends.append(seen.last)
    end, exact = ends
    assert np.array_equal(end.wear, exact.wear)
    assert (end.wear[0] > found.profiles["wear_lower"][-1]).all()
