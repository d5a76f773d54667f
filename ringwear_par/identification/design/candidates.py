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

#: keys of the load, of which one may vary
LOADS = ("load.pressure", "load.force")
#: values of a range that are tried: of loads (one, or several in a test), durations and speeds
_LOADS, _DURATIONS, _SPEEDS = (15, 6), 10, 3
#: time in which a load changes, as a share of the test
_RAMP = 1e-3
#: fewest readings over time of a record, which continues at its rate in a longer test
_RECORD = 10


@dataclass(frozen=True, eq=False)
class Candidate:
    """One test that could be made."""

    #: of the case, with plain numbers; a tuple of several loads one after another
    keys: Mapping[str, Any]
    #: its case, and when it is read
    experiment: Experiment

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
        """What differs first: loads, or speed and duration where loads do not vary."""
        return self.loads or (self.keys.get("load.omega", 0.0), self.seconds)

    def name(self, space: DesignSpace) -> str:
        """Return the test in a few words, in the units in which ranges are written."""

        def in_unit(key: str, value: float) -> str:
            unit = space.units.get(key, BY_PATH[key].unit)
            return f"{value / factor(unit, BY_PATH[key].unit):.4g} {unit}"

        words = []
        for key in (*LOADS, "load.omega"):
            if key in self.keys:
                values = self.loads if key in LOADS else (self.keys[key],)
                words.append(" then ".join(in_unit(key, value) for value in values))
        duration = in_unit("time.end", self.seconds) if "time.end" in space.units else ""
        return ", ".join([*words, duration or time_words(self.seconds, self.seconds)])


def candidates(space: DesignSpace, template: Experiment) -> list[Candidate]:
    """Return the tests of a space, measured as ``template``; InputError for impossible values.

    Records go on at their rate, with their median noise; profiles are measured at the end, that of
    a body as its last one in the file; all else is read at its part of the test.
    """
    usual, tests = template.case.time.end, list[Candidate]()
    read = {s.quantity if s.profile else s.name: s for s in template.series}
    for chosen in itertools.product(*_axes(space)):
        keys = {key: value for some in chosen for key, value in some.items()}
        if (end := keys.get("time.end", usual)) > space.time_limit:
            continue
        case = template.case.replace({key: _as_in_case(v, end) for key, v in keys.items()})
        series = tuple(_scaled(s, end, end / usual) for s in read.values())
        tests.append(Candidate(keys, Experiment(f"candidate {len(tests) + 1}", case, series)))
    return tests


def _axes(space: DesignSpace) -> list[list[dict[str, Any]]]:
    """Return the values that are tried of speed, load and duration, by key; {} of what is fixed."""
    ranges = space.ranges

    def levels(key: str, count: int) -> list[float]:
        return np.unique(np.linspace(*ranges[key], count)).tolist()

    def one(key: str, count: int) -> list[dict[str, Any]]:
        return [{key: value} for value in levels(key, count)] if key in ranges else [{}]

    fewest, most = map(int, ranges.get("load.steps", (1, 1)))
    loads: list[dict[str, Any]] = []
    for key in {*LOADS} & {*ranges}:
        for n in range(fewest, most + 1):  # increasing ones
            steps = itertools.combinations(levels(key, _LOADS[n > 1]), n)
            loads += [{key: v if n > 1 else v[0]} for v in steps]
    return [one("load.omega", _SPEEDS), loads or [{}], one("time.end", _DURATIONS)]


def _as_in_case(value: Any, end: float) -> Any:
    """Return a value as cases have it: several loads are a schedule of equal parts with ramps."""
    if not isinstance(value, tuple):
        return value
    points = [[0.0, value[0]]]
    for i, (before, after) in enumerate(itertools.pairwise(value), start=1):
        at = end * i / len(value)
        points += [[at, before], [at + _RAMP * end, after]]
    return points


def _scaled(series: Series, end: float, longer: float) -> Series:
    """Return the readings of a test that ends at ``end``, longer by a factor."""
    if series.profile:
        return replace(series, at=end)
    if series.n < _RECORD:
        return replace(series, x=series.x * longer)
    count = max(round(series.n * longer), 2)
    x = longer * np.linspace(series.x[0], series.x[-1], count)
    sd = np.full(count, np.median(series.sd))
    return replace(series, x=x, value=np.zeros(count), sd=sd, lines=None, censored=None)
