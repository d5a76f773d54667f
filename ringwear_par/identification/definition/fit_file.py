"""Fit files as a whole: base case, keys to fit, experiments; what they must have together."""

import itertools
import logging
import math
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ringwear_par.cases.case import Case
from ringwear_par.cases.files.columns import FileStore
from ringwear_par.cases.files.faults import Origin
from ringwear_par.cases.files.key_values import read_values
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
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.errors import Fault, InputError, legible
from ringwear_par.identification.definition.experiments import Cases, read_experiments
from ringwear_par.identification.definition.fitted_parameters import read_parameters, read_process
from ringwear_par.identification.definition.problem import (
    GROUPS,
    PLURALS,
    DesignSpace,
    Problem,
    Settings,
    body_of_wear,
)
from ringwear_par.identification.definition.schema import inner, keys_of, read_all

log = logging.getLogger(__name__)

#: keys of the search for an optimum, which files of laboratories still have
_GONE = ("starts", "method")
#: beginning of the faults of a test
_TEST = re.compile(r'.*?(?:experiment|line)(?: \d+)? "(?:[^"\\]|\\.)*": ')
#: most sizes that one fit may estimate: readings of more tell little but their priors
_MOST_FITTED = 3
#: largest correlation time, as a share of a record: noise that is correlated for longer looks like
#: wear
_LONGEST_CORRELATION = 0.1
#: keys of the load, of which one may vary
LOADS = ("load.pressure", "load.force")


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
    if isinstance(source, Mapping) and isinstance(case := source.get("case"), Case):
        if case.rebuild is None:
            raise InputError("fit: case: its text has not its keys; must be one that was read")
        source = {**source, "case": read_keys(case.text)}
    name, folder, tables, written = source_tables(source, "fit")
    known = {"fit", "experiment", "tests"} & tables.keys()
    if not known and (kind := kinds(tables)) & {"case", "study"}:
        kind_of_file = "a case" if "case" in kind and "case" not in tables else "a study"
        raise InputError(f"{name}: is {kind_of_file}, not a fit file; [[experiment]] is missing")
    faults: list[str] = []
    file = TableReader(name, tables, faults)
    base = base_keys(name, folder, tables, isinstance(source, Mapping), faults)
    case = file.raw("case")
    origin = Origin(str(folder / case) if isinstance(case, str) else f"{name}: case")
    of_keys = [Fault(fault) for fault in read_values(base or {}, origin)[1]]
    if wrong := [fault for fault in of_keys if fault.code != "missing"]:  # which tests may set
        base = None
        faults += wrong
    fit = inner(file, "fit")
    if gone := [key for key in _GONE if key in fit]:
        log.warning("%s: %s: is not needed any more, and ignored", fit.place, ", ".join(gone))
        for key in gone:
            fit.raw(key)
    parameters, process = read_parameters(fit), read_process(fit)
    settings = Settings(fit.read("level"), fit.read("loss"), process)
    fit.finish()
    alone = running is not None and not others
    files = FileStore(folder, growing=alone)
    tests = _tests(file, base, files)
    if running is not None:
        tests = _chosen(name, tests, running, others)
    experiments = read_experiments(name, tests, Cases(base, parameters, faults), files)
    design = _read_design_space(inner(file, "design"))
    compared, laws = inner(file, "compare"), {}
    for law in [*compared.keys()]:
        reader = inner(compared, law, "compare.NAME")
        laws[law] = changes_of(reader, folder), read_parameters(reader)
        reader.finish()
    file.finish()
    whose = f"{name}: without {legible(running or '')}" if others else name
    problem = Problem(whose, written, settings, parameters, experiments, {}, files.hashes, design)
    _check_readings(problem, plans, faults)
    _refuse(faults)
    if alone:
        return problem
    _check(problem, faults)
    alternatives = {}
    for law, (changes, fitted) in laws.items():
        place = f"{name}: compare.{legible(law)}"
        read = read_experiments(place, tests, Cases(base, fitted, faults, changes), files)
        alternatives[law] = replace(problem, name=place, parameters=fitted, experiments=read)
        if not faults:
            _check(alternatives[law], faults)
    _refuse(faults)
    return replace(problem, alternatives=alternatives)


def _refuse(faults: Sequence[str]) -> None:
    """Raise InputError of faults; one that several tests have is said of the first one only."""
    rules = [_TEST.sub("", fault, count=1) for fault in faults]
    first = dict(zip(reversed(rules), reversed(faults), strict=True))
    if faults:
        raise InputError(*(
            Fault(first[rule]).reworded(first[rule] + f" (so in {count} tests)" * (count > 1))
            for rule, count in Counter(rules).items()
        ))  # fmt: skip


def _chosen(name: str, tests: Mapping[str, Any], running: str, others: bool) -> dict[str, Any]:
    """Return the table of the running test, or of all others, out of those of a fit file."""
    names = {w: table.get("name") for w, table in tests.items() if isinstance(table, Mapping)}
    known = [test for test in names.values() if isinstance(test, str)]
    running = running or (known[-1] if known else "")
    if known and running not in known:
        every = ", ".join(map(legible, known))
        raise InputError(f"--test = {legible(running)}: must be one of {every} of {name}")
    if others and len(tests) == 1:
        raise InputError(
            f"{name}: has no test but {legible(running)}; --after must name the folder of a "
            "fit of others"
        )
    return {w: table for w, table in tests.items() if (names.get(w) == running) is not others}


def _tests(file: TableReader, base: Mapping[str, Any] | None, files: FileStore) -> dict[str, Any]:
    """Return the tables of a fit file's tests, by where they stand.

    Those of the table that ``[tests]`` names, then those that are written out; ``base`` has the
    dotted keys of their case, None where that has faults.
    """
    table, written = file.raw("tests"), file.raw("experiment", [])
    if not isinstance(written, list) or not (written or table is not None):
        file.wrong("experiment", "must be tables, [[experiment]]")
        written = []
    tests = {f"experiment {number}": test for number, test in enumerate(written, start=1)}
    if table is None:
        return tests
    place, keys = f"{file.place}: tests", keys_of("tests")
    return laboratory_tests(place, table, keys, base, files, file.faults) | tests


def _read_design_space(reader: TableReader) -> DesignSpace:
    """Return the space of ``[design]``."""
    criterion = reader.read("criterion")
    varied, budget = inner(reader, "vary"), inner(reader, "budget")
    reader.finish()
    written = {key: varied.raw(key) for key in keys_of("design.vary")}
    units = {
        key: number_and_unit(entry[0])[1]
        for key, entry in written.items()
        if isinstance(entry, list) and entry and has_unit(entry[0])
    }
    every = zip(keys_of("design.vary"), read_all(varied), strict=True)
    ranges = {key: value for key, value in every if value is not None}
    if all(key in ranges for key in LOADS):
        varied.fault("load.pressure and load.force: only one of them may vary")
    seconds, count = read_all(budget)
    limit = (seconds or math.inf) * (1.0 + 1e-9)  # for round-off
    return DesignSpace(criterion, ranges, limit, count, units)


def _check_readings(problem: Problem, plans: bool, faults: list[str]) -> None:
    """Refuse planned readings but for plans, and what does not go together with limits."""
    settings = problem.settings
    for test, series in ((e.name, s) for e in problem.experiments for s in e.series):
        place = f'{problem.name}: experiment "{legible(test)}": {series.name}'
        if series.planned and not plans:
            rule = "must be given; planned readings are for --dry-run and ringwear design"
            fault = Fault(f"{place}: file or value {rule}", "experiment.data.file", "missing")
            faults.append(fault)
        limits = np.zeros(1) if series.censored is None else series.censored
        rules = {
            'must be absent with loss = "student"': settings.loss == "student",
            "must be absent with process": bool(settings.process),
            "must be absent with correlation_time": series.correlation_time > 0.0,
            'needs sd as a number where all readings are: must not be "fit"':
                series.sd_fitted and limits.all(),
        }  # fmt: skip
        faults += [
            Fault(f"{place}: censored: {rule}", "experiment.data.censored", "conflict")
            for rule, broken in rules.items()
            if broken and limits.any()
        ]


def _check(problem: Problem, faults: list[str]) -> None:
    """Refuse what readings cannot tell, as more unknowns than there are readings."""
    series = [record for experiment in problem.experiments for record in experiment.series]
    nuisances = [nuisance.free for record in series for nuisance in record.nuisances]
    free = sum(p.prior is None for p in problem.parameters) + sum(nuisances)
    found = [*_faults_of_scatter(problem), *_faults_of_process(problem)]
    if (readings := sum(record.n for record in series)) < free:
        rule = "must be at least as many as are fitted"
        found = [f"{readings} readings: {rule}, {free} parameters and nuisances"]
    faults += [f"{problem.name}: {sentence}" for sentence in found]


def _faults_of_scatter(problem: Problem) -> Iterator[str]:
    """Yield what readings cannot tell of the scatters."""
    scatters = [(p.key, p.scatter) for p in problem.parameters if p.scatter is not None]
    fitted = [(key, group) for key, s in scatters for group, v in s.sizes.items() if v is None]
    count = len(fitted) + sum(noise.fitted for noise in problem.settings.process.values())
    if count > _MOST_FITTED:
        yield f'{count} sizes of scatter and process are "fit"; must be at most {_MOST_FITTED}'
    if not scatters:
        return
    every = (series for test in problem.experiments for series in test.series)
    if all(s.censored is not None and s.censored.all() for s in every):
        rule = "which tell nothing of keys with scatter; some must be values, or scatter absent"
        yield f"all readings are limits, {rule}"
    groups = zip(*(experiment.groups for experiment in problem.experiments), strict=True)
    names = dict(zip(GROUPS, groups, strict=True))
    for group in GROUPS[1:]:
        pairs = sorted({*zip(names["specimen"], names[group], strict=True)})
        for (specimen, label), (again, other) in itertools.pairwise(pairs):
            if specimen == again:
                both = f'{group} "{legible(label)}" and of "{legible(other)}"'
                yield f'specimen "{legible(specimen)}" is of {both}; must be of one {group}'
    for key, group in fitted:
        scatter, count, plural = f"scatter of {key}", len({*names[group]}), PLURALS[group]
        if count == 1:
            rule = f"must be a number, or there must be at least 2 {plural}"
            yield f"{scatter} between {plural} cannot be fitted to one {group}; {rule}"
        for small in GROUPS[: GROUPS.index(group)]:
            pairs_of_groups = {*zip(names[small], names[group], strict=True)}
            if (key, small) in fitted and len(pairs_of_groups) == count:
                same = f"{group} and {small} are the same groups"
                yield f'{scatter}: {same}; only one of the two can be "fit"'


def _faults_of_process(problem: Problem) -> Iterator[str]:
    """Yield what readings cannot tell of wear's own noise."""
    tests = problem.experiments
    series = [(test.name, one) for test in tests for one in test.series]
    bodies = [body_of_wear(key) for key in problem.settings.process]
    for body in bodies:
        key = f"fit.process.wear.{body}"
        if not any(test.case.laws[BODIES.index(body)] for test in tests):
            yield f"{key}: {body} does not wear; must be a body with a wear law"
        elif not any(one.tells_wear(body) for _, one in series):
            kinds_of_body = f"depth, mass, volume or profile of {body}"
            yield f"{key}: no reading is of a {kinds_of_body}; must have one at least"
    for test, one in series:
        length, time = float(np.ptp(one.x)), one.correlation_time  # s
        if time > _LONGEST_CORRELATION * length and any(map(one.tells_wear, bodies)):
            state = f'experiment "{legible(test)}": {one.name}: correlation_time = {time:g}'
            rule = f"must be at most {_LONGEST_CORRELATION:g} of the record, {length:g} s"
            yield f"{state}: cannot be told from wear's own noise (fit.process); {rule}"
