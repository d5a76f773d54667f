"""Observer that stores the histories of cases, and makes their results."""

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import BoolArray
from ringwear_par.cases.case import Case
from ringwear_par.errors import ValidityWarning, reason_of
from ringwear_par.history.observers.balances import Balances, WorstBalances
from ringwear_par.history.observers.boundaries import BoundaryObserver
from ringwear_par.history.observers.stresses import CaseStresses, StressObserver
from ringwear_par.history.observers.worst_states import WorstStates
from ringwear_par.history.snapshots import Observer, Snapshot
from ringwear_par.history.state import Start
from ringwear_par.results.fields import (
    boundary_arrays,
    point_columns,
    stress_arrays,
    stress_rows,
)
from ringwear_par.results.key_numbers import end_numbers
from ringwear_par.results.result import (
    BALANCE,
    Checkpoint,
    HistoryColumns,
    Result,
    case_attributes,
    times_through,
)
from ringwear_par.results.rows import LastStates, StoredRows
from ringwear_par.results.variables import LAYER_ENDS
from ringwear_par.results.warnings import INFINITE, Measures, Warnings

_NO_FAILURES: Mapping[int, Exception] = MappingProxyType({})


class Recorder:
    """Stores the states of histories that their cases ask for, their balances and warnings.

    An observer; calls are collective on comm, the same on all ranks. Each of its parts observes one
    thing, of all histories at once.

    Parameters
    ----------
    cases : of one ``lockstep.batch_key``.
    comm : communicator of their histories.
    before : result of the interrupted history that continues, of one case; None: it starts.
    stresses : returns the stresses of a case, None where it asks for none; None: made here.
    results : whether there are to be results, which hold what it takes to continue.
    """

    def __init__(
        self,
        cases: Sequence[Case],
        comm: MPI.Comm,
        before: Result | None = None,
        *,
        stresses: Callable[[Case], CaseStresses | None] | None = None,
        results: bool = True,
    ) -> None:
        self._cases, self._comm, count = cases, comm, len(cases)
        #: where the history continues, None where it starts
        self.start: Start | None = None
        self._rows = StoredRows(cases)
        rows, stored_until = np.zeros(0, dtype=bool), -1.0
        if before is not None:
            assert before.checkpoint is not None
            self.start = before.checkpoint.start
            rows = self._rows.restore(before, float(self.start.state.time[0]))
            stored_until = float(before.histories["time"][rows][-1])
        self._balances, self._worst = WorstBalances(count), WorstStates(cases[0], count)
        self._boundary = BoundaryObserver(cases[0], comm, stored_until)
        self._stresses = StressObserver(
            cases, stresses or (lambda case: CaseStresses(case, comm)), stored_until,
            points_only=not results,
        )  # fmt: skip
        self._last = LastStates(count, results)
        #: of each history so far
        self.warnings = Warnings(cases, self._worst, self._balances, self._stresses)
        self._observers: tuple[Observer, ...] = (
            self._balances, self._worst, self._boundary, self._stresses, self._rows, self._last,
            self.warnings,
        )  # fmt: skip
        self._started, self._stepping = time.perf_counter(), 0.0
        #: s, spent by others on output, which is no time of stepping
        self.seconds_output = 0.0
        #: attributes of the interrupted history
        self._before: Mapping[str, Any] = {}
        if before is not None:
            self._restore(before, rows)

    def __call__(self, snapshot: Snapshot) -> bool:
        """Take new states; store those that cases ask for. Collective."""
        for observer in self._observers:
            observer(snapshot)
        self._stepping = time.perf_counter() - self._started
        return False

    # -- where an interrupted history continues ----------------------------------------------------

    def _restore(self, before: Result, rows: BoolArray) -> None:
        """Take over the stored rows of an interrupted history, and the worst of all its states."""
        assert before.checkpoint is not None
        assert self.start is not None
        case, worst = self._cases[0], before.checkpoint.worst
        attributes = self._before = before.attributes
        self._balances.restore(
            Balances(**before.balances),
            bool(attributes["closing_contact"]),
            worst["reactions"][1],
        )
        self._worst.restore(worst)
        steps, reached = int(self.start.progress.steps[0]), float(self.start.state.time[0])
        stored, finished = before.histories["time"][rows], case.time.finished(steps, reached)
        self._boundary.restore(before.boundary, stored, finished)
        self._stresses.restore(before.stress, stored, finished, worst[INFINITE])
        names = [f"wear_{body}" for body in ("lower", "upper")]
        if case.output.profiles == "all" and set(names) <= before.profiles.keys():
            wear = np.array([before.profiles[name] for name in names])
            self._stresses.restore_wear(before.histories["time"], wear)

    # -- what there is -----------------------------------------------------------------------------

    @property
    def last(self) -> Snapshot | None:
        """The last states, stored or not; None before the first."""
        return self._last.snapshot

    @property
    def finished(self) -> bool:
        """Whether a single history has come to its end."""
        return self._last.finished

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
        stops = [() if bad else self._last.stops.get(i, ()) for i, bad in enumerate(failed)]
        warnings = self.warnings.histories(failed)
        rows, whole = self._rows.columns(), times_through(self._cases[0], self._last.through)
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
            imbalance=np.where(failed, 0.0, self._balances.imbalance),
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
        return self._result(0, columns, warnings, self.warnings.measures(), error)

    def results(self, failures: Mapping[int, Exception]) -> list[Result | Exception]:
        """Return the results of all histories, or why there is none."""
        failures = {**self._stresses.failures, **failures}
        columns, warnings = self._recorded(failures)
        measures = self.warnings.measures()
        return [
            failures[number]
            if number in failures
            else self._result(number, columns, doubts, measures)
            for number, doubts in enumerate(warnings)
        ]

    def _result(
        self,
        number: int,
        columns: HistoryColumns,
        warnings: Sequence[ValidityWarning],
        measures: Measures,
        error: str = "",
    ) -> Result:
        case, rows = self._cases[number], columns.rows(number)
        start, place, defect = self._last.state(number)
        steps, time_reached = columns.steps[rows], float(start.state.time[place])
        through = times_through(case, self._last.through[:, number])
        worst = {name: values[:, number].tolist() for name, values in measures.items()}
        about = case_attributes(case, time_reached)
        balances = vars(self._balances.history(number)).copy()
        if not case.time.adaptive:  # nothing is known of the errors of fixed steps
            del balances["step_error"]
        if number in self._last.stops:
            about["stopped_by"] = " and ".join(self._last.stops[number].values())

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
        data |= boundary_arrays(self._boundary.states)
        return Result(
            data,
            {
                **about,
                **{name: float(time) for name, time in through.items()},
                "status": "complete" if self._last.has_ended(number) else "incomplete",
                "error": error,
                "ranks": self._comm.size,
                **self._seconds(),
                **{f"{BALANCE}{name}": value for name, value in balances.items()},
                "symmetry_defect": defect,
                "closing_contact": int(self._balances.closing_contact[number]),
                "doubts": json.dumps([warning.to_dict() for warning in warnings]),
            },
            Checkpoint(start, place, int(self._rows.pending[number]), worst),
        )  # fmt: skip

    def _seconds(self) -> dict[str, float]:
        """Return the wall times so far by attribute, s, those of an interrupted run included.

        Of several histories, those of one in the mean. The assembly of a shared pair is another's,
        and that of one that was assembled before is of then.
        """
        physics, output = self._last.physics, self.seconds_output
        cost = physics.update_cost
        if not physics.pair_is_shared:
            cost = cost + physics.pairs[0].cost
        assembly, solution = cost.seconds_assembly, cost.seconds_solution
        stepping = self._stepping / len(self._cases) - output - (assembly + solution)
        seconds = {
            "seconds_assembly": assembly,
            "seconds_factorisation": solution,
            "seconds_stepping": max(stepping, 0.0),
            "seconds_output": output,
        }
        return {name: s + float(self._before.get(name, 0.0)) for name, s in seconds.items()}
