"""Many cases at once: those that fail do not disturb the others, and ranks share the work."""

from dataclasses import replace

import numpy as np
import pytest
from swept import CASE

from ringwear_par.cases.reading import parse_case
from ringwear_par.errors import RingwearError
from ringwear_par.results.result import FailedResult, Result
from ringwear_par.studies import many
from ringwear_par.studies.many import simulate_all
from ringwear_par.wear.threshold import ThresholdLaw


@pytest.fixture(scope="module")
def case():
    return parse_case(CASE, "case", {"time.steps": 2})


@pytest.fixture
def computed(monkeypatch):
    """The cases that this rank simulates."""
    computed, simulate = [], many.simulate

    def noted(case, *words, **how):
        computed.append(case)
        return simulate(case, *words, **how)

    monkeypatch.setattr(many, "simulate", noted)
    return computed


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
    assert str(found[1].error) == "ValueError: no such\nmaterial"
    assert found[1].case == bad.told != bad.text
    assert found[1].error.__traceback__ is None


def test_an_assembly_that_raises_fails_its_group_only(case, comm, monkeypatch):
    """On one of the ranks: the others hear of it."""
    other, assemble = case.replace({"upper.r": [28.0, 32.0]}), many.assemble

    def failing(case, comm):
        if case == other and comm.rank == comm.size - 1:
            raise MemoryError("no room")
        return assemble(case, comm)

    monkeypatch.setattr(many, "assemble", failing)
    found = simulate_all([other, case, other], comm)
    assert [type(each) for each in found] == [FailedResult, Result, FailedResult]
    assert {str(found[i].error) for i in (0, 2)} == {"MemoryError: no room"}
