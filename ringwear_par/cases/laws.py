"""Wear laws from the keys of a case."""

from collections.abc import Mapping
from typing import Any

from ringwear_par.cases.schema import BY_PATH
from ringwear_par.wear.catalogue import LAWS
from ringwear_par.wear.law import Law
from ringwear_par.wear.parameters import parameters_of


def law_keys(table: str, law: Any) -> set[str]:
    """Return the keys of a body's wear table, "wear.lower", under a law; none if it is no law."""
    if not (isinstance(law, str) and law in LAWS):
        return set()
    return {f"{table}.law", *(f"{table}.{name}" for name in parameters_of(LAWS[law]))}


def law_faults(
    name: str, table: str, flat: Mapping[str, Any], values: Mapping[str, Any]
) -> list[str]:
    """Return the faults of a body's wear law.

    Parameters
    ----------
    name : what messages call the case.
    table : "wear.lower" or "wear.upper".
    flat, values : dotted keys as given, and as read, defaults included and wrong ones left out.
    """
    if f"{table}.law" not in flat:
        return [f"{name}: {table}.law is missing: {BY_PATH[f'{table}.law'].rule}"]
    law = values.get(f"{table}.law")
    if law is None:
        return []
    declared = parameters_of(LAWS[law])
    faults = [
        f"{name}: {table}.{key} is missing: {BY_PATH[f'{table}.{key}'].rule} where {table}.law = "
        f'"{law}"'
        for key, parameter in declared.items()
        if parameter.needed and f"{table}.{key}" not in flat
    ]
    known = law_keys(table, law)
    faults += [
        f'{name}: {path}: has no meaning where {table}.law = "{law}"; must be among '
        f"{', '.join(declared)}"
        for path in flat
        if path in BY_PATH and path.startswith(f"{table}.") and path not in known
    ]
    own = {key: values[f"{table}.{key}"] for key in declared if f"{table}.{key}" in values}
    return faults + [f"{name}: {fault}" for fault in LAWS[law].faults(f"{table}.", own)]


def make_law(table: str, values: Mapping[str, Any]) -> Law:
    """Return the law that a table of a case, "wear.lower" or "wear.upper", gives.

    Raises
    ------
    InputError : a user's file that is no law.
    """
    law = LAWS[values[f"{table}.law"]]
    return law.from_values({key: values[f"{table}.{key}"] for key in parameters_of(law)})
