"""Where readings and measured inputs come from (file, value, plan), their noise and limits."""

import logging
import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from itertools import compress

import numpy as np
from scipy.ndimage import median_filter

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.cases.files.columns import (
    UNITS,
    FileStore,
    missing_column,
    no_unit,
    read_intervals,
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
from ringwear_par.errors import Fault, InputError, legible
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
#: keys that go with the one that tells the readings, or with none, by kind
_OF_FILE, _OF_NUMBERS = ("columns", "units", "skip", "drop"), ("unit", "at")
_SOURCES: dict[str, dict[str, tuple[str, ...]]] = {
    "profile": {"file": (*_OF_FILE, "at"), "r": _OF_NUMBERS},
    "through": {"value": ("unit",), "": ("unit",)},
}
_USUAL: dict[str, tuple[str, ...]] = {
    "file": _OF_FILE, "value": _OF_NUMBERS, "times": ("unit",), "": _OF_NUMBERS,
}  # fmt: skip


@contextmanager
def _as_faults(reader: TableReader, key: str) -> Iterator[None]:
    """Add the faults of an InputError to those of a key."""
    try:
        yield
    except InputError as error:
        for fault in error.faults:
            reader.fault(fault, key)


def read_readings(
    reader: TableReader, kind: str, end: float, files: FileStore
) -> tuple[Series, Measurements | None] | None:
    """Return the readings of a table of a fit file, and the rows of their file, if they have one.

    Their noise is not known yet. None, and faults, where there are none.

    Parameters
    ----------
    kind : a name in ``READING_KINDS``.
    end : s, of the test.
    """
    every = "file", "value", "times", "r", *_OF_FILE, *_OF_NUMBERS
    known = [name for name in every if name in keys_of(reader.loc)]
    for name in known:
        reader.raw(name)
    sources = _SOURCES.get(kind, _USUAL)
    source = next((name for name in sources if name in reader), "")
    where = f"beside {source}" if source else f"for a {kind}"
    allowed = source, *sources.get(source, _OF_NUMBERS)
    refuse(reader, where, *(name for name in known if name not in allowed))
    at = reader.read("at") if "at" in known else None
    if at is not None and at > end:
        reader.wrong("at", f"must be within the test, which ends at {end:g} s")
    excluded = read_intervals(reader, "exclude", "mm" if kind == "profile" else "s")
    if source == "file" or "value" not in known:
        found = _from_file(reader, kind, end, files)
    elif source or kind in ("mass", "volume", "through") or (at is not None and "" in sources):
        found = _from_numbers(reader, kind, source, end if at is None else at), None
    else:
        planned = "r" if kind == "profile" else "times"
        reader.wrong("file", f"must be given, or {planned} of planned readings")
        return None
    series, data = found
    if series is None:
        return None
    x = series.x
    if kind == "through":  # and may be after the end
        x = np.minimum(series.value, end)
    elif kind != "profile" and len(x) and end < x[-1] <= end * (1.0 + _ROUNDED):
        x = np.append(x[:-1], end)
    at = (end if at is None else at) if kind == "profile" else None
    ends = np.array(excluded).reshape(-1, 2)
    keep = ~((x[:, None] >= ends[:, 0]) & (x[:, None] <= ends[:, 1])).any(axis=1)
    series = replace(series, x=x, at=at, excluded=tuple(excluded)).part(keep)
    if data is not None and series.lines is not None:
        rows = compress(data.rows, np.isin(data.lines, series.lines))
        data = replace(data, rows=tuple(rows), lines=series.lines)
    return series, data


def _from_numbers(reader: TableReader, kind: str, source: str, at: float) -> Series | None:
    """Return a single reading at ``at`` (s), or planned ones; None, and faults, of wrong ones."""
    key, unit, written = "unit", reader.raw("unit", ""), reader.raw("value")
    if isinstance(written, str) and "unit" not in reader:
        key, unit = "value", number_and_unit(written)[1] if has_unit(written) else BASE[kind]
    try:
        scale = factor(str(unit), BASE[kind])
    except RejectedError:
        reader.wrong(key, f"must be the unit of {UNITS[BASE[kind]]}", "unit")
        return None
    value = reader.read("value", unit=str(unit)) if source == "value" else 0.0
    x = reader.read(source) if source in ("times", "r") else np.array([at])
    if x is None or value is None:
        return None
    values, sd = np.full(len(x), scale * value), np.full(len(x), np.nan)
    planned = source != "value"
    return Series(kind, kind, x, values, sd, unit=str(unit), factor=scale, planned=planned)


def _from_file(
    reader: TableReader, kind: str, end: float, files: FileStore
) -> tuple[Series | None, Measurements | None]:
    """Return the readings of a file, and its table; None, and faults, where they are wrong."""
    name, skip, drop = (reader.read(key) for key in ("file", "skip", "drop"))
    roles = ("r" if kind == "profile" else "time", "value")
    columns, units = (read_texts(reader, key, roles) for key in ("columns", "units"))
    data: Measurements | None = None
    if name is not None:
        with _as_faults(reader, "file"):
            data = files(name, skip, drop)
    if columns is None or units is None or data is None:
        return None, data
    if not columns and len(data.columns) == len(roles) and not {*roles} & {*data.columns}:
        columns = dict(zip(roles, data.columns, strict=True))
    names = [columns.get(role, role) for role in roles]
    of_x, of_value = (
        _column_unit(reader, data, role, name, units.get(role), base)
        for role, name, base in zip(roles, names, (BASE[roles[0]], BASE[kind]), strict=True)
    )
    if of_x is None or of_value is None:
        return None, data
    (_, x_scale), (unit, scale) = of_x, of_value
    rows, hour = data.filled(*names), None
    if roles[0] == "time":
        rows, hour = data.first_stamps(names[0], rows), 3600.0 / x_scale
    x, value = np.full((2, int(rows.sum())), np.nan)
    with _as_faults(reader, "file"):
        x = x_scale * data.numbers(names[0], rows, hour)
    with _as_faults(reader, "file"):
        value = scale * data.numbers(names[1], rows)
    if hour and len(x) and x[0] > end and is_clock(first := data.first_cell(names[0])):
        x = x - x[0]
        begin = f"{data.name}: the times begin with {legible(first)}, after the end of the test"
        warn_once(f"{begin}; they are taken as times of day, that of the first reading as 0")
    sd, lines = np.full(len(x), np.nan), data.lines[rows]
    series = Series(kind, kind, x, value, sd, unit=unit, factor=scale, lines=lines, file=data.name)
    return series, data


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
    with _as_faults(reader, "units"):
        if unit:
            named = unit_of_column(data.label(column), base)
        else:
            named = unit_by_name(data, column, base, hint)
        stamps = role == "time" and data.begins_with_stamp(column)
        chosen = unit or named or (base if stamps else "")
        try:
            scale = factor(chosen, base)
        except RejectedError as error:
            wrong = Fault(f"{state} must be the unit of {UNITS[base]}", code="unit")
            raise InputError(wrong if unit else no_unit(data, column, base, hint)) from error
        if unit and named and not math.isclose(factor(named, base), scale):
            by_name = f"the column {legible(column)} of {data.name} is in {legible(named)}"
            rule = "by its name; must be the same unit"
            raise InputError(Fault(f"{state} {by_name} {rule}", code="unit"))
        return chosen, scale
    return None


def read_noise(
    reader: TableReader, series: Series, data: Measurements | None
) -> tuple[FloatArray, bool]:
    """Return the standard deviation of each reading, and whether it is to be fitted."""
    entry, value, unknown = reader.raw("sd"), series.value, np.full(series.n, np.nan)
    if entry == "fit":
        if series.n < _SMOOTH or series.planned:
            rule = f'"fit" needs {_SMOOTH} readings at least, neither planned nor excluded'
            reader.wrong("sd", f"must be a number: {rule}")
        return np.full(series.n, _scatter(value)), True
    if isinstance(entry, Mapping):
        (share,) = read_all(inner(reader, "sd"))
        smooth = np.abs(median_filter(value, min(_SMOOTH, series.n) or 1, mode="nearest"))
        small = smooth <= _NEAR_ZERO * smooth.max(initial=0.0)
        if share is not None and small.any():
            rule = "must be in the data's unit where readings are near zero, as here"
            reader.wrong("sd", line_of(series, int(small.argmax())) + rule)
        return unknown if share is None else share * smooth, False
    if data is not None and entry in data.columns:
        return _sd_column(reader, data, entry, series), False
    single = reader.read("sd", unit=series.unit)
    return unknown if single is None else np.full(series.n, series.factor * single), False


def _sd_column(reader: TableReader, data: Measurements, column: str, series: Series) -> FloatArray:
    """Return the standard deviations in a column, in its own unit or that of the readings."""
    sd, filled, base = np.full(series.n, np.nan), data.filled(column), BASE[series.kind]
    with _as_faults(reader, "sd"):
        unit = unit_by_name(data, column, base) or series.unit
        sd[filled] = factor(unit, base) * data.numbers(column, filled)
        if (wrong := np.flatnonzero(~(sd > 0.0))).size:
            place = data.cell_place(column, int(wrong[0]), wrong.size)
            raise InputError(f"{place}: must be a number > 0")
    return sd


def line_of(series: Series, i: int) -> str:
    """Return where a reading stands, as sentences about it begin; "" where it is in no file."""
    return "" if series.lines is None else f"{series.file}: line {series.lines[i]}: "


def _scatter(value: FloatArray) -> float:
    """Return a guess of the noise of readings, by the scatter of their second differences."""
    second = np.abs(np.diff(value, 2)) / math.sqrt(6.0)
    guess = 1.4826 * float(np.median(second)) if len(second) else 0.0
    return guess or 1e-3 * float(np.abs(value).max(initial=0.0)) or 1e-9


def read_censored(reader: TableReader, n: int, data: Measurements | None) -> IntArray | None:
    """Return the sides (n,) at which readings are limits: -1 at most, 1 at least; None for none."""
    word = reader.read("censored")
    if word is None or word in _SIDES:
        return None if word is None else np.full(n, _SIDES[word])
    if data is None or word not in data.columns:
        reader.wrong("censored", f"must be {keys_of(reader.loc)['censored'].allowed}")
        return None
    sides = [_SIDES.get(cell.strip()) for cell in data.cells(word)]
    if wrong := [row for row, side in enumerate(sides) if side is None]:
        place = data.cell_place(word, wrong[0], len(wrong))
        reader.fault(f"{place}: must be below, above or empty", "censored")
        return None
    return np.array(sides, dtype=int)
