"""Locks on the folder of a sweep: one sweep at a time, or slices, each once."""

import fcntl
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from ringwear_par.errors import InputError


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
        whole = held.enter_context((folder / "lock").open("a"))
        _lock(whole, fcntl.LOCK_SH if part else fcntl.LOCK_EX, folder)
        if part:  # only now: who has the whole may remove it
            own = held.enter_context((folder / f"lock{part}").open("a"))
            _lock(own, fcntl.LOCK_EX, folder)
        yield


def forget_slices(folder: Path) -> None:
    """Remove the locks of slices. Needs the lock of the whole folder."""
    for path in folder.glob("lock[0-9]*-[0-9]*"):
        path.unlink(missing_ok=True)


def _lock(file: object, kind: int, folder: Path) -> None:
    try:
        fcntl.flock(file.fileno(), kind | fcntl.LOCK_NB)  # type: ignore[attr-defined]
    except BlockingIOError:
        raise InputError(
            f"{folder}: another sweep is at work in this folder; wait for its end, or use another"
        ) from None
    except OSError as error:
        raise InputError(f"{folder}: its disk cannot lock files: {error.strerror}") from error
