"""``fit.parameters``: which case keys are fitted, from which starts and within which bounds.

The cases of tests must depend on them smoothly, have laws that allow them, and not set them too.
"""

import difflib
import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ringwear_par.cases.case import Case
from ringwear_par.cases.files.faults import LOADS
from ringwear_par.cases.files.key_values import nearest_key
from ringwear_par.cases.layers import expanded
from ringwear_par.cases.numbers import interval_of
from ringwear_par.cases.schema import BY_PATH, base_unit, key_of, layer_entry
from ringwear_par.cases.smooth_keys import smooth_keys
from ringwear_par.cases.tables import name_unknown_keys
from ringwear_par.cases.units import factor, has_unit, in_unit_where_right, number_and_unit
from ringwear_par.cases.values import RejectedError
from ringwear_par.errors import MOST_FAULTS, Fault, InputError, legible
from ringwear_par.files.text import shortened
from ringwear_par.identification.definition.problem import FittedParameter, Problem
from ringwear_par.identification.definition.scatter import read_scatter
from ringwear_par.identification.definition.schema import keys_of, reader_of
from ringwear_par.studies.variations import split_key, unnested


def read_parameters(
    place: str,
    table: Any,
    faults: list[str],
    units: Mapping[str, str],
    case_units: Mapping[str, str],
) -> tuple[FittedParameter, ...]:
    """Return the fitted keys, and add what is wrong with them to the faults.

    A key is reported in its unit of ``units``, else in that of its start, else in that of the
    case.
    """
    if not isinstance(table, Mapping) or not table:
        sentence = f"{place}: is missing or empty; must name one case key at least"
        faults.append(Fault(sentence, "fit.parameters", "missing"))
        return ()
    parameters = []
    for key, entry in unnested(table, keys_of("fit.parameters.KEY").keys()).items():
        written = entry.get("start") if isinstance(entry, Mapping) else None
        own = number_and_unit(str(written))[1] if has_unit(written) else case_units.get(key, "")
        unit = units.get(key, own)
        if (parameter := _parameter(f'{place}."{legible(key)}"', key, entry, faults)) is not None:
            parameters.append(replace(parameter, unit=unit if _is_other(unit, key) else ""))
    return tuple(parameters)


def _is_other(unit: str, key: str) -> bool:
    """Tell whether a unit fits a key and is not the case's own."""
    try:
        return bool(unit) and not math.isclose(factor(unit, base_unit(key)), 1.0)
    except RejectedError:  # of another law of the case
        return False


def read_units(place: str, table: Any, parameters: Any, faults: list[str]) -> dict[str, str]:
    """Return the units in which fitted keys are reported, as ``fit.units`` names them."""
    if not isinstance(table, Mapping):
        faults.append(f"{place} = {shortened(table)}: must be a table of units by fitted key")
        return {}
    known = parameters if isinstance(parameters, Mapping) else {}
    fitted = unnested(known, keys_of("fit.parameters.KEY").keys())
    units = unnested(table, set())
    name_unknown_keys(place, units, list(fitted), faults, "is not fitted", "fit.units")
    for key, unit in units.items():
        if key not in fitted:
            continue
        try:
            factor(str(unit), base_unit(key))
        except RejectedError:
            state = f'{place}."{legible(key)}" = {shortened(unit)}'
            sentence = f"{state}: must be a unit of {base_unit(key) or 'a parameter'}"
            faults.append(Fault(sentence, f"fit.units.{key}", "unit"))
    return units


def _parameter(place: str, key: str, table: Any, faults: list[str]) -> FittedParameter | None:
    path, entry = split_key(key)
    allowed = None if isinstance(entry, int) else interval_of((path, entry))
    if layer_entry(key) is not None and (layer_key := key_of(key)) is not None:
        allowed = layer_key.numbers
    if allowed is None or path.startswith("time."):
        near = ""
        if path not in BY_PATH and len(faults) < MOST_FAULTS:
            near = nearest_key(path)
        sentence = (
            f"{place}: cannot be fitted{near}; must be a number of a wear law, "
            "contact.friction, a load, load.omega, a modulus, or a layer's thickness or "
            "Poisson's ratio"
        )
        faults.append(Fault(sentence, f"fit.parameters.{key}", "not_allowed"))
        return None
    before, unit = len(faults), base_unit(key)
    if unit is None:  # of a user's law, whose numbers have any unit
        table = in_unit_where_right(table, None)
    reader = reader_of("fit.parameters.KEY", place, table, faults)
    start, bounds, prior = (reader.read(name, unit=unit) for name in ("start", "bounds", "prior"))
    log = reader.read("scale") == "log"
    scatter = read_scatter(place, key, reader.raw("scatter"), log, unit or "", faults)
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
    return FittedParameter(key, start, bounds, log, prior, scatter)


def unit_scale(parameter: FittedParameter) -> float:
    """Return the size of the user's unit of a fitted key in the case's unit, 1 for the same."""
    return factor(parameter.unit, base_unit(parameter.key)) if parameter.unit else 1.0


def units_of(problem: Problem) -> dict[str, str]:
    """Return the units of the fitted keys, "1" for none."""
    known = smooth_keys(problem.experiments[0].case)
    return {key: known[key] for key in problem.keys}


def unit_of_key(problem: Problem, key: str) -> str:
    """Return the unit of a fitted key, with a blank before it; "" for none."""
    unit = units_of(problem)[key]
    return "" if unit in ("1", "-") else f" {unit}"


def refuse_unfit(
    place: str, parameters: Sequence[FittedParameter], case: Case, faults: list[str]
) -> None:
    """Add a fault for each key that a case does not depend on smoothly, or not up to its bounds.

    As of a layer that is thicker than its body, or of k_start of less than k. Where both of these
    are fitted, values out of order are improbable.
    """
    allowed = smooth_keys(case)
    for key, bounds in ((parameter.key, parameter.bounds) for parameter in parameters):
        if key not in allowed:
            similar = difflib.get_close_matches(key, allowed, n=3, cutoff=0.0)
            faults.append(
                f"{place}: {key}: cannot be fitted: the history does not depend on it smoothly; "
                f"must be a key such as {', '.join(similar)}"
            )
            continue
        others = {parameter.key for parameter in parameters} - {key}
        for bound in bounds:
            try:
                case.replace({key: bound})
            except InputError as error:
                if not any(other in error.faults[0] for other in others):
                    fault = f"no case at its bound {bound:g}: {error.faults[0]}"
                    faults.append(f"{place}: {key}: {fault}")


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
