"""Files opened to be read, whoever has put them there: ordinary ones only.

A pipe may keep its reader waiting for ever, and a device may have no end.
"""

import errno
import os
import stat
from pathlib import Path
from typing import BinaryIO

_MUST = "must be an ordinary file"


def open_ordinary(path: Path, flags: int = os.O_RDONLY, folder: int | None = None) -> BinaryIO:
    """Open a file that must be an ordinary one. Not collective.

    Parameters
    ----------
    flags : of ``os.open``: to read, or to write as well, which makes a file that is not there.
    folder : descriptor of the folder that ``path`` counts from.

    Raises
    ------
    OSError : it cannot be opened, or is a folder, a pipe or a device.
    """
    # O_NONBLOCK: a pipe nobody writes to is opened at once; on ordinary files it does nothing
    try:
        handle = os.open(path, flags | os.O_NONBLOCK | os.O_CLOEXEC, 0o666, dir_fd=folder)
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
