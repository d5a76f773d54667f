"""Wear laws from the keys of a case."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from ringwear_par.cases.schema import BY_PATH, LAWS
from ringwear_par.cases.text import read_text, toml_value
from ringwear_par.errors import InputError
from ringwear_par.schedules import Quantity, Table, largest, smallest
from ringwear_par.wear.law import (
    ArchardLaw,
    NonLocalLaw,
    PowerLaw,
    RunningInLaw,
    TableLaw,
    ThresholdLaw,
    WearLaw,
)
from ringwear_par.wear.user import UserLaw

_LAW_CLASSES: dict[str, Callable[..., WearLaw]] = {
    "threshold": ThresholdLaw,
    "archard": ArchardLaw,
    "power": PowerLaw,
    "table": TableLaw,
    "running-in": RunningInLaw,
    "non-local": NonLocalLaw,
}


def told(quantity: Quantity | None) -> str:
    """Return a quantity as messages tell it."""
    return f"a table to {largest(quantity):g}" if isinstance(quantity, Table) else f"{quantity:g}"


def law_keys(law: Any) -> tuple[str, ...]:
    """Return the keys that the table of a law may have; none where it is no law."""
    known = isinstance(law, str) and law in LAWS
    return ("law", *LAWS[law][0], *LAWS[law][1]) if known else ()


def law_faults(
    name: str, table: str, flat: Mapping[str, Any], values: Mapping[str, Any]
) -> list[str]:
    """Return the faults of a body's wear law."""
    law = values.get(f"{table}.law")
    if law is None:
        return []
    needs, may = LAWS[law]
    faults = [
        f"{name}: {table}.{key} is missing: {BY_PATH[f'{table}.{key}'].rule} where {table}.law = "
        f'"{law}"'
        for key in needs
        if f"{table}.{key}" not in flat
    ]
    for path in flat:
        key = path.removeprefix(f"{table}.")
        if path in BY_PATH and path.startswith(f"{table}.") and key not in ("law", *needs, *may):
            keys = ", ".join((*needs, *may))
            faults.append(
                f'{name}: {path}: has no meaning where {table}.law = "{law}"; must be among {keys}'
            )
    if law == "running-in":
        depth, distance = (values.get(f"{table}.{key}") for key in ("depth", "distance"))
        unread = {f"{table}.depth", f"{table}.distance"} & (flat.keys() - values.keys())
        if (depth is None) == (distance is None) and not unread:
            faults.append(
                f"{name}: {table}.depth, {table}.distance: one of them must be given (mm)"
            )
        k, start = values.get(f"{table}.k"), values.get(f"{table}.k_start")
        if k is not None and start is not None and smallest(start) < largest(k):
            faults.append(
                f"{name}: {table}.k_start = {told(start)}: must be at least {table}.k = {told(k)}"
            )
    file = values.get(f"{table}.file")
    if law == "user" and file is not None and f"{table}.parameters" in values:
        try:
            _user_law(values, table)
        except InputError as error:
            faults += [f"{name}: {table}.file = {toml_value(file)}: {f}" for f in error.faults]
    return faults


def _user_law(values: Mapping[str, Any], table: str) -> UserLaw:
    """Return the law that a Python file defines.

    Raises
    ------
    InputError : the file cannot be read or run, or does not define a law.
    """
    path = Path(values[f"{table}.file"])
    law = UserLaw(str(path), read_text(path), values[f"{table}.parameters"] or ())
    missing = law.missing()
    if missing:
        raise InputError(missing)
    return law


def make_law(table: str, values: Mapping[str, Any]) -> WearLaw:
    """Return the law that a table of a case, "wear.lower" or "wear.upper", gives.

    Raises
    ------
    InputError : a user's file that is no law.
    """
    name = values[f"{table}.law"]
    if name == "user":
        return _user_law(values, table)
    keys = (key for group in LAWS[name] for key in group)
    return _LAW_CLASSES[name](**{key: values[f"{table}.{key}"] for key in keys})
