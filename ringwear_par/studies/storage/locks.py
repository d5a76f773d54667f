"""Locks on the folder of a sweep: one sweep at a time, or slices, each once."""

import fcntl
import os
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import BinaryIO

from ringwear_par.errors import InputError
from ringwear_par.files.ordinary import open_ordinary


@contextmanager
def locked(folder: Path, part: str) -> Iterator[None]:
    """Hold a sweep's folder, or one slice of it, for this process. Call on one rank.

    Parameters
    ----------
    folder : of the sweep.
    part : name of the slice, "" for the whole, which excludes every slice.

    Raises
    ------
    InputError : another sweep is at work there.
    """
    with ExitStack() as held:
        whole = held.enter_context(_opened(folder / "lock"))
        _lock(whole, fcntl.LOCK_SH if part else fcntl.LOCK_EX, folder)
        if part:  # only now: who has the whole may remove it
            own = held.enter_context(_opened(folder / f"lock{part}"))
            _lock(own, fcntl.LOCK_EX, folder)
        yield


def forget_slices(folder: Path) -> None:
    """Remove the locks of slices. Needs the lock of the whole folder."""
    for path in folder.glob("lock[0-9]*-[0-9]*"):
        path.unlink(missing_ok=True)


def _opened(path: Path) -> BinaryIO:
    """Open a lock, or make it.

    Raises
    ------
    InputError : it cannot be opened, or something else is there.
    """
    try:
        return open_ordinary(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW)
    except OSError as error:
        raise InputError(f"{path}: cannot be opened: {error.strerror or error}") from error


def _lock(file: BinaryIO, kind: int, folder: Path) -> None:
    try:
        fcntl.flock(file, kind | fcntl.LOCK_NB)
    except BlockingIOError:
        raise InputError(
            f"{folder}: another sweep is at work in this folder; wait for its end, or use another"
        ) from None
    except OSError as error:
        raise InputError(f"{folder}: its disk cannot lock files: {error.strerror}") from error
