"""Stores the histories of a block, and makes their results."""

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np
from mpi4py import MPI

from ringwear_par.batched import take
from ringwear_par.cases.case import Case
from ringwear_par.cases.schema import STOP_CRITERIA
from ringwear_par.errors import ValidityWarning, reason_of
from ringwear_par.history.checks import Worst
from ringwear_par.history.loop import STOP, Instant
from ringwear_par.history.state import State
from ringwear_par.history.stresses import Boundaries, CaseStresses, InfiniteEdge, Stresses
from ringwear_par.results.fields import boundary_arrays, point_columns, stress_arrays, stress_rows
from ringwear_par.results.key_numbers import end_numbers
from ringwear_par.results.result import (
    BALANCE,
    Checkpoint,
    HistoryColumns,
    Last,
    Result,
    case_attributes,
    times_through,
)
from ringwear_par.results.rows import Rows, moment
from ringwear_par.results.variables import LAYER_ENDS
from ringwear_par.results.warnings import warnings_of_histories

#: what a checkpoint calls the largest stress beside an edge
_INFINITE = "infinite_stress"
_NO_FAILURES: Mapping[int, Exception] = MappingProxyType({})


class Recorder:
    """Stores the states of histories that their cases ask for, their balances and warnings.

    Calls are collective on comm, the same on all ranks.

    Parameters
    ----------
    cases : of one ``block_key``.
    comm : communicator of their histories.
    before : result of the interrupted history that continues, of one case; None: it starts.
    stresses : returns the stresses of a case; None: made here.
    results : whether there are to be results, which hold what it takes to continue.
    pair_is_shared : whether others have paid for the contact pair.
    """

    def __init__(
        self,
        cases: Sequence[Case],
        comm: MPI.Comm,
        before: Result | None = None,
        *,
        stresses: Callable[[Case], CaseStresses] | None = None,
        results: bool = True,
        pair_is_shared: bool = False,
    ) -> None:
        self._cases, self._comm, self._results, count = cases, comm, results, len(cases)
        self._pair_is_shared = pair_is_shared
        self._rows, self._worst = Rows(cases), Worst(count)
        self._boundaries = Boundaries(cases[0], comm)
        of = stresses or (lambda case: CaseStresses(case, comm))
        made = {} if cases[0].stress is None else {0: of(cases[0])}
        self._stresses = Stresses(
            cases, stresses or (lambda case: made[0]), points_only=not results
        )
        #: the last states that histories went on from; None before the first
        self.last: Instant | None = None
        #: of histories that have ended: their last instant, and their place in it
        self._ended: dict[int, tuple[Instant, int]] = {}
        #: limits that ended histories before their times, in words by criterion, by number
        self._stops: dict[int, dict[str, str]] = {}
        self._started, self._stepping = time.perf_counter(), 0.0
        #: s, spent by others on output, which is no time of stepping
        self.seconds_output = 0.0
        #: attributes of the interrupted history, and where it continues
        self._before: Mapping[str, Any] = {}
        self.first: State | None = None
        if before is not None:
            self._restore(before)

    def _restore(self, before: Result) -> None:
        """Take over the stored rows of an interrupted history, and the worst of all its states."""
        assert before.checkpoint is not None
        self.first, self._before = before.checkpoint.first, before.attributes
        times, worst = self._rows.restore(before), dict(before.checkpoint.worst)
        self._stresses.infinite[0] = InfiniteEdge(*worst.pop(_INFINITE))
        self._worst.restore(worst)
        if self._cases[0].output.boundary != "last":
            self._boundaries.states = [s for s in before.boundary if s.time in times]
        stress = self._cases[0].stress
        if before.stress is not None and stress is not None and stress.times != "last":
            self._stresses.states[0] = [s for s in before.stress.states if s.time in times]

    def __call__(self, instant: Instant) -> bool:
        """Take new states; store those that cases ask for. Collective."""
        self.last, numbers = instant, instant.block.number
        stored = np.flatnonzero(instant.stored)
        if len(stored):
            part = instant
            if len(stored) < len(numbers):
                some = (instant.block, instant.state, instant.stored, instant.ended)
                part = Instant(*take(some, stored), instant.following)
            self._worst(part)
            self._fields(part)
            self._rows(part)
        for place in np.flatnonzero(instant.ended).tolist():
            self._ended[int(numbers[place])] = instant, place
        self._note_stops(instant)
        self._stepping = time.perf_counter() - self._started
        return False

    def _fields(self, instant: Instant) -> None:
        """Compute stresses and boundary fields of stored states, where cases ask for them."""
        case = self._cases[0]
        if case.stress is None and case.output.boundary == "none":
            return
        for place, number in enumerate(instant.block.number.tolist()):
            state, before = moment(instant, place), float(self._rows.last_time[number])
            self._boundaries(state, before)
            self._stresses(number, state, before)

    def _note_stops(self, instant: Instant) -> None:
        """Note which limits have ended those histories that are not at the ends of their times."""
        block, state = instant.block, instant.state
        early = instant.ended & (state.time < block.limits[:, -1])
        for name, most in block.stop.items() if early.any() else ():
            for place in np.flatnonzero(early & (STOP[name](block, state) >= most)).tolist():
                limit = f"stop.{name} = {most[place]:g} {STOP_CRITERIA[name].unit}"
                self._stops.setdefault(int(block.number[place]), {})[name] = limit

    # -- what there is -----------------------------------------------------------------------------

    @property
    def finished(self) -> bool:
        """Whether a single history has come to its end."""
        return 0 in self._ended

    def columns(self, failures: Mapping[int, Exception] = _NO_FAILURES) -> HistoryColumns:
        """Return all histories as they are stored.

        Parameters
        ----------
        failures : of histories that could not go on; they have the rows before.
        """
        return self._recorded(failures)[0]

    def _recorded(
        self, failures: Mapping[int, Exception]
    ) -> tuple[HistoryColumns, Sequence[Sequence[ValidityWarning]]]:
        """Return all histories as they are stored, and the warnings of each."""
        failures, count = {**self._stresses.failures, **failures}, len(self._cases)
        failed = [number in failures for number in range(count)]
        stops = [() if bad else self._stops.get(i, {}) for i, bad in enumerate(failed)]
        warnings = warnings_of_histories(self._cases, self._worst.measures, self._stresses, failed)
        through = np.full((2, count), np.inf)
        for number, (instant, place) in self._ended.items():
            through[:, number] = instant.state.through[place]
        rows, whole = self._rows.columns(), times_through(self._cases[0], through)
        # cases ask for the same stresses, or for none
        histories = [self._stresses.history(number) for number in range(count)]
        times = np.split(rows["histories"]["time"], rows["offsets"][1:-1])
        stresses = [
            stress_rows(history, at)
            for history, at in zip(histories, times, strict=True)
            if history is not None
        ]
        if histories[0] is not None:
            whole |= {n: np.tile(v, (count, 1)) for n, v in point_columns(histories[0]).items()}
        columns = HistoryColumns(
            **rows,
            imbalance=np.where(failed, 0.0, self._worst.imbalance),
            flags=tuple(
                (*(warning.code for warning in texts), *(f"stopped_by_{name}" for name in limits))
                for texts, limits in zip(warnings, stops, strict=True)
            ),
            seconds=np.full(count, self._stepping / count),
            status=tuple("failed" if bad else "done" for bad in failed),
            reason=tuple(reason_of(failures[i]) if bad else "" for i, bad in enumerate(failed)),
            stress={n: np.concatenate([s[n] for s in stresses]) for n in (stresses or [{}])[0]},
            whole=whole,
        )
        numbers = end_numbers(self._cases, columns)
        return replace(columns, whole={**columns.whole, **numbers}), warnings

    # -- results -----------------------------------------------------------------------------------

    def result(self, error: str = "") -> Result:
        """Return the result of a single history so far. Collective on comm.

        Parameters
        ----------
        error : why the history cannot go on, "" where it can.
        """
        columns, (warnings,) = self._recorded(_NO_FAILURES)
        return self._result(0, columns, warnings, error)

    def results(self, failures: Mapping[int, Exception]) -> list[Result | Exception]:
        """Return the results of all histories, or why there is none."""
        failures = {**self._stresses.failures, **failures}
        columns, warnings = self._recorded(failures)
        return [
            failures[number] if number in failures else self._result(number, columns, doubts)
            for number, doubts in enumerate(warnings)
        ]

    def _result(
        self,
        number: int,
        columns: HistoryColumns,
        warnings: Sequence[ValidityWarning],
        error: str = "",
    ) -> Result:
        assert self.last is not None
        case, rows = self._cases[number], columns.rows(number)
        instant, place = self._ended.get(number, (self.last, 0))
        block, state = take((instant.block, instant.state), np.array([place]))
        steps, time_reached = columns.steps[rows], float(state.time[0])
        balances = vars(self._worst.balances(number)).copy()
        if not case.time.adaptive:  # nothing is known of the errors of fixed steps
            del balances["step_error"]
        about = case_attributes(case, time_reached)
        if number in self._stops:
            about["stopped_by"] = " and ".join(self._stops[number].values())

        data: dict[str, Any] = {"step": steps, "line/edges": case.line.edges}
        numbers = np.arange(len(steps))
        if case.output.times and not np.array_equal(steps, numbers):
            data |= {"step": numbers, "steps_made": steps}
        for table in (columns.histories, columns.profiles, columns.layers):
            data |= {n: self._rows.part(n, column, rows, number) for n, column in table.items()}
        for i, name in enumerate(LAYER_ENDS):
            if case.rings[i].layers:
                data[name] = case.layer_ends(i)
        if (stresses := self._stresses.history(number)) is not None:
            data |= stress_arrays(stresses)
        data |= boundary_arrays(self._boundaries.states)
        through = times_through(case, state.through[0])
        worst = {name: values[:, number].tolist() for name, values in self._worst.measures.items()}
        worst[_INFINITE] = [*self._stresses.infinite[number]]
        return Result(
            data,
            {
                **about,
                **{name: float(time) for name, time in through.items()},
                "status": "complete" if number in self._ended else "incomplete",
                "error": error,
                "ranks": self._comm.size,
                **self._seconds(instant),
                **{f"{BALANCE}{name}": value for name, value in balances.items()},
                "symmetry_defect": float(self._worst.measures["asymmetry"][0, number]),
                "doubts": json.dumps([warning.to_dict() for warning in warnings]),
            },
            Checkpoint(state, Last.of(block, state), worst),
        )  # fmt: skip

    def _seconds(self, instant: Instant) -> dict[str, float]:
        """Return the wall times so far by attribute, s, those of an interrupted run included.

        Of several histories, those of one in the mean.
        """
        elastic = np.zeros(2)
        if not self._pair_is_shared:
            elastic += instant.block.line.pairs[0].seconds
        if instant.following is not None:
            elastic += instant.following.seconds
        assembly, solution = elastic.tolist()
        stepping = self._stepping / len(self._cases) - self.seconds_output - assembly - solution
        seconds = {
            "seconds_assembly": assembly,
            "seconds_factorisation": solution,
            "seconds_stepping": max(stepping, 0.0),
            "seconds_output": self.seconds_output,
        }
        return {name: s + float(self._before.get(name, 0.0)) for name, s in seconds.items()}
