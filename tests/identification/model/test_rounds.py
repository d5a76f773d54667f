"""Rounds of histories, which the first rank asks and all compute: alike, and ended together."""

import re
import signal
import sys
import threading
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from laboratory import FITTED, TRUTH

from ringwear_par.errors import ComputationError, LawError, RingwearError
from ringwear_par.identification.definition.fit_file import read_fit
from ringwear_par.identification.estimation import profile as profile_room
from ringwear_par.identification.estimation import solution as solution_room
from ringwear_par.identification.estimation.minimise import Optimum, minimise
from ringwear_par.identification.fit import expected_result, fit, fit_problem
from ringwear_par.identification.model import histories as histories_room
from ringwear_par.identification.model import rounds as rounds_room
from ringwear_par.identification.model.histories import Histories, HistoryError
from ringwear_par.identification.model.rounds import Rounds, StoppedError, side_by_side
from ringwear_par.results.execution.stop_signals import StopSignals


def test_an_error_on_one_rank_ends_all(tables, comm, monkeypatch, capfd):
    """The first rank, which waits for its histories, and those that serve; it is told once."""
    computed = histories_room.computed
    calls = []

    def failing(*args, **kwargs):
        calls.append(args)
        if comm.rank == comm.size - 1 and len(calls) == 3:
            raise MemoryError("no room")
        return computed(*args, **kwargs)

    monkeypatch.setattr(histories_room, "computed", failing)
    with pytest.raises(MemoryError if comm.size == 1 else RingwearError, match="no room"):
        fit(tables(starts=3), comm)
    assert "Traceback" not in "".join(capfd.readouterr())


def test_an_error_of_the_first_rank_ends_all(tables, comm, monkeypatch):
    def failing(*_):
        raise RingwearError("no starts")

    monkeypatch.setattr(solution_room, "solve_starts", failing)
    with pytest.raises(RingwearError, match="no starts"):
        fit(tables(), comm)


def test_a_result_that_cannot_be_sent_ends_all(tables, comm):
    rounds = Rounds(read_fit(tables()), comm, StopSignals())
    with pytest.raises(Exception, match=r"[Pp]ickl"):
        rounds.lead(lambda: lambda: None)


def test_cases_that_one_rank_cannot_take_end_all(tables, comm, monkeypatch):
    """Where friction of tests is renewed."""
    problem = read_fit(tables())
    rounds = Rounds(problem, comm, StopSignals())
    change = Histories.change_cases

    def failing(histories, experiments):
        if comm.rank == comm.size - 1:
            raise MemoryError("no room")
        change(histories, experiments)

    monkeypatch.setattr(Histories, "change_cases", failing)
    with pytest.raises(MemoryError if comm.size == 1 else RingwearError, match="no room"):
        rounds.lead(lambda: rounds.renew_inputs(np.array([1e-7, 0.0])))


def test_a_signal_to_any_rank_stops_all(tables, comm):
    with StopSignals() as signals:
        rounds = Rounds(read_fit(tables()), comm, signals)
        if comm.rank == comm.size - 1:
            signal.raise_signal(signal.SIGUSR1)
        with pytest.raises(StoppedError, match="stopped by SIGUSR1"):
            rounds.lead(lambda: rounds.responses(np.array([[1e-7, 0.0]])))


def test_a_result_tells_that_it_computes_no_more(tables, comm):
    found = expected_result(read_fit(tables()), comm)
    found.misfit.evaluate(found.x)
    with pytest.raises(RingwearError, match="keeps the readings at its estimate only"):
        found.misfit.evaluate(1.01 * found.x)


@pytest.mark.parametrize("terminal", [True, False])
def test_how_far_a_fit_is_is_told_on_a_terminal(terminal, tables, comm, monkeypatch, capfd):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: terminal)
    found = fit(tables(starts=1 + terminal), comm)
    said = capfd.readouterr().err
    assert ("1 of 2 starts have ended" in said) is terminal
    assert ("intervals" in said) is terminal
    counts = [int(count) for count in re.findall(r", (\d+) histories", said)]
    assert counts == sorted(counts)
    assert not counts or 0 < counts[-1] <= found.histories


def test_what_fails_in_a_round_ends_all_jobs():
    before = threading.active_count()

    def compute(points):
        raise RingwearError("no room")

    with pytest.raises(RingwearError, match="no room"):
        side_by_side([lambda wait_for: wait_for(np.zeros(1))] * 3, compute)
    assert threading.active_count() == before


def test_a_profile_that_finds_a_better_optimum_is_followed(tables, comm, monkeypatch):
    """From where a minimiser has stuck, half a standard deviation away."""
    expected = fit(tables(starts=1, intervals=["profile"]), comm)
    calls = []

    def stuck(misfit, x, *args, **kwargs):
        found = minimise(misfit, x, *args, **kwargs)
        calls.append(found)
        if len(calls) > 1:
            return found
        away = found.x.copy()
        away[1] += 0.5 * expected.parameters[1].sd
        return replace(found, x=away, evaluation=misfit.evaluate(away))

    monkeypatch.setattr(solution_room, "minimise", stuck)
    found = fit(tables(starts=1, intervals=["profile"]), comm)
    assert len(calls) == 2
    assert len(found.starts) == 2
    assert found.chi2 == pytest.approx(expected.chi2, rel=1e-9)
    for one, other in zip(found.parameters, expected.parameters, strict=True):
        assert abs(one.estimate - other.estimate) < 1e-3 * one.sd
        assert np.abs(np.subtract(one.interval, other.interval)).max() < 0.05 * one.sd


def test_a_limit_that_is_not_found_is_told(tables, comm, monkeypatch):
    monkeypatch.setattr(profile_room, "_CLOSE", -1.0)
    found = fit(tables(starts=1, intervals=["profile"]), comm)
    assert set(found.inexact_limits) == set(TRUTH)
    assert {doubt.keys for doubt in found.doubts if doubt.code == "inexact-limit"} == {
        (key,) for key in TRUTH
    }


@pytest.mark.parametrize(
    ("error", "raised"), [(HistoryError, False), (ComputationError, True), (LawError, True)]
)
def test_a_profile_takes_only_missing_histories_for_too_far(
    error, raised, tables, comm, monkeypatch
):
    problem = read_fit(tables(intervals=["profile"]))

    def failing(*args, **kwargs):
        raise error("no history")

    found = expected_result(problem, comm)
    optimum = Optimum(found.x, found.evaluation, True, 0, 0)
    estimates = [replace(p, verdict="identified") for p in found.parameters]
    monkeypatch.setattr(profile_room, "minimise", failing)
    arguments = found.misfit, optimum, estimates, found.covariance
    if raised:
        with pytest.raises(error, match="no history"):
            profile_room.likelihood_profiles(*arguments)
    else:
        assert set(profile_room.likelihood_profiles(*arguments).inexact_limits) == set(TRUTH)


def test_starts_are_where_all_parameters_are_felt(tables, comm):
    """Of thresholds that mostly are above all pressures, from which nothing leads away."""
    given = tables(starts=4)
    given["fit"]["parameters"] = {**FITTED, "wear.lower.p0": {"start": 0.0, "bounds": [0.0, 1000]}}
    found = fit_problem(read_fit(given), comm)
    assert found.n_at_best == 4
    assert all(start.converged for start in found.starts)


def test_threads_need_an_mpi_that_allows_them(monkeypatch):
    funneled = SimpleNamespace(Query_thread=lambda: 1, THREAD_SERIALIZED=2)
    monkeypatch.setattr(rounds_room, "MPI", funneled)
    with pytest.raises(ComputationError, match="MPI_THREAD_SERIALIZED or more is needed"):
        rounds_room.side_by_side([lambda wait_for: None], lambda points: None)
