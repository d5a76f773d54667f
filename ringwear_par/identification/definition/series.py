"""``[[experiment.data]]`` and ``[[experiment.input]]``: readings in the units of a case."""

import math
from dataclasses import replace

import numpy as np

from ringwear_par.arrays import BoolArray
from ringwear_par.cases.case import Case, density_keys
from ringwear_par.cases.files.columns import FileStore
from ringwear_par.cases.tables import TableReader
from ringwear_par.errors import counted
from ringwear_par.files.measurements import and_more
from ringwear_par.files.smoothing import MOST_POINTS
from ringwear_par.identification.definition.data_sources import (
    line_of,
    read_censored,
    read_noise,
    read_readings,
    warn_once,
)
from ringwear_par.identification.definition.problem import (
    GROWTH_TIME,
    READING_KINDS,
    MeasuredInput,
    Nuisance,
    Series,
    friction_power,
)
from ringwear_par.identification.definition.schema import (
    DENSITIES,
    FEWEST_READINGS,
    check_start,
    inner,
    read_all,
    refuse,
)
from ringwear_par.schedules import in_time

#: share of the test that an input must cover
_COVERED = 0.95
#: coefficients of friction, from rolling to clean metals; others are likely in another unit
_FRICTIONS = 1e-3, 2.0
#: largest correlation time, in lengths of the test: noise correlated for longer is an offset
_LONGEST_CORRELATION = 100.0
#: a time constant is fitted within so many sd of its prior about the prior's mean
_PRIOR_REACH = 4.0
#: schema of all nuisances but thermal growth
_NUISANCE = "experiment.data.nuisance.KIND"
#: blocks of equal time of a test, in which the readings of a long record are averaged
BLOCKS = 500


def read_series(reader: TableReader, case: Case | None, files: FileStore) -> Series | None:
    """Return the readings of a table; None, and its faults, where it has some.

    Parameters
    ----------
    case : of its test; one that has faults itself is None.
    """
    before, quantity = len(reader.faults), reader.read("quantity")
    if quantity is None:
        return None
    kind, _, body = quantity.partition(".")
    reader.place = f"{reader.place} ({quantity})"
    end = math.inf if case is None else case.time.end
    density = _density(reader, body, case) if kind == "mass" else 1.0
    if kind == "through" and case is not None and not getattr(case, body).layers:
        reader.fault(f"{body} has no layers; must have one at least")
    nuisances = _nuisances(reader, kind, case)
    if kind == "profile":
        refuse(reader, "for a profile, it is for noise in time", "correlation_time")
    correlation = reader.read("correlation_time")
    if correlation > _LONGEST_CORRELATION * end:
        rule = f"must be at most {_LONGEST_CORRELATION:g} times the test, which ends at {end:g} s"
        reader.wrong("correlation_time", f"{rule}; noise that never changes is an offset")
    read = read_readings(reader, kind, end, files)
    for name in ("sd", "censored"):
        reader.raw(name)
    reader.finish()
    if read is None:
        return None
    series, data = read
    sd, fitted = read_noise(reader, series, data)
    series = replace(
        series, name=quantity, quantity=quantity, sd=sd, sd_fitted=fitted, density=density,
        nuisances=nuisances, correlation_time=correlation,
        censored=read_censored(reader, series.n, data),
    )  # fmt: skip
    if case is not None and len(reader.faults) == before:
        _check(reader, series, case)
    return series if len(reader.faults) == before else None


def _check(reader: TableReader, series: Series, case: Case) -> None:
    """Refuse a series without readings, or with too few, or with some that a case cannot have."""
    if not series.n:
        reader.fault("has no readings; must have one at least that is neither empty nor excluded")
        return
    if series.profile:
        (low, high), x = getattr(case, series.body).r, series.x
        rule = f"must be on the {series.body} body, from {low:g} to {high:g} mm"
        _refuse_readings(reader, series, (x < low) | (x > high), "r = {x:g} mm", rule)
    else:
        _check_times(reader, series, case.time.end)
    height = min(ring.z[1] - ring.z[0] for ring in case.rings)
    body = getattr(case, series.body)
    volume = math.pi * (body.r[1] ** 2 - body.r[0] ** 2) * (body.z[1] - body.z[0])
    mass = volume * (series.density or max(body.densities))
    of_body = {"mm": ("height", height), "mm^3": ("volume", volume), "g": ("mass", mass)}
    size, most = of_body.get(unit := READING_KINDS[series.kind].unit, ("", math.inf))
    rule = f"must be less than the {size} of a body, {most:g} {unit}; look at the unit"
    beyond = np.abs(series.value) > most
    _refuse_readings(reader, series, beyond, f"{{value:g}} {series.unit}", rule)
    free = [nuisance.kind for nuisance in series.nuisances if nuisance.free]
    if series.n <= len(free):
        rule = f"must have more than nuisances without prior or bounds, {', '.join(free)}"
        reader.fault(f"has {counted(series.n, 'reading')}; {rule}, which fit so few exactly")


def _nuisances(reader: TableReader, kind: str, case: Case | None) -> tuple[Nuisance, ...]:
    table, allowed = inner(reader, "nuisance"), READING_KINDS[kind].nuisances
    nuisances = list[Nuisance]()
    for name in allowed:
        table.raw(name)
    table.finish()
    for name in [*table.keys()]:  # in their order
        if name == "thermal" and name in allowed:
            nuisances += _growth(inner(table, name), case)
        elif name in allowed:
            nuisances.append(Nuisance(name, *read_all(inner(table, name, _NUISANCE))))
        if name == "compliance" and case is not None and case.load.force is None:
            table.wrong(name, 'needs load.control = "force"', "conflict")
    return tuple(nuisances)


def _growth(reader: TableReader, case: Case | None) -> list[Nuisance]:
    """Return the growth of a warm rig, and its time constant, s."""
    faults, power = reader.faults, reader.read("power")
    prior, bounds = read_all(inner(reader, "amplitude", _NUISANCE))
    grown = Nuisance("thermal", prior, bounds, power=power)
    if power and case and not (case.load.force and friction_power(case)[1].any()):
        rule = 'needs load.control = "force" and friction power, mu F omega > 0, at some time'
        reader.wrong("power", rule, "conflict")
    before, time = len(faults), inner(reader, "time")
    start, prior, bounds = read_all(time)
    reader.finish()
    if not {"prior", "bounds"} & time.keys():
        time.fault("has neither prior nor bounds; must have one of them at least", code="missing")
    if len(faults) > before:
        return []
    if bounds is None:
        reach = _PRIOR_REACH * prior.sd
        bounds = max(prior.mean - reach, 0.01 * prior.mean), prior.mean + reach
    check_start(time, start, bounds)
    return [grown, Nuisance(GROWTH_TIME, prior, bounds, start, power)]


def _density(reader: TableReader, body: str, case: Case | None) -> float | None:
    """Return the density of all that a body loses, g/mm3; None where each layer has its own.

    Refuse one of the case that is not known, or that nothing has, as that in another unit.
    """
    density: float | None = reader.read("density")
    if "density" in reader or case is None:
        return density
    densities = getattr(case, body).densities
    (low, high), keys = DENSITIES, density_keys(body, len(densities) - 1)
    wrong = [
        f"{key} = {value:g}" if value else key
        for key, value in zip(keys, densities, strict=True)
        if not (value and low <= value <= high)
    ]
    if wrong:
        rule = f"must be given here, or in the case ({', '.join(wrong)})"
        reader.wrong("density", f"{rule}, from {low:g} to {high:g} g/mm3")
    return densities[0] if len(set(densities)) == 1 else None


def _refuse_readings(
    reader: TableReader, series: Series, wrong: BoolArray, words: str, rule: str
) -> None:
    """Refuse readings where some (n,) are wrong: the first one in words with {x} and {value}."""
    if wrong.any():
        i = int(wrong.argmax())
        first = words.format(x=series.x[i], value=series.value[i] / series.factor)
        more = and_more(int(wrong.sum()), "reading")
        reader.fault(f"{line_of(series, i)}{first}{more}: {rule}")


def _check_times(reader: TableReader, series: Series, end: float) -> None:
    """Refuse times that do not increase, or outside the test."""
    x = series.x
    late = np.diff(x, prepend=-np.inf) <= 0
    _refuse_readings(reader, series, late, "time {x:g} s", "times must increase")
    rule = f"must be within the test, from 0 to {end:g} s (time.end)"
    _refuse_readings(reader, series, (x < 0) | (x > end), "time {x:g} s", rule)


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


def read_input(
    key: str, reader: TableReader, case: Case | None, files: FileStore
) -> MeasuredInput | None:
    """Return a measured input of a case; None, and faults, where it is wrong or the case is."""
    before, of_torque = len(reader.faults), key == "contact.friction"
    end = math.inf if case is None else case.time.end
    reader.place = f"{reader.place} ({key})"
    smooth, scale = reader.read("smooth"), reader.read("scale")
    reader.read("quantity")
    if ("quantity" in reader) is not of_torque:
        rule = 'must be "torque" for contact.friction, and absent for other keys'
        reader.wrong("quantity", rule, "conflict")
    kind = "torque" if of_torque else key.partition(".")[2]
    read = read_readings(reader, kind, end, files)
    reader.finish()
    if read is None or case is None or len(reader.faults) > before:
        return None
    series = replace(read[0], name=key)
    x, value = series.x, series.value
    _check_times(reader, series, end)
    if len(x) < FEWEST_READINGS:
        reader.fault(f"has {len(x)} readings; must have {FEWEST_READINGS} at least")
    elif (covered := float(np.ptp(x)) / end) < _COVERED and not files.growing:
        state = f"readings from {x[0]:g} to {x[-1]:g} s cover {100.0 * covered:.3g} % of the test"
        reader.fault(f"{state}; must cover {100.0 * _COVERED:g} % at least")
    if smooth == "none" and len(x) > MOST_POINTS:
        reader.wrong("smooth", f'must be "auto" or a time with more than {MOST_POINTS} readings')
    low = value <= 0.0 if of_torque else value < 0.0
    hint = "look at its sign" if low.all() else "exclude leaves out times of stops, say"
    rule = f"must be {'>' if of_torque else '>='} 0; {hint}"
    _refuse_readings(reader, series, low, f"{{value:g}} {series.unit}", rule)
    force = case.load.force
    if of_torque and force is None:
        reader.fault('needs load.control = "force"', "key", "conflict")
    elif of_torque and force is not None and (no_load := in_time(force, x) <= 0.0).any():
        first = f"the load is 0 at {x[no_load][0]:g} s"
        reader.fault(f"{first}; exclude must leave out readings without load")
    if len(reader.faults) > before:
        return None
    entry = MeasuredInput(key, series, smooth, scale, 0.5 * sum(case.contact))
    typical, (least, most) = float(np.median(entry.readings(case))), _FRICTIONS
    if of_torque and not least <= typical <= most:
        warn_once(
            f"{series.file}: readings in {series.unit} mean a friction of {typical:.3g}, where "
            f"contacts have {least:g} to {most:g}; look at the unit of the torque, and at the load"
        )
    return entry
