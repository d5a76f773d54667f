"""No room grows: each has a largest number of lines, which changes only ever lower.

Lines of Python, Cython and C are counted, docstrings, comments and blank lines with them.
"""

from collections import Counter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
#: kinds of files of a program; data and templates do not count
PROGRAMS = {".py", ".pyi", ".pyx", ".h", ".c", ".sh", ".sbatch"}
#: parts of the package (files and folders), and most lines of them together
ROOMS = {
    "elasticity": 5497,
    "contact compiled": 3959,
    "wear": 2734,
    "history": 5880,
    "cases schedules.py errors.py": 5567,
    "files": 1466,
    "measuring": 2499,
    "results": 5439,
    "studies": 7626,
    "identification": 11724,
    "prediction monitoring": 2705,
    "pictures reports explorer functions": 7324,
    "verification cli.py commands.py info.py __init__.py __main__.py version.py": 2995,
    "parallel.py petsc.py arrays.py batched.py options.py": 597,
}
#: most lines of what is beside the package, and of the package
FOLDERS = {"ringwear_par": 66012, "tests": 29288, "scripts slurm": 5280, "docs": 1263}


def lines(folder: str) -> Counter[Path]:
    """Return the lines of each program in a folder, by its place there."""
    top = ROOT / folder
    return Counter(
        {
            path.relative_to(top): path.read_text(encoding="utf-8").count("\n")
            for path in top.rglob("*")
            if path.suffix in PROGRAMS and path.is_file()
        }
    )


@pytest.mark.parametrize("parts", ROOMS)
def test_a_room_does_not_grow(parts):
    sizes = lines("ringwear_par")
    size = sum(
        n for path, n in sizes.items() if path.parts[0] in parts.split() and path.suffix != ".pyi"
    )
    assert 0.98 * ROOMS[parts] <= size <= ROOMS[parts], "lower the number where a room has shrunk"
