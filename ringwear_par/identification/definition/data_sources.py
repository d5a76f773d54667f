"""``[[experiment.data]]``: where readings come from (file, value, plan), their noise and limits."""

import logging
import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from scipy.ndimage import median_filter

from ringwear_par.arrays import BoolArray, FloatArray, IntArray
from ringwear_par.cases.files.columns import (
    UNITS,
    FileStore,
    missing_column,
    no_unit,
    read_texts,
    unit_by_name,
)
from ringwear_par.cases.tables import TableReader
from ringwear_par.cases.units import (
    factor,
    has_unit,
    number_and_unit,
    unit_of_column,
)
from ringwear_par.cases.values import RejectedError
from ringwear_par.errors import InputError, legible
from ringwear_par.files.measurements import Measurements
from ringwear_par.files.table_text import is_clock
from ringwear_par.files.text import shortened
from ringwear_par.identification.definition.problem import BASE, Series
from ringwear_par.identification.definition.schema import inner, keys_of, read_all, refuse

log = logging.getLogger(__name__)

#: window of the running median that smooths data, in readings
_SMOOTH = 9
#: share of the largest reading below which a relative error means nothing
_NEAR_ZERO = 0.05
#: by word: the true value is at most the reading (-1), at least (1), or equal to it (0)
_SIDES = {"below": -1, "above": 1, "": 0}
#: share of the test by which times may be later than its end, as when rounded to minutes
_ROUNDED = 2e-4
#: keys of a file, and all that tell where readings are from
_OF_FILE = ("columns", "units", "skip", "drop")
_SOURCES = ("file", *_OF_FILE, "value", "unit", "times", "r")


@dataclass(frozen=True, eq=False)
class Readings:
    """Readings whose noise is not known yet, and where they are from."""

    series: Series
    #: the table and which of its rows have readings; None of others.
    data: Measurements | None = None
    rows: BoolArray | None = None


@contextmanager
def _as_faults(reader: TableReader, key: str) -> Iterator[None]:
    """Add the faults of an InputError to those of a key."""
    try:
        yield
    except InputError as error:
        for fault in error.faults:
            reader.fault(fault, key)


def read_readings(
    reader: TableReader, kind: str, at: float | None, end: float, files: FileStore
) -> Readings | None:
    """Return the readings of a table of a fit file at ``at`` (s) or until the end (s) of the test.

    None, and faults, where there are none; ``kind`` is a name in ``READING_KINDS``.
    """
    for name in _SOURCES:
        if name in keys_of(reader.loc):
            reader.raw(name)
    where = "r" if kind == "profile" else "times"
    if "file" in reader and kind != "through":
        refuse(reader, "beside file", "value", "unit", "times", "r")
        return _from_file(reader, kind, end, files)
    planned, unit = kind == "profile" or "value" not in reader, reader.raw("unit", "")
    once = kind in ("mass", "volume", "through") or (at is not None and kind != "profile")
    if planned and not once and where not in reader:
        rule = f"must be given, or {where} of planned readings"
        reader.wrong("file", rule)
        return None
    refuse(reader, f"with {where if planned else 'value'}", "file", *_OF_FILE)
    x, value, key = np.array([end if at is None else at]), 0.0, "unit"
    if planned:
        refuse(reader, f"of a {kind}", "times" if kind == "profile" else "r")
        x = reader.read(where) if where in reader else x
    else:
        refuse(reader, "beside value", "times", "r")
        written = reader.raw("value")
        if isinstance(written, str) and "unit" not in reader:
            key, unit = "value", number_and_unit(written)[1] if has_unit(written) else BASE[kind]
    try:
        scale = factor(str(unit), BASE[kind])
    except RejectedError:
        reader.wrong(key, f"must be the unit of {UNITS[BASE[kind]]}", "unit")
        return None
    if not planned:
        value = reader.read("value", unit=str(unit))
    if x is None or value is None:
        return None
    values = np.full(len(x), scale * value)
    series = _series(kind, x, values, end, unit=str(unit), factor=scale, planned=planned)
    return Readings(series)


def _series(kind: str, x: FloatArray, value: FloatArray, end: float, **more: Any) -> Series:
    """Return times or radii (n,) and values, in the units of a case, as a series."""
    if kind == "through":  # and may be after the end
        x = np.minimum(value, end)
    elif kind != "profile" and len(x) and end < x[-1] <= end * (1.0 + _ROUNDED):
        x = np.append(x[:-1], end)
    return Series(kind, kind, x, value, np.full(len(x), np.nan), **more)


def _from_file(reader: TableReader, kind: str, end: float, files: FileStore) -> Readings | None:
    name, skip, drop = (reader.read(key) for key in ("file", "skip", "drop"))
    roles = ("r" if kind == "profile" else "time", "value")
    columns, units = (read_texts(reader, key, roles) for key in ("columns", "units"))
    data: Measurements | None = None
    if name is not None:
        with _as_faults(reader, "file"):
            data = files(name, skip, drop)
    if columns is None or units is None or data is None:
        return None
    if not columns and len(data.columns) == len(roles) and not {*roles} & {*data.columns}:
        columns = dict(zip(roles, data.columns, strict=True))
    names = [columns.get(role, role) for role in roles]
    bases = BASE[roles[0]], BASE[kind]
    of_x, of_value = (
        _column_unit(reader, data, role, name, units.get(role), base)
        for role, name, base in zip(roles, names, bases, strict=True)
    )
    if of_x is None or of_value is None:
        return None
    (_, x_scale), (unit, scale) = of_x, of_value
    rows, hour, timed = data.filled(*names), None, roles[0] == "time"
    if timed:
        rows, hour = data.first_stamps(names[0], rows), 3600.0 / x_scale
    x, value = np.full((2, int(rows.sum())), np.nan)
    with _as_faults(reader, "file"):
        x = x_scale * data.numbers(names[0], rows, hour)
    with _as_faults(reader, "file"):
        value = scale * data.numbers(names[1], rows)
    if timed and len(x) and x[0] > end and is_clock(first := data.first_cell(names[0])):
        x = x - x[0]
        begin = f"{data.name}: the times begin with {legible(first)}, after the end of the test"
        warn_once(f"{begin}; they are taken as times of day, that of the first reading as 0")
    series = _series(
        kind, x, value, end, unit=unit, factor=scale, lines=data.lines[rows], file=data.name
    )
    return Readings(series, data, rows)


@cache
def warn_once(sentence: str) -> None:
    """Warn of readings, once: those of a running test are read again and again."""
    log.warning("%s", sentence)


def _column_unit(
    reader: TableReader, data: Measurements, role: str, column: str, unit: str | None, base: str
) -> tuple[str, float] | None:
    """Return the unit of a column, and its size in that of the program.

    None, and a fault, where there is no such column, no unit, or that of something else.
    """
    state, hint = f"units.{role} = {shortened(unit)}:", f", or units.{role} must be given"
    if missing := missing_column(data, column, role):
        reader.fault(missing, "columns")
        return None
    try:
        if unit:
            named = unit_of_column(data.label(column), base)
        else:
            named = unit_by_name(data, column, base, hint)
        if not (unit or named) and role == "time" and data.begins_with_stamp(column):
            named = base
        scale = factor(unit or named or "", base)
    except InputError as error:
        reader.fault(error.faults[0], "units")
    except RejectedError:
        wrong = f"{state} must be the unit of {UNITS[base]}"
        sentence = wrong if unit else no_unit(data, column, base, hint)
        reader.fault(sentence, f"units.{role}", "unit")
    else:
        if not (unit and named) or math.isclose(factor(named, base), scale):
            return unit or named or "", scale
        by_name = f"the column {legible(column)} of {data.name} is in {legible(named)} by its name"
        reader.fault(f"{state} {by_name}; must be the same unit", "units", "unit")
    return None


def read_noise(reader: TableReader, readings: Readings, keep: BoolArray) -> tuple[FloatArray, bool]:
    """Return the standard deviation of each reading, and whether it is to be fitted."""
    entry, series, data = reader.raw("sd"), readings.series, readings.data
    value, unknown = series.value, np.full(series.n, np.nan)
    named, relative = isinstance(entry, str) and not has_unit(entry), isinstance(entry, Mapping)
    if series.planned and (named or relative):
        reader.wrong("sd", "must be a number > 0, in unit, of readings that are planned")
    elif entry == "fit":
        if keep.sum() < _SMOOTH:
            more = "" if keep.all() else " that are not excluded"
            reader.wrong("sd", f'must be a number: "fit" needs {_SMOOTH} readings at least{more}')
        return np.full(series.n, _scatter(value[keep])), True
    elif relative:
        (share,) = read_all(inner(reader, "sd"))
        smooth = np.abs(median_filter(value, min(_SMOOTH, series.n) or 1, mode="nearest"))
        small = smooth <= _NEAR_ZERO * smooth.max(initial=0.0)
        if share is not None and small.any():
            rule = "must be in the data's unit where readings are near zero, as here"
            reader.wrong("sd", lines_of(series)[int(small.argmax())] + rule)
        return unknown if share is None else share * smooth, False
    elif named and (data is None or entry not in data.columns):
        column = "" if data is None else f', "fit", a column of {data.name}'
        reader.wrong("sd", f"must be a number > 0{column} or {{ relative = x }}")
    elif named:
        return _sd_column(reader, str(entry), readings), False
    elif (single := reader.read("sd", unit=series.unit)) is not None:
        return np.full(series.n, series.factor * single), False
    return unknown, False


def _sd_column(reader: TableReader, column: str, readings: Readings) -> FloatArray:
    """Return the standard deviations in a column, in its own unit or that of the readings."""
    data, rows, base = readings.data, readings.rows, BASE[readings.series.kind]
    assert data is not None
    assert rows is not None
    sd, filled = np.full(len(data.rows), np.nan), rows & data.filled(column)
    with _as_faults(reader, "sd"):
        unit = unit_by_name(data, column, base) or readings.series.unit
        sd[filled] = factor(unit, base) * data.numbers(column, filled)
        if (wrong := np.flatnonzero(rows & ~(sd > 0.0))).size:
            place = data.cell_place(column, int(wrong[0]), wrong.size)
            raise InputError(f"{place}: must be a number > 0")
    return sd[rows]


def lines_of(series: Series) -> list[str]:
    """Return where readings stand, as sentences about them begin; "" of those in no file."""
    if series.lines is None:
        return [""] * series.n
    return [f"{series.file}: line {line}: " for line in series.lines.tolist()]


def _scatter(value: FloatArray) -> float:
    """Return a guess of the noise of readings, by the scatter of their second differences."""
    second = np.abs(np.diff(value, 2)) / math.sqrt(6.0)
    guess = 1.4826 * float(np.median(second)) if len(second) else 0.0
    return guess or 1e-3 * float(np.abs(value).max(initial=0.0)) or 1e-9


def read_censored(reader: TableReader, readings: Readings) -> IntArray | None:
    """Return the sides (n,) at which readings are limits: -1 at most, 1 at least; None for none."""
    word, data, rows = reader.read("censored"), readings.data, readings.rows
    if word is None or word in _SIDES:
        return None if word is None else np.full(readings.series.n, _SIDES[word])
    if data is None or rows is None or word not in data.columns:
        where = "" if data is None else f", or a column of {data.name}"
        reader.wrong("censored", f'must be "below" or "above"{where}')
        return None
    sides = [_SIDES.get(cell.strip()) for cell in data.cells(word)]
    wrong = [row for row in np.flatnonzero(rows).tolist() if sides[row] is None]
    if wrong:
        place = data.cell_place(word, wrong[0], len(wrong))
        reader.fault(f"{place}: must be below, above or empty", "censored")
        return None
    return np.array([side for side, read in zip(sides, rows.tolist(), strict=True) if read])
