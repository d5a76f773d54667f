"""Fit files: a base case, the keys sought, and experiments with their measurements."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ringwear_par.cases.case import Case
from ringwear_par.cases.files.columns import FileStore
from ringwear_par.cases.files.faults import Origin
from ringwear_par.cases.files.keys import (
    base_keys,
    flatten,
    in_full,
    kinds,
    override,
    plain,
    read_keys,
    written_units,
)
from ringwear_par.cases.files.reading import make_case
from ringwear_par.cases.tables import TableReader, name_unknown_keys
from ringwear_par.cases.text import shortened, toml_value
from ringwear_par.cases.units import has_unit, number_and_unit
from ringwear_par.errors import MOST_FAULTS, InputError, legible
from ringwear_par.files.text import parse_toml, read_text, refuse_depth
from ringwear_par.history.validity.case_limits import check_case
from ringwear_par.identification.definition import schema
from ringwear_par.identification.definition.censoring import check_censored
from ringwear_par.identification.definition.fitted_parameters import (
    read_parameters,
    read_units,
    refuse_both,
    refuse_fixed,
)
from ringwear_par.identification.definition.key_order import refuse_order
from ringwear_par.identification.definition.problem import (
    DesignSpace,
    Experiment,
    FittedParameter,
    Problem,
    Series,
    Settings,
)
from ringwear_par.identification.definition.process import check_process, read_process
from ringwear_par.identification.definition.scatter import check_scatter, read_groups
from ringwear_par.identification.definition.series import read_series

#: what a fit needs of histories, and how they are stepped
_STEPPING = {"time.scheme": "adaptive"}
_OUTPUT = {
    "output.every": 1, "output.profiles": "all", "output.fields": ["wear_lower", "wear_upper"],
    "output.boundary": "none", "stress": None,
}  # fmt: skip
_TABLES = ("case", "fit", "experiment", "compare", "design")
_LOADS = ("load.pressure", "load.force")


def read_complete(source: Path | str | Mapping[str, Any]) -> Problem:
    """Read a fit file, if the packages for its intervals are there. Not collective.

    Raises
    ------
    InputError : its faults; a package that is missing.
    """
    problem = read_fit(source)
    if missing := problem.settings.missing_package:
        raise InputError(f"{problem.name}: {missing}")
    return problem


def read_fit(
    source: Path | str | Mapping[str, Any],
    *,
    plans: bool = False,
    test: str = "",
    files: FileStore | None = None,
) -> Problem:
    """Read a fit file with its case and all its measurements, or the same as a dict.

    Not collective.

    Parameters
    ----------
    plans : whether readings may be planned ones.
    test : name of the one experiment that is read, and not compared with others; "": all are.
    files : of measurements; None: those beside the fit file, as they are.

    Raises
    ------
    InputError : all faults, one sentence each.
    """
    if isinstance(source, Mapping):
        refuse_depth(source, "fit")
        name, folder, tables = "fit", Path(), plain(_with_keys(source))
        written = "".join(f"{toml_value(key)} = {toml_value(v)}\n" for key, v in tables.items())
    else:
        path = Path(source)
        name, folder, written = str(path), path.parent, read_text(path)
        tables = parse_toml(written, name)
    if "experiment" not in tables and (kind := kinds(tables)) & {"case", "study"}:
        kind_of_file = "a case" if "case" in kind and "case" not in tables else "a study"
        raise InputError(f"{name}: is {kind_of_file}, not a fit file; [[experiment]] is missing")
    faults: list[str] = []
    name_unknown_keys(name, tables, _TABLES, faults)
    base = base_keys(name, folder, tables, isinstance(source, Mapping), faults)
    case_units = written_units(tables.get("case"), folder)
    settings, parameters = _read_settings(f"{name}: fit", tables.get("fit", {}), case_units, faults)
    files = FileStore(folder) if files is None else files
    reader = _Experiments(name, folder, base, files, plans)
    experiments = reader.all(tables.get("experiment"), parameters, faults, test)
    design = _read_design_space(f"{name}: design", tables.get("design", {}), case_units, faults)
    laws = _read_alternatives(f"{name}: compare", tables.get("compare", {}), case_units, faults)
    if faults:
        raise InputError(*faults)
    if test:
        return Problem(name, written, settings, parameters, experiments, {}, files.hashes, design)
    _check_counts(name, parameters, experiments, faults)
    check_scatter(name, parameters, experiments, settings, faults)
    check_censored(name, settings, experiments, faults)
    check_process(name, settings.process, experiments, settings.intervals, faults)
    alternatives = {}
    for law, (changes, law_parameters) in laws.items():
        alternatives[law] = Problem(
            f"{name}: compare.{law}", written, settings, law_parameters,
            reader.changed(law, experiments, changes, law_parameters, faults), {}, files.hashes,
            design,
        )  # fmt: skip
        _check_counts(f"{name}: compare.{law}", law_parameters, experiments, faults)
        linear = replace(settings, intervals=("linear",))
        check_scatter(f"{name}: compare.{law}", law_parameters, experiments, linear, faults)
        changed = alternatives[law].experiments
        check_process(alternatives[law].name, settings.process, changed, ("linear",), faults)
    if faults:
        raise InputError(*faults)
    return Problem(
        name, written, settings, parameters, experiments, alternatives, files.hashes, design
    )


def _with_keys(source: Mapping[str, Any]) -> dict[str, Any]:
    """Return the tables of a fit with the keys of its case, where that is a Case."""
    case = source.get("case")
    if not isinstance(case, Case):
        return dict(source)
    if case.rebuild is None:
        raise InputError("fit: case: its text does not tell its keys; must be one that was read")
    return {**source, "case": read_keys(case.text)}


def _read_settings(
    said: str, table: Any, case_units: Mapping[str, str], faults: list[str]
) -> tuple[Settings, tuple[FittedParameter, ...]]:
    reader = TableReader(said, table, faults, schema.FIT)
    fitted = reader.raw("parameters")
    units = read_units(f"{said}.units", reader.raw("units", {}), fitted, faults)
    parameters = read_parameters(f"{said}.parameters", fitted, faults, units, case_units)
    names = ("starts", "method", "intervals", "samples", "level", "loss")
    settings = {name: reader.read(name) for name in names}
    process = read_process(f"{said}.process", reader.raw("process", {}), faults)
    reader.finish()
    intervals = dict.fromkeys(("linear", *settings.pop("intervals")))
    return Settings(intervals=tuple(intervals), process=process, **settings), parameters


def _read_design_space(
    said: str, table: Any, case_units: Mapping[str, str], faults: list[str]
) -> DesignSpace:
    """Return the space of ``[design]``; add what is wrong with it to the faults."""
    reader = TableReader(said, table, faults, schema.DESIGN)
    criterion = reader.read("criterion")
    vary, budget = (reader.raw(key, {}) for key in ("vary", "budget"))
    reader.finish()
    units = {key: unit for key, unit in case_units.items() if key in schema.VARY}
    for key, entry in vary.items() if isinstance(vary, Mapping) else ():
        if isinstance(entry, list) and entry and has_unit(entry[0]):
            units[key] = number_and_unit(entry[0])[1]
    vary = TableReader(f"{said}.vary", vary, faults, schema.VARY)
    values = {key: vary.read(key) for key in schema.VARY}
    ranges = {key: value for key, value in values.items() if value is not None}
    vary.finish()
    if all(key in ranges for key in _LOADS):
        vary.fault("load.pressure and load.force: only one of them may vary")
    if "load.steps" in ranges and not any(key in ranges for key in _LOADS):
        vary.wrong(
            "load.steps", "needs load.pressure or load.force beside it, the range of the loads"
        )
    limits = TableReader(f"{said}.budget", budget, faults, schema.BUDGET)
    seconds, count = limits.read("time.end"), limits.read("experiments")
    limits.finish()
    return DesignSpace(criterion, ranges, seconds, count, units)


class _Experiments:
    """Reads the experiments, of the base case (None where it has faults) and under other laws."""

    def __init__(
        self,
        name: str,
        folder: Path,
        base: dict[str, Any] | None,
        files: FileStore,
        plans: bool,
    ) -> None:
        self._name, self._folder, self._base, self._files = name, folder, base, files
        self._plans = plans
        self._keys: dict[str, dict[str, Any]] = {}
        #: what was wrong with cases; of fitted keys the same need not be said of every experiment
        self._reported: set[str] = set()

    def all(
        self,
        tables: Any,
        parameters: tuple[FittedParameter, ...],
        faults: list[str],
        test: str = "",
    ) -> tuple[Experiment, ...]:
        """Return all experiments, or one test, and add what is wrong with them to the faults."""
        if not isinstance(tables, list) or not tables:
            state = "is missing" if tables is None else f"= {shortened(tables)}"
            faults.append(f"{self._name}: experiment {state}: must be tables, [[experiment]]")
            return ()
        experiments: list[Experiment] = []
        for i, table in enumerate(tables, start=1):
            if test and isinstance(table, Mapping) and table.get("name", test) != test:
                continue
            experiment = self._experiment(i, table, parameters, faults)
            if experiment is None:
                continue
            for other in experiments:
                self._refuse_twin(experiment, other, faults)
            experiments.append(experiment)
        return tuple(experiments)

    def _experiment(
        self, i: int, table: Any, parameters: tuple[FittedParameter, ...], faults: list[str]
    ) -> Experiment | None:
        reader = TableReader(f"{self._name}: experiment {i}", table, faults, schema.EXPERIMENT)
        name = reader.read("name")
        if name is None:
            return None
        said = reader.place = f'{self._name}: experiment "{legible(name)}"'
        changes = self._changes(reader, faults)
        refuse_both(f"{said}: set", parameters, changes, faults)
        case = None
        if self._base is not None and len(faults) < MOST_FAULTS:  # no more are told
            keys = override(override(self._base, _STEPPING), changes)
            self._keys[name] = override(keys, {**_STEPPING, **_OUTPUT})
            case = self._case(said, self._keys[name], changes, parameters, faults)
        groups = read_groups(reader, name)
        data = reader.raw("data")
        reader.finish()
        if not isinstance(data, list) or not data:
            reader.wrong("data", "must be tables, [[experiment.data]]")
            return None
        series: list[Series] = []
        for number_, entry in enumerate(data, start=1):
            readings = read_series(
                f"{said}: data {number_}", entry, case, self._files, faults, plans=self._plans
            )
            if readings is None:
                continue
            if any(_same_readings(readings, other) for other in series):
                reader.fault(
                    f"data {number_} ({readings.quantity}): {readings.file} is there twice; must "
                    "be once"
                )
            series.append(readings)
        return None if case is None else Experiment(name, case, _named(series), groups)

    def _changes(self, reader: TableReader, faults: list[str]) -> dict[str, Any]:
        table = reader.raw("set", {})
        if not isinstance(table, Mapping):
            reader.wrong("set", "must be a table of case keys")
            return {}
        try:
            return in_full(flatten(table, f"{reader.place}: set"), self._folder)
        except InputError as error:
            faults += error.faults
            return {}

    def _case(
        self,
        said: str,
        keys: Mapping[str, Any],
        changes: Mapping[str, Any],
        parameters: tuple[FittedParameter, ...],
        faults: list[str],
    ) -> Case | None:
        """Return a case with the parameters at their starts."""
        starts = {parameter.key: parameter.start for parameter in parameters}
        changed = frozenset({*changes, *starts})
        try:
            case = make_case(override(keys, starts), Origin(said, changed, f"{said}: set"))
            check_case(case, 1, said)
        except InputError as error:
            tables = {parameter.key.rpartition(".")[0] for parameter in parameters}
            for fault in error.faults:
                sentence = fault.replace(said, "")
                if sentence not in self._reported or not any(table in sentence for table in tables):
                    faults.append(fault)
                self._reported.add(sentence)
            return None
        if case.mesh.geometry == "updated":
            faults.append(f'{said}: mesh.geometry = "updated": must be "fixed" in a fit')
            return None
        refuse_fixed(said, parameters, case, faults)
        refuse_order(said, parameters, case, faults)
        return case

    def _refuse_twin(self, one: Experiment, other: Experiment, faults: list[str]) -> None:
        """Refuse an experiment that is there already."""
        said = f'{self._name}: experiment "{legible(one.name)}"'
        if one.name == other.name:
            faults.append(f"{said}: is there twice; names must differ")
            return
        for series in one.series:
            if any(_same_readings(series, twin) for twin in other.series):
                faults.append(
                    f"{said}: {series.quantity}: {series.file} has the readings of experiment "
                    f'"{legible(other.name)}"; every experiment must have its own'
                )

    def changed(
        self,
        name: str,
        experiments: tuple[Experiment, ...],
        changes: Mapping[str, Any],
        parameters: tuple[FittedParameter, ...],
        faults: list[str],
    ) -> tuple[Experiment, ...]:
        """Return the experiments under another law."""
        changed = []
        for experiment in experiments:
            said = f'{self._name}: compare.{legible(name)}: experiment "{legible(experiment.name)}"'
            refuse_both(said, parameters, changes, faults)
            full_changes = in_full(changes, self._folder)
            keys = override(self._keys[experiment.name], full_changes)
            case = self._case(said, keys, changes, parameters, faults)
            if case is None:
                break  # the others have the same fault
            changed.append(replace(experiment, case=case))
        return tuple(changed)


def _same_readings(one: Series, other: Series) -> bool:
    """Tell whether two series share lines of a file, with the same readings."""
    if one.lines is None or other.lines is None or one.file != other.file:
        return False
    _, first, second = np.intersect1d(one.lines, other.lines, return_indices=True)
    same = len(first) and one.quantity == other.quantity
    return bool(same and np.array_equal(one.value[first], other.value[second]))


def _named(series: list[Series]) -> tuple[Series, ...]:
    """Return series with names that differ."""
    counts: dict[str, int] = {}
    named = []
    for one in series:
        name = one.quantity if one.at is None else f"{one.quantity} at {one.at:g} s"
        counts[name] = counts.get(name, 0) + 1
        if counts[name] > 1:
            name = f"{name} ({counts[name]})"
        named.append(replace(one, name=name))
    return tuple(named)


def _read_alternatives(
    said: str, table: Any, case_units: Mapping[str, str], faults: list[str]
) -> dict[str, tuple[dict[str, Any], tuple[FittedParameter, ...]]]:
    laws = {}
    if not isinstance(table, Mapping):
        faults.append(f"{said} = {shortened(table)}: must be a table")
        return {}
    for name, entry in table.items():
        reader = TableReader(f"{said}.{legible(name)}", entry, faults)
        changed = reader.raw("set", {})
        fitted = reader.raw("parameters")
        parameters = read_parameters(f"{reader.place}.parameters", fitted, faults, {}, case_units)
        reader.finish()
        try:
            changes = flatten(
                changed if isinstance(changed, Mapping) else {"": changed}, reader.place
            )
        except InputError as error:
            faults += error.faults
            continue
        laws[name] = changes, parameters
    return laws


def _check_counts(
    name: str,
    parameters: tuple[FittedParameter, ...],
    experiments: tuple[Experiment, ...],
    faults: list[str],
) -> None:
    """Refuse what has fewer readings than are sought."""
    readings = sum(experiment.n for experiment in experiments)
    series = [one for experiment in experiments for one in experiment.series]
    free = sum(p.prior is None for p in parameters) + sum(
        n.free for one in series for n in one.nuisances
    )
    if readings < free:
        faults.append(
            f"{name}: {readings} readings: must be at least as many as are sought, {free} "
            "parameters and nuisances"
        )
