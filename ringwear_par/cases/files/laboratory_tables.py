"""Tables of a laboratory: a row a test, with its conditions and its masses."""

import logging
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from ringwear_par.cases.files.columns import FileStore, missing_column, unit_by_name
from ringwear_par.cases.files.weighings import KINDS, Weighing
from ringwear_par.cases.schema import BY_PATH, key_of
from ringwear_par.cases.tables import Key, TableReader
from ringwear_par.cases.units import bare_name, factor, has_unit, number_and_unit, unit_of_column
from ringwear_par.cases.values import RejectedError
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.errors import InputError, legible
from ringwear_par.files.measurements import Measurements, read_measurements, unused_columns
from ringwear_par.files.table_text import EMPTY, NUMBER
from ringwear_par.files.text import parse_value, shortened

log = logging.getLogger(__name__)

_READ = partial(read_measurements, labelled=True)
#: words in names of columns, by what these are of; letters alone are names as they are
_WORDS: dict[str, set[str]] = {
    "name": {"name", "test", "versuch"},
    "specimen": {"specimen", "probe"},
    "batch": {"batch", "charge"},
    "lab": {"lab", "labor", "laboratory"},
    "at": {"at"},
    "load.force": {"force", "load", "F", "kraft", "last"},
    "load.pressure": {"pressure", "load", "p", "pressung", "last"},
    "load.omega": {"omega", "speed", "n", "drehzahl"},
    "time.end": {"duration", "dauer"},
    "sd": {"sd", "u"},
    **KINDS,
}
_TEXTS, _MASSES = ("name", "specimen", "batch", "lab"), (*KINDS, "sd")
#: units of what is no key of a case
_UNITS = {"at": "s", **dict.fromkeys(_MASSES, "g")}
#: of masses in g: differences have the digits that were typed, and no more
_DIGITS = 12
#: of a case
_TABLES = {path.partition(".")[0] for path in BY_PATH}
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
    file, sd = reader.read("file"), reader.raw("sd")
    names, units = (_texts(reader, key) for key in ("columns", "units"))
    templates = {key: _templates(reader, key) for key in ("data", "input")}
    if has_unit(sd):
        reader.read("sd")
    elif sd is not None:
        reader.wrong("sd", 'must be a number > 0 with its unit, such as "0.1 mg"')
    reader.finish()
    if file is None or len(faults) > before:
        return {}
    worn = [body for body in BODIES if any(key.startswith(f"wear.{body}.") for key in base or ())]
    try:
        rows = _Reader(files.read(file, _READ), names, units, worn, sd, templates)
    except InputError as error:
        for fault in error.faults:
            reader.fault(fault)
        return {}
    tests = rows.tests()
    for fault in rows.faults:
        reader.fault(fault)
    return tests


def _texts(reader: TableReader, key: str) -> Mapping[str, str]:
    """Return a table of texts by what columns are of."""
    table = reader.raw(key, {})
    if not isinstance(table, Mapping) or not all(isinstance(v, str) for v in table.values()):
        reader.wrong(key, "must be a table of texts")
        return {}
    known = (*_TEXTS, "at", *_MASSES)
    for role in table:
        if role not in known and role.partition(".")[0] not in _MASSES and key_of(role) is None:
            reader.fault(
                f"{key}.{legible(role)}: must be {', '.join(known)}, a mass with its body "
                "(loss.lower) or a key of a case"
            )
    return table


def _templates(reader: TableReader, key: str) -> list[Mapping[str, Any]]:
    tables = reader.raw(key, [])
    if not isinstance(tables, list) or not all(isinstance(table, Mapping) for table in tables):
        reader.wrong(key, f"must be tables, [[tests.{key}]]")
        return []
    return tables


class _Reader:
    """Reads the tests of a table.

    Parameters
    ----------
    names, units : of columns by role, as a user has them.
    worn : bodies that wear.
    sd : of one weighing, a text with its unit; None: unknown.
    templates : of ``[[tests.data]]`` and ``[[tests.input]]``.
    """

    def __init__(
        self,
        table: Measurements,
        names: Mapping[str, str],
        units: Mapping[str, str],
        worn: Sequence[str],
        sd: str | None,
        templates: Mapping[str, list[Mapping[str, Any]]],
    ) -> None:
        self._table, self._units, self._worn = table, units, worn
        self._sd, self._templates = sd, templates
        #: each with the line or the column
        self.faults = [
            fault for role, name in names.items() if (fault := missing_column(table, name, role))
        ]
        chosen = {name: role for role, name in names.items()}
        self._columns = [
            column
            for place, name in enumerate(table.columns)
            if (column := self._column(place, chosen.get(name) or self._role(place)))
        ]
        self._names = next((c.place for c in self._columns if c.role == "name"), 0)
        self._refuse_twins()

    def tests(self) -> dict[str, dict[str, Any]]:
        """Return the tests without faults by the places of their rows."""
        rows: dict[str, list[int]] = {}
        for number, row in enumerate(self._table.rows if not self.faults else ()):
            if row[self._names]:
                rows.setdefault(row[self._names], []).append(number)
            else:
                self._fault(number, "names no test; must begin with a name")
        tests = {}
        for name, numbers in rows.items():
            before, test = len(self.faults), self._test(name, numbers)
            if len(self.faults) == before:
                tests[f"{self._table.name}: line {self._table.lines[numbers[0]]}"] = test
        used = {self._names, *(column.place for column in self._columns)}
        texts = [
            str(t) for tables in self._templates.values() for one in tables for t in one.values()
        ]
        placed = {name for text in texts for name in _PLACE.findall(text)}
        unused = [
            name for i, name in enumerate(self._table.columns)
            if name and i not in used and name not in placed
        ]  # fmt: skip
        if unused and self._worn and not self.faults:
            log.warning("%s: %s", self._table.name, unused_columns(unused))
        return tests

    def _fault(self, number: int, sentence: str) -> None:
        self.faults.append(f"{self._table.name}: line {self._table.lines[number]}: {sentence}")

    def _role(self, place: int) -> str:
        """Return the role that the name of a column tells, "" for none."""
        name = self._table.columns[place]
        bare = bare_name(name)
        if known := next((one for one in (name, bare) if key_of(one) is not None), ""):
            return known
        if bare.partition(".")[0] in _TABLES and "." in bare:
            return bare  # the case does not know it, and tells the nearest key
        words = re.findall(r"[^\W\d_]+", bare)
        known_words = {word.lower() for word in words if len(word) > 1} | {*words[:1]}
        roles = [role for role, usual in _WORDS.items() if known_words & usual]
        label = self._table.column(place).label(name)
        in_its_unit = [role for role in roles if unit_of_column(label, self._base(role))]
        return next(iter([*in_its_unit, *roles]), "")

    def _base(self, role: str) -> str:
        """Return a unit of what a role is of, "" for none."""
        key = key_of(role)
        unit = _UNITS.get(role.partition(".")[0], "") if key is None else key.unit
        return "" if unit in ("-", "1") else unit

    def _column(self, place: int, role: str) -> _Column | None:
        """Return a column with its unit and body; None for one that is not used, or has faults."""
        name, base, column = self._table.columns[place], self._base(role), self._table.column(place)
        unit = self._units.get(role)
        if not role or not base:
            return _Column(place, role) if role else None
        try:
            if unit is not None:
                factor(unit, base)
            else:
                unit = unit_by_name(column, name, base, f', or tests.units."{role}" must be given')
        except RejectedError:
            self.faults.append(f"units.{role} = {shortened(unit)}: must be a unit of {base}")
            return None
        except InputError as error:
            self.faults += error.faults
            return None
        if unit is None and role != name:
            self.faults.append(
                f"{self._table.name}: {legible(name)}: no unit; name it {legible(name)} / {base}, "
                f"or tests.units must have {role}"
            )
            return None
        kind, _, body = role.partition(".")
        if kind not in _MASSES:
            return _Column(place, role, unit or "")
        words = {word.lower() for word in re.findall(r"[^\W\d_]+", name)}
        bodies = [body] if body else [b for b in BODIES if b in words] or self._worn
        if len(bodies) == 1:
            return _Column(place, kind, unit or "", bodies[0])
        if self._worn:  # else the case has faults, or nothing wears, which is told
            self.faults.append(
                f"{self._table.name}: {legible(name)}: must tell whose mass it is: name it lower "
                f'{legible(name)}, or tests.columns = {{ "{kind}.lower" = ... }}'
            )
        return None

    def _refuse_twins(self) -> None:
        """Refuse columns of the same, but of masses, whose mean counts."""
        known: dict[tuple[str, str], int] = {}
        for column in self._columns:
            first = known.setdefault((column.role, column.body), column.place)
            if first != column.place and column.role not in KINDS:
                names = (legible(self._table.columns[i]) for i in (first, column.place))
                self.faults.append(
                    f"{self._table.name}: the columns {' and '.join(names)} may both be of "
                    f"{column.role}; tests.columns must tell which one is"
                )

    def _test(self, name: str, numbers: list[int]) -> dict[str, Any]:
        """Return the keys of a test, of its rows."""
        test: dict[str, Any] = {"name": name, "set": {}}
        for column in self._columns:
            if column.role in ("name", "at", *_MASSES):
                continue
            value = self._value(column, numbers[0])
            for number in numbers[1:]:
                if (other := self._value(column, number)) not in (None, value):
                    place = f"{legible(self._table.columns[column.place])} = {shortened(other)}"
                    self._fault(
                        number,
                        f"{place}: must be that of the first row of {legible(name)}, or empty",
                    )
            if value is not None:
                (test if column.role in _TEXTS else test["set"])[column.role] = value
        for key, templates in self._templates.items():
            tables = [self._completed(template, numbers[0]) for template in templates]
            test[key] = [table for table in tables if table is not None]
        for body in BODIES:
            columns = [column for column in self._columns if column.body == body]
            test["data"] += [
                reading
                for n in numbers
                if columns and (reading := self._weighed(columns, body, n, numbers[0]))
            ]
        if not test["data"]:
            self._fault(numbers[0], f"{legible(name)}: has no reading; must have a mass at least")
        return test

    def _weighed(
        self, columns: Sequence[_Column], body: str, number: int, first: int
    ) -> dict[str, Any] | None:
        """Return the mass lost by a body since the start as ``[[experiment.data]]`` has it."""
        masses: dict[str, list[float]] = {}
        unit, sd = "", self._sd
        for column in columns:
            row = number
            if column.role == "before" and first != number:
                row = first
                if self._value(column, number) not in (None, self._value(column, first)):
                    self._fault(
                        number,
                        f"{legible(self._table.columns[column.place])}: must be the mass before "
                        "the test, as in its first row, or empty",
                    )
            value = self._value(column, row)
            if value is None:
                continue
            if column.role == "sd":
                sd = value
                continue
            mass, unit = number_and_unit(value)
            masses.setdefault(column.role, []).append(mass * factor(unit, "g"))
        if not {"after", "loss"} & masses.keys():
            return None
        try:
            weighing = Weighing.of(masses)
        except InputError as error:
            self._fault(number, str(error))
            return None
        if sd is None:
            self._fault(
                number,
                "the sd of its mass is unknown; must be in a column sd, or that of one weighing in "
                "tests.sd",
            )
            return None
        if sd is self._sd:
            one, unit_of_sd = number_and_unit(sd)
            sd = f"{weighing.u(one):.12g} {unit_of_sd}"
        reading = {
            "quantity": f"mass.{body}",
            "value": f"{round(weighing.loss, _DIGITS) / factor(unit, 'g'):.12g} {unit}", "sd": sd,
        }  # fmt: skip
        at = next((self._value(c, number) for c in self._columns if c.role == "at"), None)
        if at is None and number != first:
            name = legible(self._table.rows[number][self._names])
            self._fault(number, f"has no time; several weighings of {name} must have a column at")
        return reading if at is None else {**reading, "at": at}

    def _completed(self, template: Mapping[str, Any], number: int) -> dict[str, Any] | None:
        """Return keys with cells of a row in the place of columns; None where one is empty."""
        completed = dict(template)
        for key, text in template.items():
            for name in _PLACE.findall(text) if isinstance(text, str) else ():
                if fault := missing_column(self._table, name, f"{key} = {shortened(text)}"):
                    self.faults.append(fault)
                    return None
                cell = self._table.rows[number][self._table.columns.index(name)]
                if cell.lower() in EMPTY:
                    return None
                number_cell = cell.replace(",", ".")
                cell = number_cell if NUMBER.fullmatch(number_cell) else cell
                completed[key] = completed[key].replace(f"{{{name}}}", cell)
        return completed

    def _value(self, column: _Column, number: int) -> Any:
        """Return the raw value of a cell, with its unit; None for none."""
        one = self._table.column(column.place)
        cell = one.rows[number][0]
        if cell.lower() in EMPTY:
            return None
        if column.role in _TEXTS:
            return cell
        if not column.unit and not NUMBER.fullmatch(cell.replace(",", ".")):
            return parse_value(cell)
        try:
            (value,) = one.numbers(one.columns[0], np.arange(len(one.rows)) == number)
        except InputError as error:
            self.faults += [fault for fault in error.faults if fault not in self.faults]
            return None
        if column.unit:
            return f"{float(value)!r} {column.unit}"
        return parse_value(cell) if cell.isdigit() else float(value)
