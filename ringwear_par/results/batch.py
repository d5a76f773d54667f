"""Records histories in lock step by column, and makes their results."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from ringwear_par import __version__
from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.cases.case import Case
from ringwear_par.contact.problem import WarmStart
from ringwear_par.elasticity.pair import ContactPair
from ringwear_par.errors import reason_of
from ringwear_par.history.balances import TO_ROUND_OFF, Balances, balances
from ringwear_par.history.sensitivity import units_of
from ringwear_par.history.snapshots import BatchSnapshot, Snapshot
from ringwear_par.history.state import Progress, State
from ringwear_par.history.stresses import CaseStresses, StressObserver
from ringwear_par.history.tangent import variables as derivatives_of
from ringwear_par.history.validity import WorstStates
from ringwear_par.results.checkpoints import take
from ringwear_par.results.columns import HistoryColumns
from ringwear_par.results.recorder import (
    Recorder,
    attributes,
    derivative_names,
    layer_names_of,
    row,
    times_through,
)
from ringwear_par.results.result import Result
from ringwear_par.results.stress_variables import point_columns, stress_rows
from ringwear_par.results.unit_suspicions import ValidityWarning
from ringwear_par.results.variables import (
    D_PROFILES,
    HISTORIES,
    LAYER_PROFILES,
    LAYER_VOLUMES,
)
from ringwear_par.results.warnings import (
    infinite_at_interfaces,
    infinite_edge,
    infinite_stress,
    unstable,
    validity_warnings,
    worn_points,
)

_BALANCES = [each.name for each in fields(Balances)]
#: along the contact line
_WIDE = (*D_PROFILES, *LAYER_PROFILES)
#: what is told since the start, and of what
_SINCE_START = {"penetration": "approach", "d_penetration": "d_approach"}


@dataclass(frozen=True)
class Alone:
    """A history that was computed alone.

    Parameters
    ----------
    recorder : what is stored of it; None where it did not get as far.
    error : why it failed, None if it did not.
    seconds : s, that it took.
    """

    recorder: Recorder | None
    error: Exception | None
    seconds: float

    @property
    def reason(self) -> str:
        """Why it failed, on one line; "" if it did not."""
        return "" if self.error is None else reason_of(self.error)


@dataclass(frozen=True)
class _End:
    """Where some histories ended, (h,)."""

    numbers: IntArray
    state: State
    progress: Progress
    symmetry_defect: FloatArray
    scaled_pressure: FloatArray
    rate: FloatArray
    gap: FloatArray


def _at(name: str, rows: Any) -> Any:
    """Return where some rows of a variable are, or some histories: P parameters come first."""
    return (slice(None), rows) if name.startswith("d_") else rows


class BatchRecorder:
    """Stores the states of histories in lock step, their balances and doubts.

    Called with the snapshots of ``simulate_batch``. No work is done for each history and step.

    Parameters
    ----------
    cases : of one ``batch_key``.
    pair : their contact pair.
    stresses : returns what has the stresses of a case, None where it asks for none.
    keep_ends : whether there are to be results, which hold what it takes to go on.
    derivatives : keys that the histories have derivatives with respect to.
    """

    def __init__(
        self,
        cases: Sequence[Case],
        pair: ContactPair,
        stresses: Callable[[Case], CaseStresses | None],
        keep_ends: bool = False,
        derivatives: Sequence[str] = (),
    ) -> None:
        self._cases, self._pair, self._keep_ends = cases, pair, keep_ends
        output, count = cases[0].output, len(cases)
        self._fields, self._deep = output.fields, output.profiles == "all"
        # rows as they come: numbers of the histories, steps, variables
        self._numbers: list[IntArray] = []
        self._steps: list[IntArray] = []
        self._parameters = tuple(derivatives)
        names = derivative_names(cases[0], derivatives)
        self._layers = {
            name: 1 + len(cases[0].lower.layers if "lower" in name else cases[0].upper.layers)
            for name in layer_names_of(cases[0])
        }
        stored = (*HISTORIES, *self._fields, *names, *self._layers)
        fields_of_pair = {*self._fields, *D_PROFILES, *LAYER_PROFILES}
        last = () if self._deep else tuple(name for name in stored if name in fields_of_pair)
        self._rows: dict[str, list[Any]] = {name: [] for name in stored if name not in last}
        self._last = {name: np.full(self._shape(name, count), np.nan) for name in last}
        self._pending = np.zeros(count, dtype=np.int64)
        self._worst = np.zeros((len(_BALANCES), count))
        self._worst_states = WorstStates(cases[0], count)
        self._step_error_time = np.zeros(count)
        self._closing_contact = np.zeros(count, dtype=bool)
        self._doubts: list[tuple[ValidityWarning, ...]] = [()] * count
        self._ends: list[_End] = []
        #: of cases that ask for stress; grids and faces are for results alone
        self._stress = {
            number: StressObserver(case, own, points_only=not keep_ends)
            for number, case in enumerate(cases)
            if (own := stresses(case)) is not None
        }
        self._through = np.full((2, count), np.inf)
        self._begun = time.perf_counter()
        self._seconds = 0.0

    def _shape(self, name: str, rows: int) -> tuple[int, ...]:
        """Return the shape of so many rows of a variable, or of so many histories' last ones."""
        parameters = (len(self._parameters),) if name.startswith("d_") else ()
        along = (self._pair.line.n,) if name in self._fields or name in _WIDE else ()
        if name in LAYER_VOLUMES:
            along = (self._layers[name],)
        return (*parameters, rows, *along)

    def __call__(self, snapshot: BatchSnapshot) -> None:
        """Take the new states of histories."""
        if snapshot.step is None:
            for place, found in unstable(snapshot.model).items():
                self._doubts[snapshot.numbers[place]] = (found,)
        shown = np.flatnonzero(snapshot.shown)
        self._pending[snapshot.numbers[shown]] += snapshot.iterations[shown]
        if not snapshot.passing:
            self._judge(snapshot, shown)
        if snapshot.stored.any():
            self._store(snapshot, np.flatnonzero(snapshot.stored))
            if self._stress:
                self._add_stresses(snapshot)
        if snapshot.finished.any():
            self._end(snapshot, np.flatnonzero(snapshot.finished))
        self._seconds = time.perf_counter() - self._begun

    def _judge(self, snapshot: BatchSnapshot, shown: IntArray) -> None:
        """Take the balances and the validity of the new states."""
        now, numbers = balances(snapshot.model, snapshot.state), snapshot.numbers[shown]
        self._worst_states(snapshot.model, snapshot.state, numbers, shown)
        if snapshot.step is not None:
            now["step_error"] = snapshot.step.history_error
            closing = np.broadcast_to(snapshot.step.closing, snapshot.shown.shape)[shown]
            self._closing_contact[numbers] |= closing
        every = np.zeros((len(_BALANCES), len(snapshot.numbers)))
        for name, value in now.items():
            every[_BALANCES.index(name)] = value
        value, before = every[:, shown], self._worst[:, numbers]
        worse = ~(value <= before)  # NaN too
        self._worst[:, numbers] = np.where(worse, value, before)
        step = worse[_BALANCES.index("step_error")]
        self._step_error_time[numbers[step]] = snapshot.state.time[shown][step]

    def _store(self, snapshot: BatchSnapshot, stored: IntArray) -> None:
        values, numbers = row(snapshot.model, snapshot.state), snapshot.numbers[stored]
        values["contact_iterations"] = self._pending[snapshot.numbers]
        values |= derivatives_of(snapshot.model, snapshot.state)
        self._numbers.append(numbers)
        self._steps.append(snapshot.progress.steps[stored])
        # states do not change: those of all histories are stored as they are
        kept = slice(None) if len(stored) == len(snapshot.numbers) else stored
        for name, rows in self._rows.items():
            if name not in _SINCE_START:
                rows.append(values[name][_at(name, kept)])
        ended = np.flatnonzero(snapshot.finished)
        for name, last in self._last.items() if len(ended) else ():
            last[_at(name, snapshot.numbers[ended])] = values[name][_at(name, ended)]
        self._pending[numbers] = 0

    def _add_stresses(self, snapshot: BatchSnapshot) -> None:
        """Compute the stresses of new stored states that cases ask for."""
        for place in np.flatnonzero(snapshot.stored).tolist():
            number, finished = int(snapshot.numbers[place]), bool(snapshot.finished[place])
            asked = self._cases[number].stress
            if asked is None or (asked.times == "last" and not finished):
                continue
            observer, state = self._stress[number], snapshot.state.history(place)
            count = len(observer.states)
            observer(
                Snapshot(
                    snapshot.model, state, None, Progress(int(snapshot.progress.steps[place])), 0,
                    True, snapshot.passing, finished,
                )
            )  # fmt: skip
            if len(observer.states) > count:
                case, line = self._cases[number], self._pair.line
                infinite = infinite_edge(case, observer.history(), line, state)
                if infinite is not None:
                    self._worst_states.take_infinite_stress(number, *infinite)

    def _end(self, snapshot: BatchSnapshot, ended: IntArray) -> None:
        """Take the last states of histories."""
        numbers, model = snapshot.numbers[ended], snapshot.model
        state = replace(snapshot.state, tangent=None).take(ended)  # derivatives are stored by now
        if state.through is not None:
            self._through[:, numbers] = state.through
        for number in numbers.tolist():
            case, worst = self._cases[number], self._worst_states.history(number)
            self._doubts[number] += validity_warnings(case, worst, self.balances(number))
            if number in self._stress:
                found = self._stress[number].history()
                self._doubts[number] += infinite_stress(found, worst)
                self._doubts[number] += infinite_at_interfaces(case, found)
                self._doubts[number] += worn_points(case, found, self._stress[number])
        if self._keep_ends:
            solver = model.batch.solver
            self._ends.append(
                _End(
                    numbers, state, snapshot.progress.take(ended),
                    model.compliances.symmetry_defect[ended],
                    solver.scaled_pressures[ended], model.approach_rates(ended),
                    model.given.initial_gap[ended] + state.wear[0] + state.wear[1],
                )
            )  # fmt: skip

    def balances(self, number: int) -> Balances:
        """Return the worst of all balances of a history so far."""
        return Balances(*self._worst[:, number].tolist())

    def columns(self, alone: Mapping[int, Alone]) -> HistoryColumns:
        """Return all histories as they are stored.

        Parameters
        ----------
        alone : those that were computed alone, by number; nothing else is taken of them.
        """
        count = len(self._cases)
        numbers, steps, rows = self._sorted(alone)
        found = rows | self._last_ones(alone)
        offsets = np.searchsorted(numbers, np.arange(count + 1))
        imbalance = self._worst[[_BALANCES.index(name) for name in TO_ROUND_OFF]].max(axis=0)
        flags = [tuple(doubt.flag for doubt in found) for found in self._doubts]
        seconds = np.full(count, self._seconds / count)
        for number, one in alone.items():
            seconds[number] += one.seconds
            if one.recorder is not None:
                imbalance[number] = one.recorder.balances.worst
                flags[number] = tuple(doubt.flag for doubt in one.recorder.doubts)
            else:
                imbalance[number], flags[number] = 0.0, ()
        failed = [number in alone and alone[number].error is not None for number in range(count)]
        return HistoryColumns(
            offsets,
            steps,
            {name: found[name] for name in HISTORIES},
            {name: found[name] for name in self._fields},
            imbalance,
            tuple(() if bad else found for bad, found in zip(failed, flags, strict=True)),
            seconds,
            tuple("failed" if bad else "done" for bad in failed),
            tuple(alone[i].reason if bad else "" for i, bad in enumerate(failed)),
            {name: values for name, values in found.items() if name.startswith("d_")},
            {name: found[name] for name in self._layers},
            self._stress_columns(alone, offsets, found["time"]),
            self._each(alone),
        )

    def _stress_columns(
        self, alone: Mapping[int, Alone], offsets: IntArray, times: FloatArray
    ) -> dict[str, FloatArray]:
        """Return what is stored of stresses of all rows; cases ask for the same, or for none."""
        parts = []
        for number, observer in self._stress.items():
            one = alone.get(number)
            own = times[offsets[number] : offsets[number + 1]]
            history = observer.history() if one is None else None
            if one is not None and one.recorder is not None:
                history = one.recorder.stress
            parts.append(stress_rows(history or observer.history().none, own))
        return {name: np.concatenate([part[name] for part in parts]) for name in (parts or [{}])[0]}

    def _each(self, alone: Mapping[int, Alone]) -> dict[str, FloatArray]:
        """Return what histories have one of."""
        found = times_through(self._cases[0], self._through.copy())
        for number, one in alone.items():
            arrays = {} if one.recorder is None else one.recorder.arrays()
            for name, values in found.items():
                values[number] = arrays.get(name, np.nan)
        if self._stress:
            points = point_columns(self._stress[0].history())
            found |= {name: np.tile(at, (len(self._cases), 1)) for name, at in points.items()}
        return found

    def _sorted(self, alone: Mapping[int, Alone]) -> tuple[IntArray, IntArray, dict[str, Any]]:
        """Return number, steps and variables of all rows, by history."""
        chunks = list(self._numbers)
        steps = list(self._steps)
        rows = {name: list(parts) for name, parts in self._rows.items()}
        kept = [~np.isin(chunk, list(alone)) for chunk in chunks]
        for number, one in alone.items():
            if one.recorder is None:
                continue
            arrays, made = one.recorder.arrays(), one.recorder.steps
            chunks.append(np.full(len(made), number))
            kept.append(np.ones(len(made), dtype=bool))
            steps.append(made)
            for name, parts in rows.items():
                parts.append(arrays.get(name, np.empty(self._shape(name, 0))))
        nothing = np.empty(0, dtype=np.int64)
        everything = np.concatenate([nothing, *chunks])
        which = np.flatnonzero(np.concatenate([np.empty(0, dtype=bool), *kept]))
        which = which[np.argsort(everything[which], kind="stable")]
        places = np.full(len(everything), -1)
        places[which] = np.arange(len(which))

        def by_history(name: str, parts: Sequence[Any]) -> Any:
            """Return rows in order: fields, which are large, are copied once only."""
            shape, wide = self._shape(name, 0), name in (*self._fields, *_WIDE, *LAYER_VOLUMES)
            if not wide:
                dtype = HISTORIES[name].dtype if name in HISTORIES else np.float64
                together = np.concatenate([np.empty(shape, dtype), *parts], axis=-1)
                return together[..., which]
            found, first = np.empty(self._shape(name, len(which))), 0
            for part, own in zip(parts, kept, strict=True):
                to = places[first : first + len(own)]
                first += len(own)
                if own.all():
                    found[_at(name, to)] = part
                else:
                    found[_at(name, to[own])] = part[_at(name, own)]
            return found

        found = {
            name: by_history(name, parts)
            for name, parts in rows.items()
            if name not in _SINCE_START
        }
        numbers = everything[which]
        first = np.searchsorted(numbers, numbers)
        for name, whole in _SINCE_START.items():
            if name in rows:
                found[name] = found[whole] - found[whole][..., first]
        return numbers, np.concatenate([nothing, *steps])[which], found

    def _last_ones(self, alone: Mapping[int, Alone]) -> dict[str, FloatArray]:
        """Return the profiles of the last stored states, (B, n)."""
        found = {}
        for name, last in self._last.items():
            found[name] = last.copy()
            for number, one in alone.items():
                arrays = {} if one.recorder is None else one.recorder.arrays()
                found[name][_at(name, number)] = arrays.get(name, np.nan)
        return found

    def results(self, alone: Mapping[int, Alone]) -> dict[int, Result]:
        """Return the results of the histories that have ended here, by number.

        Parameters
        ----------
        alone : those that were computed alone, and have results of their own.
        """
        columns, units = self.columns(alone), units_of(self._cases[0], self._parameters)
        ends = {
            int(number): (end, place)
            for end in self._ends
            for place, number in enumerate(end.numbers)
        }
        return {
            number: self._result(number, *where, columns, units)
            for number, where in ends.items()
            if number not in alone
        }

    def _result(
        self,
        number: int,
        end: _End,
        place: int,
        columns: HistoryColumns,
        units: Mapping[str, str],
    ) -> Result:
        case, line, rows = self._cases[number], self._pair.line, columns.rows(number)
        steps = columns.steps[rows]
        state = end.state.history(place)
        progress = Progress(*(values[place].item() for values in vars(end.progress).values()))
        contact = state.contact
        warm = WarmStart(
            end.scaled_pressure[place], end.rate[place], end.gap[place], contact.approach,
            contact.force,
        )  # fmt: skip
        share = float(columns.seconds[number])
        return Result(
            line,
            np.arange(len(steps)) if case.output.times else steps,
            steps,
            {name: values[rows] for name, values in columns.histories.items()},
            {
                name: values[rows] if self._deep else values[number]
                for name, values in columns.profiles.items()
            },
            (),
            attributes(
                case,
                ranks=1,
                begun_by=__version__,
                time=float(state.time),
                finished=True,
                seconds={
                    "seconds_assembly": 0.0, "seconds_factorisation": 0.0,
                    "seconds_stepping": share, "seconds_output": 0.0,
                },
                symmetry_defect=float(end.symmetry_defect[place]),
                doubts=self._doubts[number],
                error="",
                balances=self.balances(number),
                step_error_time=float(self._step_error_time[number]),
                closing_contact=bool(self._closing_contact[number]),
                through=state.through,
            ),
            take(state, progress, warm, 0, 0, self._worst_states.history(number)),
            parameters=dict(units),
            derivatives={
                name: values[:, rows] if name in self._rows else values[:, number]
                for name, values in columns.derivatives.items()
            },
            layers={
                name: values[rows] if name in self._rows else values[number]
                for name, values in columns.layers.items()
            },
            stress=self._stress[number].history() if number in self._stress else None,
        )  # fmt: skip
