"""Layers among the keys of a case: each entry of each of them under a name of its own.

``lower.layers`` is a list of tables. Its entries are called as studies and ``--set`` call them:
``lower.layers[0].thickness``, ``lower.layers[0].wear.k``; 0 is the layer at the contact face.
"""

import copy
import re
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from ringwear_par.cases.schema import LAYER_LAWS, MOST_LAYERS, key_of, layer_entry
from ringwear_par.cases.values import RejectedError
from ringwear_par.errors import Fault, InputError, legible
from ringwear_par.files.text import shortened
from ringwear_par.wear.laws import LAWS

LAYERS = ("lower.layers", "upper.layers")
_ENTRY = re.compile(r"\[([0-9]{1,3})\]\.(.+)")


def expanded(keys: Mapping[str, Any]) -> dict[str, Any]:
    """Return dotted keys with the entries of layers in the place of their lists.

    Lists of anything but tables stay, for their reader to refuse.
    """
    keys_by_entry: dict[str, Any] = {}
    for path, value in keys.items():
        entries = entries_of(value) if path in LAYERS else None
        if entries is None:
            keys_by_entry[path] = value
        else:
            keys_by_entry |= {f"{path}{entry}": value for entry, value in entries.items()}
    return keys_by_entry


def layer_tables(keys: Mapping[str, Any]) -> list[str]:
    """Return the names of the layers among dotted keys: "lower.layers[0]"."""
    return [
        f"{path}[{i}]"
        for path in LAYERS
        if entries_of(keys.get(path)) is not None
        for i in range(len(keys[path]))
    ]


def of_refused_law(path: str, entries: Mapping[str, Any]) -> bool:
    """Tell whether a key is a parameter of a law that layers cannot wear by.

    Parameters
    ----------
    entries : dotted keys and raw values, layers entry by entry.
    """
    table, _, name = path.rpartition(".")
    law = entries.get(f"{table}.law")
    if layer_entry(path) is None or not isinstance(law, str) or law in LAYER_LAWS:
        return False
    return law in LAWS and name in LAWS[law].parameters


def entries_of(layers: Any) -> dict[str, Any] | None:
    """Return raw values by entry, "[0].wear.k"; None where they are no such list."""
    if not (isinstance(layers, list | tuple) and all(isinstance(value, dict) for value in layers)):
        return None
    if len(layers) > MOST_LAYERS:
        return None
    entries: dict[str, Any] = {}
    for i, layer in enumerate(layers):
        for name, value in layer.items():
            if name == "wear" and isinstance(value, dict) and value:
                entries |= {f"[{i}].wear.{key}": value for key, value in value.items()}
            else:
                entries[f"[{i}].{name}"] = value
    return entries


def with_entries(path: str, layers: Any, changes: Mapping[str, Any]) -> Any:
    """Return the raw list of layers with some entries replaced; None takes one away.

    Under another law, parameters that have a meaning no more go.

    Raises
    ------
    InputError : there is no such layer.
    """
    changed = copy.deepcopy(list(layers)) if entries_of(layers) is not None else []
    for name, value in changes.items():
        match = _ENTRY.fullmatch(name)
        assert match is not None
        i, entry = int(match[1]), match[2]
        if i >= len(changed):
            names = ", ".join(f"{path}[{j}]" for j in range(len(changed)))
            sentence = (
                f"{path}[{i}].{legible(entry)} = {shortened(value)}: the case has no such layer; "
                "must be of " + (names or f"one of {path}, of which it has none")
            )
            raise InputError(Fault(sentence, f"{path}[{i}].{entry}", "unknown_key"))
        table, last = changed[i], entry
        if entry.startswith("wear."):
            last = entry.removeprefix("wear.")
            if not isinstance(table.get("wear"), dict):
                table["wear"] = {}
            table = table["wear"]
            if last == "law" and isinstance(value, str) and value in LAYER_LAWS:
                own_keys = {"law", *LAYER_LAWS[value].parameters}
                for foreign_key in [
                    foreign_key for foreign_key in table if foreign_key not in own_keys
                ]:
                    if f"[{i}].wear.{foreign_key}" not in changes:
                        del table[foreign_key]
        if value is None:
            table.pop(last, None)
        else:
            table[last] = value
        if changed[i].get("wear") == {}:
            del changed[i]["wear"]
    return changed


def layers_in_full(path: str, layers: Any) -> Any:
    """Return the raw list of layers with numbers in the units of a case; wrong ones stay."""
    if entries_of(layers) is None:
        return layers
    copies = copy.deepcopy(list(layers))
    for i, layer in enumerate(copies):
        wear = layer.get("wear")
        for name, table in ((f"{path}[{i}]", layer), (f"{path}[{i}].wear", wear)):
            for entry, value in table.items() if isinstance(table, dict) else ():
                key = key_of(f"{name}.{entry}")
                if key is not None and isinstance(value, str | list | dict):
                    with suppress(RejectedError):
                        table[entry] = key.without_units(value)
    return copies


def changed_layers(keys: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return changes of which those of entries of layers are one of their whole list.

    Raises
    ------
    InputError : there is no such layer.
    """
    merged = dict(changes)
    for path in LAYERS:
        entries = {}
        for name in changes:
            entry = layer_entry(name)
            if entry is not None and entry[0] == path:
                entries[f"{entry[1]}.{entry[2]}"] = merged.pop(name)
        if entries:
            merged[path] = with_entries(path, merged.get(path, keys.get(path, [])), entries)
    return merged
