"""``[[experiment]]``: tests of a fit file, each with its case and its measurements."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from operator import itemgetter
from typing import Any

from ringwear_par.cases.case import Case, refuse_stop
from ringwear_par.cases.files.columns import FileStore
from ringwear_par.cases.files.faults import LOADS, Origin
from ringwear_par.cases.files.keys import changes_of, naming, override
from ringwear_par.cases.files.reading import make_case
from ringwear_par.cases.layers import expanded
from ringwear_par.cases.tables import TableReader
from ringwear_par.errors import Fault, InputError, legible
from ringwear_par.history.refusals import check_case
from ringwear_par.identification.definition.problem import (
    GROUPS,
    Experiment,
    FittedParameter,
    MeasuredInput,
    Series,
)
from ringwear_par.identification.definition.schema import reader_of, tables_in
from ringwear_par.identification.definition.series import read_input, read_series

#: what a fit needs of histories, and how they are stepped
_STEPPING = {"time.scheme": "adaptive"}
_OUTPUT = {
    "output.every": 1, "output.profiles": "all", "output.fields": ["wear_lower", "wear_upper"],
    "output.boundary": "none", "stress": None,
}  # fmt: skip


@dataclass(frozen=True)
class Cases:
    """Makes the cases of tests under one law."""

    #: keys of the base case; None where it has faults
    base: Mapping[str, Any] | None
    parameters: tuple[FittedParameter, ...]
    faults: list[str]
    #: case keys of another law; None: that of the base case and the tests
    law: Mapping[str, Any] | None = None

    def of(self, place: str, changes: Mapping[str, Any], measured: Sequence[str]) -> Case | None:
        """Return the case of a test with the parameters at their starts; None, and faults.

        Parameters
        ----------
        place : how sentences about it begin.
        changes : case keys that the test sets.
        measured : case keys that are inputs; they are numbers here.
        """
        known = changes if self.law is None else self.law
        self._refuse_twice(place, known, measured)
        if self.base is None:
            return None
        places = {key: self.base.get(key, 1.0) for key in measured}
        starts = {parameter.key: parameter.start for parameter in self.parameters}
        origin = Origin(place, frozenset({*known, *starts}), f"{place}: set")
        try:
            with naming(origin.setting):
                keys = override(self.base, {**places, **changes, **_STEPPING})
                keys = override(keys, {**_OUTPUT, **(self.law or {}), **starts})
            case = make_case(keys, origin)
            if case.mesh.geometry == "updated":
                sentence = f'{place}: mesh.geometry = "updated": must be "fixed" in a fit'
                raise InputError(Fault(sentence, "mesh.geometry", "conflict"))
            refuse_stop(case, place, "in a fit")
            check_case(case, 1, place)
        except InputError as error:
            self.faults.extend(error.faults)
            return None
        self._refuse_unfit(place, case)
        return case

    def _refuse_twice(
        self, place: str, changes: Mapping[str, Any], measured: Sequence[str]
    ) -> None:
        """Refuse each quantity that is set, fitted or an input, and known otherwise as well.

        A table that is set, as of layers or of a user's law, may lack the fitted number: its start
        fills the case.
        """
        single = expanded(changes)
        for path, table in [*single.items()]:
            single |= {f"{path}.{name}": 0 for name in table} if isinstance(table, Mapping) else {}
        known = dict.fromkeys(single, "is set")
        new = [(parameter.key, "is fitted") for parameter in self.parameters]
        for key, how in [*new, *((key, "is an input") for key in measured)]:
            for other in sorted(known.keys() & (LOADS if key in LOADS else {key})):
                sentence = f"{place}: {other}: {known[other]}, and {key} {how}; must be only one"
                self.faults.append(Fault(sentence, other, "conflict"))
            known[key] = how

    def _refuse_unfit(self, place: str, case: Case) -> None:
        """Refuse each bound of a key that a case cannot have.

        As of a layer that is thicker than its body, or of k_start of less than k. Where both of
        these are fitted, values out of order are improbable.
        """
        keys = {parameter.key for parameter in self.parameters}
        for key, bound in ((p.key, bound) for p in self.parameters for bound in p.bounds):
            try:
                case.replace({key: bound})
            except InputError as error:
                fault = error.faults[0]
                if not any(other in fault for other in keys - {key}):
                    sentence = f"{place}: {key}: no case at its bound {bound:g}: {fault}"
                    self.faults.append(Fault(sentence, "fit.parameters.KEY.bounds", "not_allowed"))


def read_experiments(
    name: str, tests: Mapping[str, Any], cases: Cases, files: FileStore
) -> tuple[Experiment, ...]:
    """Return all experiments of a fit file; what is wrong with them is added to the faults.

    Parameters
    ----------
    name : of the fit file, or of another law in it.
    tests : tables of the experiments, by where they stand.
    """
    every = [
        _experiment(reader_of("experiment", f"{name}: {where}", table, cases.faults), cases, files)
        for where, table in tests.items()
    ]
    experiments = tuple(experiment for experiment in every if experiment is not None)
    _refuse_twins(name, experiments, cases.faults)
    return experiments


def _experiment(reader: TableReader, cases: Cases, files: FileStore) -> Experiment | None:
    name = reader.read("name")
    if name is None:
        return None
    reader.place = f'{reader.place} "{legible(name)}"'
    changes = changes_of(reader, files.folder)
    keyed = [(key, table) for table in tables_in(reader, "input") if (key := table.read("key"))]
    case = cases.of(reader.place, changes, [key for key, _ in keyed])
    inputs = list[MeasuredInput]()
    for key, table in sorted(keyed, key=itemgetter(0), reverse=True):  # friction needs the load
        measured = read_input(key, table, case, files)
        if case is not None and measured is not None:
            inputs.append(measured)
            case = measured.applied(case)
    specimen, batch, lab = (reader.read(group) for group in GROUPS)
    data = tables_in(reader, "data", needed=True)
    reader.finish()
    every = [read_series(entry, case, files) for entry in data]
    series = [one for one in every if one is not None]
    if "contact.friction" in dict(keyed) and any(s.quantity == "torque" for s in series):
        reader.fault("torque: is an input; cannot be fitted too", "input", "conflict")
    if case is None:
        return None
    groups = (specimen or name, batch or "", lab or "")
    return Experiment(name, case, _named(series), groups, tuple(inputs))


def _refuse_twins(name: str, experiments: Sequence[Experiment], faults: list[str]) -> None:
    """Refuse experiments of one name, and readings of a file that are there twice."""
    owners = dict[Any, str]()
    for name_of_test, count in Counter(experiment.name for experiment in experiments).items():
        if count > 1:
            sentence = f'{name}: experiment "{legible(name_of_test)}": is there twice'
            faults.append(Fault(f"{sentence}; names must differ", "experiment.name", "conflict"))
    for owner, series in ((e.name, s) for e in experiments for s in e.series if s.file):
        content = series.file, series.quantity, series.x.tobytes(), series.value.tobytes()
        if content in owners:
            faults.append(
                f'{name}: experiment "{legible(owner)}": {series.quantity}: {series.file} has the '
                f'readings of experiment "{legible(owners[content])}"; must be read once'
            )
        owners[content] = owner


def _named(series: Sequence[Series]) -> tuple[Series, ...]:
    """Return series with names that differ."""
    counts, names, named = Counter(s.quantity for s in series), Counter[str](), []
    for record in series:
        weighing = record.at is None and record.n == 1 and counts[record.quantity] > 1
        at = float(record.x[0]) if weighing else record.at
        name = record.quantity if at is None else f"{record.quantity} at {at:g} s"
        names[name] += 1
        again = f" ({names[name]})" if names[name] > 1 else ""
        named.append(replace(record, name=f"{name}{again}"))
    return tuple(named)
