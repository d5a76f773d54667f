"""Fitted keys and the cases of tests: smooth, not set as well, in the order that laws need."""

import difflib
import itertools
from collections.abc import Mapping, Sequence
from typing import Any

from ringwear_par.cases.case import Case
from ringwear_par.cases.layers import expanded
from ringwear_par.cases.smooth_keys import elastic_numbers, smooth_keys
from ringwear_par.errors import Fault, InputError
from ringwear_par.identification.definition.problem import FittedParameter

#: the loads of a test, of which it has one
LOADS = ("load.force", "load.pressure", "load.displacement")


def refuse_unfit(
    place: str, parameters: Sequence[FittedParameter], case: Case, faults: list[str]
) -> None:
    """Add a fault for each key on which a case does not depend smoothly, or out of order."""
    allowed, elastic = smooth_keys(case), elastic_numbers(case)
    for parameter in parameters:
        if parameter.key in elastic:
            faults += _faults_of_bounds(place, parameter, case)
        if parameter.key not in allowed:
            similar = difflib.get_close_matches(parameter.key, allowed, n=3, cutoff=0.0)
            faults.append(
                f"{place}: {parameter.key}: cannot be fitted: the history does not depend on it "
                f"smoothly; must be a key such as {', '.join(similar)}"
            )
    _refuse_order(place, parameters, case, faults)


def _refuse_order(
    place: str, parameters: Sequence[FittedParameter], case: Case, faults: list[str]
) -> None:
    """Add a fault where bounds of one key break a law's rule beside the value of another.

    As k_start of at least k. Where both are fitted, values out of order are improbable.
    """
    bounds = {parameter.key: parameter.bounds for parameter in parameters}
    for table, law in case.laws_by_table.items():
        for rule in () if law is None else law.kind.declared:
            larger, smaller = f"{table}.{rule.name}", f"{table}.{rule.at_least}"
            if law is None or not rule.at_least or (larger in bounds) == (smaller in bounds):
                continue
            low = bounds[larger][0] if larger in bounds else law.values[rule.name]
            high = bounds[smaller][1] if smaller in bounds else law.values[rule.at_least]
            if isinstance(low, float | int) and isinstance(high, float | int) and low < high:
                faults.append(
                    f"{place}: bounds let {larger} be {low:g}, less than {smaller}, {high:g}; must "
                    "keep it as large, or both be fitted"
                )


def _faults_of_bounds(place: str, parameter: FittedParameter, case: Case) -> list[str]:
    """Return why there is no case at a bound, as of a layer that is thicker than its body."""
    for bound in parameter.bounds:
        try:
            case.replace({parameter.key: bound})
        except InputError as error:
            return [f"{place}: {parameter.key}: no case at its bound {bound:g}: {error.faults[0]}"]
    return []


def refuse_twice(
    place: str,
    changes: Mapping[str, Any],
    parameters: Sequence[FittedParameter],
    measured: Sequence[str],
    faults: list[str],
) -> None:
    """Add a fault for each quantity that is set, fitted or an input, and known otherwise as well.

    A table that is set, as of layers or of a user's law, may lack the fitted number: its start
    fills the case.
    """
    known = [(key, "is set") for key in sorted(_single_keys(changes))]
    known += [(parameter.key, "is fitted") for parameter in parameters]
    known += [(key, "is an input") for key in measured]
    for (key, how), (other, how_too) in itertools.combinations(known, 2):
        same = key == other or (key in LOADS and other in LOADS)
        if same and how_too != "is set":
            sentence = f"{place}: {key}: {how}, and {other} {how_too}; must be only one"
            faults.append(Fault(sentence, key, "conflict"))


def _single_keys(changes: Mapping[str, Any]) -> set[str]:
    """Return the keys that are set, with each number of layers and of parameters of its own."""
    keys = expanded(changes)
    tables = {path: value for path, value in keys.items() if isinstance(value, Mapping)}
    return keys.keys() | {f"{path}.{name}" for path, table in tables.items() for name in table}
