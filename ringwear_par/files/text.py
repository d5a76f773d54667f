"""Users' text files, cases, studies, tables and laws: one reader for all; values of TOML."""

import json
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ringwear_par.errors import InputError, legible

#: a number with a decimal comma as a value, or as the first of a list
_COMMA = re.compile(r"[=\[]\s*([-+]?[0-9]+),([0-9]+)")


def read_text(path: Path) -> str:
    """Return the text of a user's file, without the byte-order mark that some programs write.

    Raises
    ------
    InputError : there is no such file, it may not be read, or it is no text.
    """
    try:
        return path.read_text("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is not a text file in UTF-8") from error
    except (OSError, ValueError) as error:  # ValueError: of a name with a zero byte
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{path}: cannot be read: {reason}") from error


def parse_toml(text: str, name: str) -> dict[str, Any]:
    """Return the tables of a TOML text that messages call ``name``.

    Raises
    ------
    InputError : it is none.
    """
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # ValueError: of long whole numbers, too
        place = re.search(r"at line ([0-9]+)", str(error))
        line = text.splitlines()[int(place[1]) - 1 :][:1] if place else []
        comma = _COMMA.search(line[0]) if line else None
        hint = f"; decimals have a point, as {comma[1]}.{comma[2]}" if comma else ""
        raise InputError(f"{name}: is not valid TOML: {legible(str(error), 200)}{hint}") from error


def parse_value(text: str) -> Any:
    """Return the value of a TOML text, or the text itself where it is none."""
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except (ValueError, RecursionError):
        return text.strip()


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
