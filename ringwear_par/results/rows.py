"""Observers of stored states: rows of variables, and last states, from which histories go on."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ringwear_par import batched
from ringwear_par.arrays import BoolArray, IntArray, share
from ringwear_par.cases.case import Case
from ringwear_par.history.inputs import StoredStates
from ringwear_par.history.physics import Physics
from ringwear_par.history.snapshots import Snapshot
from ringwear_par.history.state import Start, State
from ringwear_par.history.stop_criteria import limit_words, limits_reached
from ringwear_par.results.result import Result
from ringwear_par.results.variables import HISTORIES, VARIABLES, layer_names

#: what is noted of each row beside its variables: the number of its history, steps made, and the
#: iterations of the contact solver in these
_NOTED = ("number", "steps", "iterations")


def row(physics: Physics, state: State) -> dict[str, Any]:
    """Return the result's variables of B states by name, (B,) or (B, n). Not collective.

    All but ``penetration`` and ``contact_iterations``, which other states have a part in.
    """
    contact, volumes = state.contact, physics.integrals(state.wear)
    lower, upper = state.wear
    sliding = physics.sliding(state.time)
    values = {
        "time": state.time,
        "approach": contact.approach,
        "force": contact.force,
        "torque": physics.torque(contact.pressure, sliding),
        "twist": physics.twist(contact.pressure, sliding),
        "worn_volume_lower": volumes[0],
        "worn_volume_upper": volumes[1],
        "dissipated_energy": state.energy,
        "normal_work": state.normal_work,
        "pressure": contact.pressure,
        # in contact it is 0 all but round-off
        "gap": np.where(contact.pressure > 0.0, 0.0, contact.gap),
        "wear_lower": lower,
        "wear_upper": upper,
    }
    for i, body in enumerate(("lower", "upper")):
        if physics.layer_ends[i] is not None:
            left = physics.layer_left(i, state.wear[i])
            values[f"share_through_{body}"] = share(physics.area, left <= 0.0)
            values[f"layer_left_{body}"] = left
            values[f"worn_volume_{body}_layers"] = physics.layer_volumes(i, state.wear[i])
    return values


class StoredRows:
    """Rows of the variables that the cases of some histories store: an observer. Not collective.

    Parameters
    ----------
    cases : of one ``lockstep.batch_key``.
    """

    def __init__(self, cases: Sequence[Case]) -> None:
        case, count = cases[0], len(cases)
        self._case, self._count = case, count
        layers = len(case.lower.layers), len(case.upper.layers)
        #: names of what is stored, by field of ``HistoryColumns``
        self._groups = {
            "histories": tuple(HISTORIES),
            "profiles": case.output.fields,
            "layers": layer_names((layers[0] > 0, layers[1] > 0)),
        }
        sizes = {"element": case.line.n, "layer": 1 + layers[0], "layer_upper": 1 + layers[1]}
        #: rows as they come, and of each history the last profiles where these alone are stored
        self._rows: dict[str, list[Any]] = {name: [np.empty(0, np.int64)] for name in _NOTED}
        self._last_profiles: dict[str, Any] = {}
        for name in (name for names in self._groups.values() for name in names):
            variable = VARIABLES[name]
            shape = [sizes[axis] for axis in variable.dimensions[1:]]
            if case.output.profiles == "last" and "element" in variable.dimensions:
                self._last_profiles[name] = np.full((count, *shape), np.nan)
            elif name != "penetration":  # follows from the approach
                self._rows[name] = [np.empty((0, *shape), variable.dtype)]
        # (B,) iterations of the contact solver in all steps so far, in those before the last stored
        # state, and in those before the first one here
        self._iterations, self._until_last, self._until_first = np.zeros((3, count), np.int64)

    @property
    def pending(self) -> IntArray:
        """(B,) iterations of the contact solver since the last stored state."""
        return self._iterations - self._until_last

    def restore(self, before: Result, reached: float) -> BoolArray:
        """Take the stored rows of an interrupted single history that its case still stores.

        Return which they are, (s,). The last row of a shorter run may not be among them.

        Parameters
        ----------
        reached : s, time from which the history continues.
        """
        assert before.checkpoint is not None
        steps, times = before.steps_made, np.asarray(before.data["time"])
        ended = [self._case.time.finished(*state) for state in zip(steps, times, strict=True)]
        rows = (times <= reached) & (ended | StoredStates.of([self._case]).at(steps, times))
        self._iterations[:] = before.checkpoint.start.progress.iterations
        forgotten = before.data["contact_iterations"][~rows].sum()
        self._until_last -= forgotten + before.checkpoint.pending_iterations - self._iterations
        self._until_first[:] = self._until_last
        noted = {
            "number": np.zeros(len(rows), np.int64),
            "steps": steps,
            "iterations": np.repeat(self._until_last, len(rows)),
        }
        for name, parts in self._rows.items():
            parts.append({**before.data, **noted}[name][rows])
        for name, last in self._last_profiles.items():
            if rows[-1]:
                last[0] = before.data[name]
        return rows

    def __call__(self, snapshot: Snapshot) -> bool:
        """Take new states that are to be stored."""
        iterations = snapshot.progress.iterations
        if not snapshot.passing:
            self._iterations[snapshot.numbers] = iterations
        stored = np.flatnonzero(snapshot.stored)
        if not len(stored):
            return False
        # of a state from which its history does not go on from another; steps have theirs by now
        apart = snapshot.passing or snapshot.step is None
        values = row(snapshot.physics, snapshot.state) | {
            "contact_iterations": snapshot.iterations * apart,
            "number": snapshot.numbers.copy(),
            "steps": snapshot.progress.steps.copy(),
            "iterations": iterations.copy(),
        }
        # states do not change: those of all histories are stored without a copy
        part = slice(None) if len(stored) == len(snapshot.numbers) else stored
        for name, rows in self._rows.items():
            rows.append(values[name][part])
        # a single history may be stored before its end
        last = np.flatnonzero(snapshot.finished) if self._count > 1 else stored
        for name, profiles in self._last_profiles.items() if len(last) else ():
            profiles[snapshot.numbers[last]] = values[name][last]
        np.maximum.at(self._until_last, snapshot.numbers[stored], iterations[stored])
        return False

    def columns(self) -> dict[str, Any]:
        """Return all rows, by history: the fields of ``HistoryColumns`` that these are."""
        times, numbers = (np.concatenate(self._rows[name]) for name in ("time", "number"))
        order = np.lexsort((times, numbers))  # states within steps may come late
        for parts in self._rows.values():
            parts[:] = [np.concatenate(parts)[order]]  # from now on in order, and once in memory
        values = {name: rows for name, (rows,) in self._rows.items()}
        numbers, steps, until = (values.pop(name) for name in _NOTED)
        first = np.searchsorted(numbers, numbers)
        at_first = np.arange(len(numbers)) == first
        since = until - np.where(at_first, self._until_first[numbers], np.roll(until, 1))
        values["contact_iterations"] = values["contact_iterations"] + since
        values["penetration"] = values["approach"] - values["approach"][first]
        offsets = np.searchsorted(numbers, np.arange(self._count + 1))
        values |= self._last_profiles
        groups = {g: {name: values[name] for name in names} for g, names in self._groups.items()}
        return {"offsets": offsets, "steps": steps, **groups}

    def part(self, name: str, values: Any, rows: slice, number: int) -> Any:
        """Return the values of a variable in some rows of a history, or its last profile."""
        return values[number if name in self._last_profiles else rows]


class LastStates:
    """The state from which each of B histories can go on: an observer. Not collective.

    Parameters
    ----------
    count : B.
    results : whether the states at the ends of the histories are wanted.
    """

    def __init__(self, count: int, results: bool = True) -> None:
        self._results = results
        #: the last snapshot that histories went on from; None before the first, or if not wanted
        self.snapshot: Snapshot | None = None
        #: (2, B) s, when wear got through all layers of lower and upper, by the end of a history
        self.through = np.full((2, count), np.inf)
        #: limits that ended histories before their times, in words by criterion, by number
        self.stops: dict[int, dict[str, str]] = {}
        #: starts of histories that ended together, the place of each, and its symmetry defect
        self._ended: dict[int, tuple[Start, int, float]] = {}

    def __call__(self, snapshot: Snapshot) -> bool:
        """Take new states."""
        if snapshot.passing:
            return False
        if self._results:
            self.snapshot = snapshot
        places = np.flatnonzero(snapshot.finished)
        if not len(places):
            return False
        numbers = snapshot.numbers[places]
        self._note_stops(snapshot, places)
        if snapshot.state.through is not None:
            self.through[:, numbers] = snapshot.state.through[:, places]
        if self._results:
            start, defects = _starts(snapshot, places)
            self._ended |= {n: (start, i, defects[i]) for i, n in enumerate(numbers.tolist())}
        return False

    def _note_stops(self, snapshot: Snapshot, places: IntArray) -> None:
        """Note which limits have ended those histories that are not at the ends of their times."""
        inputs, state, steps = snapshot.physics.inputs, snapshot.state, snapshot.progress.steps
        if not inputs.stop_limits:
            return
        reached = limits_reached(inputs.stop_limits, state)
        for i in places.tolist():
            case = inputs.cases[i]
            if not case.time.finished(int(steps[i]), float(state.time[i])):
                limits = {n: limit_words(case, n) for n, which in reached.items() if which[i]}
                self.stops[int(snapshot.numbers[i])] = limits

    def state(self, number: int) -> tuple[Start, int, float]:
        """Return the end or present of a history: of some starts one, and its symmetry defect."""
        if number in self._ended:
            return self._ended[number]
        assert self.snapshot is not None
        start, defects = _starts(self.snapshot, np.flatnonzero(self.snapshot.numbers == number))
        return start, 0, defects[0]

    def has_ended(self, number: int) -> bool:
        """Tell whether a history has come to its end."""
        return number in self._ended

    @property
    def physics(self) -> Physics:
        """The physics of the last snapshot."""
        assert self.snapshot is not None
        return self.snapshot.physics

    @property
    def finished(self) -> bool:
        """Whether a single history has come to its end."""
        return self.snapshot is not None and bool(self.snapshot.finished.all())


def _starts(snapshot: Snapshot, places: IntArray) -> tuple[Start, list[float]]:
    """Return where histories of a snapshot continue, and symmetry defects."""
    physics, state = snapshot.physics, snapshot.state
    start = Start(state, snapshot.progress, snapshot.contacts.warm, physics.updates)
    defects = physics.compliances.symmetry_defect[places].tolist()
    return batched.take(start, places), defects
