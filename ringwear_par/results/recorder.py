"""Observer that stores what a case asks for, and makes the result of its history."""

import json
import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from mpi4py import MPI

from ringwear_par import __version__
from ringwear_par.arrays import FloatArray, IntArray, share
from ringwear_par.cases.case import Case
from ringwear_par.cases.law_trials import law_sources
from ringwear_par.elasticity.boundary_fields import BODIES, BoundaryState
from ringwear_par.elasticity.pair import BodyCost
from ringwear_par.elasticity.stress_fields import StressHistory, StressState
from ringwear_par.history.balances import Balances, WorstBalances
from ringwear_par.history.boundaries import BoundaryObserver
from ringwear_par.history.layers import layer_left, layer_volumes
from ringwear_par.history.model import WearModel
from ringwear_par.history.saving import stores
from ringwear_par.history.sensitivity import units_of
from ringwear_par.history.snapshots import Snapshot
from ringwear_par.history.state import Start, State
from ringwear_par.history.stresses import CaseStresses, StressObserver
from ringwear_par.history.tangent import variables as derivatives_of
from ringwear_par.history.validity import WorstStates
from ringwear_par.info import versions
from ringwear_par.results.checkpoints import restored, take
from ringwear_par.results.result import Result, balance_attributes
from ringwear_par.results.stress_variables import point_columns, stress_rows
from ringwear_par.results.unit_suspicions import ValidityWarning
from ringwear_par.results.variables import (
    D_HISTORIES,
    D_PROFILES,
    HISTORIES,
    LAYER_PROFILES,
    TIMES_THROUGH,
    layer_names,
)
from ringwear_par.results.warnings import (
    infinite_at_interfaces,
    infinite_edge,
    infinite_stress,
    instability,
    validity_warnings,
    worn_points,
)
from ringwear_par.schedules import in_time, integral
from ringwear_par.wear.layered import LayeredLaw

#: the number of a single history among its kind
_ALONE = np.zeros(1, dtype=np.int64)


def row(model: WearModel, state: State) -> dict[str, Any]:
    """Return what a state says of the result's variables, by name. Not collective.

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
        "case": case.told,
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
    """Stores the states of a history that its case asks for, its balances and its doubts.

    An observer; calls are collective on comm, the same on all ranks.

    Parameters
    ----------
    case : the case.
    comm : communicator of its history.
    before : result of the interrupted history that goes on; None: it starts.
    derivatives : keys that the history has derivatives with respect to.
    stresses : of cases that the history shares them with; None: its own.
    """

    def __init__(
        self,
        case: Case,
        comm: MPI.Comm,
        before: Result | None = None,
        derivatives: Sequence[str] = (),
        stresses: CaseStresses | None = None,
    ) -> None:
        self._case, self._comm = case, comm
        #: where the history goes on, None where it starts
        self.start: Start | None = None
        #: whether the profiles are stored as often as the histories, or at the last state only
        self._deep = case.output.profiles == "all"
        self._steps: list[int] = []
        self._histories: dict[str, list[float]] = {name: [] for name in HISTORIES}
        self._profiles: dict[str, list[FloatArray]] = {name: [] for name in case.output.fields}
        self._parameters = tuple(derivatives)
        self._derivatives: dict[str, list[FloatArray]] = {
            name: [] for name in derivative_names(case, derivatives)
        }
        self._layers: dict[str, list[Any]] = {name: [] for name in layer_names_of(case)}
        self._earlier: list[BoundaryState] = []
        self._earlier_stress: list[StressState] = []
        #: iterations of the contact solver since the last stored state
        self._pending_iterations = 0
        self._last: Snapshot | None = None
        self._seconds: dict[str, float] = {}
        self._instability: tuple[ValidityWarning, ...] = ()
        self._begun = time.perf_counter()
        #: s, spent by others on output, which is no time of stepping
        self.seconds_output = 0.0
        self._balances, self._worst = WorstBalances(), WorstStates(case)
        #: version that began the history
        self._begun_by = __version__
        if before is not None:
            self._restore(before)
        self._boundary: BoundaryObserver | None = None
        self._stress: StressObserver | None = None
        stored_until = (-1.0, *self._histories["time"])[-1]
        if case.output.boundary != "none":
            self._boundary = BoundaryObserver(case, comm, stored_until)
        if case.stress is not None:
            own = stresses or CaseStresses(case, comm)
            self._stress = StressObserver(case, own, stored_until)
            self._stress.wear = self._wear_under_stress()

    def _wear_under_stress(self) -> FloatArray | None:
        """Return the wear, (2, n) mm, at the last stresses of an interrupted history, if stored."""
        names = [f"wear_{body}" for body in BODIES]
        if not (self._earlier_stress and self._deep and set(names) <= self._profiles.keys()):
            return None
        row = self._histories["time"].index(self._earlier_stress[-1].time)
        return np.array([self._profiles[name][row] for name in names])

    def _restore(self, before: Result) -> None:
        """Put the stored rows of an interrupted run back, as far as the case still stores them."""
        case = self._case
        self.start = start = restored(before)
        assert before.checkpoint is not None
        steps = [int(step) for step in before.steps_made]
        times = [float(time) for time in before.histories["time"]]
        # the last one of a shorter run may not belong here
        rows, last = zip(steps, times, strict=True), start.state.time
        keep = np.array([t <= last and stores(case, n, t) for n, t in rows])
        self._steps = before.steps_made[keep].tolist()
        self._histories = {name: before.histories[name][keep].tolist() for name in HISTORIES}
        for name in self._profiles:
            stored = before.profiles[name]
            self._profiles[name] = list(stored[keep] if self._deep else stored[None][keep[-1:]])
        for name in self._layers:
            stored, last_only = before.layers[name], name in LAYER_PROFILES and not self._deep
            self._layers[name] = list(stored[None][keep[-1:]] if last_only else stored[keep])
        # the last state of a shorter run is not the last one of this run
        left = set(before.histories["time"][keep].tolist())
        finished = case.time.finished(start.progress.steps, start.state.time)
        if case.output.boundary != "last" or finished:
            self._earlier = [b for b in before.boundary if b.time in left]
        asked = "none" if case.stress is None else case.stress.times
        if before.stress is not None and (asked != "last" or finished):
            self._earlier_stress = [s for s in before.stress.states if s.time in left]
        self._pending_iterations = int(before.checkpoint.numbers["pending_iterations"]) + int(
            before.histories["contact_iterations"][~keep].sum()
        )
        self._balances = WorstBalances(
            Balances(**before.balances),
            float(before.attributes.get("step_error_time", 0.0)),
            bool(before.attributes.get("closing_contact", False)),
        )
        self._worst.restore(before.checkpoint.worst)
        self._begun_by = str(before.attributes.get("begun_by", before.attributes["version"]))
        self._seconds = {
            name: float(value)
            for name, value in before.attributes.items()
            if name.startswith("seconds_")
        }

    def __call__(self, snapshot: Snapshot) -> bool:
        """Take a new state; store it if it is one of those asked for. Collective."""
        if self._last is None:
            self._instability = instability(snapshot.model)
        if not snapshot.passing:
            self._last = snapshot
            self._worst(snapshot.model, snapshot.state, _ALONE, _ALONE)
        self._balances(snapshot)
        if self._boundary is not None:
            self._boundary(snapshot)
        if self._stress is not None:
            count = len(self._stress.states)
            self._stress(snapshot)
            if len(self._stress.states) > count:
                line, history = snapshot.model.line, self._stress.history()
                infinite = infinite_edge(self._case, history, line, snapshot.state)
                if infinite is not None:
                    self._worst.take_infinite_stress(0, *infinite)
        self._pending_iterations += snapshot.iterations
        if snapshot.stored:
            self._store(snapshot)
        return False

    def _store(self, snapshot: Snapshot) -> None:
        values = row(snapshot.model, snapshot.state)
        approach = self._histories["approach"] or [values["approach"]]
        values["penetration"] = values["approach"] - approach[0]
        values["contact_iterations"] = self._pending_iterations
        self._steps.append(snapshot.progress.steps)
        for name, column in self._histories.items():
            column.append(values[name])
        for name, rows in self._profiles.items():
            if not self._deep:
                rows.clear()
            rows.append(values[name])
        for name, rows in self._layers.items():
            if not self._deep and name in LAYER_PROFILES:
                rows.clear()
            rows.append(values[name])
        slopes = derivatives_of(snapshot.model, snapshot.state)
        for name, rows in self._derivatives.items():
            if name == "d_penetration":
                first = self._derivatives["d_approach"][0]
                slopes[name] = slopes["d_approach"] - first
            if not self._deep and name in D_PROFILES:
                rows.clear()
            rows.append(slopes[name])
        self._pending_iterations = 0

    @property
    def last(self) -> Snapshot | None:
        """The last state, stored or not; None before the first."""
        return self._last

    @property
    def balances(self) -> Balances:
        """The worst of all balances so far."""
        return self._balances.worst

    @property
    def doubts(self) -> tuple[ValidityWarning, ...]:
        """What makes the answer doubtful, if anything."""
        if self._last is None:
            return ()
        worst = self._worst.history()
        return (
            *self._instability,
            *validity_warnings(self._case, worst, self.balances),
            *infinite_stress(self.stress, worst),
            *infinite_at_interfaces(self._case, self.stress),
            *worn_points(self._case, self.stress, self._stress),
        )

    @property
    def stress(self) -> StressHistory | None:
        """The stresses so far, None where the case asks for none."""
        if self._stress is None:
            return None
        return self._stress.history(tuple(self._earlier_stress))

    @property
    def steps(self) -> IntArray:
        """Steps made at each stored state."""
        return np.array(self._steps, dtype=np.int64)

    def arrays(self) -> dict[str, Any]:
        """Return what is stored so far by variable, ``step`` (what rows are called) included."""
        line = self._case.line if self._last is None else self._last.model.line
        steps = np.array(self._steps, dtype=np.int64)
        return {
            "step": np.arange(len(steps)) if self._case.output.times else steps,
            **{
                name: np.array(column, dtype=HISTORIES[name].dtype)
                for name, column in self._histories.items()
            },
            "r": line.r,
            "width": line.width,
            **{
                name: np.array(rows if self._deep else rows[-1])
                for name, rows in self._profiles.items()
                if rows
            },
            **{
                name: np.array(rows if self._deep or name not in LAYER_PROFILES else rows[-1])
                for name, rows in self._layers.items()
                if rows
            },
            **{
                name: np.stack(rows, axis=1) if self._deep or name not in D_PROFILES else rows[-1]
                for name, rows in self._derivatives.items()
                if rows
            },
            **self._of_sweeps(),
        }

    def _of_sweeps(self) -> dict[str, Any]:
        """Return what sweeps alone store as arrays."""
        found: dict[str, Any] = {}
        if self._last is not None:
            found |= times_through(self._case, self._last.state.through)
        if (stress := self.stress) is not None:
            found |= stress_rows(stress, np.array(self._histories["time"]))
            found |= point_columns(stress)
        return found

    def result(self, error: str = "") -> Result:
        """Return what is stored so far, and what it takes to go on. Collective on comm.

        Parameters
        ----------
        error : why the history cannot go on, "" where it can.
        """
        assert self._last is not None
        model, state, progress = self._last.model, self._last.state, self._last.progress
        arrays, case = self.arrays(), self._case
        boundary = self._earlier + ([] if self._boundary is None else self._boundary.states)
        return Result(
            case.line,
            arrays["step"],
            np.array(self._steps, dtype=np.int64),
            {name: arrays[name] for name in HISTORIES},
            {name: arrays[name] for name in self._profiles if name in arrays},
            tuple(boundary),
            attributes(
                case,
                ranks=self._comm.size,
                begun_by=self._begun_by,
                time=float(state.time),
                finished=self._last.finished,
                seconds=self.seconds(),
                symmetry_defect=model.compliance.symmetry_defect,
                doubts=self.doubts,
                error=error,
                balances=self.balances,
                step_error_time=self._balances.step_error_time,
                closing_contact=self._balances.closing_contact,
                through=state.through,
            ),
            take(
                state,
                progress,
                model.warm(),
                self._followed[1],
                self._pending_iterations,
                self._worst.history(),
            ),
            parameters=units_of(case, self._parameters),
            derivatives={name: arrays[name] for name in self._derivatives},
            layers={name: arrays[name] for name in self._layers},
            stress=self.stress,
        )

    def kernel_evaluations(self) -> int:
        """Return how many kernels were evaluated for both bodies, updates included."""
        assert self._last is not None
        return (self._last.model.pair.cost + self._followed[0]).kernel_evaluations

    @property
    def _followed(self) -> tuple[BodyCost, int]:
        """What it took to let elements follow the wear, and how often they did."""
        assert self._last is not None
        following = self._last.model.following
        return (BodyCost(), 0) if following is None else (following.cost, following.updates)

    def seconds(self) -> dict[str, float]:
        """Return the wall times so far by attribute, s, those of an interrupted run included."""
        assert self._last is not None
        model, (cost, _) = self._last.model, self._followed
        if not model.lent_pair:  # what was assembled elsewhere took no time here
            cost = cost + model.pair.cost
        stepping = time.perf_counter() - self._begun - self.seconds_output
        stepping -= cost.seconds_assembly + cost.seconds_solution
        seconds = {
            "seconds_assembly": cost.seconds_assembly,
            "seconds_factorisation": cost.seconds_solution,
            "seconds_stepping": stepping,
            "seconds_output": self.seconds_output,
        }
        return {name: s + self._seconds.get(name, 0.0) for name, s in seconds.items()}
