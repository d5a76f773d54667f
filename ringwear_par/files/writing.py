"""Files are ordinary ones; outputs are refused before work where they cannot be, or written whole.

Of files to be read, a pipe may keep its reader waiting for ever, and a device may have no end.
"""

import errno
import fcntl
import logging
import os
import re
import secrets
import shlex
import stat
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from ringwear_par.errors import ComputationError, InputError, RingwearError

log = logging.getLogger(__name__)

_MUST = "must be an ordinary file"


def open_ordinary(path: Path, flags: int = os.O_RDONLY) -> BinaryIO:
    """Open a file that must be an ordinary one. Not collective.

    Parameters
    ----------
    flags : of ``os.open``: to read, or to write as well, which makes a file that is not there.

    Raises
    ------
    OSError : it cannot be opened, or is a folder, a pipe or a device.
    """
    # O_NONBLOCK: a pipe nobody writes to is opened at once; on ordinary files it does nothing
    try:
        handle = os.open(path, flags | os.O_NONBLOCK | os.O_CLOEXEC, 0o666)
    except OSError as error:
        if error.errno == errno.ELOOP and flags & os.O_NOFOLLOW:
            raise OSError(error.errno, f"it is a link, {_MUST}", str(path)) from error
        raise
    try:
        mode = os.fstat(handle).st_mode
        if stat.S_ISDIR(mode):
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
        if not stat.S_ISREG(mode):
            raise OSError(errno.EINVAL, f"it is a pipe or a device, {_MUST}", str(path))
        return os.fdopen(handle, "rb+" if flags & os.O_RDWR else "rb")
    except BaseException:
        os.close(handle)
        raise


def read_bytes(path: Path) -> bytes:
    """Return the content of an ordinary file. Not collective.

    Raises
    ------
    OSError : it cannot be read, or is none.
    """
    with open_ordinary(path) as file:
        return file.read()


#: failures that another name would not mend
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EIO)
#: how the names of files end that are not whole yet; nobody can know the digits before
_TEMPORARY = re.compile(r"(.+)\.tmp[0-9a-f]{16}", re.DOTALL)
_BYTES = 8
#: opened for nothing but what they are: no link is followed, no reader of a fifo waited for
_LOOK = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC


def _new_file(path: Path, mode: int) -> tuple[Path, int]:
    """Return the name and the descriptor of a file that was not there, beside another.

    Its ending is not that of the other, so that who looks for files by their ending finds whole
    ones only. It is locked for as long as it is open, so that ``remove_leftovers`` leaves it.
    """
    while True:
        name = path.with_name(f"{path.name}.tmp{secrets.token_hex(_BYTES)}")
        flags = os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
        try:
            handle = os.open(name, flags, mode)
        except OSError as error:
            raise OSError(error.errno, error.strerror, str(path)) from error
        if _is_locked(handle) and os.fstat(handle).st_nlink:
            return name, handle
        os.close(handle)  # another process has taken it for left over


def _is_locked(handle: int) -> bool:
    """Lock a new file; return False where another process was faster."""
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # the disk cannot lock files, and nobody takes them for left over
        pass
    return True


def _allow_readers(handle: int) -> None:
    """Turn the lock of a file into one that readers share and ``remove_leftovers`` respects.

    HDF5 locks what it reads: it refuses a file that its writer still holds for itself alone in
    the moment after the file got its name.
    """
    with suppress(OSError):  # the disk cannot lock files
        fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)


def remove_leftovers(folder: Path, name: str = "") -> None:
    """Remove what killed processes have left of files that were not whole yet. Not collective.

    What a process still writes to stays, and so does all that is on a disk that cannot lock files.

    Parameters
    ----------
    name : of the one file whose left-overs go; "": those of all files of the folder.
    """
    with suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            match = _TEMPORARY.fullmatch(entry.name)
            if match and name in ("", match[1]):
                with suppress(OSError):  # somebody else's, or in use
                    _remove_if_left(entry.path)


def _remove_if_left(path: str) -> None:
    handle = os.open(path, _LOOK)
    try:
        if stat.S_ISREG(os.fstat(handle).st_mode):
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            os.unlink(path)
    finally:
        os.close(handle)


def check_writable(path: Path) -> None:
    """Refuse a file that cannot be written; remove what a killed process has left of it.

    Not collective.

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
    remove_leftovers(path.parent, path.name)
    try:
        probe, handle = _new_file(path, 0o666)
        os.close(handle)
        probe.unlink(missing_ok=True)
    except OSError as error:
        raise unwritable(path, error) from error


def announce_replacement(path: Path) -> None:
    """Say that a finished outcome will be replaced. On one rank."""
    if path.exists():
        log.info("%s is there already: it will be replaced", path)


def closing_line(folder: Path, names: Sequence[str]) -> str:
    """Return the line about what was written to a folder, and about the command to type next."""
    present = ", ".join(str(folder / name) for name in names if (folder / name).exists())
    source, page = (shlex.quote(str(path)) for path in (folder, f"{folder}.html"))
    return f"written: {present}; next: ringwear report {source} -o {page}"


def unwritable(path: Path, error: OSError) -> RingwearError:
    """Return the error of a file that cannot be written: another name, or room on the disk."""
    kind = ComputationError if error.errno in _FULL else InputError
    return kind(f"{path}: cannot be written: {error.strerror or error}")


@contextmanager
def atomic_write(path: Path, mode: int = 0o666) -> Iterator[Path]:
    """Yield a name to write to; what is written becomes the file at the end. Not collective.

    What was written is on the disk before it replaces the file; nothing is left of it after an
    error. The name is that of an open descriptor: whoever may write to the folder, what is written
    goes to no other file, as it would through a link put in the place of an ordinary name. What
    writes by the ending of a name must be told the format.

    Parameters
    ----------
    mode : permissions of the file, less those that the process masks.

    Raises
    ------
    OSError : the disk or the folder; its ``filename`` is that of the file.
    """
    temporary, handle = _new_file(path, mode)
    opened = Path(f"/proc/self/fd/{handle}")
    try:
        yield opened
        os.fsync(handle)
        _allow_readers(handle)
        temporary.replace(path)
    except OSError as error:
        if error.filename is not None and Path(error.filename) not in (temporary, opened):
            raise
        raise OSError(error.errno, error.strerror or str(error), str(path)) from error
    finally:
        temporary.unlink(missing_ok=True)
        os.close(handle)
