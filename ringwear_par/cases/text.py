"""Values as TOML writes them, and as messages show them."""

import json
from collections.abc import Mapping
from typing import Any

from ringwear_par.errors import legible

#: what Python writes and reads in decimal digits at any setting
_WRITTEN = 10**640


def toml_value(value: Any) -> str:
    """Return a value as TOML writes it."""
    if type(value) is float:  # most are, of the columns of a study
        return repr(value)
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):  # TOML's escapes are JSON's, but for one more control character
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, list | tuple):
        return "[" + ", ".join(toml_value(v) for v in value) + "]"
    if isinstance(value, dict):
        items = ", ".join(f"{toml_value(str(k))} = {toml_value(v)}" for k, v in value.items())
        return "{ " + items + " }"
    if isinstance(value, int) and abs(value) >= _WRITTEN:
        return hex(value)
    return repr(value) if isinstance(value, int | float) else str(value)


def shortened(value: Any) -> str:
    """Return a value as messages show it."""
    return legible(toml_value(value))


def toml_text(keys: Mapping[str, Any]) -> str:
    """Return a TOML text with these dotted keys."""
    tables: dict[str, list[str]] = {"": []}
    for path, value in keys.items():
        table, _, name = path.rpartition(".")
        tables.setdefault(table, []).append(f"{name} = {toml_value(value)}")
    blocks = [
        "\n".join(([f"[{table}]"] if table else []) + lines)
        for table, lines in tables.items()
        if lines
    ]
    return "\n\n".join(blocks) + "\n"
