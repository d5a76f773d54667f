"""Wear laws from the keys of a case."""

from collections.abc import Mapping
from typing import Any

from ringwear_par.cases.schema import key_of
from ringwear_par.errors import InputError
from ringwear_par.wear.law import Law, parameters_of
from ringwear_par.wear.laws import LAWS


def law_keys(table: str, law: Any) -> set[str]:
    """Return the keys of a body's wear table, "wear.lower", under a law; none if it is no law."""
    if not (isinstance(law, str) and law in LAWS):
        return set()
    return {f"{table}.law", *(f"{table}.{name}" for name in parameters_of(LAWS[law]))}


def read_law(
    name: str, table: str, keys: Mapping[str, Any], values: Mapping[str, Any], faults: list[str]
) -> Law | None:
    """Return a body's wear law, None where it has none or a wrong one; add to the faults.

    Parameters
    ----------
    name : what messages call the case.
    table : "wear.lower", "wear.upper", or that of a layer, "lower.layers[0].wear".
    keys, values : dotted keys as given, and as read, defaults included; without wrong ones, and
        without those that a misspelt one means.
    faults : what is wrong with the case.
    """
    if not any(path.startswith(f"{table}.") for path in keys):
        return None
    if values.get(f"{table}.law", "") is None:
        faults.append(f"{name}: {table}.law is missing: {_rule(f'{table}.law')}")
    law = values.get(f"{table}.law")
    if law is None:
        return None
    declared = parameters_of(LAWS[law])
    law_faults = [
        f'{table}.{key} is missing: {_rule(f"{table}.{key}")} where {table}.law = "{law}"'
        for key, parameter in declared.items()
        if parameter.needed and values.get(f"{table}.{key}", "") is None
    ]
    known = law_keys(table, law)
    law_faults += [
        f'{path}: has no meaning where {table}.law = "{law}"; must be among {", ".join(declared)}'
        f"{_owners(path)}"
        for path in keys
        if path.startswith(f"{table}.") and path not in known and key_of(path) is not None
    ]
    parameters = {key: values[path] for key in declared if (path := f"{table}.{key}") in values}
    result = None
    if law_faults or len(parameters) < len(declared):
        law_faults += LAWS[law].faults(f"{table}.", parameters)
    else:
        result, law_faults = make_law(LAWS[law], table, parameters)
    faults += [f"{name}: {fault}" for fault in law_faults]
    return result


def make_law(
    kind: type[Law], table: str, values: Mapping[str, Any]
) -> tuple[Law | None, list[str]]:
    """Return a law of parameters that are right one by one; or None, and what is wrong with them.

    Parameters
    ----------
    table : as of ``read_law``.
    values : of all parameters, by name.
    """
    faults = kind.faults(f"{table}.", values)
    if faults:
        return None, faults
    try:
        return kind.from_values(values), []
    except InputError as error:
        return None, [f"{table}.{fault}" for fault in error.faults]


def _rule(path: str) -> str:
    key = key_of(path)
    assert key is not None
    return key.rule


def _owners(path: str) -> str:
    """Return the laws that have a parameter, in words."""
    name = path.rpartition(".")[2]
    laws = [f'"{law}"' for law in LAWS if name in parameters_of(LAWS[law])]
    return f" ({name} is of law = {' or '.join(laws)})" if laws else ""
