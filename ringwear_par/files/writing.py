"""Outputs: refused before work where they cannot be, and written whole or not at all."""

import errno
import logging
import os
import secrets
import shlex
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from ringwear_par.errors import ComputationError, InputError, RingwearError

log = logging.getLogger(__name__)

#: errors that another file name would not avoid
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EIO)


@contextmanager
def atomic_write(path: Path, mode: int = 0o666) -> Iterator[Path]:
    """Yield a name to write to; what is written becomes the file at the end. Not collective.

    What was written is on the disk before it replaces the file; nothing is left of it after an
    error. The name does not end as that of the file: who looks for files by their ending finds
    whole ones only, and a writer that chooses the format by it must be given the format.

    Parameters
    ----------
    mode : permissions of the file, less those that the process masks.

    Raises
    ------
    OSError : the disk or the folder; its ``filename`` is that of the file.
    """
    temporary = _beside(path)
    try:
        temporary.touch(mode, exist_ok=False)
        yield temporary
        with temporary.open("rb") as file:
            os.fsync(file.fileno())
        temporary.replace(path)
    except OSError as error:
        if error.filename not in (None, str(temporary)):
            raise
        raise OSError(error.errno, error.strerror or str(error), str(path)) from error
    finally:
        with suppress(OSError):
            temporary.unlink()


def _beside(path: Path) -> Path:
    """Return a new name in the folder of a file."""
    return path.with_name(f".{path.name}.{secrets.token_hex(4)}.tmp")


def check_writable(path: Path) -> None:
    """Refuse a file that cannot be written. Not collective.

    Raises
    ------
    InputError : the reason, in one sentence.
    ComputationError : the disk is full.
    """
    if path.is_dir():
        raise InputError(f"{path}: is a folder; must be a file name")
    if not path.parent.is_dir():
        raise InputError(f"{path}: its folder {path.parent} does not exist")
    if path.exists() and not os.access(path, os.W_OK):
        raise InputError(f"{path}: is write-protected; must be a file that may be replaced")
    try:
        probe = _beside(path)
        probe.touch(exist_ok=False)
        probe.unlink()
    except OSError as error:
        raise unwritable(path, error) from error


def unwritable(path: Path, error: OSError) -> RingwearError:
    """Return the error of a file that cannot be written: another name, or room on the disk."""
    kind = ComputationError if error.errno in _FULL else InputError
    return kind(f"{path}: cannot be written: {error.strerror or error}")


def announce_replacement(path: Path) -> None:
    """Say that a finished outcome will be replaced. On one rank."""
    if path.exists():
        log.info("%s is there already: it will be replaced", path)


def closing_line(folder: Path, names: Sequence[str]) -> str:
    """Return the line about what was written to a folder, and about the command to type next."""
    present = ", ".join(str(folder / name) for name in names if (folder / name).exists())
    source, page = (shlex.quote(str(path)) for path in (folder, f"{folder}.html"))
    return f"written: {present}; next: ringwear report {source} -o {page}"
