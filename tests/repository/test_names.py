"""Names are nouns and verbs of the field: no pronoun and no participle stands for a thing."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from paths import ROOT

PACKAGE = ROOT / "ringwear_par"
#: words that do not say what they name
VAGUE = {
    "asked", "each", "found", "given", "held", "kept", "lent", "made", "nothing", "others", "own",
    "shown", "sought", "there", "told", "what",
}  # fmt: skip
#: likewise; not in these files yet
ALSO_VAGUE = {"here", "said", "so", "these", "this", "those", "untold", "why"}
ALSO_TO_DO = {"history/batch.py"}
#: beginnings of docstrings that name no noun
VAGUE_DOCSTRING = re.compile(r"(?:Return|Tell|Give) (?:what|the same|that of|those)\b")


def room_of(path: Path) -> str:
    """Return the folder, or the module of the root, that a file belongs to."""
    parts = path.relative_to(PACKAGE).parts
    if parts[0] == "studies":  # a room of rooms
        return "/".join(parts[:2])
    return parts[0].removesuffix(".py")


ROOMS = sorted({room_of(path) for path in PACKAGE.rglob("*.py")})


def identifiers(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Yield line and name of the functions, classes, parameters, variables and attributes."""
    for node in ast.walk(tree):
        match node:
            case ast.FunctionDef(name=name) | ast.ClassDef(name=name) | ast.arg(arg=name):
                yield node.lineno, name
            case ast.Name(id=name, ctx=ast.Store()) | ast.Attribute(attr=name, ctx=ast.Store()):
                yield node.lineno, name
            case ast.alias(asname=str(name)):
                yield node.lineno, name


def docstrings(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Yield line and docstring of the functions and classes."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield node.lineno, ast.get_docstring(node) or ""


def faults(path: Path, text: str) -> list[str]:
    """Return the vague names and docstrings of a module, each with its line."""
    tree, place = ast.parse(text), path.relative_to(PACKAGE)
    vague = VAGUE if place.as_posix() in ALSO_TO_DO else VAGUE | ALSO_VAGUE
    names = [(1, path.stem), *identifiers(tree)]
    return [
        f"{place}:{line}: {name}" for line, name in names if name.strip("_").lower() in vague
    ] + [
        f"{place}:{line}: {text.partition(chr(10))[0]}"
        for line, text in docstrings(tree)
        if VAGUE_DOCSTRING.match(text)
    ]


@pytest.mark.parametrize("room", ROOMS)
def test_names_are_nouns_and_verbs_of_the_field(room):
    paths = [path for path in sorted(PACKAGE.rglob("*.py")) if room_of(path) == room]
    vague = [fault for path in paths for fault in faults(path, path.read_text())]
    assert not vague, "\n".join(vague)


def test_vague_names_are_seen():
    text = """
def told(given): "Return what is given."
class There: kept = 1
self._found = [own for own in given]
import numpy as asked
"""
    assert len(faults(PACKAGE / "made.py", text)) == 9
