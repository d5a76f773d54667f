"""Tests that could be made, by ``[design]``: experiments that are measured like a given one."""

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import Case
from ringwear_par.identification.definition.problem import DesignSpace, Experiment, Series

#: keys of the load, of which one may vary, and of all that may
LOADS = ("load.pressure", "load.force")
_STEPS, _PROFILES, _AT = "load.steps", "profiles", "profile.at"
INSTANTS = (_PROFILES, _AT)
MOST_CANDIDATES = 2000

#: number of values of a range that are tried; of loads where a test has several; of durations; of
#: speeds
_LEVELS, _STEP_LEVELS, _DURATIONS, _SPEEDS = 15, 6, 10, 3
#: number of instants of a profile; the same of several profiles
_INSTANTS, _FEW_INSTANTS = 10, 5
#: time in which a load changes, as a share of the test
_RAMP = 1e-3
#: fewest readings over time of a record, which continues at its rate in a longer test
_RECORD = 10


@dataclass(frozen=True, eq=False)
class Candidate:
    """One test that could be made."""

    #: of the case, with plain numbers; of several loads one after another a tuple.
    keys: Mapping[str, float | tuple[float, ...]]
    #: s, when profiles are measured, if they are.
    profiles: tuple[float, ...]
    #: its case, and readings without data. Tests that differ in the instants of profiles share
    #: their cases, and the series that both have.
    experiment: Experiment
    #: whether tests differ in when profiles are measured.
    instants_vary: bool = False

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

    @property
    def kind(self) -> tuple[float, ...]:
        """What differs first: loads, or speed, duration and instants where they do not vary."""
        speed = self.keys.get("load.omega", 0.0)
        return self.loads or (float(speed), self.seconds, *self.profiles)  # type: ignore[arg-type]

    def to_dict(self) -> dict[str, Any]:
        """Return the entry of design.json."""
        entry: dict[str, Any] = {
            key: list(value) if isinstance(value, tuple) else value
            for key, value in self.keys.items()
        }
        if self.profiles:
            entry |= {_PROFILES: len(self.profiles), _AT: list(self.profiles)}
        return entry

    def changes(self) -> dict[str, Any]:
        """Return the case keys as a case file has them."""
        return _changes(self.keys, self.seconds)


def count_of(space: DesignSpace) -> int:
    """Return how many tests a space has."""
    return math.prod(map(len, _axes(space)))


def _axes(space: DesignSpace) -> tuple[list[Any], ...]:
    """Return speeds, loads, durations and instants of profiles of tests; None: the template's."""
    return (
        _levels(space, "load.omega", _SPEEDS) or [None], _sequences(space),
        _levels(space, "time.end", _DURATIONS) or [None], _instants(space),
    )  # fmt: skip


def candidates(space: DesignSpace, template: Experiment) -> list[Candidate]:
    """Return the tests of a space, measured as ``template``; InputError for impossible values."""
    load = _load(space)
    *conditions, instants = _axes(space)
    if not any(series.profile for series in template.series):
        instants = [()]
    tests: list[Candidate] = []
    for omega, sequence, duration in itertools.product(*conditions):
        end = template.case.time.end if duration is None else duration
        if end > space.time_limit:
            continue
        keys: dict[str, Any] = {}
        if load is not None:
            keys[load] = sequence if len(sequence) > 1 else sequence[0]
        keys |= {} if omega is None else {"load.omega": omega}
        keys |= {} if duration is None else {"time.end": end}
        case = template.case.replace(_changes(keys, end))
        readings_at = _measured(template, case)
        for parts in instants:
            at = tuple(end * part for part in parts)
            experiment = Experiment(f"candidate {len(tests) + 1}", case, readings_at(at))
            tests.append(Candidate(keys, at, experiment, len(instants) > 1))
    return tests


def _load(space: DesignSpace) -> str | None:
    """Return the key of the load that varies."""
    return next((key for key in LOADS if key in space.ranges), None)


def _instants(space: DesignSpace) -> list[tuple[float, ...]]:
    """Return when profiles are measured, parts of the test.

    Unless that may vary, at equal intervals, the last one at the end.
    """
    counts = _counts(space, _PROFILES)
    if _AT not in space.ranges:
        return [tuple(i / count for i in range(1, count + 1)) for count in counts]
    instants: list[tuple[float, ...]] = []
    for count in counts:
        levels = _levels(space, _AT, _INSTANTS if count == 1 else _FEW_INSTANTS)
        instants += itertools.combinations(levels, count)
    return instants


def _levels(space: DesignSpace, key: str, count: int) -> list[Any]:
    if key not in space.ranges:
        return []
    low, high = space.ranges[key]
    return [low] if low == high else np.linspace(low, high, count).tolist()


def _counts(space: DesignSpace, key: str) -> list[int]:
    low, high = space.ranges.get(key, (1, 1))
    return list(range(int(low), int(high) + 1))


def _sequences(space: DesignSpace) -> list[tuple[float, ...]]:
    """Return the loads of tests: several of one grow."""
    load = _load(space)
    if load is None:
        return [()]
    sequences: list[tuple[float, ...]] = []
    for count in _counts(space, _STEPS):
        levels = _levels(space, load, _LEVELS if count == 1 else _STEP_LEVELS)
        sequences += itertools.combinations(levels, count)
    return sequences


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


def _measured(template: Experiment, case: Case) -> Callable[[Sequence[float]], tuple[Series, ...]]:
    """Return a function of instants (s) of profiles, to the readings of a candidate.

    Records go on at their rate, all else is read at its part of the test. Noise is that of the
    template, of records its median. Of profiles of one body at several times the last one serves;
    tests share those of one instant.
    """
    longer = case.time.end / template.case.time.end
    last = last_profiles(template.series)

    @cache
    def profile(series: Series, at: float) -> Series:
        return replace(series, name=f"{series.quantity} at {at:.6g} s", at=at)

    scaled = {s: _scaled(s, longer) for s in template.series if not s.profile}

    def at(instants: Sequence[float]) -> tuple[Series, ...]:
        series: list[Series] = []
        for entry in template.series:
            if not entry.profile:
                series.append(scaled[entry])
            elif entry is last[entry.quantity]:
                series += [profile(entry, instant) for instant in instants]
        return tuple(series)

    return at


def last_profiles(every: Sequence[Series]) -> dict[str, Series]:
    """Return of all profiles of one body the last one, by quantity."""
    profiles = [series for series in reversed(every) if series.profile]
    return {s.quantity: s for s in sorted(profiles, key=lambda profile: profile.at or 0.0)}


def _scaled(series: Series, longer: float) -> Series:
    """Return the readings over time of a longer test."""
    if series.n < _RECORD:
        return replace(series, x=series.x * longer)
    span = series.x[-1] - series.x[0]
    count = max(round(series.n * longer), 2)
    x = longer * (series.x[0] + span * np.linspace(0.0, 1.0, count))
    sd: FloatArray = np.full(count, np.median(series.sd))
    return replace(series, x=x, value=np.zeros(count), sd=sd, lines=None)
