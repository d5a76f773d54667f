"""Many cases at once: the results of single runs, whatever goes on beside them."""

from dataclasses import replace

import pytest
from agreement import assert_agree
from mpi4py import MPI
from parts import parse_case
from swept import CASE

import ringwear_par as rw
from ringwear_par.studies import many
from ringwear_par.studies.many import simulate_all

ALONE = MPI.COMM_SELF
KINDS = [rw.FailedResult, rw.Result, rw.FailedResult]


@pytest.fixture(scope="module")
def case():
    return parse_case(CASE, "case", {"time.steps": 2})


@pytest.fixture(scope="module")
def six_steps(case):
    return case.replace({"time.steps": 6, "output.every": 2})


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
    other, assemble = case.replace({"upper.r": [28.0, 32.0]}), many.assemble

    def failing(case, comm):
        if case == other:
            raise MemoryError("no room")
        return assemble(case, comm)

    monkeypatch.setattr(many, "assemble", failing)
    found = simulate_all([other, case, other], comm)
    assert [type(each) for each in found] == KINDS
    assert all("no room" in str(each.error) for each in found[::2])


@pytest.mark.parametrize("change", [{"mesh.contact_elements": 6000}, {"time.steps": 10**9}])
def test_a_case_without_memory_for_it_fails_alone(case, comm, with_memory, change):
    """The first of its group; its own assembly, or what it stores, would take all memory."""
    with_memory(2e9)
    huge = case.replace(change)
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


def cases_of(case, **more):
    """Cases that differ in numbers; one fails, and some stay alone."""
    changes = [
        {"wear.lower.k": 2e-7}, {"load.pressure": 50.0, "time.steps": 3}, {"wear.lower.k": 0.5},
        {"wear.lower.p0": 0.0}, {"wear.lower.k": 2e-7}, {"upper.young": 5e4},
        {"mesh.geometry": "updated"}, {"time.scheme": "explicit"},
        {"load.pressure": [[0, 9], [9, 90]]},
        {"time.scheme": "explicit", "time.step": 500.0, "time.steps": 2},
    ]  # fmt: skip
    return [case.replace({**change, **more}) for change in changes]


@pytest.mark.parametrize(("profiles", "batch"), [("all", None), ("last", 2)])
def test_results_are_those_of_single_cases(six_steps, profiles, batch):
    cases = cases_of(six_steps, **{"output.profiles": profiles})
    results = simulate_all(cases, ALONE, batch=batch)
    for one, mine in zip(cases, results, strict=True):
        if isinstance(mine, rw.FailedResult):
            with pytest.raises(rw.ComputationError) as caught:
                rw.simulate(one, ALONE)
            assert str(caught.value) == str(mine.error)
            continue
        exact = rw.simulate(one, ALONE)
        if one is not cases[-1]:  # whose steps are unstable
            assert_agree(mine, exact)
        assert [doubt.code for doubt in mine.doubts] == [doubt.code for doubt in exact.doubts]
        assert mine.attributes.keys() == exact.attributes.keys()
        for name in ("case", "status", "scheme", "law_lower", "energy_identity"):
            assert mine.attributes[name] == exact.attributes[name]
        assert mine.balances.keys() == exact.balances.keys()
        assert max(mine.balances[n] for n in ("force", "energy")) < 1e-9
        assert mine.balances["residual"] < 2e-4
    assert results[-1].doubts
    assert results[0].balances["residual"] > 1e-9  # of a block
    assert not results[0].doubts
    assert isinstance(results[2], rw.FailedResult)
