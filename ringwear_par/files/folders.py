"""The folders of outcomes: what their files are called, how they are written, what draws them."""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ringwear_par.errors import ComputationError, InputError
from ringwear_par.files.writing import atomic_write, check_writable

#: files of a fit: its outcome, which is written last, its readings and their figure
FIT, READINGS, CURVES = "fit.json", "results.h5", "fit.png"
#: file of a fit: draws of what it knows, which ArviZ opens
POSTERIOR = "draws.nc"
#: files of a design: its outcome, which is written last, and bars of the best tests
DESIGN, BARS = "design.json", "design.png"
#: files of measured tests: their numbers, which are written last, a row a test, the records
MEASURE, MEASURED_ROWS, RECORDS = "measure.json", "measure.csv", "measure.png"
#: files of a prediction: its numbers, which are written last, all draws and the band over time
PREDICTION, DRAWS, BAND = "prediction.json", "prediction.h5", "prediction.png"
#: file of a running test: its last answer
FOLLOW = "follow.json"

#: commands by what they leave in their folders; a fit and the design after it may share one
_COMMANDS = {
    FIT: "fit", DESIGN: "fit", "cases.csv": "sweep", "blocks": "sweep",
    MEASURE: "measure", PREDICTION: "predict", FOLLOW: "follow",
}  # fmt: skip


def refuse_others(folder: Path, command: str) -> None:
    """Refuse a folder that has the outcome of another command. On one rank.

    Parameters
    ----------
    command : "fit" (or of a design), "sweep", "measure", "predict" or "follow".

    Raises
    ------
    InputError : its files would be replaced.
    """
    for name, owner in _COMMANDS.items():
        path = folder / name
        occupied = path.exists()
        if path.is_dir():  # a sweep that failed before its first case has left empty files
            occupied = any(file.stat().st_size for file in path.iterdir())
        if owner != command and occupied:
            raise InputError(
                f"{folder}: is the folder of ringwear {owner} ({name}); must be another, or new"
            )


def check_folder(folder: Path, files: Sequence[str], command: str) -> None:
    """Refuse a folder where files cannot be written, before any work. On one rank.

    Parameters
    ----------
    command : whose outcome they are, see ``refuse_others``.

    Raises
    ------
    InputError, ComputationError : why not.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: is a file; must be a folder, or new")
    refuse_others(folder, command)
    if folder.is_dir():
        for name in files:
            check_writable(folder / name)
    else:  # made with its parents; the first of them that is missing tells
        check_writable([path for path in (folder, *folder.parents) if not path.exists()][-1])


@contextmanager
def new_files(folder: Path, files: Sequence[str], command: str) -> Iterator[None]:
    """Make a folder, if files can be written there, and report the disk's errors. On one rank.

    Parameters
    ----------
    command : whose outcome they are, see ``refuse_others``.

    Raises
    ------
    InputError, ComputationError : the folder or the disk.
    """
    check_folder(folder, files, command)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        yield
    except OSError as error:
        name = error.filename or folder
        raise ComputationError(f"{name}: {error.strerror or error}") from error


def write_outcome(
    folder: Path, command: str, contents: Mapping[str, Callable[[], bytes | None]]
) -> None:
    """Write the files of a folder, which is made; the last one says that it is whole. On one rank.

    Parameters
    ----------
    command : whose outcome they are, see ``refuse_others``.
    contents : see ``write_contents``.

    Raises
    ------
    InputError, ComputationError : the folder or the disk.
    """
    with new_files(folder, [*contents], command):
        write_contents(folder, contents)


def write_contents(folder: Path, contents: Mapping[str, Callable[[], bytes | None]]) -> None:
    """Write files, one after the other, each whole. On one rank.

    Parameters
    ----------
    contents : functions that return the contents of a file, by its name; None: there is none, and
        one of before goes.

    Raises
    ------
    OSError : the disk or the folder.
    """
    for name, content in contents.items():
        written = content()
        if written is None:
            (folder / name).unlink(missing_ok=True)
            continue
        with atomic_write(folder / name) as path:
            path.write_bytes(written)


def json_bytes(content: Mapping[str, Any]) -> bytes:
    """Return numbers as all JSON readers know them."""
    return f"{json.dumps(content, indent=1, allow_nan=False)}\n".encode()


def refuse_drawn(folder: Path) -> None:
    """Refuse to draw the folder of a fit or a design anew. Not collective.

    Raises
    ------
    InputError : it is one; with the pictures that are there.
    """
    for outcome, kind, pictures in (
        (FIT, "fit", f"picture {CURVES} is"),
        (DESIGN, "design", f"picture {BARS} is"),
        (MEASURE, "measurement", f"picture {RECORDS} is"),
        (PREDICTION, "prediction", f"picture {BAND} is"),
    ):
        if (folder / outcome).exists():
            raise InputError(
                f"{folder}: is the folder of a {kind}, whose {pictures} there already (a page of "
                "it is made by ringwear report); must be that of a sweep, or a result file"
            )
