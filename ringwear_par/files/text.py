"""Users' text files, cases, studies, tables and laws: one reader for all; values of TOML."""

import json
import re
import tomllib
from collections.abc import Mapping
from io import TextIOWrapper
from pathlib import Path
from typing import Any

from ringwear_par.errors import InputError, legible
from ringwear_par.files.writing import open_ordinary

#: tables and arrays within each other; a case needs six
_DEEPEST = 32
#: what makes a text of a command line TOML, and how those begin that are no plain texts
_VALUE, _MEANT = "value = ", re.compile(r"\s*([\[{]|[-+]?\.[0-9])")
#: a line that ends within an inline table, or with a comma before the end of one
_OPEN_TABLE = re.compile(r"\{[^}]*(#.*)?$|,\s*\}")


def read_text(path: Path) -> str:
    """Return the text of a user's file, without the byte-order mark that some programs write.

    Raises
    ------
    InputError : there is no such file, it may not be read, or it is no text; a pipe or a device.
    """
    try:
        with TextIOWrapper(open_ordinary(path), encoding="utf-8-sig") as file:
            return file.read()
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is not a text file in UTF-8") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
    except ValueError as error:  # of a name with a zero byte
        raise InputError(f"{path}: cannot be read: {error}") from error
    except MemoryError as error:
        raise InputError(f"{path}: cannot be read: it is too large") from error


def parse_toml(text: str, name: str) -> dict[str, Any]:
    """Return the tables of a TOML text that messages call ``name``.

    Raises
    ------
    InputError : it is none, or nested too deeply.
    """
    try:
        tables = tomllib.loads(text)
    except ValueError as error:  # of TOML, or a whole number too long for Python
        raise InputError(f"{name}: is not valid TOML: {_reason(str(error), text)}") from error
    except RecursionError as error:
        raise InputError(f"{name}: {_TOO_DEEP}") from error
    refuse_depth(tables, name)
    return tables


def parse_json(text: str) -> Any:
    """Return the values of a JSON text.

    Raises
    ------
    ValueError : it is none, or nested too deeply.
    """
    try:
        values = json.loads(text)
        refuse_depth([values], "JSON")
    except (RecursionError, InputError) as error:
        raise ValueError(_TOO_DEEP) from error
    return values


def _reason(reason: str, text: str) -> str:
    """Return why a text is no TOML, with the line that is wrong and what is usual there."""
    match = re.search(r"at line ([0-9]+)", reason)
    lines = text.splitlines()
    if match is None or not 0 < int(match[1]) <= len(lines):
        return legible(reason)
    line, hint = lines[int(match[1]) - 1].strip(), ""
    if comma := re.search(r"[=\[]\s*([-+]?[0-9]+),([0-9]+)", line):
        hint = f"; decimals have a point, as {comma[1]}.{comma[2]}"
    elif line.startswith("[") and ("overwrite" in reason or "declare" in reason):
        hint = f"; a table that is there several times is [[{line.strip('[]')}]] every time"
    elif _OPEN_TABLE.search(line) and ("key part" in reason or "inline table" in reason):
        hint = "; an inline table { ... } is on one line, without a comma at its end"
    return f"{legible(reason, 200)}: {legible(line)}{hint}"


def parse_value(text: str) -> Any:
    """Return the value of a TOML text, or the text itself where it is none."""
    try:
        return parse_toml(f"{_VALUE}{text}", "value")["value"]
    except InputError:
        return text.strip()


def value_fault(text: str) -> str:
    """Return why ``parse_value`` has returned what was meant as a number, a list or a table.

    "" where it is none of these.
    """
    if not _MEANT.match(text):
        return ""
    whole = f"{_VALUE}{text}"
    try:
        tomllib.loads(whole)
    except (ValueError, RecursionError) as error:
        place = re.search(r"at line ([0-9]+), column ([0-9]+)", str(error))
        if place is None:
            return "TOML finds no end of it" if "end of document" in str(error) else ""
        rest = whole.splitlines()[int(place[1]) - 1][int(place[2]) - 1 :]
        hint = ""
        if point := re.match(r"[-+]?(\.[0-9]+)", rest):
            hint = f"; numbers have a digit before their point, as 0{point[1]}"
        return f'TOML does not accept it at "{legible(rest)}"{hint}'
    return ""


def refuse_depth(tables: Any, name: str) -> None:
    """Refuse values within each other so deep that whatever walks through them would fail.

    Raises
    ------
    InputError : they are.
    """
    inner = [tables]
    for _ in range(_DEEPEST):
        inner = [
            entry
            for value in inner
            for entry in (value.values() if isinstance(value, dict) else value)
            if isinstance(entry, dict | list | tuple)
        ]
        if not inner:
            return
    raise InputError(f"{name}: {_TOO_DEEP}")


_TOO_DEEP = f"has values nested in each other too deeply; must be at most {_DEEPEST} deep"


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
