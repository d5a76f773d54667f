"""Output files: refused before work where they cannot be, whole where they are."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ringwear_par.errors import InputError


def check_writable(path: Path) -> None:
    """Refuse a file that cannot be written. Not collective.

    Raises
    ------
    InputError : the reason, in one sentence.
    """
    if path.is_dir():
        raise InputError(f"{path}: is a folder; must be a file name")
    if not path.parent.is_dir():
        raise InputError(f"{path}: its folder {path.parent} does not exist")
    if path.exists() and not os.access(path, os.W_OK):
        raise InputError(f"{path}: is write-protected; must be a file that may be replaced")
    probe = path.with_name(f"{path.name}.tmp{os.getpid()}")
    try:
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from error


@contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """Give a temporary name beside a file, of the same ending, that becomes the file at the end.

    Not collective. Nothing is left of it after an error.
    """
    temporary = path.with_name(f".{path.stem}.tmp{os.getpid()}{path.suffix}")
    try:
        yield temporary
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
