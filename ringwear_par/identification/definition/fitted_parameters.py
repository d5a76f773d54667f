"""``fit.parameters``: which case keys are sought, from where, within which bounds and rules."""

import difflib
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ringwear_par.cases.case import Case
from ringwear_par.cases.files.key_values import nearest_key
from ringwear_par.cases.numbers import interval_of
from ringwear_par.cases.schema import BY_PATH, base_unit, key_of, layer_entry
from ringwear_par.cases.tables import TableReader, name_unknown_keys
from ringwear_par.cases.units import factor, has_unit, in_unit, number_and_unit
from ringwear_par.cases.values import RejectedError
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.errors import MOST_FAULTS, InputError, legible
from ringwear_par.files.text import shortened
from ringwear_par.history.derivatives.keys import differentiable, elastic_numbers
from ringwear_par.identification.definition.problem import FittedParameter, Problem
from ringwear_par.identification.definition.scatter import read_scatter
from ringwear_par.identification.definition.schema import PARAMETER
from ringwear_par.studies.definition.variations import split_key
from ringwear_par.wear.law import parameters_of
from ringwear_par.wear.laws import LAWS

#: other units of keys, by the case's
_EXAMPLES = {"1/MPa": "mm3/(N m)", "MPa": "GPa", "mm": "um", "mm/s": "um/h", "rad/s": "rpm"}


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
        of_law = key_of(parameter.key) is not None  # not a parameter of a user's law
        if of_law and j is not None and parameter.log == parameters[j].log:
            pairs.append((i, j))
    return pairs


def refuse_unfit(
    said: str, parameters: Sequence[FittedParameter], case: Case, faults: list[str]
) -> None:
    """Add a fault for each key on which a case does not depend smoothly, or out of order."""
    _refuse_fixed(said, parameters, case, faults)
    _refuse_order(said, parameters, case, faults)


def _refuse_order(
    said: str, parameters: Sequence[FittedParameter], case: Case, faults: list[str]
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
                    f"{said}: {keys[0]}: {of_upper}{_range(upper)} lets it be less than {keys[1]}, "
                    f"{of_lower}{_range(lower)}; must be at least {lower[1]:g}, or both be fitted "
                    "with the same scale"
                )


def _refuse_fixed(
    said: str, parameters: Sequence[FittedParameter], case: Case, faults: list[str]
) -> None:
    """Add a fault for each key without derivatives, once for all experiments."""
    allowed, elastic = differentiable(case), elastic_numbers(case)
    for parameter in parameters:
        if parameter.key in elastic:
            faults += _faults_of_bounds(said, parameter, case)
        if parameter.key not in allowed:
            scope = said.partition(': experiment "')[0]
            beginning = f"{scope}: {parameter.key}: cannot be fitted"
            if any(fault.startswith(beginning) for fault in faults):
                continue  # said of another experiment
            similar = difflib.get_close_matches(parameter.key, allowed, n=3, cutoff=0.0)
            faults.append(
                f"{beginning}: the history of {said.removeprefix(scope)[2:]} does not depend on it "
                f"smoothly; must be a key such as {', '.join(similar)}"
            )


def _faults_of_bounds(said: str, parameter: FittedParameter, case: Case) -> list[str]:
    """Return why there is no case at a bound, as of a layer that is thicker than its body."""
    for bound in parameter.bounds:
        try:
            case.replace({parameter.key: bound})
        except InputError as error:
            return [f"{said}: {parameter.key}: no case at its bound {bound:g}: {error.faults[0]}"]
    return []


def refuse_both(
    said: str, parameters: Sequence[FittedParameter], changes: Mapping[str, Any], faults: list[str]
) -> None:
    """Add a fault for each key that is both set and fitted."""
    loads = {"load.force", "load.pressure", "load.displacement"}
    for parameter in parameters:
        path = split_key(parameter.key)[0]
        same = {parameter.key, path} | (loads if path in loads else set())
        for key in same & changes.keys():
            faults.append(
                f"{said}: {key}: is set, and {parameter.key} is fitted; must be one or the other"
            )


def _range(ends: tuple[float, float]) -> str:
    low, high = ends
    return f"{low:g}" if low == high else f"[{low:g}, {high:g}]"


def unnested(table: Mapping[str, Any]) -> dict[str, Any]:
    """Return entries by dotted key, whether written quoted or not."""
    flat: dict[str, Any] = {}
    for key, entry in table.items():
        if isinstance(entry, Mapping) and entry and not PARAMETER.keys() & entry.keys():
            flat.update({f"{key}.{inner}": value for inner, value in unnested(entry).items()})
        else:
            flat[key] = entry
    return flat


def read_parameters(
    said: str,
    table: Any,
    faults: list[str],
    units: Mapping[str, str],
    case_units: Mapping[str, str],
) -> tuple[FittedParameter, ...]:
    """Return the fitted keys, and add what is wrong with them to the faults.

    A key is told in its unit of ``units``, or in which its start is written, or the case its
    number.
    """
    if not isinstance(table, Mapping) or not table:
        faults.append(f"{said}: is missing or empty; must name one case key at least")
        return ()
    parameters = []
    for key, entry in unnested(table).items():
        parameter = _parameter(f'{said}."{legible(key)}"', key, entry, faults, units.get(key, ""))
        if parameter is not None:
            unit = parameter.unit or case_units.get(key, "")
            parameters.append(replace(parameter, unit=unit if _is_other(unit, key) else ""))
    return tuple(parameters)


def _is_other(unit: str, key: str) -> bool:
    """Tell whether a unit is one of a key, and another than the case's."""
    try:
        return bool(unit) and not math.isclose(factor(unit, base_unit(key)), 1.0)
    except RejectedError:  # of another law of the case
        return False


def read_units(said: str, table: Any, parameters: Any, faults: list[str]) -> dict[str, str]:
    """Return the units in which fitted keys are told, as ``fit.units`` names them."""
    if not isinstance(table, Mapping):
        faults.append(f"{said} = {shortened(table)}: must be a table of units by fitted key")
        return {}
    fitted = unnested(parameters) if isinstance(parameters, Mapping) else {}
    units = flat_texts(table)
    name_unknown_keys(said, units, list(fitted), faults, "is not fitted")
    for key, unit in units.items():
        if key not in fitted:
            continue
        try:
            factor(str(unit), base_unit(key))
        except RejectedError:
            base = base_unit(key) or "a parameter"
            example = f', such as "{_EXAMPLES[base]}"' if base in _EXAMPLES else ""
            state = f'{said}."{legible(key)}" = {shortened(unit)}'
            faults.append(f"{state}: must be a unit of {base}{example}")
    return units


def flat_texts(table: Mapping[str, Any]) -> dict[str, Any]:
    """Return entries by dotted key, whether written quoted or not."""
    flat: dict[str, Any] = {}
    for key, entry in table.items():
        inner = flat_texts(entry) if isinstance(entry, Mapping) else {"": entry}
        flat |= {f"{key}.{name}".rstrip("."): value for name, value in inner.items()}
    return flat


def _parameter(
    said: str, key: str, table: Any, faults: list[str], named_unit: str
) -> FittedParameter | None:
    path, entry = split_key(key)
    allowed = None if isinstance(entry, int) else interval_of((path, entry))
    if layer_entry(key) is not None and (of_layer := key_of(key)) is not None:
        allowed = of_layer.numbers
    if allowed is None or path.startswith("time."):
        near = ""
        if path not in BY_PATH and len(faults) < MOST_FAULTS:
            near = nearest_key(path)
        faults.append(
            f"{said}: cannot be fitted{near}; must be a number of a wear law, "
            "contact.friction, a load, load.omega, a modulus, or a layer's thickness or "
            "Poisson's ratio"
        )
        return None
    before = len(faults)
    scatter = None
    if isinstance(table, Mapping):
        unit, converted = base_unit(key), dict[str, Any]()
        scatter = read_scatter(
            said, key, table.get("scatter"), table.get("scale") == "log", unit or "", faults
        )
        for name, value in table.items():
            if name == "scatter":
                continue
            try:
                converted[name] = in_unit(value, unit)
            except RejectedError as reason:
                allowed_unit = f"must be in {unit} ({reason})" if unit else f"{reason}"
                faults.append(f"{said}: {name} = {shortened(value)}: {allowed_unit}")
        if len(converted) < len(table.keys() - {"scatter"}):
            return None
        if not named_unit and has_unit(table.get("start")):
            named_unit = number_and_unit(table["start"])[1]
        table = converted
    reader = TableReader(said, table, faults, PARAMETER)
    reader.raw("scatter")  # read above
    start, bounds = reader.read("start"), reader.read("bounds")
    log, prior = reader.read("scale") == "log", reader.read("prior")
    reader.finish()
    if bounds is not None:
        if log and bounds[0] <= 0:
            reader.wrong("bounds", 'must be two increasing numbers > 0 where scale = "log"')
        if not allowed.holds(np.array(bounds)).all():
            allowed_range = f"{'>=' if allowed.ends else '>'} {allowed.low:g}"
            if allowed.high < math.inf:
                allowed_range += f" and {'<=' if allowed.ends else '<'} {allowed.high:g}"
            reader.wrong("bounds", f"must be values that {path} may have, {allowed_range}")
        if start is not None and not bounds[0] <= start <= bounds[1]:
            reader.wrong("start", f"must be within its bounds, {bounds[0]:g} to {bounds[1]:g}")
    if len(faults) > before or start is None or bounds is None:
        return None
    return FittedParameter(key, start, bounds, log, prior, scatter, named_unit)


def units_of(problem: Problem) -> dict[str, str]:
    """Return the units of the fitted keys, "1" for none."""
    known = differentiable(problem.experiments[0].case)
    return {key: known[key] for key in problem.keys}


def unit_of_key(problem: Problem, key: str) -> str:
    """Return the unit of a fitted key, with a blank before it; "" for none."""
    unit = units_of(problem)[key]
    return "" if unit in ("1", "-") else f" {unit}"
