"""Observer that stores what cases ask for, and makes the results of their histories."""

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np
from mpi4py import MPI

from ringwear_par import __version__, batched
from ringwear_par.arrays import BoolArray, FloatArray, IntArray, share
from ringwear_par.cases.case import Case
from ringwear_par.cases.files.law_trials import law_sources
from ringwear_par.contact.problem import WarmStart
from ringwear_par.elasticity.boundary_fields import BODIES, BoundaryState
from ringwear_par.elasticity.pair import BodyCost
from ringwear_par.elasticity.stress.fields import StressHistory, StressState
from ringwear_par.errors import reason_of
from ringwear_par.history.layers import layer_left, layer_volumes
from ringwear_par.history.model import WearModel
from ringwear_par.history.observers.balances import Balances, WorstBalances
from ringwear_par.history.observers.boundaries import BoundaryObserver
from ringwear_par.history.observers.stresses import CaseStresses, StressObserver
from ringwear_par.history.observers.validity import WorstStates
from ringwear_par.history.saving import stores
from ringwear_par.history.sensitivity import units_of
from ringwear_par.history.snapshots import Snapshot
from ringwear_par.history.state import Progress, Start, State
from ringwear_par.history.tangent import variables as derivatives_of
from ringwear_par.info import versions
from ringwear_par.results.checkpoints import restored, take
from ringwear_par.results.columns import HistoryColumns
from ringwear_par.results.result import Result, balance_attributes
from ringwear_par.results.stress_variables import point_columns, stress_rows
from ringwear_par.results.unit_suspicions import ValidityWarning
from ringwear_par.results.variables import (
    D_HISTORIES,
    D_PROFILES,
    HISTORIES,
    LAYER_PROFILES,
    LAYER_VOLUMES,
    TIMES_THROUGH,
    layer_names,
)
from ringwear_par.results.warnings import (
    infinite_at_interfaces,
    infinite_edge,
    infinite_stress,
    unstable,
    validity_warnings,
    worn_points,
)
from ringwear_par.schedules import in_time, integral
from ringwear_par.wear.layered import LayeredLaw

#: along the contact line
_WIDE = (*D_PROFILES, *LAYER_PROFILES)
#: variables that count from the start, and the variable that they are changes of
_SINCE_START = {"penetration": "approach", "d_penetration": "d_approach"}
_NO_FAILURES: Mapping[int, Exception] = MappingProxyType({})


@dataclass(frozen=True)
class _Ends:
    """Where some histories are, to continue from."""

    state: State
    progress: Progress
    warm: WarmStart
    symmetry_defect: FloatArray
    finished: BoolArray

    @classmethod
    def of(cls, snapshot: Snapshot, places: IntArray) -> "_Ends":
        """Return where some histories of a snapshot are, without derivatives."""
        state, model = replace(snapshot.state, tangent=None), snapshot.model
        return cls(
            batched.take(state, places),
            batched.take(snapshot.progress, places),
            batched.take(model.warm, places),
            model.compliances.symmetry_defect[places],
            snapshot.finished[places],
        )


def _own_stresses(comm: MPI.Comm) -> Callable[[Case], CaseStresses | None]:
    """Return the maker of the stresses that a case asks for."""
    return lambda case: None if case.stress is None else CaseStresses(case, comm)


def row(model: WearModel, state: State) -> dict[str, Any]:
    """Return the result's variables of B states by name, (B,) or (B, n). Not collective.

    All but ``penetration`` and ``contact_iterations``, which other states have a part in.
    """
    contact, volumes = state.contact, model.integrals(state.wear)
    return {
        "time": state.time,
        "approach": contact.approach,
        "force": contact.force,
        "torque": model.torque(contact.pressure),
        "twist": model.twist(contact.pressure),
        "worn_volume_lower": volumes[0],
        "worn_volume_upper": volumes[1],
        "dissipated_energy": state.energy,
        "pressure": contact.pressure,
        "gap": contact.gap,
        "wear_lower": state.wear[0],
        "wear_upper": state.wear[1],
        **_of_layers(model, state),
    }


def _of_layers(model: WearModel, state: State) -> dict[str, Any]:
    """Return the same of bodies with layers."""
    found: dict[str, Any] = {}
    for i, body in enumerate(("lower", "upper")):
        if model.layer_ends[i] is not None:
            left = layer_left(model, i, state.wear[i])
            found[f"share_through_{body}"] = share(model.area, left <= 0.0)
            found[f"layer_left_{body}"] = left
            found[f"worn_volume_{body}_layers"] = layer_volumes(model, i, state.wear[i])
    return found


def layer_names_of(case: Case) -> tuple[str, ...]:
    """Return which variables of layers are stored of a case."""
    return layer_names((bool(case.lower.layers), bool(case.upper.layers)))


def derivative_names(case: Case, keys: Sequence[str]) -> list[str]:
    """Return which derivatives are stored of a case, with respect to some keys or none."""
    if not keys:
        return []
    fields = {f"d_{name}" for name in case.output.fields}
    return [*D_HISTORIES, *(name for name in D_PROFILES if name in fields)]


def attributes(
    case: Case,
    *,
    ranks: int,
    begun_by: str,
    time: float,
    finished: bool,
    seconds: Mapping[str, float],
    symmetry_defect: float,
    doubts: Sequence[ValidityWarning],
    error: str,
    balances: Balances,
    step_error_time: float,
    closing_contact: bool,
    through: FloatArray | None,
) -> dict[str, Any]:
    """Return the attributes of a result. Not collective.

    Parameters
    ----------
    begun_by : version that began the history.
    time : s, of its last state.
    seconds : by attribute.
    error : why it cannot go on, "" where it can.
    balances, step_error_time, closing_contact : see ``WorstBalances``.
    through : (2,) s, when wear first got through the layers, see ``State``.
    """
    laws = [law for law in case.laws if law is not None]
    return {
        "case": case.stored_text,
        "title": case.title,
        "status": "complete" if finished else "incomplete",
        "ranks": ranks,
        **versions(),
        "begun_by": begun_by,
        "scheme": case.time.scheme,
        "time_step": case.time.step,
        "time_steps": case.time.steps,
        "time_end": case.time.end,
        **seconds,
        "symmetry_defect": symmetry_defect,
        **_sliding(case, time),
        **{
            f"face_{body}": section.told
            for body, section in zip(("lower", "upper"), case.sections, strict=True)
            if section.face
        },
        "user_laws": json.dumps(law_sources(case)),
        **{
            f"law_{body}": "" if law is None else law.describe()
            for body, law in zip(("lower", "upper"), case.laws, strict=True)
        },
        **_layer_attributes(case, through),
        "doubts": json.dumps([doubt.text for doubt in doubts]),
        "error": error,
        "energy_identity": int(
            any(
                all(law.layer_ratios(case.friction))
                if isinstance(law, LayeredLaw)
                else law.per_energy(case.friction)
                for law in laws
            )
        ),
        **balance_attributes(vars(balances)),
        "step_error_time": step_error_time,
        "closing_contact": int(closing_contact),
    }


def _layer_attributes(case: Case, through: FloatArray | None) -> dict[str, Any]:
    """Return what is told of layers: what they are, and when wear first got through, s or NaN.

    Densities, where some are known: of each layer, g/mm3, or NaN.
    """
    found: dict[str, Any] = {}
    for body, ring in zip(("lower", "upper"), case.rings, strict=True):
        if ring.layers:
            found[f"layers_{body}"] = ", then ".join(
                f"{1e3 * layer.thickness:.6g} um of E = {layer.young:.6g} MPa, "
                f"nu = {layer.poisson:.6g}"
                + ("" if layer.density is None else f", {layer.density:.6g} g/mm3")
                for layer in ring.layers
            )
            if any(layer.density is not None for layer in ring.layers):
                found[f"density_{body}_layers"] = tuple(
                    np.nan if layer.density is None else layer.density for layer in ring.layers
                )
    times = times_through(case, through)
    return found | {name: float(time) for name, time in times.items()}


def times_through(case: Case, through: FloatArray | None) -> dict[str, FloatArray]:
    """Return when wear first got through the layers of each body that has some, s or NaN.

    Parameters
    ----------
    through : (2, ...) s, see ``State``.
    """
    times = np.full(2, np.inf) if through is None else through
    return {
        name: np.where(np.isfinite(time), time, np.nan)
        for name, time, ring in zip(TIMES_THROUGH, times, case.rings, strict=True)
        if ring.layers
    }


def _sliding(case: Case, time: float) -> dict[str, Any]:
    """Return what the summary tells of sliding, and densities where they are known."""
    density = {"density_lower": case.lower.density, "density_upper": case.upper.density}
    return {
        "friction": case.friction,
        "nominal_area": case.area,  # mm2
        "mean_radius": 0.5 * sum(case.overlap),  # mm
        "omega": in_time(case.load.omega, time),  # rad/s
        "angle": integral(case.load.omega, 0.0, time),  # rad
        **{name: there for name, there in density.items() if there is not None},
    }


class Recorder:
    """Stores the states of histories that their cases ask for, their balances and warnings.

    An observer; calls are collective on comm, the same on all ranks. No work is done for each
    history and step.

    Parameters
    ----------
    cases : of one ``lockstep.batch_key``.
    comm : communicator of their histories.
    before : result of the interrupted history that continues, of one case; None: it starts.
    derivatives : keys that the histories have derivatives with respect to.
    stresses : returns the stresses of a case, None where it asks for none; None: made here.
    results : whether there are to be results, which hold what it takes to continue.
    """

    def __init__(
        self,
        cases: Sequence[Case],
        comm: MPI.Comm,
        before: Result | None = None,
        *,
        derivatives: Sequence[str] = (),
        stresses: Callable[[Case], CaseStresses | None] | None = None,
        results: bool = True,
    ) -> None:
        self._cases, self._comm, self._results = cases, comm, results
        output, count = cases[0].output, len(cases)
        self._line = cases[0].line
        self._fields, self._deep = output.fields, output.profiles == "all"
        #: where the history continues, None where it starts
        self.start: Start | None = None
        # rows as they come: numbers of the histories, steps, variables
        self._numbers: list[IntArray] = []
        self._steps: list[IntArray] = []
        self._parameters = tuple(derivatives)
        self._layers = {
            name: 1 + len(cases[0].lower.layers if "lower" in name else cases[0].upper.layers)
            for name in layer_names_of(cases[0])
        }
        stored = (
            *HISTORIES, *self._fields, *derivative_names(cases[0], derivatives), *self._layers
        )  # fmt: skip
        along_line = {*self._fields, *_WIDE}
        last = () if self._deep else tuple(name for name in stored if name in along_line)
        self._rows: dict[str, list[Any]] = {name: [] for name in stored if name not in last}
        self._last_profiles = {name: np.full(self._shape(name, count), np.nan) for name in last}
        #: iterations of the contact solver since the last stored state
        self._pending = np.zeros(count, dtype=np.int64)
        self.balances, self._worst_states = WorstBalances(count), WorstStates(cases[0], count)
        self._warnings: list[tuple[ValidityWarning, ...]] = [()] * count
        self._through = np.full((2, count), np.inf)
        #: why histories cannot be recorded
        self.failures: dict[int, Exception] = {}
        self._ends: dict[int, tuple[_Ends, int]] = {}
        self._last: Snapshot | None = None
        self._seconds: dict[str, float] = {}
        self._begun, self._stepping = time.perf_counter(), 0.0
        #: s, spent by others on output, which is no time of stepping
        self.seconds_output = 0.0
        self._begun_by = __version__
        self._earlier: list[BoundaryState] = []
        self._earlier_stress: tuple[StressState, ...] = ()
        if before is not None:
            self._restore(before)
        stored_until = -1.0
        if before is not None:
            stored_until = float(np.append(-1.0, self._rows["time"][0])[-1])
        self._boundary: BoundaryObserver | None = None
        if output.boundary != "none":
            self._boundary = BoundaryObserver(cases[0], comm, stored_until)
        stresses = stresses or _own_stresses(comm)
        #: of cases that ask for stress; grids and faces are for results alone
        self._stress = {
            number: StressObserver(case, shared, stored_until, points_only=not results)
            for number, case in enumerate(cases)
            if (shared := stresses(case)) is not None
        }
        if self._stress and before is not None:
            self._stress[0].wear = self._wear_under_stress(before)

    # -- where an interrupted history continues ----------------------------------------------------

    def _restore(self, before: Result) -> None:
        """Take the stored rows of an interrupted history, as far as the case still stores them."""
        case = self._cases[0]
        self.start = start = restored(before)
        assert before.checkpoint is not None
        steps, reached = int(start.progress.steps[0]), float(start.state.time[0])
        times = before.histories["time"]
        # the last one of a shorter run may not belong here
        rows = zip(before.steps_made.tolist(), times.tolist(), strict=True)
        keep = np.array([t <= reached and stores(case, n, t) for n, t in rows])
        self._numbers.append(np.zeros(np.count_nonzero(keep), dtype=np.int64))
        self._steps.append(before.steps_made[keep])
        stored = {**before.histories, **before.profiles, **before.layers}
        for name, parts in self._rows.items():
            if name not in _SINCE_START:
                parts.append(np.asarray(stored[name])[keep])
        for name, last in self._last_profiles.items():
            if keep[-1]:
                last[0] = stored[name]
        # the last state of a shorter run is not the last one of this run
        left, finished = set(times[keep].tolist()), case.time.finished(steps, reached)
        if case.output.boundary != "last" or finished:
            self._earlier = [b for b in before.boundary if b.time in left]
        wanted = "none" if case.stress is None else case.stress.times
        if before.stress is not None and (wanted != "last" or finished):
            self._earlier_stress = tuple(s for s in before.stress.states if s.time in left)
        self._pending[0] = int(before.checkpoint.numbers["pending_iterations"]) + int(
            before.histories["contact_iterations"][~keep].sum()
        )
        self.balances.restore(
            Balances(**before.balances),
            float(before.attributes.get("step_error_time", 0.0)),
            bool(before.attributes.get("closing_contact", False)),
        )
        self._worst_states.restore(before.checkpoint.worst)
        self._begun_by = str(before.attributes["begun_by"])
        self._seconds = {
            name: float(value)
            for name, value in before.attributes.items()
            if name.startswith("seconds_")
        }

    def _wear_under_stress(self, before: Result) -> FloatArray | None:
        """Return the wear, (2, n) mm, at the last stresses of an interrupted history, if stored."""
        names = [f"wear_{body}" for body in BODIES]
        if not (self._earlier_stress and self._deep and set(names) <= before.profiles.keys()):
            return None
        row = before.histories["time"].tolist().index(self._earlier_stress[-1].time)
        return np.array([before.profiles[name][row] for name in names])

    # -- new states --------------------------------------------------------------------------------

    def __call__(self, snapshot: Snapshot) -> bool:
        """Take new states; store those that cases ask for. Collective."""
        if snapshot.step is None or self._last is None:
            for place, warning in unstable(snapshot.model).items():
                self._warnings[snapshot.numbers[place]] = (warning,)
        new = np.flatnonzero(snapshot.accepted)
        self._pending[snapshot.numbers] += snapshot.iterations
        if not snapshot.passing:
            self._last = snapshot
            self.balances(snapshot)
            numbers = snapshot.numbers[new]
            self._worst_states(snapshot.model, snapshot.state, numbers, new)
        if self._boundary is not None and snapshot.accepted[0]:
            self._boundary(snapshot.instant(0))
        if snapshot.stored.any():
            if self._stress:
                self._add_stresses(snapshot)
            self._store(snapshot, np.flatnonzero(snapshot.stored))
        if snapshot.finished.any():
            self._end(snapshot, np.flatnonzero(snapshot.finished))
        self._stepping = time.perf_counter() - self._begun
        return False

    def _store(self, snapshot: Snapshot, stored: IntArray) -> None:
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
        # of a single history they are asked for before its end as well
        last = np.flatnonzero(snapshot.finished) if len(self._cases) > 1 else stored
        for name, profiles in self._last_profiles.items() if len(last) else ():
            profiles[_at(name, snapshot.numbers[last])] = values[name][_at(name, last)]
        self._pending[numbers] = 0

    def _add_stresses(self, snapshot: Snapshot) -> None:
        """Compute the stresses of new stored states that cases ask for."""
        for place in np.flatnonzero(snapshot.stored).tolist():
            number, finished = int(snapshot.numbers[place]), bool(snapshot.finished[place])
            case = self._cases[number]
            if case.stress is None or number in self.failures:
                continue
            if case.stress.times == "last" and not finished and len(self._cases) > 1:
                continue
            observer, instant = self._stress[number], snapshot.instant(place)
            count = len(observer.states)
            try:
                observer(instant)
            except Exception as error:
                if len(self._cases) == 1:
                    raise
                self.failures[number] = error
                continue
            if len(observer.states) > count:
                infinite = infinite_edge(case, observer.history(), self._line, instant.state)
                if infinite is not None:
                    self._worst_states.take_infinite_stress(number, *infinite)

    def _end(self, snapshot: Snapshot, ended: IntArray) -> None:
        """Take the last states of histories."""
        numbers = snapshot.numbers[ended]
        if snapshot.state.through is not None:
            self._through[:, numbers] = snapshot.state.through[:, ended]
        if self._results and len(self._cases) > 1:
            ends = _Ends.of(snapshot, ended)
            self._ends |= {number: (ends, place) for place, number in enumerate(numbers.tolist())}

    # -- what there is -----------------------------------------------------------------------------

    @property
    def last(self) -> Snapshot | None:
        """The last states, stored or not; None before the first."""
        return self._last

    @property
    def finished(self) -> bool:
        """Whether a single history has come to its end."""
        return self._last is not None and bool(self._last.finished.all())

    def warnings(self, number: int = 0) -> tuple[ValidityWarning, ...]:
        """Return the warnings of a history so far."""
        case, worst = self._cases[number], self._worst_states.history(number)
        stress = self.stress(number)
        return (
            *self._warnings[number],
            *validity_warnings(case, worst, self.balances.history(number)),
            *infinite_stress(stress, worst),
            *infinite_at_interfaces(case, stress),
            *worn_points(case, stress, self._stress.get(number)),
        )

    def stress(self, number: int = 0) -> StressHistory | None:
        """Return the stresses of a history so far, None where its case asks for none."""
        observer = self._stress.get(number)
        return None if observer is None else observer.history(self._earlier_stress)

    def columns(self, failures: Mapping[int, Exception] = _NO_FAILURES) -> HistoryColumns:
        """Return all histories as they are stored.

        Parameters
        ----------
        failures : of histories that could not go on; they have the rows before.
        """
        failures, count = {**self.failures, **failures}, len(self._cases)
        numbers, steps, rows = self._sorted()
        values = rows | self._last_profiles
        offsets = np.searchsorted(numbers, np.arange(count + 1))
        failed = [number in failures for number in range(count)]
        imbalance = np.where(failed, 0.0, self.balances.imbalance)
        flags = (
            () if bad else tuple(warning.flag for warning in self.warnings(number))
            for number, bad in enumerate(failed)
        )
        return HistoryColumns(
            offsets,
            steps,
            {name: values[name] for name in HISTORIES},
            {name: values[name] for name in self._fields},
            imbalance,
            tuple(flags),
            np.full(count, self._stepping / count),
            tuple("failed" if bad else "done" for bad in failed),
            tuple(reason_of(failures[i]) if bad else "" for i, bad in enumerate(failed)),
            {name: column for name, column in values.items() if name.startswith("d_")},
            {name: values[name] for name in self._layers},
            self._stress_columns(offsets, values["time"]),
            self._single_values(),
        )

    def _shape(self, name: str, rows: int) -> tuple[int, ...]:
        """Return the shape of so many rows of a variable, or of so many histories' last ones."""
        parameters = (len(self._parameters),) if name.startswith("d_") else ()
        along = (self._line.n,) if name in self._fields or name in _WIDE else ()
        if name in LAYER_VOLUMES:
            along = (self._layers[name],)
        return (*parameters, rows, *along)

    def _stress_columns(self, offsets: IntArray, times: FloatArray) -> dict[str, FloatArray]:
        """Return the stored stresses of all rows; cases ask for the same, or for none."""
        parts = [
            stress_rows(
                observer.history(self._earlier_stress),
                times[offsets[number] : offsets[number + 1]],
            )
            for number, observer in self._stress.items()
        ]
        return {name: np.concatenate([part[name] for part in parts]) for name in (parts or [{}])[0]}

    def _single_values(self) -> dict[str, FloatArray]:
        """Return what histories have one of: times when layers were worn through, places."""
        values = times_through(self._cases[0], self._through.copy())
        if self._stress:
            points = point_columns(self._stress[0].history())
            values |= {name: np.tile(at, (len(self._cases), 1)) for name, at in points.items()}
        return values

    def _sorted(self) -> tuple[IntArray, IntArray, dict[str, Any]]:
        """Return number, steps and variables of all rows, by history."""
        nothing = np.empty(0, dtype=np.int64)
        numbers = np.concatenate([nothing, *self._numbers])
        order = np.argsort(numbers, kind="stable")
        places = np.empty(len(order), dtype=np.int64)
        places[order] = np.arange(len(order))

        def by_history(name: str, parts: Sequence[Any]) -> Any:
            """Return rows in order: fields, which are large, are copied once only."""
            if name in (*self._fields, *_WIDE, *LAYER_VOLUMES):
                column, first = np.empty(self._shape(name, len(order))), 0
                for part in parts:
                    count = part.shape[1 if name.startswith("d_") else 0]
                    column[_at(name, places[first : first + count])] = part
                    first += count
                return column
            dtype = HISTORIES[name].dtype if name in HISTORIES else np.float64
            empty = np.empty(self._shape(name, 0), dtype)
            return np.concatenate([empty, *parts], axis=-1)[..., order]

        columns = {
            name: by_history(name, parts)
            for name, parts in self._rows.items()
            if name not in _SINCE_START
        }
        numbers = numbers[order]
        first = np.searchsorted(numbers, numbers)
        for name, whole in _SINCE_START.items():
            if name in self._rows:
                columns[name] = columns[whole] - columns[whole][..., first]
        return numbers, np.concatenate([nothing, *self._steps])[order], columns

    # -- results -----------------------------------------------------------------------------------

    def result(self, error: str = "") -> Result:
        """Return the result of a single history so far. Collective on comm.

        Parameters
        ----------
        error : why the history cannot go on, "" where it can.
        """
        assert self._last is not None
        return self._result(0, _Ends.of(self._last, np.zeros(1, int)), 0, self.columns(), error)

    def results(self, failures: Mapping[int, Exception]) -> list[Result | Exception]:
        """Return the results of all histories, or why there is none."""
        failures = {**self.failures, **failures}
        if len(self._cases) == 1:
            return [failures[0] if failures else self.result()]
        columns = self.columns(failures)
        return [
            failures[number]
            if number in failures
            else self._result(number, *self._ends[number], columns)
            for number in range(len(self._cases))
        ]

    def _result(
        self, number: int, ends: _Ends, place: int, columns: HistoryColumns, error: str = ""
    ) -> Result:
        case, rows = self._cases[number], columns.rows(number)
        steps, end = columns.steps[rows], batched.take(ends, np.array([place]))
        state = end.state
        boundary = () if self._boundary is None else self._boundary.states

        def stored(name: str, values: FloatArray) -> FloatArray:
            which = rows if name in self._rows else number
            return values[_at(name, which)]

        return Result(
            case.line,
            np.arange(len(steps)) if case.output.times else steps,
            steps,
            {name: values[rows] for name, values in columns.histories.items()},
            {name: stored(name, values) for name, values in columns.profiles.items()},
            (*self._earlier, *boundary),
            attributes(
                case,
                ranks=self._comm.size,
                begun_by=self._begun_by,
                time=float(state.time[0]),
                finished=bool(end.finished[0]),
                seconds=self.seconds(),
                symmetry_defect=float(end.symmetry_defect[0]),
                doubts=self.warnings(number),
                error=error,
                balances=self.balances.history(number),
                step_error_time=float(self.balances.step_error_time[number]),
                closing_contact=bool(self.balances.closing_contact[number]),
                through=None if state.through is None else state.through[:, 0],
            ),
            take(
                state,
                end.progress,
                end.warm,
                self._remeshed[1],
                int(self._pending[number]),
                self._worst_states.history(number),
            ),
            parameters=units_of(case, self._parameters),
            derivatives={
                name: stored(name, values) for name, values in columns.derivatives.items()
            },
            layers={name: stored(name, values) for name, values in columns.layers.items()},
            stress=self.stress(number),
        )

    def kernel_evaluations(self) -> int:
        """Return how many kernels were evaluated for both bodies, updates included."""
        assert self._last is not None
        return (self._last.model.pair.cost + self._remeshed[0]).kernel_evaluations

    @property
    def _remeshed(self) -> tuple[BodyCost, int]:
        """The cost of elements that follow the wear, and how often they did."""
        assert self._last is not None
        geometry = self._last.model.geometry
        return (BodyCost(), 0) if geometry is None else (geometry.cost, geometry.updates)

    def seconds(self) -> dict[str, float]:
        """Return the wall times so far by attribute, s, those of an interrupted run included.

        Of several histories, those of one in the mean.
        """
        assert self._last is not None
        model, (cost, _) = self._last.model, self._remeshed
        if not model.pair_is_shared:  # what was assembled elsewhere took no time here
            cost = cost + model.pair.cost
        stepping = self._stepping / len(self._cases) - self.seconds_output
        stepping -= cost.seconds_assembly + cost.seconds_solution
        seconds = {
            "seconds_assembly": cost.seconds_assembly,
            "seconds_factorisation": cost.seconds_solution,
            "seconds_stepping": stepping,
            "seconds_output": self.seconds_output,
        }
        return {name: s + self._seconds.get(name, 0.0) for name, s in seconds.items()}


def _at(name: str, rows: Any) -> Any:
    """Return where some rows of a variable are, or some histories: P parameters come first."""
    return (slice(None), rows) if name.startswith("d_") else rows
