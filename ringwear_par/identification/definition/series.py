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
from ringwear_par.identification.definition.schema import (
    DATA,
    DENSITIES,
    NUISANCE,
    THERMAL,
    THERMAL_TIME,
)

#: largest correlation time, in lengths of the test: noise correlated for longer is an offset
_LONGEST_CORRELATION = 100.0
#: fewest readings of a record, and the share of the test that it covers at least: a shorter one may
#: be in another unit
_RECORD, _SHORT_RECORD = 3, 0.1
#: share of the test by which times may be later than its end, as when rounded to minutes
_ROUNDED = 2e-4
#: a time constant is fitted within so many sd of its prior about the prior's mean
_PRIOR_REACH = 4.0
#: units of densities, in g/mm3
_OTHER_UNITS = {"g/cm3": 1e-3, "kg/m3": 1e-6, "kg/mm3": 1e3, "t/mm3": 1e6}
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
    before = len(faults)
    reader = TableReader(place, table, faults, DATA)
    quantity = reader.read("quantity")
    if quantity is None:
        return None
    kind = quantity.partition(".")[0]
    reader.place = f"{place} ({quantity})"
    end = math.inf if case is None else case.time.end
    at = reader.read("at")
    density = density_of(reader, quantity, case) if kind == "mass" else 1.0
    if at is not None and at > end:
        reader.wrong("at", f"must be within the test, which ends at {end:g} s")
    timed = next((key for key in ("file", "times") if key in reader), "")
    if kind == "through":
        if at is not None:
            reader.wrong(
                "at", "must be absent: value is the time at which the layer is through", "conflict"
            )
        if case is not None and not getattr(case, quantity.partition(".")[2]).layers:
            reader.fault(f"{quantity.partition('.')[2]} has no layers; must have one at least")
    if at is not None and timed and kind != "profile":
        reader.wrong(
            "at", f"must be absent beside {timed}, whose readings have their times", "conflict"
        )
    readings = read_readings(reader, kind, at, end, files, plans)
    if readings is None:
        return None
    series = readings.series
    if kind == "through":  # and may be after the end
        series = replace(series, x=np.minimum(series.value, end))
    if kind != "profile":
        series = replace(series, x=rounded_end(series.x, end))
    excluded = read_intervals(reader, "exclude", "mm" if kind == "profile" else "s")
    keep = is_outside(series.x, excluded)
    sd, fitted = read_noise(reader, readings, keep)
    censored = read_censored(reader, readings)
    nuisances = _nuisances(reader, kind, case)
    correlation = reader.read("correlation_time")
    if correlation > 0 and kind == "profile":
        reader.wrong(
            "correlation_time", "must be absent for a profile, it is for noise in time", "conflict"
        )
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
    if kind != "profile" and series.lines is not None and series.n >= _RECORD:
        last = float(series.x.max())
        if 0.0 < last < _SHORT_RECORD * end:
            suspicions += (
                f"readings end at {last:.4g} s of a test of {end:g} s; look at the unit of time",
            )
    if kind == "profile":
        at = end if at is None else at
    series = replace(
        series, name=quantity, quantity=quantity, sd=sd, sd_fitted=fitted, density=density,
        at=at if kind == "profile" else None, nuisances=nuisances, correlation_time=correlation,
        suspicions=suspicions, excluded=tuple(excluded), censored=censored,
    ).part(keep)  # fmt: skip
    free = [nuisance.kind for nuisance in nuisances if nuisance.free]
    if not series.n:
        reader.fault("has no readings; must have one at least that is neither empty nor excluded")
        return None
    if case is not None:
        if series.profile:
            check_profile(reader, series, case)
        else:
            check_times(reader, series, case.time.end)
        if READING_KINDS[series.kind].unit == "mm":
            _check_depths(reader, series, case)
    if series.n <= len(free):
        reader.fault(
            f"has {counted(series.n, 'reading')}; must have more than nuisances "
            f"without prior or bounds, {', '.join(free)}, which fit so few exactly"
        )
    return series if len(faults) == before else None


def is_outside(x: FloatArray, intervals: Sequence[tuple[float, float]]) -> BoolArray:
    """Return which of times or radii (n,) no interval holds."""
    ends = np.array(intervals).reshape(-1, 2)
    return ~((x[:, None] >= ends[:, 0]) & (x[:, None] <= ends[:, 1])).any(axis=1)


def rounded_end(x: FloatArray, end: float) -> FloatArray:
    """Return times (n,) s whose last one is the end of the test, s, if it may be rounded."""
    rounded = len(x) > 0 and end < x[-1] <= end * (1.0 + _ROUNDED)
    return np.append(x[:-1], end) if rounded else x


def _nuisances(reader: TableReader, kind: str, case: Case | None) -> tuple[Nuisance, ...]:
    table = reader.raw("nuisance", {})
    allowed = READING_KINDS[kind].nuisances
    if not isinstance(table, Mapping):
        reader.wrong("nuisance", f"must be a table of {', '.join(allowed)}")
        return ()
    nuisances = []
    for name, entry in table.items():
        if name not in allowed:
            sentence = f"nuisance.{legible(name)}: must be one of {', '.join(allowed)}"
            reader.fault(sentence, "nuisance", "unknown_key")
            continue
        place = f"{reader.place}: nuisance.{name}"
        if name == "thermal":
            nuisances += _growth(place, entry, case, reader.faults)
            continue
        entry_reader = TableReader(place, entry, reader.faults, NUISANCE)
        bounds, prior = entry_reader.read("bounds"), entry_reader.read("prior")
        nuisances.append(Nuisance(name, prior, bounds))
        entry_reader.finish()
        if name == "compliance" and case is not None and case.load.force is None:
            entry_reader.fault('needs load.control = "force"', code="conflict")
    return tuple(nuisances)


def _growth(place: str, entry: Any, case: Case | None, faults: list[str]) -> list[Nuisance]:
    """Return the growth of a warm rig, and its time constant, s."""
    before, reader = len(faults), TableReader(place, entry, faults, THERMAL)
    amplitude = TableReader(f"{place}.amplitude", reader.raw("amplitude", {}), faults, NUISANCE)
    prior_of_growth, bounds_of_growth = amplitude.read("prior"), amplitude.read("bounds")
    amplitude.finish()
    power = reader.read("power")
    if power and case is not None:
        if case.load.force is None:
            reader.wrong("power", 'needs load.control = "force"', "conflict")
        elif not friction_power(case)[1].any():
            reader.wrong(
                "power",
                "needs friction power, mu F omega > 0, at some time of the test",
                "conflict",
            )
    time = TableReader(f"{place}.time", reader.raw("time", {}), faults, THERMAL_TIME)
    start, prior, bounds = (time.read(name) for name in ("start", "prior", "bounds"))
    time.finish()
    reader.finish()
    if len(faults) > before:
        return []
    if bounds is None and prior is None:
        time.fault("has neither prior nor bounds; must have one of them at least", code="missing")
        return []
    if prior is not None and prior.mean <= 0.0:
        time.wrong("prior", "must have a mean > 0 (s)")
        return []
    if bounds is None:
        reach = _PRIOR_REACH * prior.sd
        bounds = max(prior.mean - reach, 0.01 * prior.mean), prior.mean + reach
    elif bounds[0] == 0.0:
        time.wrong("bounds", "must be two increasing numbers > 0 (s)")
    if not bounds[0] <= start <= bounds[1]:
        time.wrong("start", f"must be within its bounds, {bounds[0]:g} to {bounds[1]:g} s")
    grown = Nuisance("thermal", prior_of_growth, bounds_of_growth, power=power)
    return [grown, Nuisance(GROWTH_TIME, prior, bounds, start, power)]


def density_of(reader: TableReader, quantity: str, case: Case | None) -> float | None:
    """Return the density of all that is lost, g/mm3; None where each layer has its own.

    Refuse one that is not known, or that nothing has, as that in another unit.
    """
    if (given := reader.read("density")) is not None:
        if rule := _density_rule(given):
            reader.wrong("density", rule)
        return float(given)
    if case is None or "density" in reader:
        return None
    body = quantity.partition(".")[2]
    densities = getattr(case, body).densities
    keys = density_keys(body, len(densities) - 1)
    if missing := [key for key, value in zip(keys, densities, strict=True) if not value]:
        reader.wrong(
            "density", f"must be given here, or as {', '.join(missing)} of the case (g/mm3)"
        )
    for key, density in zip(keys, densities, strict=True):
        if density and (rule := _density_rule(density)):
            reader.fault(f"{key} = {density:g}: {rule}")
    return densities[0] if len(set(densities)) == 1 else None


def _density_rule(density: float) -> str:
    """Return the rule that a density (g/mm3) breaks, "" if it is one of a material."""
    low, high = DENSITIES
    if low <= density <= high:
        return ""
    hints = [
        f"; {density:g} {unit} would be {density * share:.6g}"
        for unit, share in _OTHER_UNITS.items() if low <= density * share <= high
    ]  # fmt: skip
    return f"must be from {low:g} to {high:g} g/mm3, as of foams and metals{''.join(hints[:1])}"


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


def check_profile(reader: TableReader, series: Series, case: Case) -> None:
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


def _check_depths(reader: TableReader, series: Series, case: Case) -> None:
    """Refuse depths that no body has."""
    highest = min(ring.z[1] - ring.z[0] for ring in case.rings)
    rule = f"must be less than the height of a body, {highest:g} mm; look at the unit"
    deep = np.abs(series.value) > highest
    refuse_readings(reader, series, deep, f"{{value:g}} {series.unit}", rule)


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
