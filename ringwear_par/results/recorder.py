"""Stores the histories of a block as rows of variables, and makes their results."""

import json
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.batched import take
from ringwear_par.cases.case import SAME_TIME, Case
from ringwear_par.cases.schema import STOP_CRITERIA
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.errors import ValidityWarning, reason_of
from ringwear_par.history.checks import INFINITE_AT_INTERFACE, INFINITE_STRESS, Worst
from ringwear_par.history.elastic import boundary_recovery
from ringwear_par.history.layers import layer_left, layer_volumes
from ringwear_par.history.loop import STOP, Instant
from ringwear_par.history.state import State
from ringwear_par.history.stresses import Moment, Stresses, boundary_state, selected, stacked
from ringwear_par.results.fields import stored_states, stress_columns
from ringwear_par.results.key_numbers import laboratory_numbers
from ringwear_par.results.result import (
    BALANCE,
    Checkpoint,
    HistoryColumns,
    Result,
    case_attributes,
    times_through,
)
from ringwear_par.results.variables import (
    FIELDS,
    HISTORIES,
    POINT_SIDES,
    SLIDING,
    VARIABLES,
    layer_names,
)
from ringwear_par.results.warnings import warnings_of_histories

Value = Callable[[Instant], Any]
Arrays = dict[str, Any]

# -- what is stored of a state ---------------------------------------------------------------------


def _twist(of: Instant) -> FloatArray:
    """Return the area mean of the circumferential displacement jump, (B,) mm."""
    line, compliance = of.block.line, of.block.compliance
    per_shear = np.array([pair.twist for pair in line.pairs]) / line.area.sum()
    jumps = compliance.softness * compliance.of_pairs(per_shear, of.state.pressure)
    return of.block.friction.at(of.state.time) * jumps.sum(axis=1)


def _gap(of: Instant) -> FloatArray:
    """Return the gaps of the bodies under pressure, (B, n) mm; in contact 0 but for round-off."""
    return np.where(of.state.pressure > 0.0, 0.0, np.maximum(of.gap, 0.0))


def _pressure_velocity(of: Instant) -> FloatArray:
    """Return the mean pressure on the nominal area times speed, (B,) MPa m/s."""
    case, omega = of.block.cases.every[0], of.block.omega.at(of.state.time)
    return 1e-3 * (of.state.pressure @ of.block.line.area) / case.area * omega * case.mean_radius


def _distance(of: Instant) -> FloatArray:
    """Return the sliding distance at the mean radius, (B,) m."""
    return 1e-3 * of.block.omega.integral(of.state.time) * of.block.cases.every[0].mean_radius


def _layers(of: Instant, body: int) -> tuple[FloatArray, FloatArray]:
    """Return the ends of the layers of a body, and its wear, (layers + 1, B, n) and (B, n) mm."""
    block = of.block
    for wearing, wear in zip(block.wearing, of.state.wear, strict=True):
        if wearing.body == body:
            return wearing.ends, wear
    case = block.cases.every[0]
    ends = np.append(case.layer_ends(body), np.full((1, case.line.n), np.inf), axis=0)
    return np.repeat(ends[:, None], len(block), axis=1), np.zeros_like(block.gap)


def _of_body(body: int) -> dict[str, Value]:
    """Return the variables of one of the bodies by name."""
    name = BODIES[body]

    def wear(of: Instant) -> FloatArray:
        return of.block.both(of.state.wear)[body]

    def left(of: Instant) -> FloatArray:
        return layer_left(*_layers(of, body))

    def share_through(of: Instant) -> FloatArray:
        through, area = left(of) <= 0.0, of.block.line.area
        return through @ area / (np.ones_like(through) @ area)  # 1 at most

    return {
        f"wear_{name}": wear,
        f"worn_volume_{name}": lambda of: wear(of) @ of.block.line.area,
        f"layer_left_{name}": left,
        f"share_through_{name}": share_through,
        f"worn_volume_{name}_layers": lambda of: layer_volumes(
            of.block.line.area, *_layers(of, body)
        ),
    }


#: the variables of states by name, (B,) or (B, n); of iterations all so far
VALUES: Mapping[str, Value] = {
    "number": lambda of: of.block.number,
    "step": lambda of: of.state.steps,
    "contact_iterations": lambda of: of.state.iterations,
    "time": lambda of: of.state.time,
    "approach": lambda of: of.state.approach,
    "penetration": lambda of: of.state.approach - of.state.first_approach,
    "force": lambda of: of.state.pressure @ of.block.line.area,
    "torque": lambda of: of.block.friction.at(of.state.time) * of.block.moment(of.state.pressure),
    "twist": _twist,
    "dissipated_energy": lambda of: of.state.energy,
    "normal_work": lambda of: of.state.normal_work,
    "pressure": lambda of: of.state.pressure,
    "gap": _gap,
    "sliding_distance": _distance,
    "pressure_velocity": _pressure_velocity,
    **_of_body(0),
    **_of_body(1),
}


def _moment(instant: Instant, place: int) -> Moment:
    """Return one of the states of an instant."""
    block, state = instant.block, instant.state
    return Moment(
        float(state.time[place]), int(state.steps[place]), bool(instant.ended[place]),
        state.pressure[place], float(state.approach[place]), block.both(state.wear)[:, place],
        None if state.meshed is None else block.both(state.meshed)[:, place],
    )  # fmt: skip


def _points(stresses: Sequence[Mapping[str, Any]], count: int) -> dict[str, FloatArray]:
    """Return where points of stress are in each of B histories, (B, points)."""
    where = next((arrays for arrays in stresses if "point_r" in arrays), None)
    if where is None:
        return {}
    sides = np.array([*map(POINT_SIDES.index, where["point_side"])], float)
    points = {"point_r": where["point_r"], "point_z": where["point_z"], "point_side": sides}
    return {name: np.tile(values, (count, 1)) for name, values in points.items()}


# -- histories -------------------------------------------------------------------------------------


class Recorder:
    """Stores the states of histories that their cases ask for, their balances and warnings.

    Calls are collective on comm, the same on all ranks.

    Parameters
    ----------
    cases : of one ``block_key``.
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
        case, count = cases[0], len(cases)
        self._cases, self._comm, self._pair_is_shared = cases, comm, pair_is_shared
        self._worst = Worst(count)
        self._stresses = Stresses(cases, comm)
        #: of a case that wants fields on boundaries: their recovery, and those of each state so far
        self._recovery = None if case.output.boundary == "none" else boundary_recovery(case, comm)
        self._boundaries: list[dict[str, Any]] = []
        #: the rows so far by variable, as they came; the last values of what has no rows, (B, ...)
        self._rows: dict[str, list[Any]] = {"number": [np.empty(0, np.int64)]}
        self._last: dict[str, FloatArray] = {}
        layers = len(case.lower.layers), len(case.upper.layers)
        sizes = {"element": case.line.n, "layer": 1 + layers[0], "layer_upper": 1 + layers[1]}
        at_end = set() if results else set(SLIDING)
        at_end |= set(FIELDS) if case.output.profiles == "last" else set()
        of_layers = layer_names((layers[0] > 0, layers[1] > 0))
        for name in ("step", *HISTORIES, *of_layers, *SLIDING, *case.output.fields):
            shape = [sizes[axis] for axis in VARIABLES[name].dimensions[1:]]
            if name in at_end:
                self._last[name] = np.full((count, *shape), np.nan)
            else:
                self._rows[name] = [np.empty((0, *shape), VARIABLES[name].dtype)]
        #: (B,) s, time of the last stored state; negative: there is none
        self._last_time = np.full(count, -1.0)
        #: the last states that histories went on from; None before the first
        self.last: Instant | None = None
        #: of histories that have ended: their last instant, and their place in it
        self._ended: dict[int, tuple[Instant, int]] = {}
        self._started, self._stepping = time.perf_counter(), 0.0
        #: s, spent by others on output, which is no time of stepping
        self.seconds_output = 0.0
        #: attributes of the interrupted history
        self._before: Mapping[str, Any] = {}
        if before is not None:
            self._restore(before)

    def _restore(self, before: Result) -> None:
        """Take over the rows of an interrupted history that its case stores, and its worst states.

        The last row of a history that was stopped, or ends later now, may not be among them.
        """
        self._before = before.attributes
        self._worst.measures |= {n: v[:, None].copy() for n, v in before.checkpoint.worst.items()}
        case, times = self._cases[0], before.data["time"]
        if case.output.times:
            near = np.abs(times[:, None] - case.output.times) <= SAME_TIME * times[:, None]
            rows = (times == 0.0) | near.any(axis=1)
        else:
            rows = before.step % case.output.every == 0
        iterations = np.cumsum(before.data["contact_iterations"])
        of = {**before.data, "number": np.zeros_like(before.step), "contact_iterations": iterations}
        for name, parts in self._rows.items():
            parts.append(of[name][rows])
        for name, last in self._last.items() if rows[-1] else ():
            last[0] = of[name]
        self._last_time[0] = times[rows][-1]
        if case.output.boundary != "last":
            self._boundaries = stored_states(before.data, "boundary_step", times[rows])
        if case.stress is not None and case.stress.times != "last":
            self._stresses.states[0] = stored_states(before.data, "stress_step", times[rows])
        if not self._stresses.states[0]:
            for name in (INFINITE_STRESS, INFINITE_AT_INTERFACE):
                self._worst.measures.pop(name, None)

    def __call__(self, instant: Instant) -> bool:
        """Take new states; store those that cases ask for. Collective."""
        self.last, numbers = instant, instant.block.number
        if instant.stored.all():  # a single history also has instants that its case does not store
            self._store(instant)
        for place in np.flatnonzero(instant.ended).tolist():
            self._ended[int(numbers[place])] = instant, place
        self._stepping = time.perf_counter() - self._started
        return False

    def _store(self, instant: Instant) -> None:
        """Store new states, with the stresses and boundary fields that cases ask for."""
        self._worst(instant)
        case, number = self._cases[0], instant.block.number
        if case.stress is not None or case.output.boundary != "none":
            for place, history in enumerate(number.tolist()):
                state, before = _moment(instant, place), float(self._last_time[history])
                if self._recovery is not None and selected(case.output.boundary, state, before):
                    self._boundaries.append(boundary_state(self._recovery, case, state))
                for name, entries in self._stresses(history, state, before).items():
                    self._worst.take(name, np.array([history]), *np.array([entries]).T)
        for name, rows in self._rows.items():
            rows.append(VALUES[name](instant))
        for name, last in self._last.items():
            last[number] = VALUES[name](instant)
        self._last_time[number] = instant.state.time

    # -- what there is -----------------------------------------------------------------------------

    def _columns(self, unstored: Instant | None = None) -> tuple[IntArray, Arrays, Arrays]:
        """Return offsets and rows by history, see ``HistoryColumns``, and last values alone.

        A state that a single history has come to, but that is not stored, is a row, too.
        """
        rows, last = self._rows, self._last
        if unstored is not None:
            rows = {name: [*parts, VALUES[name](unstored)] for name, parts in rows.items()}
            last = {name: VALUES[name](unstored) for name in last}
        order = np.argsort(np.concatenate(rows["number"]), kind="stable")
        data = {name: np.concatenate(parts).take(order, axis=0) for name, parts in rows.items()}
        offsets = np.searchsorted(data["number"], np.arange(len(self._cases) + 1))
        # of iterations those since the row before
        made, firsts = data["contact_iterations"], offsets[:-1][np.diff(offsets) > 0]
        data["contact_iterations"] = np.diff(made, prepend=0)
        data["contact_iterations"][firsts] = made[firsts]
        return offsets, data, last

    def columns(self, failures: Mapping[int, Exception]) -> HistoryColumns:
        """Return all histories as they are stored; those that failed have the rows before."""
        count = len(self._cases)
        offsets, data, last = self._columns()
        stresses = [self._stresses.arrays(number) for number in range(count)]
        whole = last | self._of_ends(offsets, data) | _points(stresses, count)
        data |= stress_columns(stresses, data["time"], offsets)
        every = warnings_of_histories(self._cases, self._worst.measures)
        return HistoryColumns(
            offsets,
            {name: values for name, values in data.items() if name not in ("number", "step")},
            whole,
            imbalance=np.where([i in failures for i in range(count)], 0.0, self._worst.imbalance),
            flags=tuple(
                () if i in failures
                else (*(w.code for w in warnings), *(f"stopped_by_{n}" for n in self._limits(i)))
                for i, warnings in enumerate(every)
            ),
            seconds=np.full(count, self._stepping / count),
            status=tuple("failed" if i in failures else "done" for i in range(count)),
            reason=tuple(reason_of(failures[i]) if i in failures else "" for i in range(count)),
        )  # fmt: skip

    def _of_ends(self, offsets: IntArray, data: Mapping[str, Any]) -> dict[str, FloatArray]:
        """Return when layers were worn through, and numbers of laboratories at the ends, (B,)."""
        through = np.full((2, len(self._cases)), np.inf)
        for number, (instant, place) in self._ended.items():
            through[:, number] = instant.state.through[place]
        numbers, stored = times_through(self._cases[0], through), np.diff(offsets) > 0
        if stored.any():
            ends = {name: values[offsets[1:] - 1] for name, values in data.items()}
            of_ends = laboratory_numbers(self._cases, np.arange(len(self._cases)), ends)
            numbers |= {name: np.where(stored, of, np.nan) for name, of in of_ends.items()}
        return numbers

    def _limits(self, number: int) -> dict[str, str]:
        """Return the limits that ended a history before its time, in words by criterion."""
        if number not in self._ended or not self._ended[number][0].block.stop:
            return {}
        instant, place = self._ended[number]
        block, state = take((instant.block, instant.state), np.array([place]))
        return {
            name: f"stop.{name} = {most[0]:g} {STOP_CRITERIA[name].unit}"
            for name, most in block.stop.items()
            if state.time[0] < block.limits[0, -1] and STOP[name](block, state)[0] >= most[0]
        }

    # -- results -----------------------------------------------------------------------------------

    def result(self, error: str = "") -> Result:
        """Return the result of a single history so far, or up to an error. Collective on comm.

        The state that it has come to is its last row, also where its case does not store it.
        """
        assert self.last is not None
        is_stored = self.last.state.time[0] <= self._last_time[0]
        (result,) = self.results({}, None if is_stored else self.last, error)
        assert isinstance(result, Result)
        return result

    def results(
        self, failures: Mapping[int, Exception], unstored: Instant | None = None, error: str = ""
    ) -> list[Result | Exception]:
        """Return the results of all histories, or why there is none, see ``result``."""
        offsets, data, last = self._columns(unstored)
        data |= laboratory_numbers(self._cases, data.pop("number"), data)
        results: list[Result | Exception] = []
        for i, warnings in enumerate(warnings_of_histories(self._cases, self._worst.measures)):
            if i in failures:
                results.append(failures[i])
                continue
            of = {name: values[offsets[i] : offsets[i + 1]] for name, values in data.items()}
            of |= {name: values[i] for name, values in last.items()}
            of["line/edges"] = self._cases[i].line.edges
            for body, ring in enumerate(self._cases[i].rings):
                if ring.layers:
                    of[f"layer_end_{BODIES[body]}"] = self._cases[i].layer_ends(body)
                if not any(ring.densities):  # those of other cases may be known
                    of.pop(f"mass_lost_{BODIES[body]}", None)
            of |= {**self._stresses.arrays(i), **stacked(self._boundaries)}
            worst = {name: values[:, i] for name, values in self._worst.measures.items()}
            assert self.last is not None
            instant, place = self._ended.get(i, (self.last, 0))
            state = take(instant.state, np.array([place]))
            about = self._attributes(i, state, warnings) | {"error": error}
            results.append(Result(of, about, Checkpoint(state, worst)))
        return results

    def _attributes(
        self, number: int, state: State, warnings: Sequence[ValidityWarning]
    ) -> dict[str, Any]:
        """Return the attributes of a history and its last state."""
        case, balances = self._cases[number], self._worst.balances(number)
        if not case.time.adaptive:  # nothing is known of the errors of fixed steps
            del balances["step_error"]
        limits, through = self._limits(number), times_through(case, state.through[0])
        return {
            **case_attributes(case, float(state.time[0])),
            **({"stopped_by": " and ".join(limits.values())} if limits else {}),
            **{name: float(time) for name, time in through.items()},
            "status": "complete" if number in self._ended else "incomplete",
            "ranks": self._comm.size,
            **self._seconds(),
            **{f"{BALANCE}{name}": value for name, value in balances.items()},
            "symmetry_defect": float(self._worst.measures["asymmetry"][0, number]),
            "doubts": json.dumps([warning.to_dict() for warning in warnings]),
        }

    def _seconds(self) -> dict[str, float]:
        """Return the wall times so far by attribute, s: of several histories, those of one."""
        assert self.last is not None
        pair, following = self.last.block.line.pairs[0], self.last.following
        elastic = np.zeros(2) if self._pair_is_shared else pair.seconds
        elastic = elastic if following is None else elastic + following.seconds
        stepping = self._stepping / len(self._cases) - self.seconds_output - elastic.sum()
        seconds = {
            "seconds_assembly": elastic[0],
            "seconds_factorisation": elastic[1],
            "seconds_stepping": max(stepping, 0.0),
            "seconds_output": self.seconds_output,
        }
        return {name: float(s + self._before.get(name, 0.0)) for name, s in seconds.items()}
