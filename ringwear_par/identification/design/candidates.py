"""Tests that could be made, by ``[design]``: experiments that are measured like a given one."""

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ringwear_par.cases.schema import BY_PATH
from ringwear_par.cases.units import factor
from ringwear_par.identification.definition.problem import DesignSpace, Experiment, Series
from ringwear_par.results.key_numbers import time_words

#: keys of the load, of which one may vary; keys of when profiles are measured
LOADS = ("load.pressure", "load.force")
INSTANTS = ("profiles", "profile.at")
#: values of a range that are tried: of loads and instants of profiles (one, or several in a test),
#: of durations and speeds
_LOADS, _INSTANTS, _DURATIONS, _SPEEDS = (15, 6), (10, 5), 10, 3
#: time in which a load changes, as a share of the test
_RAMP = 1e-3
#: fewest readings over time of a record, which continues at its rate in a longer test
_RECORD = 10


@dataclass(frozen=True, eq=False)
class Candidate:
    """One test that could be made."""

    #: of the case, with plain numbers; a tuple of several loads one after another
    keys: Mapping[str, Any]
    #: s, when profiles are measured, if they are
    profiles: tuple[float, ...]
    #: its case, with the series of all candidates that have it, which share its history
    experiment: Experiment
    #: numbers of the series that are read in it
    series: tuple[int, ...]

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
    def kind(self) -> tuple[float, ...]:
        """What differs first: loads, or speed, duration and instants where loads do not vary."""
        return self.loads or (self.keys.get("load.omega", 0.0), self.seconds, *self.profiles)

    def name(self, space: DesignSpace) -> str:
        """Return the test in a few words, in the units in which ranges are written."""

        def in_unit(key: str, value: float) -> str:
            unit = space.units.get(key, BY_PATH[key].unit)
            return f"{value / factor(unit, BY_PATH[key].unit):.4g} {unit}"

        words, at = [], [time_words(time, self.seconds) for time in self.profiles]
        for key in (*LOADS, "load.omega"):
            if key in self.keys:
                values = self.loads if key in LOADS else (self.keys[key],)
                words.append(" then ".join(in_unit(key, value) for value in values))
        duration = in_unit("time.end", self.seconds) if "time.end" in space.units else ""
        words.append(duration or time_words(self.seconds, self.seconds))
        if not space.ranges.keys().isdisjoint(INSTANTS):
            words.append(f"profile{'s' if at[1:] else ''} at {', '.join(at)}")
        return ", ".join(words)

    def to_dict(self) -> dict[str, Any]:
        """Return the entry of design.json."""
        entry = {k: list(v) if isinstance(v, tuple) else v for k, v in self.keys.items()}
        at = {"profiles": len(self.profiles), "profile.at": list(self.profiles)}
        return entry | at if self.profiles else entry


def candidates(space: DesignSpace, template: Experiment) -> list[Candidate]:
    """Return the tests of a space, measured as ``template``; InputError for impossible values.

    Records go on at their rate, with their median noise; all else is read at its part of the test.
    Of several profiles of one body the last one in the file serves.
    """
    speeds, loads, durations, instants = axes(space)
    faces = [*{s.quantity: s for s in template.series if s.profile}.values()]
    usual = template.case.time.end
    parts = sorted({part for some in instants for part in some})
    tests: list[Candidate] = []
    for speed, load, duration in itertools.product(speeds, loads, durations):
        keys, end = speed | load | duration, duration.get("time.end", usual)
        if end > space.time_limit:
            continue
        series = [_scaled(s, end / usual) for s in template.series if not s.profile]
        shared = len(series)
        for part in parts if faces else ():
            name = f"at {end * part:.6g} s"
            series += [replace(f, name=f"{f.quantity} {name}", at=end * part) for f in faces]
        case = template.case.replace(_case_keys(keys, end))
        test = Experiment(f"candidate {len(tests) + 1}", case, tuple(series))
        for some in instants if faces else [()]:
            first = [shared + len(faces) * parts.index(part) for part in some]
            read = (*range(shared), *(i + j for i in first for j in range(len(faces))))
            tests.append(Candidate(keys, tuple(end * part for part in some), test, read))
    return tests


def axes(space: DesignSpace) -> tuple[list[Any], ...]:
    """Return keys of speed, load and duration, and instants of profiles as parts of the test."""
    ranges = space.ranges

    def levels(key: str, count: int) -> list[float]:
        return np.unique(np.linspace(*ranges[key], count)).tolist()

    def one(key: str, count: int) -> list[dict[str, float]]:
        return [{key: value} for value in levels(key, count)] if key in ranges else [{}]

    def growing(key: str, counts: range, most: tuple[int, int]) -> list[tuple[float, ...]]:
        """Return increasing values, as many in each as counts have."""
        return [v for n in counts for v in itertools.combinations(levels(key, most[n > 1]), n)]

    steps, counts = (
        range(int(low), int(high) + 1)
        for low, high in (ranges.get(key, (1, 1)) for key in ("load.steps", "profiles"))
    )
    loads: list[Any] = [{}]
    for key in {*LOADS} & {*ranges}:
        loads = [{key: v if v[1:] else v[0]} for v in growing(key, steps, _LOADS)]
    if "profile.at" in ranges:
        instants = growing("profile.at", counts, _INSTANTS)
    else:  # at equal intervals, the last one at the end
        instants = [tuple((i + 1) / n for i in range(n)) for n in counts]
    return one("load.omega", _SPEEDS), loads, one("time.end", _DURATIONS), instants


def _case_keys(keys: Mapping[str, Any], end: float) -> dict[str, Any]:
    """Return the keys of a test as a case has them, several loads as a schedule of equal parts."""
    changes = dict(keys)
    for key in LOADS:
        if isinstance(loads := keys.get(key), tuple):
            points = [[0.0, loads[0]]]
            for i, (before, after) in enumerate(itertools.pairwise(loads), start=1):
                at = end * i / len(loads)
                points += [[at, before], [at + _RAMP * end, after]]
            changes[key] = points
    return changes


def _scaled(series: Series, longer: float) -> Series:
    """Return the readings over time of a longer test."""
    if series.n < _RECORD:
        return replace(series, x=series.x * longer)
    count = max(round(series.n * longer), 2)
    x = longer * np.linspace(series.x[0], series.x[-1], count)
    sd = np.full(count, np.median(series.sd))
    return replace(series, x=x, value=np.zeros(count), sd=sd, lines=None, censored=None)
