"""The error that adaptive steps carry along: held and estimated."""

from dataclasses import replace

import numpy as np
import pytest
from changed_steps import change_steps
from mpi4py import MPI
from parts import Mesh, Output, PowerLaw, RunningInLaw, Stepping, ThresholdLaw
from reference_cases import paper_case
from ringwear_par.history.observers.trace import trace

import ringwear_par as rw
from ringwear_par.history.elastic import assemble

ALONE = MPI.COMM_SELF
LAWS = {
    "threshold": ThresholdLaw(1e-7, 40.0),
    "memory": RunningInLaw(5e-8, 4e-7, 20.0, depth=0.002),
    "power": PowerLaw(2e-10, 1.7, 1.2),
}


@pytest.fixture(scope="module")
def paper():
    case = paper_case(Mesh(32))
    return case, assemble(case, ALONE)


def history(paper, law, tolerance, end=200.0):
    case, pair = paper
    time = Stepping("adaptive", until=end, tolerance=tolerance)
    return trace(replace(case, wear_lower=law, time=time), ALONE, pair=pair)


def error_of(found, paper):
    """Return the largest error of wear at the ends of steps, mm."""
    case, states = found.physics.case, found.states[1:]
    finer = replace(case.time, tolerance=0.02 * case.time.tolerance)
    times = Output(times=tuple(state.time for state in states))
    exact = trace(replace(case, time=finer, output=times), ALONE, pair=paper[1])
    return max(np.abs((s.wear - exact.at(s.time).wear).sum(axis=0)).max() for s in states)


def test_errors_fall_as_the_tolerance_does():
    """Of the whole history, and the estimate is of their size."""
    case = paper_case(Mesh(64))
    paper = case, assemble(case, ALONE)
    tolerances, off = np.array([2.5e-6, 6.25e-7, 1.5625e-7]), []
    for tolerance in tolerances:
        found = history(paper, LAWS["threshold"], tolerance, 2000.0)
        off.append(error_of(found, paper))
        assert 0.6 < off[-1] / found.balances.step_error < 1.7
        assert off[-1] < 2.0 * tolerance
    assert 0.8 < np.polyfit(np.log(tolerances), np.log(off), 1)[0] < 1.2


@pytest.mark.parametrize("name", LAWS)
def test_the_estimate_is_the_error(paper, name):
    """In size and sign, of the elements that are off the most."""
    found = history(paper, LAWS[name], 1e-5, 5.0)
    exact = history(paper, LAWS[name], 1e-7, 5.0)
    lacking = (exact.last.wear - found.last.wear).sum(axis=0)
    worst = np.abs(lacking).argmax()
    assert 0.5 < lacking[worst] / found.last.error[worst] < 2.0
    assert found.balances.step_error <= 1.25e-5


@pytest.mark.parametrize("name", ["wear_error", "energy_error"])
def test_an_estimate_that_is_no_number_fails_the_case(paper, monkeypatch, name):
    """Alone, and among others."""

    def wrong(scheme, *arguments):
        step = scheme(*arguments)
        return replace(step, **{name: np.nan * step.wear_error})

    change_steps(monkeypatch, wrong)
    with pytest.raises(rw.ComputationError, match="not a number"):
        history(paper, LAWS["threshold"], 1e-5)
    case = replace(paper[0], time=Stepping("adaptive", until=50.0))
    for failed in rw.simulate_all([case, case], ALONE):
        assert "not a number" in str(failed.error)
