"""Tables of a laboratory: a row a test, with its conditions and its masses."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from ringwear_par.cases.files.columns import FileStore, missing_column
from ringwear_par.cases.files.laboratory_columns import (
    OF_WEIGHINGS,
    PLACE,
    TEXTS,
    Column,
    columns_of,
    name_thousands,
    name_unused,
    values_of,
)
from ringwear_par.cases.files.weighings import KINDS, MASSES, Weighing, last_digit
from ringwear_par.cases.schema import BY_PATH, key_of
from ringwear_par.cases.tables import Key, TableReader
from ringwear_par.cases.units import factor, has_unit, number_and_unit
from ringwear_par.cases.values import RejectedError
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.errors import InputError, legible
from ringwear_par.files.measurements import Measurements, and_more, read_measurements
from ringwear_par.files.table_text import EMPTY, NUMBER, has_hours
from ringwear_par.files.text import shortened

log = logging.getLogger(__name__)

#: rows of them are no tests
_STATISTICS = {"mean", "average", "mittelwert", "mittel", "median", "sum", "summe", "sd", "std",
               "stdev", "stabw", "min", "max"}  # fmt: skip


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
        reader.wrong("sd", 'must be a number > 0 with its unit, such as "0.1 mg"', "unit")
    reader.finish()
    if not readable:
        return {}
    wrong_keys = len(faults) > before
    worn = [body for body in BODIES if any(key.startswith(f"wear.{body}.") for key in base or ())]
    try:
        table = files.read(file, read_measurements, labelled=True, skip=skip).without(drop)
    except InputError as error:
        for fault in error.faults:
            reader.fault(fault, "file")
        return {}
    in_table: list[str] = []
    columns = columns_of(table, names, units, worn, in_table)
    masses = templates["data"] or {c.role for c in columns} & {*KINDS}
    if worn and not (in_table or wrong_keys or masses):
        in_table.append(
            f"{table.name}: has no column of masses; one must be named before, after or loss, or "
            "tests.columns must name it"
        )
    rows = _Rows(table, columns, sd, templates, (base or {}).get("time.end"), in_table)
    if in_table or wrong_keys:
        tests = {}
        values_of(table, columns, range(len(table.rows)), in_table)
    else:
        tests = rows.tests()
    if worn and not in_table:
        name_unused(table, columns, templates, in_table)
        name_thousands(table, columns)
    for sentence in dict.fromkeys(in_table):  # of a column it is that of each row
        reader.fault(sentence, "file")
    # the other faults of its tests may follow from those
    return {} if in_table or wrong_keys else tests


def _texts(reader: TableReader, key: str) -> Mapping[str, str]:
    """Return a table of texts by the role of columns."""
    table = reader.raw(key, {})
    if not isinstance(table, Mapping) or not all(isinstance(v, str) for v in table.values()):
        reader.wrong(key, "must be a table of texts")
        return {}
    roles = (*TEXTS, *OF_WEIGHINGS)
    for role in table:
        if role not in roles and role.partition(".")[0] not in MASSES and key_of(role) is None:
            reader.fault(
                f"{key}.{legible(role)}: must be {', '.join(roles)}, a mass with its body "
                "(loss.lower) or a key of a case",
                key,
                "unknown_key",
            )
    return table


def _templates(reader: TableReader, key: str) -> list[Mapping[str, Any]]:
    tables = reader.raw(key, [])
    if not isinstance(tables, list) or not all(isinstance(table, Mapping) for table in tables):
        reader.wrong(key, f"must be tables, [[tests.{key}]]")
        return []
    return tables


def _in(value: str, unit: str) -> float:
    """Return a number with a unit in another unit."""
    number, written = number_and_unit(value)
    return number * factor(written, unit)


@dataclass(frozen=True, eq=False)
class _Rows:
    """The rows of a table as tests."""

    table: Measurements
    columns: Sequence[Column]
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

    def _fault(self, number: int, sentence: str) -> None:
        self.faults.append(f"{self.table.name}: line {self.table.lines[number]}: {sentence}")

    def _test(self, name: str, numbers: list[int], late: dict[int, float]) -> dict[str, Any]:
        """Return the keys of a test, of its rows; add those after its end to the late ones."""
        before, first = len(self.faults), numbers[0]
        values = values_of(self.table, self.columns, numbers, self.faults)
        test: dict[str, Any] = {"name": name, "set": {}}
        for column in self.columns:
            if column.role in ("name", *OF_WEIGHINGS):
                continue
            value = values[first][column]
            for number in numbers[1:]:
                if (repeated := values[number][column]) not in (None, value):
                    place = f"{legible(self.table.columns[column.place])} = {shortened(repeated)}"
                    self._fault(
                        number,
                        f"{place}: must be that of the first row of {legible(name)}, or empty",
                    )
            is_empty = self.table.rows[first][column.place].lower() in EMPTY
            if is_empty and column.role not in TEXTS:
                heading = legible(self.table.columns[column.place])
                self._fault(first, f"{heading} is empty; must be what the test had")
            if value is not None:
                (test if column.role in TEXTS else test["set"])[column.role] = value
        for key, templates in self.templates.items():
            tables = [self._completed(template, first) for template in templates]
            test[key] = [table for table in tables if table is not None]
        for body in BODIES:
            weighed = {
                n: reading
                for n in numbers
                if any(column.body == body for column in self.columns)
                and (reading := self._weighed(values, body, n, first, name))
            }
            test["data"] += weighed.values()
            if len(self.faults) == before:
                self._check_order(name, weighed, test["set"].get("time.end", self.end), late)
        if not test["data"] and len(self.faults) == before:
            self._fault(first, f"{legible(name)}: has no reading; must have a mass at least")
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
        self, values: Mapping[int, Mapping[Column, Any]], body: str, number: int, first: int,
        name: str,
    ) -> dict[str, Any] | None:  # fmt: skip
        """Return the mass lost by a body since the start as ``[[experiment.data]]`` has it."""
        masses: dict[str, list[float]] = {}
        unit, digit = "", 0.0
        for column in (c for c in self.columns if c.body == body and c.role in KINDS):
            row = first if column.role == "before" else number
            if row != number and values[number][column] not in (None, values[first][column]):
                self._fault(
                    number,
                    f"{legible(self.table.columns[column.place])}: must be the mass before the "
                    "test, as in its first row, or empty",
                )
            if (value := values[row][column]) is not None:
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
        cells = values[number].items()
        sd, at, limit = (
            next((v for c, v in cells if c.role == role and c.body in ("", body)), None)
            for role in ("sd", "at", "censored")
        )
        if sd is None and self.sd is not None:
            weighing_sd, unit_of_sd = number_and_unit(self.sd)
            sd = f"{weighing.u(weighing_sd):.12g} {unit_of_sd}"
        if sd is None:
            filled = (self.table.rows[number][c.place].lower() not in EMPTY
                      for c, _ in cells if c.role == "sd" and c.body in ("", body))  # fmt: skip
            if not any(filled):  # else it cannot be read, which is a fault already
                self._fault(
                    number,
                    "the sd of its mass is unknown; must be in a column sd, or that of one "
                    "weighing in tests.sd",
                )
            return None
        if at is None and number != first:
            self._fault(
                number,
                f"has no time; several weighings of {legible(name)} must have a column at",
            )
        reading = {
            "quantity": f"mass.{body}",
            "value": f"{weighing.loss / factor(unit, 'g'):.12g} {unit}", "sd": sd,
            "censored": limit, "at": at,
        }  # fmt: skip
        return {key: value for key, value in reading.items() if value is not None}

    def _completed(self, template: Mapping[str, Any], number: int) -> dict[str, Any] | None:
        """Return keys with cells of a row in the place of columns; None where one is empty."""
        completed = dict(template)
        for key, text in template.items():
            for name in PLACE.findall(text) if isinstance(text, str) else ():
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
