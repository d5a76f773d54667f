"""No room grows: each has a largest number of lines, which is only ever lowered.

Lines of Python, Cython, C and shell count, docstrings, comments and blank lines with them.
"""

from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PROGRAMS = {".py", ".pyx", ".h", ".c", ".sh", ".sbatch"}
#: lines by which a room may be smaller than its number: whoever takes more out lowers it
SLACK = 150
#: parts of the package, and most lines of them together
ROOMS = {
    "elasticity": 3072,
    "contact compiled": 681,
    "wear": 593,
    "history": 1698,
    "cases schedules.py errors.py": 5484,
    "files": 1216,
    "measuring": 2506,
    "results": 2617,
    "studies": 2595,
    "identification": 6206,
    "prediction monitoring": 1094,
    "pictures reports explorer functions": 5114,
    "verify.py cli.py commands.py info.py __init__.py __main__.py version.py": 776,
    "parallel.py petsc.py arrays.py batched.py options.py": 263,
}
#: folders, and most lines of programs in them
FOLDERS = {"ringwear_par": 33915, "tests": 16208, "scripts slurm": 933, "docs": 1087}


def sizes(folder):
    """Return the lines of each program in a folder, by its place there."""
    top = ROOT / folder
    built = {"_build", "generated"}  # by the build of the site
    programs = (p for p in top.rglob("*") if p.suffix in PROGRAMS and not built & {*p.parts})
    return {p.relative_to(top): p.read_text("utf-8").count("\n") for p in programs}


def check(size, most):
    assert size <= most, "must not grow: which mechanism can go?"
    assert size >= most - SLACK, f"lower the number to {size}"


@pytest.mark.parametrize("parts", ROOMS)
def test_a_room_does_not_grow(parts):
    package = sizes("ringwear_par").items()
    check(sum(n for path, n in package if path.parts[0] in parts.split()), ROOMS[parts])


@pytest.mark.parametrize("folders", FOLDERS)
def test_a_folder_does_not_grow(folders):
    check(sum(n for one in folders.split() for n in sizes(one).values()), FOLDERS[folders])


def test_every_part_is_in_a_room():
    parts = {part for room in ROOMS for part in room.split()}
    assert {path.parts[0] for path in sizes("ringwear_par")} <= parts
