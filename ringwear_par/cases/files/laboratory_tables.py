"""Tables of a laboratory: a row a test, with its conditions and its masses."""

import logging
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from ringwear_par.cases.files.columns import FileStore, missing_column, unit_by_name
from ringwear_par.cases.files.weighings import (
    KINDS,
    MASSES,
    Weighing,
    last_digit,
    roles_by_name,
)
from ringwear_par.cases.schema import BY_PATH, key_of
from ringwear_par.cases.tables import Key, TableReader
from ringwear_par.cases.units import (
    bare_name,
    factor,
    has_unit,
    number_and_unit,
    unit_of_column,
)
from ringwear_par.cases.values import RejectedError
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.errors import InputError, legible
from ringwear_par.files.measurements import (
    Measurements,
    and_more,
    read_measurements,
    unused_columns,
)
from ringwear_par.files.table_text import EMPTY, NUMBER, has_hours
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
_TEXTS, _MASSES = ("name", "specimen", "batch", "lab"), (*KINDS, "sd")
#: of a row, not of its test
_OF_WEIGHINGS = ("at", "censored", *_MASSES)
#: a case has one of them
_LOADS = {"load.force", "load.pressure"}
#: units of roles that are no key of a case
_UNITS = {"at": "s", **dict.fromkeys(_MASSES, "g")}
#: of a case
_TABLES = {path.partition(".")[0] for path in BY_PATH}
#: rows of them are no tests
_STATISTICS = {"mean", "average", "mittelwert", "mittel", "median", "sum", "summe", "sd", "std",
               "stdev", "stabw", "min", "max"}  # fmt: skip
_SPEEDS = "; a speed v in m/s at a radius r is load.omega = v/r"
#: in texts of ``[[tests.data]]``: the name of a column
_PLACE = re.compile(r"\{([^{}]+)\}")


@dataclass(frozen=True)
class _Column:
    """A column of a table."""

    place: int
    #: one of ``_WORDS``, or the key of a case
    role: str
    #: "" for cells that are as a case file has them
    unit: str = ""
    #: of masses, that they are of
    body: str = ""


def laboratory_tests(
    place: str,
    entries: Any,
    keys: Mapping[str, Key],
    base: Mapping[str, Any] | None,
    files: FileStore,
    faults: list[str],
) -> dict[str, dict[str, Any]]:
    """Return the tests of a table as ``[[experiment]]`` has them, by the places of their rows.

    Add what is wrong to the faults. Not collective.

    Parameters
    ----------
    place : how sentences about ``[tests]`` begin.
    entries : of ``[tests]``.
    keys : its schema.
    base : dotted keys of the case; None where that has faults itself.
    """
    before, reader = len(faults), TableReader(place, entries, faults, keys)
    file, skip, drop = (reader.read(key) for key in ("file", "skip", "drop"))
    readable = file is not None and len(faults) == before
    sd = reader.raw("sd")
    names, units = (_texts(reader, key) for key in ("columns", "units"))
    templates = {key: _templates(reader, key) for key in ("data", "input")}
    if has_unit(sd):
        reader.read("sd")
    elif sd is not None:
        reader.wrong("sd", 'must be a number > 0 with its unit, such as "0.1 mg"')
    reader.finish()
    if not readable:
        return {}
    wrong_keys = len(faults) > before
    worn = [body for body in BODIES if any(key.startswith(f"wear.{body}.") for key in base or ())]
    try:
        table = files.read(file, read_measurements, labelled=True, skip=skip).without(drop)
    except InputError as error:
        for fault in error.faults:
            reader.fault(fault)
        return {}
    in_table: list[str] = []
    columns = _columns(table, names, units, worn, in_table)
    masses = templates["data"] or {c.role for c in columns} & {*KINDS}
    if worn and not (in_table or wrong_keys or masses):
        in_table.append(
            f"{table.name}: has no column of masses; one must be named before, after or loss, or "
            "tests.columns must name it"
        )
    rows = _Rows(table, columns, sd, templates, (base or {}).get("time.end"), in_table)
    tests = rows.check() if in_table or wrong_keys else rows.tests()
    if worn and not in_table:
        _name_unused(table, columns, templates, in_table)
        _name_thousands(table, columns)
    for fault in in_table:
        reader.fault(fault)
    return (
        {} if in_table or wrong_keys else tests
    )  # the other faults of its tests may follow from those


def _texts(reader: TableReader, key: str) -> Mapping[str, str]:
    """Return a table of texts by the role of columns."""
    table = reader.raw(key, {})
    if not isinstance(table, Mapping) or not all(isinstance(v, str) for v in table.values()):
        reader.wrong(key, "must be a table of texts")
        return {}
    roles = (*_TEXTS, *_OF_WEIGHINGS)
    for role in table:
        if role not in roles and role.partition(".")[0] not in _MASSES and key_of(role) is None:
            reader.fault(
                f"{key}.{legible(role)}: must be {', '.join(roles)}, a mass with its body "
                "(loss.lower) or a key of a case"
            )
    return table


def _templates(reader: TableReader, key: str) -> list[Mapping[str, Any]]:
    tables = reader.raw(key, [])
    if not isinstance(tables, list) or not all(isinstance(table, Mapping) for table in tables):
        reader.wrong(key, f"must be tables, [[tests.{key}]]")
        return []
    return tables


def _columns(
    table: Measurements,
    names: Mapping[str, str],
    units: Mapping[str, str],
    worn: Sequence[str],
    faults: list[str],
) -> list[_Column]:
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
        columns.append(_Column(0, "name"))
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
) -> _Column | None:
    """Return a column with its unit and body; None, and a fault, where they are wrong."""
    name, base = table.columns[place], _base(role)
    if not base:
        return _Column(place, role)
    try:
        if unit is not None:
            factor(unit, base)
        else:
            hint = f', or tests.units."{role}" must be given'
            unit = unit_by_name(table.column(place), name, base, hint)
    except RejectedError:
        faults.append(f"units.{role} = {shortened(unit)}: must be a unit of {base}")
        return None
    except InputError as error:
        faults += error.faults
        return None
    if unit is None and not (role == name and key_of(role)):
        faults.append(
            f"{table.name}: {legible(name)}: no unit; name it {legible(name)} / {base}, "
            f"or tests.units must have {role}"
        )
        return None
    kind, _, body = role.partition(".")
    if kind not in _MASSES:
        return _Column(place, role, unit or "")
    bodies = [body] if body else _bodies(name) or worn
    if len(bodies) == 1:
        return _Column(place, kind, unit or "", bodies[0])
    if worn:  # else the case has faults, or nothing wears, which is reported elsewhere
        faults.append(
            f"{table.name}: {legible(name)}: must tell whose mass it is: name it lower "
            f'{legible(name)}, or tests.columns = {{ "{kind}.lower" = ... }}'
        )
    return None


def _refuse_twins(table: Measurements, columns: Sequence[_Column], faults: list[str]) -> None:
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


def _name_unused(
    table: Measurements,
    columns: Sequence[_Column],
    templates: Mapping[str, list[Mapping[str, Any]]],
    faults: list[str],
) -> None:
    """Warn of columns that have no role and stand in no template; refuse speeds that differ."""
    used = {table.columns[column.place] for column in columns}
    for template in (template for tables in templates.values() for template in tables):
        used |= {name for text in template.values() for name in _PLACE.findall(str(text))}
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


def _name_thousands(table: Measurements, columns: Sequence[_Column]) -> None:
    """Warn of numbers whose decimal mark may separate thousands."""
    for column in columns:
        cells = table.column(column.place)
        row = None if column.role in (*_TEXTS, "censored") else cells.perhaps_thousands()
        if row is not None:
            cell = cells.rows[row][0]
            log.warning(
                "%s: line %d: %s = %s is read as %g; if thousands are meant, it must be %s",
                table.name, table.lines[row], legible(cells.columns[0]), cell,
                float(cell.replace(",", ".")), cell.replace(",", "").replace(".", ""),
            )  # fmt: skip


def _in(value: str, unit: str) -> float:
    """Return a number with a unit in another unit."""
    number, written = number_and_unit(value)
    return number * factor(written, unit)


@dataclass(frozen=True, eq=False)
class _Rows:
    """The rows of a table as tests."""

    table: Measurements
    columns: Sequence[_Column]
    #: of one weighing, a text with its unit; None: unknown
    sd: str | None
    #: of ``[[tests.data]]`` and ``[[tests.input]]``
    templates: Mapping[str, list[Mapping[str, Any]]]
    #: time.end of tests that do not tell it, as the case has it
    end: Any
    #: each with the line or the column
    faults: list[str]

    def tests(self) -> dict[str, dict[str, Any]]:
        """Return the tests without faults by the places of their rows."""
        place = next(column.place for column in self.columns if column.role == "name")
        rows: dict[str, list[int]] = {}
        for number, row in enumerate(self.table.rows):
            if row[place].lower().strip(" .:") in _STATISTICS:
                self._fault(
                    number, f"{legible(row[place])}: is no test by its name; must be left out"
                )
            elif row[place]:
                rows.setdefault(row[place], []).append(number)
            else:
                self._fault(number, "names no test; must begin with a name")
        tests = {}
        late: dict[int, float] = {}
        for name, numbers in rows.items():
            before, test = len(self.faults), self._test(name, numbers, late)
            if len(self.faults) == before:
                tests[f"{self.table.name}: line {self.table.lines[numbers[0]]}"] = test
        if late:
            self._refuse_late(late)
        return tests

    def _refuse_late(self, late: Mapping[int, float]) -> None:
        """Refuse weighings after the end of their test."""
        place = next(column.place for column in self.columns if column.role == "at")
        number, end = next(iter(late.items()))
        cell = self.table.rows[number][place]
        hint = ", and count from its start; it must not be a time of day" * has_hours(cell)
        self._fault(
            number,
            f"{legible(self.table.columns[place])} = {legible(cell)}{and_more(len(late), 'line')}: "
            f"must be within the test, which ends at {end:g} s{hint}",
        )

    def check(self) -> dict[str, dict[str, Any]]:
        """Check all cells of the columns that are right; return no tests."""
        for column in self.columns:
            for number in range(len(self.table.rows)):
                self._value(column, number)
        return {}

    def _fault(self, number: int, sentence: str) -> None:
        self.faults.append(f"{self.table.name}: line {self.table.lines[number]}: {sentence}")

    def _test(self, name: str, numbers: list[int], late: dict[int, float]) -> dict[str, Any]:
        """Return the keys of a test, of its rows; add those after its end to the late ones."""
        before = len(self.faults)
        test: dict[str, Any] = {"name": name, "set": {}}
        for column in self.columns:
            if column.role in ("name", *_OF_WEIGHINGS):
                continue
            value = self._value(column, numbers[0])
            for number in numbers[1:]:
                if (repeated := self._value(column, number)) not in (None, value):
                    place = f"{legible(self.table.columns[column.place])} = {shortened(repeated)}"
                    self._fault(
                        number,
                        f"{place}: must be that of the first row of {legible(name)}, or empty",
                    )
            if value is not None:
                (test if column.role in _TEXTS else test["set"])[column.role] = value
        for key, templates in self.templates.items():
            tables = [self._completed(template, numbers[0]) for template in templates]
            test[key] = [table for table in tables if table is not None]
        for body in BODIES:
            columns = [column for column in self.columns if column.body == body]
            weighed = {
                n: reading
                for n in numbers
                if columns and (reading := self._weighed(columns, body, n, numbers[0], name))
            }
            test["data"] += weighed.values()
            if len(self.faults) == before:
                self._check_order(name, weighed, test["set"].get("time.end", self.end), late)
        if not test["data"] and len(self.faults) == before:
            self._fault(numbers[0], f"{legible(name)}: has no reading; must have a mass at least")
        return test

    def _check_order(
        self, name: str, weighed: Mapping[int, Mapping[str, Any]], end: Any, late: dict[int, float]
    ) -> None:
        """Refuse two weighings of one time; warn of losses that fall by more than their noise.

        Parameters
        ----------
        weighed : of one body, by their rows.
        end : of the test, as a case has it; rows after it are added to the late ones, with it.
        """
        try:
            last = float(BY_PATH["time.end"].value(end))
        except RejectedError:  # is reported elsewhere
            return
        times = {n: _in(reading["at"], "s") if "at" in reading else last
                 for n, reading in weighed.items()}  # fmt: skip
        late |= {n: last for n, time in times.items() if time > last}
        ordered = sorted(times, key=lambda n: times[n])
        for n, following in pairwise(ordered):
            if times[n] == times[following]:
                self._fault(
                    max(n, following),
                    f"{legible(name)}: is weighed at the time of line "
                    f"{self.table.lines[min(n, following)]} again; readings of one weighing must "
                    "stand in one row",
                )
                continue
            earlier, later = weighed[n], weighed[following]
            fall = _in(earlier["value"], "g") - _in(later["value"], "g")
            noise = _in(earlier["sd"], "g") + _in(later["sd"], "g")
            if fall > noise and not {"censored"} & {*earlier, *later}:
                log.warning(
                    "%s: line %d: %s has lost %s, and %s before (line %d), which is more than "
                    "noise; look at both", self.table.name, self.table.lines[following],
                    legible(name), later["value"], earlier["value"], self.table.lines[n],
                )  # fmt: skip

    def _weighed(
        self, columns: Sequence[_Column], body: str, number: int, first: int, name: str
    ) -> dict[str, Any] | None:
        """Return the mass lost by a body since the start as ``[[experiment.data]]`` has it."""
        masses: dict[str, list[float]] = {}
        unit, digit = "", 0.0
        for column in (column for column in columns if column.role in KINDS):
            row = first if column.role == "before" else number
            if row != number and self._value(column, number) not in (
                None, self._value(column, first),
            ):  # fmt: skip
                self._fault(
                    number,
                    f"{legible(self.table.columns[column.place])}: must be the mass before the "
                    "test, as in its first row, or empty",
                )
            value = self._value(column, row)
            if value is not None:
                mass, unit = number_and_unit(value)
                grams = factor(unit, "g")
                masses.setdefault(column.role, []).append(mass * grams)
                digit = max(digit, grams * last_digit(self.table.rows[row][column.place]))
        if not {"after", "loss"} & masses.keys():
            return None
        try:
            weighing = Weighing.of(masses, digit)
        except InputError as error:
            self._fault(number, str(error))
            return None
        sd = next((self._value(c, number) for c in columns if c.role == "sd"), None)
        if sd is None and self.sd is not None:
            weighing_sd, unit_of_sd = number_and_unit(self.sd)
            sd = f"{weighing.u(weighing_sd):.12g} {unit_of_sd}"
        if sd is None:
            self._fault(
                number,
                "the sd of its mass is unknown; must be in a column sd, or that of one weighing in "
                "tests.sd",
            )
            return None
        reading = {
            "quantity": f"mass.{body}",
            "value": f"{weighing.loss / factor(unit, 'g'):.12g} {unit}", "sd": sd,
        }  # fmt: skip
        at, limit = (
            next((self._value(c, number) for c in self.columns if c.role == role), None)
            for role in ("at", "censored")
        )
        if limit is not None:
            reading["censored"] = limit
        if at is None and number != first:
            self._fault(
                number,
                f"has no time; several weighings of {legible(name)} must have a column at",
            )
        return reading if at is None else {**reading, "at": at}

    def _completed(self, template: Mapping[str, Any], number: int) -> dict[str, Any] | None:
        """Return keys with cells of a row in the place of columns; None where one is empty."""
        completed = dict(template)
        for key, text in template.items():
            for name in _PLACE.findall(text) if isinstance(text, str) else ():
                if fault := missing_column(self.table, name, f"{key} = {shortened(text)}"):
                    self.faults.append(fault)
                    return None
                cell = self.table.rows[number][self.table.columns.index(name)]
                if cell.lower() in EMPTY and key == "censored":  # a value
                    del completed[key]
                    break
                if cell.lower() in EMPTY:
                    return None
                number_cell = cell.replace(",", ".")
                is_number = NUMBER.fullmatch(number_cell) is not None
                if is_number and key != "file" and text == f"{{{name}}}":
                    completed[key] = float(number_cell)
                    break
                cell = number_cell if is_number else cell
                completed[key] = completed[key].replace(f"{{{name}}}", cell)
        return completed

    def _value(self, column: _Column, number: int) -> Any:
        """Return the raw value of a cell, with its unit; None for none."""
        cells = self.table.column(column.place)
        cell = cells.rows[number][0]
        if cell.lower() in EMPTY:
            return None
        if column.role in (*_TEXTS, "censored"):
            return cell
        if not column.unit and not NUMBER.fullmatch(cell.replace(",", ".")):
            return parse_value(cell)
        hour = factor("h", column.unit) if column.unit and _base(column.role) == "s" else None
        try:
            (read,) = cells.numbers(cells.columns[0], np.arange(len(cells.rows)) == number, hour)
        except InputError as error:
            self._add(error.faults)
            return None
        value = parse_value(cell) if cell.isdigit() else float(read)
        if column.unit:
            value = f"{float(read)!r} {column.unit}"
        if key := key_of(column.role):
            try:
                key.value(value)
            except RejectedError:
                name, line = legible(cells.columns[0]), cells.lines[number]
                self._add([f"{cells.name}: line {line}: {name} = {legible(cell)}: {key.rule}"])
                return None
        return value

    def _add(self, faults: Sequence[str]) -> None:
        """Add faults that are not there."""
        self.faults.extend(fault for fault in faults if fault not in self.faults)
