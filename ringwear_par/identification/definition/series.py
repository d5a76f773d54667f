"""``[[experiment.data]]``: from a table of a fit file to readings in the units of a case."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
from scipy.ndimage import median_filter

from ringwear_par.arrays import BoolArray, FloatArray, IntArray
from ringwear_par.cases.case import Case
from ringwear_par.cases.tables import TableReader
from ringwear_par.cases.text import shortened
from ringwear_par.cases.units import (
    assumption,
    factor,
    has_unit,
    in_unit_where_right,
    told_unit,
    unit_of_anything,
    unit_of_column,
)
from ringwear_par.cases.values import RejectedError
from ringwear_par.errors import InputError, legible
from ringwear_par.files.measurements import Measurements, and_more, read_measurements
from ringwear_par.identification.definition.problem import BASE, Nuisance, Quantity, Series
from ringwear_par.identification.definition.reading_limits import (
    check_profile,
    check_times,
    density_of,
)
from ringwear_par.identification.definition.schema import DATA, NUISANCE, NUISANCES, SD

#: what messages say of units
_UNITS = {
    "s": "a time, such as s, min or h", "mm": "a length, such as um, mm or inch",
    "N mm": "a torque, such as N mm or N m", "g": "a mass, such as mg or g",
    "mm^3": "a volume, such as mm^3 or um^3",
}  # fmt: skip
#: readings of which data are smoothed by their median
_SMOOTH = 9
#: of the largest reading: below it a relative error means nothing
_NEAR_ZERO = 0.05
#: of the test: noise that is correlated for longer is an offset
_LONGEST_CORRELATION = 100.0
#: readings of a record, and the share of the test: one that ends before may be in another unit
_RECORD, _SHORT_RECORD = 3, 0.1
#: of the test: times that are rounded, in minutes, say, may be so much later than its end
_ROUNDED = 2e-4

#: reads a table of measurements, once
Files = Callable[[str], Measurements]


class FileStore:
    """The files of data, each read once.

    Parameters
    ----------
    folder : from which their names count.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._read: dict[str, Measurements | InputError] = {}

    def __call__(self, name: str) -> Measurements:
        """Return a file's table.

        Raises
        ------
        InputError : it cannot be read; every time it is asked for.
        """
        if name not in self._read:
            try:
                self._read[name] = read_measurements(self._folder / name)
            except InputError as error:
                self._read[name] = error
        table = self._read[name]
        if isinstance(table, InputError):
            raise table
        return table

    @property
    def hashes(self) -> dict[str, str]:
        """SHA-256 of what has been read."""
        return {k: v.sha256 for k, v in self._read.items() if isinstance(v, Measurements)}


def read_series(
    said: str,
    table: Any,
    case: Case | None,
    files: Files,
    faults: list[str],
    *,
    plans: bool = False,
) -> Series | None:
    """Return the readings of one table, and add what is wrong with it to the faults.

    Parameters
    ----------
    said : how sentences about it begin.
    case : of the experiment; None where that has faults itself.
    plans : whether readings may be planned ones.
    """
    before = len(faults)
    reader = TableReader(said, table, faults, DATA)
    quantity = reader.read("quantity")
    if quantity is None:
        return None
    kind = quantity.partition(".")[0]
    reader.place = f"{said} ({quantity})"
    end = math.inf if case is None else case.time.end
    at = reader.read("at")
    density = density_of(reader, quantity, case) if kind == "mass" else 1.0
    if at is not None and at > end:
        reader.wrong("at", f"must be within the test, which ends at {end:g} s")
    timed = next((key for key in ("file", "times") if key in reader), "")
    if at is not None and timed and kind != "profile":
        reader.wrong("at", f"must be absent beside {timed}, whose readings have their times")
    where, once = ("r", ()) if kind == "profile" else ("times", ("value",))
    single_key = next((key for key in ("file", *once) if key in reader), "")
    if single_key and where in reader:
        reader.raw(where)
        reader.wrong(
            where, f"must be absent beside {single_key}; it is for readings that are planned"
        )
    if "file" in reader:
        readings = _from_file(reader, kind, files)
    elif "value" in reader and kind != "profile":
        readings = _single(reader, kind, end if at is None else at)
    else:
        readings = _planned(reader, kind, at, end, plans)
    if readings is None:
        return None
    x, value, unit, scale = readings.x, readings.value, readings.unit, readings.factor
    lines = readings.lines
    # the last time may be rounded, and the last one alone
    if kind != "profile" and len(x) and end < x[-1] <= end * (1.0 + _ROUNDED):
        x = np.append(x[:-1], end)
    keep = np.ones(len(x), dtype=bool)
    for low, high in _intervals(reader, "mm" if kind == "profile" else "s"):
        keep &= (x < low) | (x > high)
    sd, fitted = _sd(reader, readings, keep)
    nuisances = _nuisances(reader, kind, case)
    correlation = reader.read("correlation_time")
    if correlation > 0 and kind == "profile":
        reader.wrong("correlation_time", "must be absent for a profile, it is for noise in time")
    if correlation > _LONGEST_CORRELATION * end:
        reader.wrong(
            "correlation_time",
            f"must be at most {_LONGEST_CORRELATION:g} times the test, which ends at {end:g} s; "
            "noise that never changes is an offset",
        )
    reader.finish()
    if len(faults) > before:
        return None
    assumptions = readings.assumptions
    if kind != "profile" and readings.lines is not None and len(x) >= _RECORD:
        last = float(x.max())
        if 0.0 < last < _SHORT_RECORD * end:
            assumptions += (
                f"readings end at {last:.4g} s of a test of {end:g} s; look at the unit of time",
            )
    series = Series(
        quantity, cast(Quantity, quantity), x[keep], value[keep], sd[keep], fitted, unit, scale,
        (end if at is None else at) if kind == "profile" else None, density, nuisances,
        correlation, readings.where, None if lines is None else lines[keep], assumptions,
        readings.planned,
    )  # fmt: skip
    free = [nuisance.kind for nuisance in nuisances if nuisance.free]
    if not series.n:
        reader.fault("has no readings; must have one at least that is neither empty nor excluded")
        return None
    if case is not None:
        (check_profile if series.profile else check_times)(reader, series, case)
    if series.n <= len(free):
        reader.fault(
            f"has {series.n} reading{'s' if series.n > 1 else ''}; must have more than nuisances "
            f"without prior or bounds, {', '.join(free)}, which take all that they tell"
        )
    return series if len(faults) == before else None


@dataclass(frozen=True, eq=False)
class _Readings:
    """Readings and where they are from.

    Parameters
    ----------
    x, value : (n,) as a series has them.
    unit, factor : of the data, and how much it is in the units of a case.
    assumptions : sentences about columns whose unit nobody names.
    data, rows : the table and which of its rows have readings; None of others.
    lines, where : of the readings; None and "" without a table.
    planned : whether nothing has been read yet.
    """

    x: FloatArray
    value: FloatArray
    unit: str
    factor: float
    assumptions: tuple[str, ...] = ()
    data: Measurements | None = None
    rows: BoolArray | None = None
    lines: IntArray | None = None
    where: str = ""
    planned: bool = False


def _single(reader: TableReader, kind: str, at: float) -> _Readings | None:
    single = reader.read("value")
    unit, scale = _unit(reader, kind)
    if single is None or scale is None:
        return None
    return _Readings(np.array([at]), np.array([scale * single]), unit, scale)


def _planned(
    reader: TableReader, kind: str, at: float | None, end: float, plans: bool
) -> _Readings | None:
    """Return readings that are to be taken, or why there are none in words."""
    where = "r" if kind == "profile" else "times"
    file_keys = {"columns", "units"} & reader.keys()
    once = kind in ("mass", "volume") or (at is not None and kind != "profile")
    usual = "value" if once else "file"
    must = {
        "mass": "must be a finite number", "volume": "must be a finite number",
        "profile": "must be the name of a table of depths over radii",
    }.get(kind, "must be the name of a table")  # fmt: skip
    if file_keys or not (once or where in reader):
        for key in file_keys:
            reader.raw(key)
        reader.wrong(
            "file" if file_keys else usual,
            f"{must}; or {where} of planned readings, for --dry-run and design",
        )
        return None
    x = np.array([end if at is None else at])
    if where in reader:
        x = reader.read(where)
    unit, scale = _unit(reader, kind)
    if not plans:
        reader.wrong(usual, f"{must}; planned readings are for --dry-run and ringwear design only")
    if x is None or scale is None:
        return None
    return _Readings(x, np.zeros(len(x)), unit, scale, planned=True)


def _unit(reader: TableReader, kind: str) -> tuple[str, float | None]:
    unit = str(reader.raw("unit") or "")
    return unit, _factor(reader, "unit", unit, BASE[kind])


def _from_file(reader: TableReader, kind: str, files: Files) -> _Readings | None:
    name = reader.read("file")
    for key in ("value", "unit"):
        if key in reader:
            reader.raw(key)
            reader.wrong(key, "must be absent beside file")
    roles = ("r" if kind == "profile" else "time", "value")
    columns, units = reader.raw("columns", {}), reader.raw("units", {})
    for key, table in (("columns", columns), ("units", units)):
        wrong = not isinstance(table, Mapping) or set(table) - set(roles)
        if wrong or not all(isinstance(entry, str) for entry in table.values()):
            reader.wrong(key, f"must be a table of texts, for {' and '.join(roles)}")
            return None
    if name is None:
        return None
    try:
        data = files(name)
    except InputError as error:
        for fault in error.faults:
            reader.fault(fault)
        return None
    column_names, units_by_role, factors = {}, {}, {}
    assumed: list[str] = []  # roles
    for role in roles:
        column = columns.get(role, role)
        if column not in data.columns:
            reader.fault(
                f"{data.name}: has no column {legible(column)} for {role}; must be one of "
                f"{legible(', '.join(data.columns), 200)}"
            )
            continue
        base = BASE[kind if role == "value" else role]
        try:
            unit = units.get(role) or told_unit(data.label(column), base) or ""
        except RejectedError as reason:
            reader.fault(
                f"{data.name}: the column {legible(column)} {reason}; must be in the unit of "
                f"{_UNITS[base]}, or units.{role} must be given"
            )
            continue
        if not unit:
            unit = base
            assumed.append(role)
        scale = _factor(reader, f"units.{role}", unit, base)
        if scale is None:
            continue
        if named := _other_unit(data.label(column), unit):
            reader.fault(
                f"units.{role} = {shortened(unit)}: the column {legible(column)} of {data.name} is "
                f"in {named} by its name; must be the same unit"
            )
        column_names[role], units_by_role[role], factors[role] = column, unit, scale
    if len(column_names) < len(roles):
        return None
    rows = data.filled(*column_names.values())
    if "time" in column_names:
        rows = data.first_stamps(column_names["time"], rows)
    hour = factor("h", "s") / factors["time"] if "time" in roles else None
    x = factors[roles[0]] * _column(reader, data, column_names[roles[0]], rows, hour)
    value = factors["value"] * _column(reader, data, column_names["value"], rows)
    if "time" in assumed and data.names_seconds(column_names["time"], rows):
        assumed.remove("time")
    return _Readings(
        x, value, units_by_role["value"], factors["value"],
        tuple(assumption(column_names[role], units_by_role[role]) for role in assumed), data, rows,
        data.lines[rows], data.name,
    )  # fmt: skip


def _other_unit(column: str, unit: str) -> str:
    """Return the unit that a column's name ends with where it is not this one, else ""."""
    named = unit_of_column(column, unit)
    return "" if named is None or math.isclose(factor(named, unit), 1.0) else legible(named)


def _column(
    reader: TableReader, data: Measurements, name: str, rows: BoolArray, hour: float | None = None
) -> FloatArray:
    try:
        return data.numbers(name, rows, hour)
    except InputError as error:
        for fault in error.faults:
            reader.fault(fault)
        return np.full(int(rows.sum()), np.nan)


def _factor(reader: TableReader, key: str, unit: str, base: str) -> float | None:
    try:
        return factor(unit, base)
    except RejectedError:
        state = f"= {shortened(unit)}" if unit else "is missing"
        reader.fault(f"{key} {state}: must be the unit of {_UNITS[base]}")
        return None


def _intervals(reader: TableReader, unit: str) -> list[tuple[float, float]]:
    """Return the intervals of ``exclude``, in a unit."""
    value = in_unit_where_right(reader.raw("exclude", []), unit)
    good = isinstance(value, list | tuple) and all(
        isinstance(entry, list | tuple)
        and len(entry) == 2
        and all(isinstance(v, int | float) and math.isfinite(v) for v in entry)
        and entry[0] < entry[1]
        for entry in value
    )
    if not good:
        reader.wrong("exclude", "must be a list of increasing pairs (mm of a profile, else s)")
        return []
    return [(float(low), float(high)) for low, high in value]


def _sd(reader: TableReader, readings: _Readings, keep: BoolArray) -> tuple[FloatArray, bool]:
    """Return the standard deviation of each reading, and whether it is to be fitted."""
    entry, value, data = reader.raw("sd"), readings.value, readings.data
    unknown = np.full(len(value), np.nan)
    named = isinstance(entry, str) and not has_unit(entry)
    if readings.planned and (named or isinstance(entry, Mapping)):
        reader.wrong("sd", "must be a number > 0, in unit, of readings that are planned")
        return unknown, False
    if named and entry != "fit":
        if data is None:
            reader.wrong("sd", "must be a number > 0 or { relative = x }")
            return unknown, False
        return _sd_column(reader, entry, readings), False
    if entry == "fit":
        if keep.sum() < _SMOOTH:
            more = "" if keep.all() else " that are not excluded"
            reader.wrong("sd", f'must be a number: "fit" needs {_SMOOTH} readings at least{more}')
        return np.full(len(value), _scatter(value[keep])), True
    if isinstance(entry, Mapping):
        share = TableReader(f"{reader.place}: sd", entry, [], SD)
        relative = share.read("relative")
        if relative is None or set(entry) != {"relative"}:
            reader.wrong("sd", "must be { relative = x }, a number > 0")
            return unknown, False
        if not len(value):  # which is told of all readings
            return unknown, False
        smooth = np.abs(median_filter(value, min(_SMOOTH, len(value)), mode="nearest"))
        small = smooth <= _NEAR_ZERO * smooth.max(initial=0.0)
        if small.any():
            line = ""
            if readings.lines is not None:
                line = f"{readings.where}: line {readings.lines[np.flatnonzero(small)[0]]}: "
            reader.wrong(
                "sd", f"{line}must be in the data's unit where readings are near zero, as here"
            )
            return unknown, False
        return relative * smooth, False
    single = reader.read("sd", unit=readings.unit)
    return np.full(len(value), math.nan if single is None else readings.factor * single), False


def _sd_column(reader: TableReader, column: str, readings: _Readings) -> FloatArray:
    """Return the standard deviations in a column of a table."""
    data, rows, lines = readings.data, readings.rows, readings.lines
    assert data is not None
    assert rows is not None
    assert lines is not None
    unknown = np.full(len(readings.value), np.nan)
    if column not in data.columns:
        reader.wrong(
            "sd", f'must be a number, "fit", {{ relative = x }} or a column of {data.name}'
        )
        return unknown
    label = data.label(column)
    named = _other_unit(label, readings.unit)
    if not named and unit_of_column(label, readings.unit) is None:
        named = legible(unit_of_anything(label) or "")
    if named:
        reader.wrong(
            "sd",
            f"the column is in {named} by its name; must be in {readings.unit}, as the readings",
        )
        return unknown
    filled = data.filled(column)[rows]
    if not filled.all():
        reader.fault(
            f"{readings.where}: line {lines[~filled][0]}: {column} is empty; must be a number > 0"
        )
        return unknown
    sd = readings.factor * _column(reader, data, column, rows)
    if (wrong := np.flatnonzero(sd <= 0)).size:
        values = f"{column} = {sd[wrong[0]] / readings.factor:g}{and_more(wrong.size, 'line')}"
        reader.fault(f"{readings.where}: line {lines[wrong[0]]}: {values}: must be a number > 0")
    return sd


def _scatter(value: FloatArray) -> float:
    """Return a guess of the noise of readings: what second differences scatter by."""
    second = np.abs(np.diff(value, 2)) / math.sqrt(6.0)
    guess = 1.4826 * float(np.median(second)) if len(second) else 0.0
    return guess or 1e-3 * float(np.abs(value).max(initial=0.0)) or 1e-9


def _nuisances(reader: TableReader, kind: str, case: Case | None) -> tuple[Nuisance, ...]:
    table = reader.raw("nuisance", {})
    if not isinstance(table, Mapping):
        reader.wrong("nuisance", f"must be a table of {', '.join(NUISANCES[kind])}")
        return ()
    nuisances = []
    for name, entry in table.items():
        if name not in NUISANCES[kind]:
            reader.fault(f"nuisance.{legible(name)}: must be one of {', '.join(NUISANCES[kind])}")
            continue
        entry_reader = TableReader(
            f"{reader.place}: nuisance.{name}", entry, reader.faults, NUISANCE
        )
        bounds, prior = entry_reader.read("bounds"), entry_reader.read("prior")
        nuisances.append(Nuisance(name, prior, bounds))
        entry_reader.finish()
        if name == "compliance" and case is not None and case.load.force is None:
            entry_reader.fault('needs load.control = "force"')
    return tuple(nuisances)
