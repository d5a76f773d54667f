"""Tests that could be made, by ``[design]``: experiments that are measured like a given one."""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ringwear_par.identification.definition.problem import DesignSpace, Experiment, Series

#: keys of the load, of which one may vary; keys of when profiles are measured
LOADS = ("load.pressure", "load.force")
INSTANTS = ("profiles", "profile.at")
MOST_CANDIDATES = 2000
#: values of a range that are tried: of loads, of several loads in one test, of durations, of speeds,
#: of the instant of a profile, of several profiles in one test
_LOADS, _STEPS, _DURATIONS, _SPEEDS, _INSTANTS, _FEW_INSTANTS = 15, 6, 10, 3, 10, 5
#: time in which a load changes, as a share of the test
_RAMP = 1e-3
#: fewest readings over time of a record, which continues at its rate in a longer test
_RECORD = 10


@dataclass(frozen=True, eq=False)
class Candidate:
    """One test that could be made."""

    #: of the case, with plain numbers; a tuple of several loads one after another
    keys: Mapping[str, float | tuple[float, ...]]
    #: s, when profiles are measured, if they are
    profiles: tuple[float, ...]
    #: its case, with the series of all candidates that have it, which share its history
    experiment: Experiment
    #: numbers of its own series
    series: tuple[int, ...]
    #: whether candidates differ in when profiles are measured
    instants_vary: bool

    @property
    def seconds(self) -> float:
        """How long it takes."""
        return self.experiment.case.time.end

    @property
    def loads(self) -> tuple[float, ...]:
        """Loads one after another, where they vary."""
        loads = next((self.keys[key] for key in LOADS if key in self.keys), ())
        return loads if isinstance(loads, tuple) else (loads,)

    @property
    def kind(self) -> tuple[Any, ...]:
        """What differs first: loads, or speed, duration and instants where they do not vary."""
        return self.loads or (self.keys.get("load.omega", 0.0), self.seconds, *self.profiles)

    @property
    def plain(self) -> bool:
        """Whether load and duration are all that there is to tell of it on a map."""
        return len(self.loads) == 1 and len(self.profiles) < 2 and "load.omega" not in self.keys

    def to_dict(self) -> dict[str, Any]:
        """Return the entry of design.json."""
        entry = {k: list(v) if isinstance(v, tuple) else v for k, v in self.keys.items()}
        if self.profiles:
            entry |= {"profiles": len(self.profiles), "profile.at": list(self.profiles)}
        return entry

    def changes(self) -> dict[str, Any]:
        """Return the case keys as a case file has them."""
        return _changes(self.keys, self.seconds)


def count_of(space: DesignSpace) -> int:
    """Return how many tests a space has."""
    return math.prod(map(len, _axes(space)))


def candidates(space: DesignSpace, template: Experiment) -> list[Candidate]:
    """Return the tests of a space, measured as ``template``; InputError for impossible values.

    Records go on at their rate, with their median noise; all else is read at its part of the test.
    Of profiles of one body at several times the last one serves.
    """
    load = next((key for key in LOADS if key in space.ranges), "")
    *conditions, instants = _axes(space)
    faces = last_profiles(template.series)
    instants = instants if faces else [()]
    parts = sorted({part for some in instants for part in some})
    tests: list[Candidate] = []
    for omega, loads, duration in itertools.product(*conditions):
        end = template.case.time.end if duration is None else duration
        if end > space.time_limit:
            continue
        varied = {load: loads[0] if len(loads) == 1 else loads, "load.omega": omega, "time.end": duration}
        keys = {key: value for key, value in varied.items() if key and value is not None}
        case = template.case.replace(_changes(keys, end))
        series = [_scaled(s, end / template.case.time.end) for s in template.series if not s.profile]
        shared = range(len(series))
        numbers = dict[float, list[int]]()
        for part in parts:
            numbers[part] = [len(series) + i for i in range(len(faces))]
            at = end * part
            series += [replace(s, name=f"{s.quantity} at {at:.6g} s", at=at) for s in faces.values()]
        test = Experiment(f"candidate {len(tests) + 1}", case, tuple(series))
        for some in instants:
            own = (*shared, *(number for part in some for number in numbers[part]))
            at_parts = tuple(end * part for part in some)
            tests.append(Candidate(keys, at_parts, test, own, len(instants) > 1))
    return tests


def _axes(space: DesignSpace) -> tuple[list[Any], ...]:
    """Return speeds, loads, durations and instants (parts of the test); None: the template's."""

    def levels(key: str, count: int) -> list[Any]:
        low, high = space.ranges[key]
        return [low] if low == high else np.linspace(low, high, count).tolist()

    def one(key: str, count: int) -> list[Any]:
        return levels(key, count) if key in space.ranges else [None]

    def some(key: str, number: str, single: int, several: int) -> list[tuple[float, ...]]:
        """Return growing values: as many in each as the key ``number`` allows."""
        first, last = (int(n) for n in space.ranges.get(number, (1, 1)))
        return [
            chosen
            for count in range(first, last + 1)
            for chosen in itertools.combinations(levels(key, single if count == 1 else several), count)
        ]

    load = next((key for key in LOADS if key in space.ranges), None)
    sequences = [(None,)] if load is None else some(load, "load.steps", _LOADS, _STEPS)
    if "profile.at" in space.ranges:
        instants = some("profile.at", "profiles", _INSTANTS, _FEW_INSTANTS)
    else:  # at equal intervals, the last one at the end
        first, last = (int(n) for n in space.ranges.get("profiles", (1, 1)))
        instants = [tuple((i + 1) / n for i in range(n)) for n in range(first, last + 1)]
    return one("load.omega", _SPEEDS), sequences, one("time.end", _DURATIONS), instants


def _changes(keys: Mapping[str, Any], end: float) -> dict[str, Any]:
    """Return case keys, several loads as a schedule of equal parts."""
    changes = dict(keys)
    for key in LOADS:
        if isinstance(loads := keys.get(key), tuple):
            points = [[0.0, loads[0]]]
            for i, (before, after) in enumerate(itertools.pairwise(loads), start=1):
                at = end * i / len(loads)
                points += [[at, before], [at + _RAMP * end, after]]
            changes[key] = points
    return changes


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
    sd = np.full(count, np.median(series.sd))
    return replace(series, x=x, value=np.zeros(count), sd=sd, lines=None, censored=None)
