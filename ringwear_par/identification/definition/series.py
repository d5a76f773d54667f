"""``[[experiment.data]]``: from a table of a fit file to readings in the units of a case."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray
from ringwear_par.cases.case import Case, density_keys
from ringwear_par.cases.files.columns import FileStore, read_intervals
from ringwear_par.cases.tables import TableReader
from ringwear_par.errors import counted, legible
from ringwear_par.files.measurements import and_more
from ringwear_par.identification.definition.data_sources import (
    lines_of,
    read_censored,
    read_noise,
    read_readings,
)
from ringwear_par.identification.definition.problem import (
    GROWTH_TIME,
    Nuisance,
    Series,
    friction_power,
)
from ringwear_par.identification.definition.reading_kinds import READING_KINDS
from ringwear_par.identification.definition.schema import DENSITIES, read_all, reader_of

#: largest correlation time, in lengths of the test: noise correlated for longer is an offset
_LONGEST_CORRELATION = 100.0
#: fewest readings of a record, and the share of the test that it covers at least: a shorter one may
#: be in another unit
_RECORD, _SHORT_RECORD = 3, 0.1
#: share of the test by which times may be later than its end, as when rounded to minutes
_ROUNDED = 2e-4
#: a time constant is fitted within so many sd of its prior about the prior's mean
_PRIOR_REACH = 4.0
#: blocks of equal time of a test, in which the readings of a long record are averaged
BLOCKS = 500


def read_series(
    place: str,
    table: Any,
    case: Case | None,
    files: FileStore,
    faults: list[str],
    *,
    plans: bool = False,
) -> Series | None:
    """Return the readings of one table, or add its faults; a case that has some itself is None."""
    before, reader = len(faults), reader_of("experiment.data", place, table, faults)
    if (quantity := reader.read("quantity")) is None:
        return None
    kind, _, body = quantity.partition(".")
    reader.place = f"{place} ({quantity})"
    end = math.inf if case is None else case.time.end
    at = _read_at(reader, kind, end)
    density = density_of(reader, body, case) if kind == "mass" else 1.0
    if kind == "through" and case is not None and not getattr(case, body).layers:
        reader.fault(f"{body} has no layers; must have one at least")
    if (readings := read_readings(reader, kind, at, end, files, plans)) is None:
        return None
    series, profile = readings.series, kind == "profile"
    if kind == "through":  # and may be after the end
        series = replace(series, x=np.minimum(series.value, end))
    if not profile:
        series = replace(series, x=rounded_end(series.x, end))
    excluded = read_intervals(reader, "exclude", "mm" if profile else "s")
    keep = is_outside(series.x, excluded)
    sd, fitted = read_noise(reader, readings, keep)
    censored = read_censored(reader, readings)
    nuisances = _nuisances(reader, kind, case)
    correlation = reader.read("correlation_time")
    if correlation > 0 and profile:
        rule = "must be absent for a profile, it is for noise in time"
        reader.wrong("correlation_time", rule, "conflict")
    if correlation > _LONGEST_CORRELATION * end:
        reader.wrong(
            "correlation_time",
            f"must be at most {_LONGEST_CORRELATION:g} times the test, which ends at {end:g} s; "
            "noise that never changes is an offset",
        )
    reader.finish()
    if len(faults) > before:
        return None
    suspicions = series.suspicions
    if not profile and series.lines is not None and series.n >= _RECORD:
        last = float(series.x.max())
        if 0.0 < last < _SHORT_RECORD * end:
            suspicions += (
                f"readings end at {last:.4g} s of a test of {end:g} s; look at the unit of time",
            )
    series = replace(
        series, name=quantity, quantity=quantity, sd=sd, sd_fitted=fitted, density=density,
        at=(end if at is None else at) if profile else None, nuisances=nuisances,
        correlation_time=correlation, suspicions=suspicions, excluded=tuple(excluded),
        censored=censored,
    ).part(keep)  # fmt: skip
    _check(reader, series, case)
    return series if len(faults) == before else None


def _read_at(reader: TableReader, kind: str, end: float) -> float | None:
    """Return the time of readings, s; None, and perhaps a fault, where they have their own."""
    at: float | None = reader.read("at")
    timed = next((key for key in ("file", "times") if key in reader), "")
    if at is None:
        return None
    if at > end:
        reader.wrong("at", f"must be within the test, which ends at {end:g} s")
    if kind == "through":
        rule = "must be absent: value is the time at which the layer is through"
        reader.wrong("at", rule, "conflict")
    elif timed and kind != "profile":
        rule = f"must be absent beside {timed}, whose readings have their times"
        reader.wrong("at", rule, "conflict")
    return at


def _check(reader: TableReader, series: Series, case: Case | None) -> None:
    """Refuse a series without readings, or with too few, or with some that a case cannot have."""
    if not series.n:
        reader.fault("has no readings; must have one at least that is neither empty nor excluded")
        return
    if case is not None and series.profile:
        _check_profile(reader, series, case)
    elif case is not None:
        check_times(reader, series, case.time.end)
    if case is not None and READING_KINDS[series.kind].unit == "mm":
        highest = min(ring.z[1] - ring.z[0] for ring in case.rings)
        rule = f"must be less than the height of a body, {highest:g} mm; look at the unit"
        deep = np.abs(series.value) > highest
        refuse_readings(reader, series, deep, f"{{value:g}} {series.unit}", rule)
    free = [nuisance.kind for nuisance in series.nuisances if nuisance.free]
    if series.n <= len(free):
        reader.fault(
            f"has {counted(series.n, 'reading')}; must have more than nuisances "
            f"without prior or bounds, {', '.join(free)}, which fit so few exactly"
        )


def is_outside(x: FloatArray, intervals: Sequence[tuple[float, float]]) -> BoolArray:
    """Return which of times or radii (n,) no interval holds."""
    ends = np.array(intervals).reshape(-1, 2)
    return ~((x[:, None] >= ends[:, 0]) & (x[:, None] <= ends[:, 1])).any(axis=1)


def rounded_end(x: FloatArray, end: float) -> FloatArray:
    """Return times (n,) s whose last one is the end of the test, s, if it may be rounded."""
    rounded = len(x) > 0 and end < x[-1] <= end * (1.0 + _ROUNDED)
    return np.append(x[:-1], end) if rounded else x


def _nuisances(reader: TableReader, kind: str, case: Case | None) -> tuple[Nuisance, ...]:
    table, allowed = reader.raw("nuisance", {}), READING_KINDS[kind].nuisances
    if not isinstance(table, Mapping):
        reader.wrong("nuisance", f"must be a table of {', '.join(allowed)}")
        return ()
    nuisances = []
    for name, entry in table.items():
        place = f"{reader.place}: nuisance.{legible(name)}"
        if name not in allowed:
            sentence = f"nuisance.{legible(name)}: must be one of {', '.join(allowed)}"
            reader.fault(sentence, "nuisance", "unknown_key")
        elif name == "thermal":
            nuisances += _growth(place, entry, case, reader.faults)
        else:
            nuisances.append(_nuisance(place, name, entry, reader.faults))
        if name == "compliance" and case is not None and case.load.force is None:
            reader.fault(f'nuisance.{name} needs load.control = "force"', "nuisance", "conflict")
    return tuple(nuisances)


def _nuisance(
    place: str, kind: str, entry: Any, faults: list[str], *, power: bool = False
) -> Nuisance:
    _, (prior, bounds) = read_all("experiment.data.nuisance.KIND", place, entry, faults)
    return Nuisance(kind, prior, bounds, power=power)


def _growth(place: str, entry: Any, case: Case | None, faults: list[str]) -> list[Nuisance]:
    """Return the growth of a warm rig, and its time constant, s."""
    before = len(faults)
    reader = reader_of("experiment.data.nuisance.thermal", place, entry, faults)
    power, amplitude = reader.read("power"), reader.raw("amplitude", {})
    grown = _nuisance(f"{place}.amplitude", "thermal", amplitude, faults, power=power)
    if power and case is not None and case.load.force is None:
        reader.wrong("power", 'needs load.control = "force"', "conflict")
    elif power and case is not None and not friction_power(case)[1].any():
        rule = "needs friction power, mu F omega > 0, at some time of the test"
        reader.wrong("power", rule, "conflict")
    table, name = reader.raw("time", {}), "experiment.data.nuisance.thermal.time"
    time, (start, prior, bounds) = read_all(name, f"{place}.time", table, faults)
    reader.finish()
    if len(faults) > before:
        return []
    if prior is not None and prior.mean <= 0.0:
        time.wrong("prior", "must have a mean > 0 (s)")
    elif bounds is None and prior is None:
        time.fault("has neither prior nor bounds; must have one of them at least", code="missing")
    elif bounds is None:
        reach = _PRIOR_REACH * prior.sd
        bounds = max(prior.mean - reach, 0.01 * prior.mean), prior.mean + reach
    elif bounds[0] == 0.0:
        time.wrong("bounds", "must be two increasing numbers > 0 (s)")
    if len(faults) == before and not bounds[0] <= start <= bounds[1]:
        time.wrong("start", f"must be within its bounds, {bounds[0]:g} to {bounds[1]:g} s")
    return [grown, Nuisance(GROWTH_TIME, prior, bounds, start, power)]


def density_of(reader: TableReader, body: str, case: Case | None) -> float | None:
    """Return the density of all that a body loses, g/mm3; None where each layer has its own.

    Refuse one that is not known, or that nothing has, as that in another unit.
    """
    low, high = DENSITIES
    rule = f"must be from {low:g} to {high:g} g/mm3, as of foams and metals"
    if "density" in reader or case is None:
        density: float | None = reader.read("density")
        if density is not None and not low <= density <= high:
            reader.wrong("density", rule)
        return density
    densities = getattr(case, body).densities
    keys = density_keys(body, len(densities) - 1)
    if missing := [key for key, value in zip(keys, densities, strict=True) if not value]:
        reader.wrong(
            "density", f"must be given here, or as {', '.join(missing)} of the case (g/mm3)"
        )
    reader.read("density")
    for key, density in zip(keys, densities, strict=True):
        if density and not low <= density <= high:
            reader.fault(f"{key} = {density:g}: {rule}")
    return densities[0] if len(set(densities)) == 1 else None


def refuse_readings(
    reader: TableReader, series: Series, wrong: BoolArray, words: str, rule: str
) -> None:
    """Refuse readings where some (n,) are wrong: the first one in words with {x} and {value}."""
    if wrong.any():
        i = int(wrong.argmax())
        first = words.format(x=series.x[i], value=series.value[i] / series.factor)
        more = and_more(int(wrong.sum()), "reading")
        reader.fault(f"{lines_of(series)[i]}{first}{more}: {rule}")


def check_times(reader: TableReader, series: Series, end: float) -> None:
    """Refuse times that do not increase, or outside the test."""
    x = series.x
    late = np.diff(x, prepend=-np.inf) <= 0
    refuse_readings(reader, series, late, "time {x:g} s", "times must increase")
    rule = f"must be within the test, from 0 to {end:g} s (time.end)"
    refuse_readings(reader, series, (x < 0) | (x > end), "time {x:g} s", rule)


def _check_profile(reader: TableReader, series: Series, case: Case) -> None:
    """Refuse radii that are not those of the body."""
    (low, high), x = getattr(case, series.body).r, series.x
    outside = (x < low) | (x > high)
    rule = f"must be on the {series.body} body, from {low:g} to {high:g} mm"
    refuse_readings(reader, series, outside, "r = {x:g} mm", rule)
    a, b = case.contact
    if not ((x >= a) & (x <= b)).any():
        reader.fault(
            f"{series.file or 'r'}: has no reading within the contact, {a:g} to {b:g} mm; must "
            "have one at least"
        )


def averaged(series: Series, end: float) -> Series:
    """Return a record averaged in blocks of equal time; one of correlated noise is thinned.

    No block reaches across an excluded part. Blocks are those of the test, whenever the record
    ends: while it grows, all but the last one stay as they are. Profiles and limits stay too.

    Parameters
    ----------
    end : s, of the test.
    """
    limits = series.censored is not None and series.censored.any()
    if series.profile or limits or series.n < 2:
        return series
    block = series.x // (end / BLOCKS)
    parts_before = (series.x[:, None] > np.array([low for low, _ in series.excluded])).sum(axis=1)
    is_first = (np.diff(block, prepend=-1.0) != 0) | (np.diff(parts_before, prepend=-1) != 0)
    first = np.flatnonzero(is_first)
    if first.size == series.n:
        return series
    counts = np.diff(first, append=series.n)
    if series.correlation_time:
        return series.part(first + counts - 1)
    weights = series.sd**-2
    total = np.add.reduceat(weights, first)
    single = counts == 1  # to the last bit, so that a record that grows stays what it was
    x, value = (
        np.where(single, column[first], np.add.reduceat(weights * column, first) / total)
        for column in (series.x, series.value)
    )
    sd = np.where(single, series.sd[first], total**-0.5)
    return replace(series, x=x, value=value, sd=sd, lines=None, censored=None)
