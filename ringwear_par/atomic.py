"""Output files: refused before work where they cannot be, whole where they are."""

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ringwear_par.errors import ComputationError, InputError, RingwearError

#: failures that another name would not mend
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EIO)


def temporary_name(path: Path) -> Path:
    """Return the name beside a file that it has until it is whole.

    Its ending is not that of the file, so that who looks for files by their ending finds whole
    ones only; what writes by the ending must be told the format.
    """
    return path.with_name(f"{path.name}.tmp{os.getpid()}")


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
    probe = temporary_name(path)
    try:
        probe.touch()
        probe.unlink(missing_ok=True)
    except OSError as error:
        raise unwritable(path, error) from error


def unwritable(path: Path, error: OSError) -> RingwearError:
    """Return what a failure to write means to a user: another name, or room on the disk."""
    kind = ComputationError if error.errno in _FULL else InputError
    return kind(f"{path}: cannot be written: {error.strerror or error}")


@contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """Give a temporary name to write to, which becomes the file at the end. Not collective.

    What was written is on the disk before it replaces the file; nothing is left of it after an
    error.

    Raises
    ------
    OSError : the disk or the folder; its ``filename`` is that of the file.
    """
    temporary = temporary_name(path)
    try:
        yield temporary
        with temporary.open("rb+") as file:
            os.fsync(file.fileno())
        temporary.replace(path)
    except OSError as error:
        if error.filename is not None and Path(error.filename) != temporary:
            raise
        raise OSError(error.errno, error.strerror or str(error), str(path)) from error
    finally:
        temporary.unlink(missing_ok=True)
