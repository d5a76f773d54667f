"""Measure files: the rig's case, the tests' records, weighings, uncertainties."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ringwear_par.cases.case import Case
from ringwear_par.cases.files.columns import FileStore, read_intervals, read_texts
from ringwear_par.cases.files.faults import Origin
from ringwear_par.cases.files.keys import (
    base_keys,
    changes_of,
    kinds,
    override,
    source_tables,
)
from ringwear_par.cases.files.reading import make_case
from ringwear_par.cases.files.weighings import Weighing, Weighings, read_weighings
from ringwear_par.cases.tables import TableReader, name_unknown_keys
from ringwear_par.cases.units import has_unit, in_unit
from ringwear_par.cases.values import RejectedError, is_number
from ringwear_par.errors import Fault, InputError, legible
from ringwear_par.files.text import shortened
from ringwear_par.measuring.definition import schema
from ringwear_par.measuring.definition.problem import Limits, Problem, Test, Uncertainty
from ringwear_par.measuring.definition.records import CHANNELS, Record, read_record
from ringwear_par.schedules import quantity_text

_TABLES = ("case", "measure", "test")
#: share of a test by which a record may end before it, or be longer
_SHORTER = 0.1
_HOUR = 3600.0


def read_measure(source: Path | str | Mapping[str, Any]) -> Problem:
    """Read a measure file with its case, its records and its weighings, or the same as a dict.

    Not collective.

    Raises
    ------
    InputError : all faults, one sentence each.
    """
    name, folder, tables, written = source_tables(source, "measure")
    if "test" not in tables and "measure" not in tables:
        kind = "a fit file" if "experiment" in tables else "a case" if kinds(tables) else "another"
        raise InputError(f"{name}: is {kind}, not a measure file; [[test]] is missing")
    faults: list[str] = []
    name_unknown_keys(name, tables, _TABLES, faults)
    base = base_keys(name, folder, tables, isinstance(source, Mapping), faults)
    files = FileStore(folder)
    reader = TableReader(f"{name}: measure", tables.get("measure", {}), faults, schema.MEASURE)
    weighings, mass_sd = _read_masses(reader, files)
    uncertainty = _read_uncertainty(reader)
    limits = _read_limits(reader)
    reader.finish()
    tests = _Tests(name, base, files, weighings, limits).all(tables.get("test"), faults)
    if faults:
        raise InputError(*faults)
    return Problem(
        name, written, tests, *mass_sd, uncertainty, limits, files.hashes,
        tuple(_notes(tests, weighings, mass_sd[0])),
    )  # fmt: skip


def tables_of(
    records: Sequence[str | Path], case: Any, masses: str | Path | None = None
) -> dict[str, Any]:
    """Return the tables of a measure file for some records of one rig.

    Parameters
    ----------
    records : names of files; tests are called as they are, without their endings.
    case : the name of a case file, or the tables of a case.
    masses : the name of a table of weighings; None: nothing was weighed.
    """
    tables: dict[str, Any] = {
        "case": str(case) if isinstance(case, str | Path) else case,
        "test": [{"name": Path(file).stem, "file": str(file)} for file in records],
    }
    if masses is not None:
        tables["measure"] = {"masses": {"file": str(masses)}}
    return tables


def _read_masses(
    reader: TableReader, files: FileStore
) -> tuple[Weighings | None, tuple[float | None, Any]]:
    """Return the weighings, and the sd of one (g) with its type."""
    table = reader.raw("masses")
    if table is None:
        return None, (None, "B")
    masses = TableReader(f"{reader.place}.masses", table, reader.faults, schema.MASSES)
    file, sd = masses.read("file"), masses.read("sd")
    if sd is not None and not has_unit(masses.raw("sd")):
        masses.wrong("sd", 'must have its unit, such as "0.1 mg"', "unit")
    masses.finish()
    if file is None:
        if isinstance(table, Mapping) and "file" not in table:
            masses.wrong("file", f"must be {schema.MASSES['file'].allowed}")
        return None, (sd, "B")
    try:
        weighings = files.read(file, read_weighings)
    except InputError as error:
        for fault in error.faults:
            masses.fault(fault, "file")
        return None, (sd, "B")
    if sd is not None:
        return weighings, (sd, "B")
    return weighings, (weighings.sd, "B" if weighings.coarse else "A")


def _read_uncertainty(reader: TableReader) -> dict[str, Uncertainty]:
    table = reader.raw("uncertainty", {})
    if not isinstance(table, Mapping):
        reader.wrong("uncertainty", "must be a table of standard uncertainties")
        return {}
    try:
        table = _flat(table)
    except InputError as error:
        reader.faults += [fault.reworded(f"{reader.place}.{fault}") for fault in error.faults]
        return {}
    entries = TableReader(f"{reader.place}.uncertainty", table, reader.faults, schema.UNCERTAINTY)
    uncertainties = {}
    for name, unit in schema.UNCERTAIN.items():
        entry = entries.raw(name)
        if entry is None:
            continue
        rule = f"must be {schema.UNCERTAINTY[name].allowed}{f' ({unit})' if unit else ''}"
        relative = isinstance(entry, Mapping)
        try:
            size = entry.get("relative") if relative else in_unit(entry, unit)
            if (relative and set(entry) != {"relative"}) or not (relative or unit):
                raise RejectedError
            if not is_number(size) or not 0.0 < size < math.inf or (relative and size >= 1.0):
                raise RejectedError
        except RejectedError as reason:
            entries.wrong(name, f"{rule}{f' ({reason})' if str(reason) else ''}", reason.code)
            continue
        uncertainties[name] = Uncertainty(float(size), relative)
    if {"load.force", "load.pressure"} <= uncertainties.keys():
        entries.wrong("load.pressure", "must be absent beside load.force", "conflict")
    entries.finish()
    return uncertainties


def _flat(table: Mapping[str, Any]) -> dict[str, Any]:
    """Return a table of dotted keys whose tables with ``relative`` are values."""
    flat: dict[str, Any] = {}
    for name, entry in table.items():
        if isinstance(entry, Mapping) and "relative" not in entry and "." not in name and entry:
            parts = {f"{name}.{inner}": value for inner, value in entry.items()}
        else:
            parts = {name: entry}
        if twice := flat.keys() & parts.keys():
            raise InputError(f"uncertainty: {legible(min(twice))}: is given twice")
        flat |= parts
    return flat


def _read_limits(reader: TableReader) -> Limits:
    steady = TableReader(
        f"{reader.place}.steady", reader.raw("steady", {}), reader.faults, schema.STEADY
    )
    wear, friction, start = (steady.read(name) for name in ("wear", "friction", "from"))
    if start is not None:
        for name in ("wear", "friction"):
            if name in steady:
                steady.wrong(name, "must be absent beside from", "conflict")
    steady.finish()
    return Limits(wear, friction, start)


class _Tests:
    """Reads the tests.

    Parameters
    ----------
    base : keys of the rig's case; None where it has faults.
    weighings : None where there are none.
    """

    def __init__(
        self,
        name: str,
        base: dict[str, Any] | None,
        files: FileStore,
        weighings: Weighings | None,
        limits: Limits,
    ) -> None:
        self._name, self._base, self._files = name, base, files
        self._weighings, self._limits = weighings, limits
        #: of the base case, which need not be said of every test
        self._reported: set[str] = set()

    def all(self, tables: Any, faults: list[str]) -> tuple[Test, ...]:
        """Return all tests, and add what is wrong with them to the faults."""
        if not isinstance(tables, list) or not tables:
            state = "is missing" if tables is None else f"= {shortened(tables)}"
            sentence = f"{self._name}: test {state}: must be tables, [[test]]"
            faults.append(Fault(sentence, "test", "missing" if tables is None else "not_allowed"))
            return ()
        tests: list[Test] = []
        names: set[str] = set()
        for number, table in enumerate(tables, start=1):
            reader = TableReader(f"{self._name}: test {number}", table, faults, schema.TEST)
            name = reader.read("name")
            if name is not None:
                reader.place = f'{self._name}: test "{legible(name)}"'
            if name in names:
                reader.fault(
                    "name: there are two tests of this name; names must differ", "name", "conflict"
                )
            names.add(name)
            test = self._test(reader, name)
            if test is not None:
                tests.append(test)
        return tuple(tests)

    def _test(self, reader: TableReader, name: str | None) -> Test | None:
        before = len(reader.faults)
        changes = changes_of(reader, self._files.folder)
        case = self._case(reader, changes)
        record = self._record(reader)
        reader.finish()
        if len(reader.faults) > before or name is None or case is None or record is None:
            return None
        # of other keys of time, such as the steps of a history, nothing follows for the test
        timed = any(key.startswith("time.") for key in changes)
        duration = case.time.end if timed else record.duration
        weighing = None if self._weighings is None else self._weighings.specimens.get(name)
        test = Test(name, case, record, duration, weighing)
        self._check(reader, test, weighing)
        return test

    def _case(self, reader: TableReader, changes: Mapping[str, Any]) -> Case | None:
        if self._base is None:
            return None
        name = reader.place
        try:
            keys = override(self._base, changes)
            return make_case(keys, Origin(name, frozenset(changes), f"{name}: set"))
        except InputError as error:
            for fault in error.faults:
                sentence = fault.replace(name, "")
                if sentence not in self._reported:
                    reader.faults.append(fault)
                self._reported.add(sentence)
            return None

    def _record(self, reader: TableReader) -> Record | None:
        file, sense, skip, drop = (reader.read(k) for k in ("file", "sense", "skip", "drop"))
        exclude = read_intervals(reader, "exclude", "s")
        texts = [read_texts(reader, key, [*CHANNELS]) or {} for key in ("columns", "units")]
        if file is None:
            return None
        try:
            return read_record(
                self._files(file, skip, drop),
                columns=texts[0],
                units=texts[1],
                exclude=exclude,
                sense=sense,
            )
        except InputError as error:
            faults: Sequence[str] = error.faults
            if _has_weighings(self._files.folder / file):
                faults = (
                    f"{legible(file)}: is a table of weighings, not a record; it must be given as "
                    "--masses or measure.masses.file",
                )
            for fault in faults:
                reader.fault(fault, "file")
            return None

    def _check(self, reader: TableReader, test: Test, weighing: Weighing | None) -> None:
        """Add what the case and the record do not tell of each other to the faults."""
        case, end, length = test.case, test.record.end, test.record.duration
        if case.load.force is None:
            reader.fault(
                'load.control = "displacement": must be "force": a wear rate needs the load'
            )
            return
        if not test.slides:
            reader.fault(
                f"load.force = {quantity_text(test.force)} and load.omega = "
                f"{quantity_text(case.load.omega)}: the load must be > 0 at all times of the test, "
                "and the speed at some; in a pause load.omega is 0"
            )
        if not (1.0 - _SHORTER) * length <= test.duration:
            reader.fault(
                f"time.end = {test.duration:g} s: the record is {length:g} s long; must be at "
                "least as long; is the unit of the record's time right?"
            )
        if length < _SHORTER * test.duration:
            reader.fault(
                f"the record ends at {length:g} s of a test of {test.duration:g} s; is the unit of "
                "its time right?"
            )
        if self._limits.start is not None and self._limits.start > (1.0 - _SHORTER) * end:
            reader.fault(
                f"measure.steady.from = {self._limits.start:g} s: the record ends at {end:g} s; "
                f"must be at most {1.0 - _SHORTER:g} of the record"
            )
        if weighing is None:
            return
        if case.wear_lower is not None and case.wear_upper is not None:
            reader.fault(
                "both bodies wear: a weighing is of one body; must have [wear.lower] or "
                "[wear.upper]"
            )
        elif case.wear_lower is None and case.wear_upper is None:
            reader.fault(
                "no body wears; the weighed body must have a table [wear.lower] or [wear.upper]"
            )
        elif test.density is None:
            reader.fault(
                f"{test.body}.density is missing: a weighing needs it; must be a number > 0 "
                "(g/mm^3)"
            )


def _has_weighings(path: Path) -> bool:
    """Tell whether a file is a table of weighings."""
    try:
        read_weighings(path)
    except InputError:
        return False
    return True


def _notes(tests: Sequence[Test], weighings: Weighings | None, mass_sd: float | None) -> list[str]:
    """Return sentences about what the files do not tell of each other."""
    notes = [
        f"{test.name}: the record is {test.record.duration / _HOUR:.3g} h long and time.end is "
        f"{test.duration / _HOUR:.3g} h; numbers of the whole test use time.end"
        for test in tests
        if test.duration >= (1.0 + _SHORTER) * test.record.duration
    ]
    if weighings is None:
        return notes
    notes += weighings.notes
    notes += [f"{test.name} was not weighed" for test in tests if test.weighing is None]
    names = {test.name for test in tests}
    untested = [name for name in weighings.specimens if name not in names]
    if untested:
        notes.append(f"weighed specimens without a test: {legible(', '.join(untested), 200)}")
    if weighings.coarse and mass_sd is not None and mass_sd == weighings.sd:
        notes.append(
            "repeated weighings are equal or nearly so: the uncertainty of one, "
            f"{1e3 * mass_sd:.2g} mg, is that of its last digit, {1e3 * weighings.resolution:g} "
            "mg, over the root of 12"
        )
    if mass_sd is None:
        notes.append("uncertainty of masses is unknown and in no budget: give measure.masses.sd")
    return notes
