"""Fit files: a base case, the keys to fit, and experiments with their measurements."""

import logging
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from ringwear_par.cases.case import Case
from ringwear_par.cases.files.columns import FileStore
from ringwear_par.cases.files.keys import (
    base_keys,
    changes_of,
    kinds,
    read_keys,
    source_tables,
)
from ringwear_par.cases.files.laboratory_tables import laboratory_tests
from ringwear_par.cases.tables import TableReader
from ringwear_par.cases.units import has_unit, number_and_unit
from ringwear_par.errors import Fault, InputError, legible
from ringwear_par.identification.definition.experiments import (
    Cases,
    read_experiments,
    under_law,
)
from ringwear_par.identification.definition.fitted_parameters import read_parameters
from ringwear_par.identification.definition.problem import (
    DesignSpace,
    Experiment,
    FittedParameter,
    Problem,
    Series,
    Settings,
)
from ringwear_par.identification.definition.scatter import (
    check_process,
    check_scatter,
    read_process,
)
from ringwear_par.identification.definition.schema import (
    inner,
    keys_of,
    read_all,
    reader_of,
    tables_in,
)

log = logging.getLogger(__name__)

#: keys of the search for an optimum, which files of laboratories still have
_GONE = ("starts", "method")
#: beginning of the faults of a test
_TEST = re.compile(r'.*?(?:experiment|line)(?: \d+)? "(?:[^"\\]|\\.)*": ')
_LOADS = ("load.pressure", "load.force")


def read_fit(
    source: Path | str | Mapping[str, Any],
    *,
    plans: bool = False,
    running: str | None = None,
    others: bool = False,
) -> Problem:
    """Read a fit file with its case and all its measurements, or a dict of them. Not collective.

    Planned readings only where ``plans``. Of a ``running`` experiment ("": the last one) this one
    alone, whose files grow and whose readings may be too few for a fit, or all ``others``. Raises
    InputError with all faults.
    """
    tables_or_file = _with_keys(source) if isinstance(source, Mapping) else source
    name, folder, tables, written = source_tables(tables_or_file, "fit")
    if not {"experiment", "tests"} & tables.keys() and (kind := kinds(tables)) & {"case", "study"}:
        kind_of_file = "a case" if "case" in kind and "case" not in tables else "a study"
        raise InputError(f"{name}: is {kind_of_file}, not a fit file; [[experiment]] is missing")
    faults: list[str] = []
    file = TableReader(name, tables, faults)
    base = base_keys(name, folder, tables, isinstance(source, Mapping), faults)
    settings, parameters = _read_settings(inner(file, "fit"))
    alone = running is not None and not others
    files = FileStore(folder, growing=alone)
    tests = _tests(file, base, files)
    if running is not None:
        tests = _chosen(file, tests, running, others)
    experiments = read_experiments(name, tests, Cases(base, parameters, faults), files)
    faults += () if plans else _planned(name, experiments)
    design = _read_design_space(inner(file, "design"))
    compared, laws = inner(file, "compare"), {}
    for law in [*compared.keys()]:
        reader = inner(compared, law, "compare.NAME")
        laws[law] = changes_of(reader, folder), read_parameters(reader)
        reader.finish()
    file.raw("case")
    file.finish()
    _refuse(faults)
    whose = f"{name}: without {legible(running or '')}" if others else name
    problem = Problem(whose, written, settings, parameters, experiments, {}, files.hashes, design)
    if alone:
        return problem
    _check(problem, faults)
    alternatives = {}
    for law, (changes, fitted) in laws.items():
        place = f"{name}: compare.{legible(law)}"
        other = under_law(place, experiments, Cases(base, fitted, faults, changes))
        alternatives[law] = replace(problem, name=place, parameters=fitted, experiments=other)
        if not faults:
            _check(alternatives[law], faults)
    _refuse(faults)
    return replace(problem, alternatives=alternatives)


def _refuse(faults: Sequence[str]) -> None:
    """Raise InputError of faults; one that several tests have is said of the first one only."""
    tests: dict[str, list[str]] = {}
    for fault in faults:
        test = _TEST.match(fault)
        tests.setdefault(fault[test.end() :] if test else fault, []).append(fault)
    said = [
        Fault(first).reworded(first + f" (so in {len(repeats) + 1} tests)" * bool(repeats))
        for first, *repeats in tests.values()
    ]
    if said:
        raise InputError(*said)


def _chosen(
    file: TableReader, tests: list[TableReader], running: str, others: bool
) -> list[TableReader]:
    """Return the table of the running test, or of all others, out of those of a fit file."""
    known = [name for test in tests if isinstance(name := test.raw("name"), str)]
    if not known:  # which their readers say
        return tests
    running = running or known[-1]
    if running not in known:
        every = ", ".join(map(legible, known))
        raise InputError(f"--test = {legible(running)}: must be one of {every} of {file.place}")
    if others and len(tests) == 1:
        raise InputError(
            f"{file.place}: has no test but {legible(running)}; --after must name the folder of a "
            "fit of others"
        )
    return [test for test in tests if (test.raw("name") == running) is not others]


def _tests(
    file: TableReader, base: Mapping[str, Any] | None, files: FileStore
) -> list[TableReader]:
    """Return the tables of a fit file's tests.

    Those that are written out, then those of the table that ``[tests]`` names; ``base`` has the
    dotted keys of their case, None where that has faults.
    """
    table, place = file.raw("tests"), f"{file.place}: tests"
    written = tables_in(file, "experiment", needed=table is None)
    if table is None:
        return written
    rows = laboratory_tests(place, table, keys_of("tests"), base, files, file.faults)
    return written + [
        reader_of("experiment", f"{file.place}: {row}", table, file.faults)
        for row, table in rows.items()
    ]


def _with_keys(source: Mapping[str, Any]) -> dict[str, Any]:
    """Return the tables of a fit with the keys of its case, where that is a Case."""
    case = source.get("case")
    if not isinstance(case, Case):
        return dict(source)
    if case.rebuild is None:
        raise InputError("fit: case: its text does not tell its keys; must be one that was read")
    return {**source, "case": read_keys(case.text)}


def _read_settings(reader: TableReader) -> tuple[Settings, tuple[FittedParameter, ...]]:
    """Return how to fit, and the fitted keys, of ``[fit]``."""
    if gone := [key for key in _GONE if key in reader]:
        log.warning("%s: %s: is not needed any more, and ignored", reader.place, ", ".join(gone))
        for key in gone:
            reader.raw(key)
    parameters = read_parameters(reader, reader.raw("units", {}))
    level, loss = reader.read("level"), reader.read("loss")
    process = read_process(reader)
    reader.finish()
    return Settings(level, loss, process), parameters


def _read_design_space(reader: TableReader) -> DesignSpace:
    """Return the space of ``[design]``."""
    criterion = reader.read("criterion")
    varied, budget = inner(reader, "vary"), inner(reader, "budget")
    reader.finish()
    units = {}
    for key in keys_of("design.vary"):
        entry = varied.raw(key)
        if isinstance(entry, list) and entry and has_unit(entry[0]):
            units[key] = number_and_unit(entry[0])[1]
    every = zip(keys_of("design.vary"), read_all(varied), strict=True)
    ranges = {key: value for key, value in every if value is not None}
    if all(key in ranges for key in _LOADS):
        varied.fault("load.pressure and load.force: only one of them may vary")
    seconds, count = read_all(budget)
    return DesignSpace(criterion, ranges, seconds, count, units)


def _placed(name: str, experiments: Sequence[Experiment]) -> list[tuple[str, Series]]:
    """Return all series of experiments, each with how sentences about it begin."""
    return [
        (f'{name}: experiment "{legible(experiment.name)}": {series.name}', series)
        for experiment in experiments
        for series in experiment.series
    ]


def _planned(name: str, experiments: Sequence[Experiment]) -> list[Fault]:
    """Return the faults of readings that are planned, where there must be some."""
    rule = "file or value must be given; planned readings are for --dry-run and ringwear design"
    return [
        Fault(f"{place}: {rule}", "experiment.data.file", "missing")
        for place, series in _placed(name, experiments)
        if series.planned
    ]


def _check(problem: Problem, faults: list[str]) -> None:
    """Refuse what readings cannot tell, as more unknowns than there are readings."""
    series = [record for experiment in problem.experiments for record in experiment.series]
    free = sum(p.prior is None for p in problem.parameters)
    free += sum(n.free for record in series for n in record.nuisances)
    if (readings := sum(record.n for record in series)) < free:
        faults.append(
            f"{problem.name}: {readings} readings: must be at least as many as are fitted, {free} "
            "parameters and nuisances"
        )
        return
    _check_censored(problem, faults)
    check_scatter(problem, faults)
    check_process(problem, faults)


def _check_censored(problem: Problem, faults: list[str]) -> None:
    """Refuse what does not go together with censored readings."""
    for place, series in _placed(problem.name, problem.experiments):
        if series.censored is None or not series.censored.any():
            continue
        rules = {
            'must be absent with loss = "student"': problem.settings.loss == "student",
            "must be absent with process": bool(problem.settings.process),
            "must be absent with correlation_time": series.correlation_time > 0.0,
            'needs sd as a number where all readings are: must not be "fit"':
                series.sd_fitted and series.censored.all(),
        }  # fmt: skip
        faults += [
            Fault(f"{place}: censored: {rule}", "experiment.data.censored", "conflict")
            for rule, broken in rules.items()
            if broken
        ]
