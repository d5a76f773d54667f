"""Fitted keys and the cases of tests: smooth, not set as well, in the order that laws need."""

import difflib
from collections.abc import Mapping, Sequence
from typing import Any

from ringwear_par.cases.case import Case
from ringwear_par.cases.layers import expanded
from ringwear_par.cases.schema import key_of
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.errors import Fault, InputError
from ringwear_par.history.derivatives.keys import differentiable, elastic_numbers
from ringwear_par.identification.definition.problem import FittedParameter
from ringwear_par.studies.definition.variations import split_key
from ringwear_par.wear.law import parameters_of
from ringwear_par.wear.laws import LAWS


def ordered_keys(parameters: Sequence[FittedParameter]) -> list[tuple[int, int]]:
    """Return pairs (i, j) of fitted keys of one scale of which i may not be less than j."""
    least = {
        name: parameter.at_least
        for law in LAWS.values()
        for name, parameter in parameters_of(law).items()
    }
    places = {parameter.key: i for i, parameter in enumerate(parameters)}
    pairs = []
    for i, parameter in enumerate(parameters):
        table, _, name = parameter.key.rpartition(".")
        j = places.get(f"{table}.{least.get(name, '')}")
        is_law_key = key_of(parameter.key) is not None  # not a parameter of a user's law
        if is_law_key and j is not None and parameter.log == parameters[j].log:
            pairs.append((i, j))
    return pairs


def refuse_unfit(
    place: str, parameters: Sequence[FittedParameter], case: Case, faults: list[str]
) -> None:
    """Add a fault for each key on which a case does not depend smoothly, or out of order."""
    _refuse_fixed(place, parameters, case, faults)
    _refuse_order(place, parameters, case, faults)


def _refuse_order(
    place: str, parameters: Sequence[FittedParameter], case: Case, faults: list[str]
) -> None:
    """Add a fault where bounds, or a value that is not fitted, break a rule of a law's numbers.

    As k_start of at least k. Of two fitted keys of one scale the rule is a bound, see
    ``ordered_keys``.
    """
    fitted = {parameter.key: parameter for parameter in parameters}
    ordered = {(parameters[i].key, parameters[j].key) for i, j in ordered_keys(parameters)}
    for body, law in zip(BODIES, case.laws, strict=True):
        if law is None:
            continue
        for name, rule in parameters_of(type(law)).items():
            keys = f"wear.{body}.{name}", f"wear.{body}.{rule.at_least}"
            if not rule.at_least or not fitted.keys() & set(keys) or keys in ordered:
                continue
            ranges = []
            for key, number in zip(keys, (name, rule.at_least), strict=True):
                value = law.quantity(number)
                if key in fitted:
                    ranges.append((fitted[key].bounds, "bounds "))
                elif isinstance(value, float | int):
                    ranges.append(((float(value), float(value)), "value "))
            if len(ranges) == 2 and ranges[0][0][0] < ranges[1][0][1]:
                (upper, of_upper), (lower, of_lower) = ranges
                faults.append(
                    f"{place}: {keys[0]}: {of_upper}{_range(upper)} lets it be less than {keys[1]}"
                    f", {of_lower}{_range(lower)}; must be at least {lower[1]:g}, or both be "
                    "fitted with the same scale"
                )


def _refuse_fixed(
    place: str, parameters: Sequence[FittedParameter], case: Case, faults: list[str]
) -> None:
    """Add a fault for each key without derivatives, once for all experiments."""
    allowed, elastic = differentiable(case), elastic_numbers(case)
    for parameter in parameters:
        if parameter.key in elastic:
            faults += _faults_of_bounds(place, parameter, case)
        if parameter.key not in allowed:
            scope = place.partition(': experiment "')[0]
            beginning = f"{scope}: {parameter.key}: cannot be fitted"
            if any(fault.startswith(beginning) for fault in faults):
                continue  # said of another experiment
            similar = difflib.get_close_matches(parameter.key, allowed, n=3, cutoff=0.0)
            faults.append(
                f"{beginning}: the history of {place.removeprefix(scope)[2:]} does not depend on "
                f"it smoothly; must be a key such as {', '.join(similar)}"
            )


def _faults_of_bounds(place: str, parameter: FittedParameter, case: Case) -> list[str]:
    """Return why there is no case at a bound, as of a layer that is thicker than its body."""
    for bound in parameter.bounds:
        try:
            case.replace({parameter.key: bound})
        except InputError as error:
            return [f"{place}: {parameter.key}: no case at its bound {bound:g}: {error.faults[0]}"]
    return []


def refuse_both(
    place: str, parameters: Sequence[FittedParameter], changes: Mapping[str, Any], faults: list[str]
) -> None:
    """Add a fault for each key that is both set and fitted.

    A table that is set, as of layers or of a user's law, may lack the fitted number: its start
    fills the case.
    """
    loads = {"load.force", "load.pressure", "load.displacement"}
    keys = _single_keys(changes)
    for parameter in parameters:
        path, entry = split_key(parameter.key)
        same = {parameter.key} if entry is not None else loads if path in loads else {path}
        for key in sorted(same & keys):
            sentence = (
                f"{key}: is set, and {parameter.key} is fitted; must be one or the other, a fitted "
                "key needs no value in the case"
            )
            faults.append(Fault(f"{place}: {sentence}", key, "conflict"))


def _single_keys(changes: Mapping[str, Any]) -> set[str]:
    """Return the keys that are set, with each number of layers and of parameters of its own."""
    keys = expanded(changes)
    tables = {path: value for path, value in keys.items() if isinstance(value, Mapping)}
    return keys.keys() | {f"{path}.{name}" for path, table in tables.items() for name in table}


def _range(ends: tuple[float, float]) -> str:
    low, high = ends
    return f"{low:g}" if low == high else f"[{low:g}, {high:g}]"
