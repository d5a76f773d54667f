"""Columns of a laboratory's tables: what each is of by its name, in which unit; their cells."""

import logging
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ringwear_par.cases.files.columns import missing_column, no_unit, unit_by_name
from ringwear_par.cases.files.weighings import KINDS, MASSES, roles_by_name
from ringwear_par.cases.schema import BY_PATH, key_of
from ringwear_par.cases.units import bare_name, factor, unit_of_column
from ringwear_par.cases.values import RejectedError
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.errors import Fault, InputError, legible
from ringwear_par.files.measurements import Measurements, unused_columns
from ringwear_par.files.table_text import EMPTY, NUMBER
from ringwear_par.files.text import parse_value, shortened

log = logging.getLogger(__name__)

#: words in names of columns by their role; single letters count with their case
_WORDS: dict[str, set[str]] = {
    "name": {"name", "test", "versuch"},
    "specimen": {"specimen", "probe"},
    "batch": {"batch", "charge"},
    "lab": {"lab", "labor", "laboratory"},
    "at": {"at"},
    "censored": {"censored"},
    "load.force": {"force", "load", "F", "kraft", "last"},
    "load.pressure": {"pressure", "load", "p", "pressung", "last"},
    "load.omega": {"omega", "speed", "n", "drehzahl"},
    "time.end": {"duration", "dauer"},
    **MASSES,
}
#: in texts of ``[[tests.data]]``: the name of a column
PLACE = re.compile(r"\{([^{}]+)\}")
#: of texts; of a row, not of its test
TEXTS, OF_WEIGHINGS = ("name", "specimen", "batch", "lab"), ("at", "censored", *KINDS, "sd")
#: a case has one of them
_LOADS = {"load.force", "load.pressure"}
#: units of roles that are no key of a case
_UNITS = {"at": "s", **dict.fromkeys(MASSES, "g")}
#: of a case
_TABLES = {path.partition(".")[0] for path in BY_PATH}
_SPEEDS = "; a speed v in m/s at a radius r is load.omega = v/r"


@dataclass(frozen=True)
class Column:
    """A column of a table."""

    place: int
    #: one of ``_WORDS``, or the key of a case
    role: str
    #: "" for cells that are as a case file has them
    unit: str = ""
    #: of masses, that they are of
    body: str = ""


def columns_of(
    table: Measurements,
    names: Mapping[str, str],
    units: Mapping[str, str],
    worn: Sequence[str],
    faults: list[str],
) -> list[Column]:
    """Return the columns of a table that are used; add what is wrong to the faults.

    Parameters
    ----------
    names, units : of columns by role, as a user has them.
    worn : bodies that wear.
    """
    faults += [
        fault for role, name in names.items() if (fault := missing_column(table, name, role))
    ]
    chosen = {name: role for role, name in names.items()}
    roles = [
        chosen.get(name) or _role(table.column(place), names, worn)
        for place, name in enumerate(table.columns)
    ]
    faults += [
        f"units.{role}: no column is known to be of {role}; tests.columns must name it"
        for role in units
        if role not in roles
    ]
    columns = [
        column
        for place, role in enumerate(roles)
        if role and (column := _column(table, place, role, units.get(role), worn, faults))
    ]
    if all(column.role != "name" for column in columns):
        columns.append(Column(0, "name"))
    _refuse_twins(table, columns, faults)
    return columns


def _role(column: Measurements, names: Mapping[str, str], worn: Sequence[str]) -> str:
    """Return the role that the name of a column tells, "" for none or that of a named column."""
    (name,) = column.columns
    bare = bare_name(name)
    if key := next((text for text in (name, bare) if key_of(text) is not None), ""):
        return "" if key in names else key
    if bare.partition(".")[0] in _TABLES and "." in bare:
        return bare  # the case does not know it, and tells the nearest key
    taken = {*names} | (_LOADS if _LOADS & {*names} else set())
    bodies = _bodies(name) or worn
    roles = roles_by_name(column, _WORDS, _base)
    return next((r for r in roles if not taken & {r, *(f"{r}.{body}" for body in bodies)}), "")


def _bodies(name: str) -> list[str]:
    """Return the bodies that the name of a column has."""
    words = {word.lower() for word in re.findall(r"[^\W\d_]+", name)}
    return [body for body in BODIES if body in words]


def _base(role: str) -> str:
    """Return the unit of a role, "" for none."""
    key = key_of(role)
    unit = _UNITS.get(role.partition(".")[0], "") if key is None else key.unit
    return "" if unit in ("-", "1") else unit


def _column(
    table: Measurements,
    place: int,
    role: str,
    unit: str | None,
    worn: Sequence[str],
    faults: list[str],
) -> Column | None:
    """Return a column with its unit and body; None, and a fault, where they are wrong."""
    name, base = table.columns[place], _base(role)
    if not base:
        return Column(place, role)
    try:
        if unit is not None:
            factor(unit, base)
        else:
            hint = f', or tests.units."{role}" must be given'
            unit = unit_by_name(table.column(place), name, base, hint)
    except RejectedError:
        sentence = f"units.{role} = {shortened(unit)}: must be a unit of {base}"
        faults.append(Fault(sentence, code="unit"))
        return None
    except InputError as error:
        faults += error.faults
        return None
    if unit is None and not (role == name and key_of(role)):
        faults.append(no_unit(table, name, base, f", or tests.units must have {role}"))
        return None
    kind, _, body = role.partition(".")
    if kind not in MASSES:
        return Column(place, role, unit or "")
    bodies = [body] if body else _bodies(name) or worn
    if len(bodies) == 1:
        return Column(place, kind, unit or "", bodies[0])
    if worn:  # else the case has faults, or nothing wears, which is reported elsewhere
        faults.append(
            f"{table.name}: {legible(name)}: must tell whose mass it is: name it lower "
            f'{legible(name)}, or tests.columns = {{ "{kind}.lower" = ... }}'
        )
    return None


def _refuse_twins(table: Measurements, columns: Sequence[Column], faults: list[str]) -> None:
    """Refuse two columns of one role; of masses the mean counts."""
    first_places: dict[tuple[str, str], int] = {}
    for column in columns:
        first = first_places.setdefault((column.role, column.body), column.place)
        if first != column.place and column.role not in KINDS:
            names = (legible(table.columns[i]) for i in (first, column.place))
            faults.append(
                f"{table.name}: the columns {' and '.join(names)} may both be of "
                f"{column.role}; tests.columns must tell which one is"
            )


def name_unused(
    table: Measurements,
    columns: Sequence[Column],
    templates: Mapping[str, list[Mapping[str, Any]]],
    faults: list[str],
) -> None:
    """Warn of columns that have no role and stand in no template; refuse speeds that differ."""
    used = {table.columns[column.place] for column in columns}
    for template in (template for tables in templates.values() for template in tables):
        used |= {name for text in template.values() for name in PLACE.findall(str(text))}
    if unused := [name for name in table.columns if name and name not in used]:
        speeds = [name for name in unused if unit_of_column(table.label(name), "m/s")]
        log.warning("%s: %s%s", table.name, unused_columns(unused), _SPEEDS * bool(speeds))
        if all(column.role != "load.omega" for column in columns):
            faults += [
                f"{table.name}: {legible(name)}: is not read, and its tests differ in it; must be "
                f"a column of load.omega{_SPEEDS}"
                for name in speeds
                if len({row[table.columns.index(name)] for row in table.rows} - EMPTY) > 1
            ]


def name_thousands(table: Measurements, columns: Sequence[Column]) -> None:
    """Warn of numbers whose decimal mark may separate thousands."""
    for column in columns:
        cells = table.column(column.place)
        row = None if column.role in (*TEXTS, "censored") else cells.perhaps_thousands()
        if row is not None:
            cell = cells.rows[row][0]
            log.warning(
                "%s: line %d: %s = %s is read as %g; if thousands are meant, it must be %s",
                table.name, table.lines[row], legible(cells.columns[0]), cell,
                float(cell.replace(",", ".")), cell.replace(",", "").replace(".", ""),
            )  # fmt: skip


def values_of(
    table: Measurements, columns: Iterable[Column], numbers: Sequence[int], faults: list[str]
) -> dict[int, dict[Column, Any]]:
    """Return the raw values of some rows, with their units; None for none; add to the faults."""
    values: dict[int, dict[Column, Any]] = {number: {} for number in numbers}
    for column in columns:
        cells = table.column(column.place)
        for number in numbers:
            try:
                values[number][column] = _value(cells, column, number)
            except InputError as error:
                faults += [fault for fault in error.faults if fault not in faults]
                values[number][column] = None
    return values


def _value(cells: Measurements, column: Column, number: int) -> Any:
    """Return the raw value of a cell of a column, with its unit; None for none."""
    cell = cells.rows[number][0]
    if cell.lower() in EMPTY:
        return None
    if column.role in (*TEXTS, "censored"):
        return cell
    if not column.unit and not NUMBER.fullmatch(cell.replace(",", ".")):
        return parse_value(cell)
    hour = factor("h", column.unit) if column.unit and _base(column.role) == "s" else None
    (read,) = cells.numbers(cells.columns[0], np.arange(len(cells.rows)) == number, hour)
    value = parse_value(cell) if cell.isdigit() else float(read)
    if column.unit:
        value = f"{float(read)!r} {column.unit}"
    if key := key_of(column.role):
        try:
            key.value(value)
        except RejectedError as error:
            name, line = legible(cells.columns[0]), cells.lines[number]
            raise InputError(
                f"{cells.name}: line {line}: {name} = {legible(cell)}: {key.rule}"
            ) from error
    return value
