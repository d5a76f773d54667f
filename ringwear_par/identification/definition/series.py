"""``[[experiment.data]]``: from a table of a fit file to readings in the units of a case."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray, IntArray
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
    body = quantity.partition(".")[2]
    densities = (
        (None,) if case is None else (case.lower if body == "lower" else case.upper).densities
    )
    case_density = densities[0] if len(set(densities)) == 1 else None
    if reader.raw("density") is None and len(densities) > 1:
        _check_densities(reader, body, densities)
        return case_density
    if "density" not in reader and case_density is None:
        if case is not None:  # else that of the case may be there
            reader.wrong("density", f"must be given here, or as {body}.density of the case (g/mm3)")
        return None
    density: float | None = reader.read("density", case_density)
    if density is not None and (rule := _density_rule(density)):
        reader.wrong("density", rule)
    return density


def _check_densities(reader: TableReader, body: str, densities: Sequence[float | None]) -> None:
    """Refuse a mass of a body some of whose layers have no density, or one that nothing has."""
    keys = density_keys(body, len(densities) - 1)
    missing = ", ".join(key for key, density in zip(keys, densities, strict=True) if not density)
    if missing:
        reader.wrong(
            "density", f"must be that of all that is lost, or the case must have {missing} (g/mm3)"
        )
    for key, density in zip(keys, densities, strict=True):
        if density and (rule := _density_rule(density)):
            reader.fault(f"{key} = {density:g}: {rule}")


def _density_rule(density: float) -> str:
    """Return the rule that a density (g/mm3) breaks, "" if it is one of a material."""
    low, high = DENSITIES
    if low <= density <= high:
        return ""
    hint = next(
        (
            f"; {density:g} {unit} would be {density * share:.6g}"
            for unit, share in _OTHER_UNITS.items()
            if low <= density * share <= high
        ),
        "",
    )
    return f"must be from {low:g} to {high:g} g/mm3, as of foams and metals{hint}"


def check_times(reader: TableReader, series: Series, end: float) -> None:
    """Refuse times that do not increase, or outside the test."""
    x, lines = series.x, lines_of(series)
    if (late := np.flatnonzero(np.diff(x) <= 0)).size:
        i = int(late[0])
        reader.fault(
            f"{lines[i + 1]}time {x[i + 1]:g} s after {x[i]:g} s{_more(late)}: times must increase"
        )
    if (outside := np.flatnonzero((x < 0) | (x > end))).size:
        i = int(outside[0])
        reader.fault(
            f"{lines[i]}time {x[i]:g} s{_more(outside)}: must be within the test, from 0 "
            f"to {end:g} s (time.end)"
        )


def check_profile(reader: TableReader, series: Series, case: Case) -> None:
    """Refuse radii that are not those of the body."""
    ring = getattr(case, series.body)
    if (outside := np.flatnonzero((series.x < ring.r[0]) | (series.x > ring.r[1]))).size:
        i, hint = int(outside[0]), ""
        if ring.r[0] <= series.x[i] / 1e3 <= ring.r[1]:
            hint = "; it is a thousand times too large: look at units.r"
        reader.fault(
            f"{lines_of(series)[i]}r = {series.x[i]:g} mm{_more(outside)}: must be on the "
            f"{series.body} body, from {ring.r[0]:g} to {ring.r[1]:g} mm{hint}"
        )
    a, b = case.contact
    if not ((series.x >= a) & (series.x <= b)).any():
        reader.fault(
            f"{series.file or 'r'}: has no reading within the contact, {a:g} to {b:g} mm; must "
            "have one at least"
        )


def _check_depths(reader: TableReader, series: Series, case: Case) -> None:
    """Refuse depths that no body has."""
    highest = min(ring.z[1] - ring.z[0] for ring in case.rings)
    i = int(np.argmax(np.abs(series.value)))
    if abs(series.value[i]) > highest:
        reader.fault(
            f"{lines_of(series)[i]}{series.value[i]:g} mm: must be less than the height of a body, "
            f"{highest:g} mm; look at the unit"
        )


def _more(wrong: IntArray) -> str:
    return and_more(len(wrong), "reading")
