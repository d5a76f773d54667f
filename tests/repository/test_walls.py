"""Tests of a room know that room, the public package and helpers: rooms can be rebuilt."""

import ast
from pathlib import Path

import pytest

TESTS = Path(__file__).parents[1]
FILES = [p for p in TESTS.rglob("*.py") if p.parent.name not in ("tests", "repository", "helpers")]
FILES += TESTS.glob("test_*.py")
#: folders whose tests are of several rooms, or of one that is called otherwise
ROOMS = {
    "contact": {"contact", "elasticity", "history"},
    "mpi": {"elasticity", "history", "parallel", "verify"},
    "verification": {"elasticity", "verify"},
    "test_full_disks.py": {"results"},
    "test_signals.py": {"results"},
}


def rooms_of(path):
    """Return the rooms that a file of tests may import."""
    top = path.relative_to(TESTS).parts[0]
    return ROOMS.get(top, {top.removeprefix("test_").removesuffix(".py")})


def imports(tree):
    """Yield the modules of the package that are imported, and the names from them."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((alias.name, "") for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield from ((node.module or "", alias.name) for alias in node.names)


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(TESTS)))
def test_other_rooms_are_not_imported(path):
    for module, name in imports(ast.parse(path.read_text("utf-8"))):
        package, _, inside = module.partition(".")
        if package == "ringwear_par":
            room = inside.partition(".")[0] or name
            assert not inside or room in rooms_of(path), f"{module}: import {name} from parts"
            private = name.startswith("_") and not name.startswith("__")
            assert not private, f"{name} of {module} is private"


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(TESTS)))
def test_no_private_name_is_patched(path):
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Call) and getattr(node.func, "attr", "") == "setattr":
            for argument in node.args[:2]:
                name = argument.value if isinstance(argument, ast.Constant) else ""
                last = str(name).rpartition(".")[2]
                assert not last.startswith("_") or last.startswith("__"), name
