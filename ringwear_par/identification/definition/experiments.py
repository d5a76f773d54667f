"""``[[experiment]]``: tests of a fit file, each with its case and its measurements."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ringwear_par.cases.case import Case, refuse_stop
from ringwear_par.cases.files.columns import FileStore
from ringwear_par.cases.files.faults import Origin
from ringwear_par.cases.files.keys import changes_of, in_full, override
from ringwear_par.cases.files.reading import make_case
from ringwear_par.cases.tables import TableReader
from ringwear_par.errors import MOST_FAULTS, Fault, InputError, legible
from ringwear_par.history.refusals import check_case
from ringwear_par.identification.definition.fitted_parameters import refuse_twice, refuse_unfit
from ringwear_par.identification.definition.inputs import input_keys, read_inputs, with_places
from ringwear_par.identification.definition.problem import (
    Experiment,
    FittedParameter,
    MeasuredInput,
    Series,
)
from ringwear_par.identification.definition.scatter import read_groups
from ringwear_par.identification.definition.schema import EXPERIMENT
from ringwear_par.identification.definition.series import read_series

#: what a fit needs of histories, and how they are stepped
_STEPPING = {"time.scheme": "adaptive"}
_OUTPUT = {
    "output.every": 1, "output.profiles": "all", "output.fields": ["wear_lower", "wear_upper"],
    "output.boundary": "none", "stress": None,
}  # fmt: skip


class ExperimentReader:
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

    def all(
        self,
        tables: Sequence[tuple[str, Any]],
        parameters: tuple[FittedParameter, ...],
        faults: list[str],
    ) -> tuple[Experiment, ...]:
        """Return all experiments, and add what is wrong with them to the faults.

        Parameters
        ----------
        tables : of the fit file, each with where it stands.
        """
        experiments: list[Experiment] = []
        for place, table in tables:
            experiment = self._experiment(place, table, parameters, faults)
            if experiment is not None:
                experiments.append(experiment)
        _refuse_twins(self._name, experiments, faults)
        return tuple(experiments)

    def _experiment(
        self, place: str, table: Any, parameters: tuple[FittedParameter, ...], faults: list[str]
    ) -> Experiment | None:
        reader = TableReader(f"{self._name}: {place}", table, faults, EXPERIMENT)
        name = reader.read("name")
        if name is None:
            return None
        row = "" if place.startswith("experiment ") else f"{place}: "
        place = reader.place = f'{self._name}: {row}experiment "{legible(name)}"'
        changes = changes_of(reader, self._folder)
        tables = reader.raw("input", [])
        measured = input_keys(tables)
        refuse_twice(place, changes, parameters, measured, faults)
        case: Case | None = None
        inputs: tuple[MeasuredInput, ...] = ()
        if self._base is not None and len(faults) < MOST_FAULTS:  # more are not shown
            keys = override(override(self._base, _STEPPING), changes)
            keys = override(with_places(keys, measured), {**_STEPPING, **_OUTPUT})
            self._keys[name] = keys
            case = self._case(place, keys, changes, parameters, faults)
            if tables:
                inputs, curves = read_inputs(place, tables, case, self._files, faults)
                case = case.replace(curves) if case and curves else None
                self._keys[name] = override(keys, curves)
        groups = read_groups(reader, name)
        data = reader.raw("data")
        reader.finish()
        if not isinstance(data, list) or not data:
            reader.wrong("data", "must be tables, [[experiment.data]]")
            return None
        series: list[Series] = []
        for number, entry in enumerate(data, start=1):
            readings = read_series(
                f"{place}: data {number}", entry, case, self._files, faults, plans=self._plans
            )
            if readings is not None:
                series.append(readings)
        if "contact.friction" in measured and any(s.quantity == "torque" for s in series):
            reader.fault("torque: is an input; cannot be fitted too", "input", "conflict")
        if case is None:
            return None
        return Experiment(name, case, _named(series), groups, inputs, table)

    def _case(
        self,
        place: str,
        keys: Mapping[str, Any],
        changes: Mapping[str, Any],
        parameters: tuple[FittedParameter, ...],
        faults: list[str],
    ) -> Case | None:
        """Return a case with the parameters at their starts."""
        starts = {parameter.key: parameter.start for parameter in parameters}
        changed = frozenset({*changes, *starts})
        try:
            case = make_case(override(keys, starts), Origin(place, changed, f"{place}: set"))
            refuse_stop(case, place, "in a fit")
            check_case(case, 1, place)
        except InputError as error:
            faults += error.faults
            return None
        if case.mesh.geometry == "updated":
            sentence = f'{place}: mesh.geometry = "updated": must be "fixed" in a fit'
            faults.append(Fault(sentence, "mesh.geometry", "conflict"))
            return None
        refuse_unfit(place, parameters, case, faults)
        return case

    def changed(
        self,
        name: str,
        experiments: tuple[Experiment, ...],
        changes: Mapping[str, Any],
        parameters: tuple[FittedParameter, ...],
        faults: list[str],
    ) -> tuple[Experiment, ...]:
        """Return the experiments under another law."""
        changed, before = [], len(faults)
        for experiment in experiments:
            place = (
                f'{self._name}: compare.{legible(name)}: experiment "{legible(experiment.name)}"'
            )
            measured = [entry.key for entry in experiment.inputs]
            refuse_twice(place, changes, parameters, measured, faults)
            keys = override(self._keys[experiment.name], in_full(changes, self._folder))
            case = None
            if len(faults) == before:
                case = self._case(place, keys, changes, parameters, faults)
            if case is None:
                break  # the others have the same fault
            changed.append(replace(experiment, case=case))
        return tuple(changed)


def _refuse_twins(name: str, experiments: Sequence[Experiment], faults: list[str]) -> None:
    """Refuse experiments of one name, and the same lines of a file in two series."""
    seen: list[tuple[str, Series]] = []
    for number, experiment in enumerate(experiments):
        place = f'{name}: experiment "{legible(experiment.name)}"'
        if experiment.name in [earlier.name for earlier in experiments[:number]]:
            sentence = f"{place}: is there twice; names must differ"
            faults.append(Fault(sentence, "experiment.name", "conflict"))
            continue
        for series in experiment.series:
            faults += [
                f"{place}: {series.quantity}: {series.file} has the readings of experiment "
                f'"{legible(owner)}"; must be read once'
                for owner, earlier in seen if _same_readings(series, earlier)
            ]  # fmt: skip
            seen.append((experiment.name, series))


def _same_readings(a: Series, b: Series) -> bool:
    """Tell whether two series share lines of a file, with the same readings."""
    if a.lines is None or b.lines is None or (a.file, a.quantity) != (b.file, b.quantity):
        return False
    _, first, second = np.intersect1d(a.lines, b.lines, return_indices=True)
    return bool(len(first)) and np.array_equal(a.value[first], b.value[second])


def _named(series: list[Series]) -> tuple[Series, ...]:
    """Return series with names that differ."""
    counts: dict[str, int] = {}
    named = []
    several = [quantity for quantity, n in Counter(s.quantity for s in series).items() if n > 1]
    for record in series:
        at = record.at
        if at is None and record.n == 1 and record.quantity in several:  # weighings
            at = float(record.x[0])
        name = record.quantity if at is None else f"{record.quantity} at {at:g} s"
        counts[name] = counts.get(name, 0) + 1
        if counts[name] > 1:
            name = f"{name} ({counts[name]})"
        named.append(replace(record, name=name))
    return tuple(named)
