"""Compiled code, and where it is kept for the next process.

That is beside the source, or in the user's cache folder, or as ``NUMBA_CACHE_DIR`` says; where
none of them may be written, in a folder of the user's own among the temporary ones.
"""

import os
import stat
import tempfile
from contextlib import suppress
from functools import partial

import numba


def _own_temporary_folder() -> str | None:
    """Return a folder that nobody else may write to, as what is in it is executed, or None."""
    try:
        path = os.path.join(tempfile.gettempdir(), f"ringwear-compiled-{os.getuid()}")
        with suppress(FileExistsError):
            os.mkdir(path, 0o700)
        found = os.lstat(path)
    except OSError:
        return None
    own = stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid()
    return path if own and not found.st_mode & 0o077 else None


def _can_be_kept() -> bool:
    def nothing() -> None:
        pass

    try:
        numba.njit(cache=True)(nothing)
    except RuntimeError:  # "no locator available"
        return False
    return True


def _kept() -> bool:
    if _can_be_kept():
        return True
    folder = _own_temporary_folder()
    if folder is None:
        return False
    numba.config.CACHE_DIR = folder
    return _can_be_kept()


#: decorator of compiled functions; without a place to keep them they are compiled by each process
compiled = partial(numba.njit, cache=_kept())
