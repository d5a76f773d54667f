"""Stores the histories of a block, and makes their results."""

import json
import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from mpi4py import MPI

from ringwear_par.batched import take
from ringwear_par.cases.case import Case
from ringwear_par.cases.schema import STOP_CRITERIA
from ringwear_par.errors import ValidityWarning, reason_of
from ringwear_par.history.block import Block
from ringwear_par.history.checks import INFINITE_AT_INTERFACE, INFINITE_STRESS, Worst
from ringwear_par.history.loop import STOP, Instant
from ringwear_par.history.state import State
from ringwear_par.history.stresses import Boundaries, Stresses
from ringwear_par.results.fields import stored_states, stress_columns
from ringwear_par.results.key_numbers import end_numbers
from ringwear_par.results.result import (
    BALANCE,
    Checkpoint,
    HistoryColumns,
    Result,
    case_attributes,
    times_through,
)
from ringwear_par.results.rows import Columns, Rows, moment
from ringwear_par.results.variables import LAYER_ENDS, POINT_SIDES
from ringwear_par.results.warnings import warnings_of_histories


class Recorder:
    """Stores the states of histories that their cases ask for, their balances and warnings.

    Calls are collective on comm, the same on all ranks.

    Parameters
    ----------
    cases : of one ``block_key``, and ``stress_key`` where they ask for stresses.
    comm : communicator of their histories.
    before : result of the interrupted history that continues, of one case; None: it starts.
    results : whether there are to be results, which hold what it takes to continue.
    pair_is_shared : whether others have paid for the contact pair.
    """

    def __init__(
        self,
        cases: Sequence[Case],
        comm: MPI.Comm,
        before: Result | None = None,
        *,
        results: bool = True,
        pair_is_shared: bool = False,
    ) -> None:
        self._cases, self._comm, self._pair_is_shared = cases, comm, pair_is_shared
        self._rows, self._worst = Rows(cases), Worst(len(cases))
        self._boundaries = Boundaries(cases[0], comm)
        self._stresses = Stresses(cases, comm, points_only=not results)
        #: the last states that histories went on from; None before the first
        self.last: Instant | None = None
        #: of histories that have ended: their last instant, and their place in it
        self._ended: dict[int, tuple[Instant, int]] = {}
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
        self.first, self._before = before.checkpoint.state, before.attributes
        times, output = self._rows.restore(before), self._cases[0].output
        self._worst.measures = {n: v[:, None].copy() for n, v in before.checkpoint.worst.items()}
        if output.boundary != "last":
            self._boundaries.states = stored_states(before.data, "boundary_step", times)
        if (stress := self._cases[0].stress) is not None and stress.times != "last":
            self._stresses.states[0] = stored_states(before.data, "stress_step", times)
        if not self._stresses.states[0]:
            for name in (INFINITE_STRESS, INFINITE_AT_INTERFACE):
                self._worst.measures.pop(name, None)

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
            for name, entries in self._stresses(number, state, before).items():
                self._worst.take(name, np.array([number]), *np.array([entries]).T)

    # -- what there is -----------------------------------------------------------------------------

    @property
    def finished(self) -> bool:
        """Whether a single history has come to its end."""
        return 0 in self._ended

    def columns(self, failures: Mapping[int, Exception]) -> HistoryColumns:
        """Return all histories as they are stored.

        Parameters
        ----------
        failures : of histories that could not go on; they have the rows before.
        """
        failures, count = {**self._stresses.failures, **failures}, len(self._cases)
        offsets, steps, data, last = self._rows.columns()
        stresses = [self._stresses.arrays(number) for number in range(count)]
        through = np.full((2, count), np.inf)
        for number, (instant, place) in self._ended.items():
            through[:, number] = instant.state.through[place]
        whole = last | times_through(self._cases[0], through)
        whole |= end_numbers(self._cases, data, offsets)
        where = next((arrays for arrays in stresses if "point_r" in arrays), {})
        if where:
            sides = np.array([*map(POINT_SIDES.index, where["point_side"])], float)
            points = {"point_r": where["point_r"], "point_z": where["point_z"], "point_side": sides}
            whole |= {name: np.tile(values, (count, 1)) for name, values in points.items()}
        return HistoryColumns(
            offsets, steps, data | stress_columns(stresses, data["time"], offsets), whole,
            imbalance=np.where([i in failures for i in range(count)], 0.0, self._worst.imbalance),
            flags=tuple(
                () if i in failures
                else (*(w.code for w in warnings), *(f"stopped_by_{n}" for n in self._limits(i)))
                for i, warnings in enumerate(self._warnings())
            ),
            seconds=np.full(count, self._stepping / count),
            status=tuple("failed" if i in failures else "done" for i in range(count)),
            reason=tuple(reason_of(failures[i]) if i in failures else "" for i in range(count)),
        )  # fmt: skip

    def _warnings(self) -> list[list[ValidityWarning]]:
        return warnings_of_histories(self._cases, self._worst.measures)

    def _end(self, number: int) -> tuple[Block, State]:
        """Return the last state of a history, as of a block of one."""
        assert self.last is not None
        instant, place = self._ended.get(number, (self.last, 0))
        return take((instant.block, instant.state), np.array([place]))

    def _limits(self, number: int) -> dict[str, str]:
        """Return the limits that ended a history before its time, in words by criterion."""
        if number not in self._ended or not self._ended[number][0].block.stop:
            return {}
        block, state = self._end(number)
        return {
            name: f"stop.{name} = {most[0]:g} {STOP_CRITERIA[name].unit}"
            for name, most in block.stop.items()
            if state.time[0] < block.limits[0, -1] and STOP[name](block, state)[0] >= most[0]
        }

    # -- results -----------------------------------------------------------------------------------

    def result(self, error: str = "") -> Result:
        """Return the result of a single history so far. Collective on comm.

        The state that it has come to is its last row, also where its case does not store it.

        Parameters
        ----------
        error : why the history cannot go on, "" where it can.
        """
        assert self.last is not None
        is_stored = self.last.state.time[0] <= self._rows.last_time[0]
        columns = self._rows.columns(None if is_stored else self.last)
        return self._result(0, columns, self._warnings()[0], error)

    def results(self, failures: Mapping[int, Exception]) -> list[Result | Exception]:
        """Return the results of all histories, or why there is none."""
        failures = {**self._stresses.failures, **failures}
        columns = self._rows.columns()
        return [
            failures[i] if i in failures else self._result(i, columns, warnings)
            for i, warnings in enumerate(self._warnings())
        ]

    def _result(
        self,
        number: int,
        columns: Columns,
        warnings: Sequence[ValidityWarning],
        error: str = "",
    ) -> Result:
        case, some = self._cases[number], slice(*columns.offsets[number : number + 2])
        block, state = self._end(number)
        balances = self._worst.balances(number)
        if not case.time.adaptive:  # nothing is known of the errors of fixed steps
            del balances["step_error"]
        about = case_attributes(case, float(state.time[0]))
        if limits := self._limits(number):
            about["stopped_by"] = " and ".join(limits.values())

        data: dict[str, Any] = {"step": columns.steps[some], "line/edges": case.line.edges}
        data |= {name: values[some] for name, values in columns.data.items()}
        data |= {name: values[number] for name, values in columns.last.items()}
        for i, name in enumerate(LAYER_ENDS):
            if case.rings[i].layers:
                data[name] = case.layer_ends(i)
        data |= {**self._stresses.arrays(number), **self._boundaries.arrays()}
        through = times_through(case, state.through[0])
        return Result(
            data,
            {
                **about,
                **{name: float(time) for name, time in through.items()},
                "status": "complete" if number in self._ended else "incomplete",
                "error": error,
                "ranks": self._comm.size,
                **self._seconds(block),
                **{f"{BALANCE}{name}": value for name, value in balances.items()},
                "symmetry_defect": float(self._worst.measures["asymmetry"][0, number]),
                "doubts": json.dumps([warning.to_dict() for warning in warnings]),
            },
            Checkpoint(state, {n: v[:, number] for n, v in self._worst.measures.items()}),
        )

    def _seconds(self, block: Block) -> dict[str, float]:
        """Return the wall times so far by attribute, s, those of an interrupted run included.

        Of several histories, those of one in the mean.
        """
        assert self.last is not None
        elastic = np.zeros(2)
        if not self._pair_is_shared:
            elastic += block.line.pairs[0].seconds
        if self.last.following is not None:
            elastic += self.last.following.seconds
        assembly, solution = elastic.tolist()
        stepping = self._stepping / len(self._cases) - self.seconds_output - assembly - solution
        seconds = {
            "seconds_assembly": assembly,
            "seconds_factorisation": solution,
            "seconds_stepping": max(stepping, 0.0),
            "seconds_output": self.seconds_output,
        }
        return {name: s + float(self._before.get(name, 0.0)) for name, s in seconds.items()}
