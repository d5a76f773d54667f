"""Users' text files, and values as TOML writes them."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ringwear_par.errors import InputError

#: longest value that a message shows in full
_SHOWN = 120


def read_text(path: Path) -> str:
    """Return the text of a user's file, without the byte-order mark that some programs write.

    Raises
    ------
    InputError : there is no such file, it may not be read, or it is no text.
    """
    try:
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is not a text file in UTF-8") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error


def toml_value(value: Any) -> str:
    """Return a value as TOML writes it."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):  # TOML's escapes are JSON's, but for one more control character
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, list | tuple):
        return "[" + ", ".join(toml_value(v) for v in value) + "]"
    if isinstance(value, dict):
        items = ", ".join(f"{toml_value(str(k))} = {toml_value(v)}" for k, v in value.items())
        return "{ " + items + " }"
    return repr(value) if isinstance(value, int | float) else str(value)


def shortened(value: Any) -> str:
    """Return a value as messages show it."""
    text = toml_value(value)
    return text if len(text) <= _SHOWN else f"{text[:80]} ... {text[-20:]}"


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
