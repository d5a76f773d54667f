"""``[[experiment.data]]``: where readings come from (file, value, plan), their noise and limits."""

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.ndimage import median_filter

from ringwear_par.arrays import BoolArray, FloatArray, IntArray
from ringwear_par.cases.files.columns import (
    UNITS,
    FileStore,
    missing_column,
    read_texts,
    unit_by_name,
)
from ringwear_par.cases.tables import TableReader
from ringwear_par.cases.units import (
    assumption,
    factor,
    has_unit,
    number_and_unit,
    unit_of_column,
)
from ringwear_par.cases.values import RejectedError
from ringwear_par.errors import Fault, InputError, legible
from ringwear_par.files.measurements import Measurements, and_more
from ringwear_par.files.table_text import is_clock
from ringwear_par.files.text import shortened
from ringwear_par.identification.definition.problem import BASE, Problem, Series
from ringwear_par.identification.definition.schema import read_all

#: window of the running median that smooths data, in readings
_SMOOTH = 9
#: share of the largest reading below which a relative error means nothing
_NEAR_ZERO = 0.05
#: by word: the true value is at most the reading (-1), at least (1), or equal to it (0)
_SIDES = {"below": -1, "above": 1, "": 0}


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
    reader: TableReader, kind: str, at: float | None, end: float, files: FileStore, plans: bool
) -> Readings | None:
    """Return the readings of a table of a fit file at ``at`` (s) or until the end (s) of the test.

    None, and faults, where there are none; ``kind`` is a name in ``READING_KINDS``.
    """
    where, once = ("r", ()) if kind == "profile" else ("times", ("value",))
    sources = once if kind == "through" else ("file", *once)
    source = next((key for key in sources if key in reader), "")
    if source and where in reader:
        reader.raw(where)
        rule = f"must be absent beside {source}; it is for readings that are planned"
        reader.wrong(where, rule, "conflict")
    if source == "file":
        return _from_file(reader, kind, end, files)
    planned = source != "value"
    if planned and not _may_be_planned(reader, kind, where, at, plans):
        return None
    value, key, unit = None if planned else reader.raw("value"), "unit", reader.raw("unit", "")
    if isinstance(value, str) and "unit" not in reader:
        key, unit = "value", number_and_unit(value)[1] if has_unit(value) else BASE[kind]
    scale = _factor(reader, key, str(unit), BASE[kind])
    x = np.array([end if at is None else at])
    if planned and where in reader:
        x = reader.read(where)
    single = 0.0 if planned or scale is None else reader.read("value", unit=str(unit))
    if x is None or scale is None or single is None:
        return None
    values = np.full(len(x), scale * single)
    return Readings(_series(kind, x, values, str(unit), scale, planned=planned))


def _may_be_planned(
    reader: TableReader, kind: str, where: str, at: float | None, plans: bool
) -> bool:
    """Tell whether readings that are neither in a file nor a value may be planned; add faults."""
    once = kind in ("mass", "volume", "through") or (at is not None and kind != "profile")
    enough = once or where in reader
    if not enough or not plans:
        rule = f"must be given; or {where} of planned readings, for --dry-run and ringwear design"
        reader.wrong("value" if once else "file", rule)
    for key in () if enough else ("columns", "units", "skip", "drop"):  # of a file
        reader.raw(key)
    return enough


def _series(
    kind: str, x: FloatArray, value: FloatArray, unit: str, scale: float, **more: Any
) -> Series:
    """Return times or radii (n,) and values, in the units of a case, as a series."""
    sd = np.full(len(x), np.nan)
    return Series(kind, kind, x, value, sd, unit=unit, factor=scale, **more)


def _factor(reader: TableReader, key: str, unit: str, base: str) -> float | None:
    """Return a unit in that of the program; None, and a fault of a key, where it is another's."""
    try:
        return factor(unit, base)
    except RejectedError:
        rule = f"must be the unit of {UNITS[base]}"
        if unit and key in reader:
            reader.wrong(key, rule, "unit")
        else:
            state = f"= {shortened(unit)}" if unit else "is missing"
            reader.fault(f"{key} {state}: {rule}", key, "unit")
        return None


def _from_file(reader: TableReader, kind: str, end: float, files: FileStore) -> Readings | None:
    name, skip, drop = (reader.read(key) for key in ("file", "skip", "drop"))
    for key in ("value", "unit"):
        if key in reader:
            reader.raw(key)
            reader.wrong(key, "must be absent beside file", "conflict")
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
    found = [
        _column_unit(reader, data, role, name, units.get(role), base)
        for role, name, base in zip(roles, names, bases, strict=True)
    ]
    if found[0] is None or found[1] is None:
        return None
    (x_unit, x_scale), (unit, scale) = found[0], found[1]
    rows, hour, timed = data.filled(*names), None, roles[0] == "time"
    if timed:
        rows, hour = data.first_stamps(names[0], rows), 3600.0 / x_scale
    x, value = np.full((2, int(rows.sum())), np.nan)
    with _as_faults(reader, "file"):
        x = x_scale * data.numbers(names[0], rows, hour)
    with _as_faults(reader, "file"):
        value = scale * data.numbers(names[1], rows)
    doubts: tuple[str, ...] = ()
    if timed and len(x) and x[0] > end and is_clock(first := data.first_cell(names[0])):
        x = x - x[0]
        sentence = "after the end of the test; they are taken as times of day, that of the first"
        doubts = (f"the times begin with {legible(first)}, {sentence} reading as 0",)
    known = (x_unit or (timed and data.names_seconds(names[0], rows)), unit)
    assumptions = tuple(
        assumption(column, base)
        for column, base, unit_known in zip(names, bases, known, strict=True)
        if not unit_known
    )
    series = _series(
        kind, x, value, unit or bases[1], scale, assumptions=assumptions, suspicions=doubts,
        lines=data.lines[rows], file=data.name,
    )  # fmt: skip
    return Readings(series, data, rows)


def _column_unit(
    reader: TableReader, data: Measurements, role: str, column: str, unit: str | None, base: str
) -> tuple[str, float] | None:
    """Return the unit of a column, "" where none is known, and its size in that of the program.

    None, and a fault, where there is no such column, or in a unit of something else.
    """
    if missing := missing_column(data, column, role):
        reader.fault(missing, "columns")
        return None
    faults, named = len(reader.faults), unit_of_column(data.label(column), base)
    if not (unit or named):
        with _as_faults(reader, "units"):  # one of something else
            unit_by_name(data, column, base, f", or units.{role} must be given")
    scale = _factor(reader, f"units.{role}", unit or named or base, base)
    if scale and named and not math.isclose(factor(named, base), scale):
        sentence = f"the column {legible(column)} of {data.name} is in {legible(named)} by its name"
        state = f"units.{role} = {shortened(unit)}: {sentence}; must be the same unit"
        reader.fault(state, "units", "unit")
    return None if scale is None or len(reader.faults) > faults else (unit or named or "", scale)


def read_noise(reader: TableReader, readings: Readings, keep: BoolArray) -> tuple[FloatArray, bool]:
    """Return the standard deviation of each reading, and whether it is to be fitted."""
    entry, series = reader.raw("sd"), readings.series
    value, named = series.value, isinstance(entry, str) and not has_unit(entry)
    unknown = np.full(len(value), np.nan)
    if series.planned and (named or isinstance(entry, Mapping)):
        reader.wrong("sd", "must be a number > 0, in unit, of readings that are planned")
    elif entry == "fit":
        if keep.sum() < _SMOOTH:
            more = "" if keep.all() else " that are not excluded"
            reader.wrong("sd", f'must be a number: "fit" needs {_SMOOTH} readings at least{more}')
        return np.full(len(value), _scatter(value[keep])), True
    elif named and readings.data is None:
        reader.wrong("sd", "must be a number > 0 or { relative = x }")
    elif named:
        return _sd_column(reader, str(entry), readings), False
    elif isinstance(entry, Mapping):
        place = f"{reader.place}: sd"
        _, (relative,) = read_all("experiment.data.sd", place, entry, reader.faults)
        smooth = np.abs(median_filter(value, min(_SMOOTH, len(value)) or 1, mode="nearest"))
        small = smooth <= _NEAR_ZERO * smooth.max(initial=0.0)
        if relative is not None and small.any():
            line = lines_of(series)[int(small.argmax())]
            rule = "must be in the data's unit where readings are near zero, as here"
            reader.wrong("sd", f"{line}{rule}")
        elif relative is not None:
            return relative * smooth, False
    else:
        single = reader.read("sd", unit=series.unit)
        return unknown if single is None else np.full(len(value), series.factor * single), False
    return unknown, False


def _sd_column(reader: TableReader, column: str, readings: Readings) -> FloatArray:
    """Return the standard deviations in a column, in its own unit or that of the readings."""
    data, rows, series = readings.data, readings.rows, readings.series
    assert data is not None
    assert rows is not None
    sd, lines, base = np.full(series.n, np.nan), lines_of(series), BASE[series.kind]
    if column not in data.columns:
        rule = f'must be a number, "fit", {{ relative = x }} or a column of {data.name}'
        reader.wrong("sd", rule)
        return sd
    filled = data.filled(column)[rows]
    if not filled.all():
        reader.fault(f"{lines[int(filled.argmin())]}{column} is empty; must be a number > 0")
        return sd
    with _as_faults(reader, "sd"):
        scale = factor(unit_by_name(data, column, base) or series.unit, base)
        sd = scale * data.numbers(column, rows)
        if (wrong := np.flatnonzero(sd <= 0)).size:
            values = f"{column} = {sd[wrong[0]] / scale:g}{and_more(wrong.size, 'line')}"
            reader.fault(f"{lines[wrong[0]]}{values}: must be a number > 0")
    return sd


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
    word = reader.read("censored")
    if word is None:
        return None
    if word in _SIDES:
        return np.full(readings.series.n, _SIDES[word])
    data = readings.data
    if data is None or readings.rows is None or word not in data.columns:
        where = "" if data is None else f", or a column of {data.name}"
        reader.wrong("censored", f'must be "below" or "above"{where}')
        return None
    place = data.columns.index(word)
    cells = [data.rows[i][place].strip() for i in np.flatnonzero(readings.rows).tolist()]
    for cell, line in zip(cells, data.lines[readings.rows].tolist(), strict=True):
        if cell not in _SIDES:
            reader.fault(
                f"{data.name}: line {line}: {legible(word)} = {legible(cell)}: must be below, "
                "above or empty"
            )
            return None
    return np.array([_SIDES[cell] for cell in cells])


def check_censored(problem: Problem, faults: list[str]) -> None:
    """Add what does not go together with censored readings to the faults."""
    name, settings = problem.name, problem.settings
    for experiment in problem.experiments:
        for series in experiment.series:
            if series.censored is None or not series.censored.any():
                continue
            rules = {
                "must be absent with loss = \"student\"": settings.loss == "student",
                "must be absent with process": bool(settings.process),
                "must be absent with correlation_time": series.correlation_time > 0.0,
                'needs sd as a number where all readings are: must not be "fit"':
                    series.sd_fitted and series.censored.all(),
            }  # fmt: skip
            place = f'{name}: experiment "{legible(experiment.name)}": {series.name}'
            faults += [
                Fault(f"{place}: censored: {rule}", "experiment.data.censored", "conflict")
                for rule, broken in rules.items()
                if broken
            ]
