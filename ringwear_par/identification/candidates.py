"""Tests that could be made, by ``[design]``: experiments that are measured like a given one."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, get_args

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import Case
from ringwear_par.cases.values import is_number
from ringwear_par.identification.problem import Criterion, Experiment, Series, Space
from ringwear_par.identification.tables import TableReader

CRITERIA = get_args(Criterion)
#: keys of the load, of which one may vary, and of all that may
LOADS = ("load.pressure", "load.force")
_STEPS, _PROFILES = "load.steps", "profiles"
_VARY = (*LOADS, "load.omega", "time.end", _STEPS, _PROFILES)
_COUNTS = {_STEPS: 4, _PROFILES: 4}
MOST_EXPERIMENTS, MOST_CANDIDATES = 6, 2000

#: values of a range that are tried; of loads where a test has several; of durations
_LEVELS, _STEP_LEVELS, _DURATIONS, _SPEEDS = 15, 6, 10, 3
#: how long a load takes to change, of the test
_RAMP = 1e-3
#: readings over time that are a record, which goes on at its rate in a longer test
_RECORD = 10


@dataclass(frozen=True, eq=False)
class Candidate:
    """One test that could be made.

    Parameters
    ----------
    keys : of the case, with plain numbers; of several loads one after another a tuple.
    profiles : how many times profiles are measured, at equal intervals, the last one at the end.
    experiment : its case, and readings without data.
    """

    keys: Mapping[str, float | tuple[float, ...]]
    profiles: int
    experiment: Experiment

    @property
    def seconds(self) -> float:
        """How long it takes."""
        return self.experiment.case.time.end

    @property
    def loads(self) -> tuple[float, ...]:
        """Loads one after another, where they vary."""
        for key in LOADS:
            if key in self.keys:
                value = self.keys[key]
                return value if isinstance(value, tuple) else (value,)
        return ()

    def told(self) -> dict[str, Any]:
        """Return what design.json says of it."""
        entry: dict[str, Any] = {
            key: list(value) if isinstance(value, tuple) else value
            for key, value in self.keys.items()
        }
        return entry | ({_PROFILES: self.profiles} if self.profiles else {})

    def changes(self) -> dict[str, Any]:
        """Return the case keys as a case file has them."""
        return _changes(self.keys, self.seconds)


def read_space(said: str, table: Any, faults: list[str]) -> Space:
    """Return what ``[design]`` asks, and add what is wrong with it to the faults."""
    reader = TableReader(said, table, faults)
    criterion = reader.choice("criterion", CRITERIA, "D")
    vary, budget = (reader.raw(key, {}) for key in ("vary", "budget"))
    reader.finish()
    ranges: dict[str, tuple[float, float]] = {}
    vary = TableReader(f"{said}.vary", vary, faults)
    for key in _VARY:
        if key in vary and (found := _range(vary, key)) is not None:
            ranges[key] = found
    for key in _VARY:
        vary.raw(key)
    vary.finish()
    if all(key in ranges for key in LOADS):
        vary.fault("load.pressure and load.force: only one of them may vary")
    if _STEPS in ranges and not any(key in ranges for key in LOADS):
        vary.wrong(_STEPS, "needs load.pressure or load.force beside it, the range of the loads")
    limits = TableReader(f"{said}.budget", budget, faults)
    seconds, count = limits.raw("time.end"), limits.raw("experiments", 1)
    limits.finish()
    if seconds is not None and not (is_number(seconds) and 0.0 < seconds < np.inf):
        limits.wrong("time.end", "must be a number above 0, s of all experiments together")
        seconds = None
    if not (isinstance(count, int) and not isinstance(count, bool)) or not (
        1 <= count <= MOST_EXPERIMENTS
    ):
        limits.wrong("experiments", f"must be a whole number from 1 to {MOST_EXPERIMENTS}")
        count = 1
    return Space(criterion, ranges, seconds, count)  # type: ignore[arg-type]


def _range(reader: TableReader, key: str) -> tuple[float, float] | None:
    value = reader.raw(key)
    most = _COUNTS.get(key)
    fine = (
        isinstance(value, list | tuple)
        and len(value) == 2
        and all(is_number(v) and np.isfinite(v) for v in value)
        and 0.0 < value[0] <= value[1]
    )
    if fine and most is not None:
        fine = all(float(v).is_integer() and v <= most for v in value)
    if not fine:
        allowed = "above 0" if most is None else f"whole, from 1 to {most}"
        reader.wrong(key, f"must be [lowest, highest], two numbers, {allowed}")
        return None
    return float(value[0]), float(value[1])


def count_of(space: Space) -> int:
    """Return how many tests a space has."""
    load = next((key for key in LOADS if key in space.ranges), None)
    found = len(_sequences(space, load, _counts(space, _STEPS, 1)))
    found *= len(_counts(space, _PROFILES, 1))
    for key, count in (("time.end", _DURATIONS), ("load.omega", _SPEEDS)):
        found *= max(len(_levels(space, key, count)), 1)
    return found


def candidates(space: Space, template: Experiment) -> list[Candidate]:
    """Return the tests of a space, measured as ``template`` is.

    Raises
    ------
    InputError : values that a case does not allow.
    """
    load = next((key for key in LOADS if key in space.ranges), None)
    steps = _counts(space, _STEPS, 1)
    profiles = [0]
    if any(series.profile for series in template.series):
        profiles = _counts(space, _PROFILES, 1)
    ends = _levels(space, "time.end", _DURATIONS) or [template.case.time.end]
    found: list[Candidate] = []
    for omega in _levels(space, "load.omega", _SPEEDS) or [None]:
        for sequence in _sequences(space, load, steps):
            for end, count in itertools.product(ends, profiles):
                if space.seconds is not None and end > space.seconds * (1.0 + 1e-9):
                    continue
                keys: dict[str, Any] = {}
                if load is not None:
                    keys[load] = sequence if len(sequence) > 1 else sequence[0]
                if omega is not None:
                    keys["load.omega"] = omega
                if "time.end" in space.ranges:
                    keys["time.end"] = end
                case = template.case.replace(_changes(keys, end))
                series = _measured(template, case, count)
                experiment = Experiment(f"candidate {len(found) + 1}", case, series)
                found.append(Candidate(keys, count, experiment))
    return found


def _levels(space: Space, key: str, count: int) -> list[Any]:
    if key not in space.ranges:
        return []
    low, high = space.ranges[key]
    return [low] if low == high else np.linspace(low, high, count).tolist()


def _counts(space: Space, key: str, usual: int) -> list[int]:
    low, high = space.ranges.get(key, (usual, usual))
    return list(range(int(low), int(high) + 1))


def _sequences(space: Space, load: str | None, steps: Sequence[int]) -> list[tuple[float, ...]]:
    """Return the loads of tests: several of one grow."""
    if load is None:
        return [()]
    found: list[tuple[float, ...]] = []
    for count in steps:
        levels = _levels(space, load, _LEVELS if count == 1 else _STEP_LEVELS)
        found += itertools.combinations(levels, count)
    return found


def _changes(keys: Mapping[str, Any], end: float) -> dict[str, Any]:
    """Return case keys, several loads as a schedule of equal parts."""
    changes = dict(keys)
    for key in LOADS:
        if isinstance(loads := keys.get(key), tuple):
            points = [[0.0, loads[0]]]
            for i, value in enumerate(loads[1:], start=1):
                at = end * i / len(loads)
                points += [[at, loads[i - 1]], [at + _RAMP * end, value]]
            changes[key] = points
    return changes


def _measured(template: Experiment, case: Case, profiles: int) -> tuple[Series, ...]:
    """Return what would be read of a case: records at their rate, all else at its part of the test.

    Noise is that of the template, of records its median. Of profiles of one body at several times
    the last one serves.
    """
    longer = case.time.end / template.case.time.end
    last: dict[str, Series] = {}
    for series in template.series:
        known = last.get(series.quantity)
        if series.profile and (known is None or _at(series) > _at(known)):
            last[series.quantity] = series
    found: list[Series] = []
    for series in template.series:
        if series.profile:
            if series is last[series.quantity]:
                found += [
                    replace(series, name=f"{series.quantity} at {at:.6g} s", at=at)
                    for at in (case.time.end * i / profiles for i in range(1, profiles + 1))
                ]
        elif series.n < _RECORD:
            found.append(replace(series, x=series.x * longer))
        else:
            span = series.x[-1] - series.x[0]
            count = max(round(series.n * longer), 2)
            x = longer * (series.x[0] + span * np.linspace(0.0, 1.0, count))
            sd: FloatArray = np.full(count, np.median(series.sd))
            found.append(replace(series, x=x, value=np.zeros(count), sd=sd, lines=None))
    return tuple(found)


def _at(series: Series) -> float:
    return 0.0 if series.at is None else series.at
