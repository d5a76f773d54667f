"""Compiled code, and where it is kept for the next process.

That is beside the source, or in the user's cache folder, or as ``NUMBA_CACHE_DIR`` says; where
none of them may be written, in a folder of the user's own among the temporary ones. What was
compiled of other sources than there are now is compiled again, and replaced.
"""

import hashlib
import logging
import os
import stat
import tempfile
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numba

from ringwear_par.parallel import together

if TYPE_CHECKING:
    from mpi4py import MPI

log = logging.getLogger(__name__)

#: most attempts to store compiled functions: more than there are functions times types of arguments
_COMPILATIONS = 20


def _own_temporary_folder() -> str | None:
    """Return a folder that nobody else may write to, as what is in it is executed, or None."""
    try:
        path = os.path.join(tempfile.gettempdir(), f"ringwear-compiled-{os.getuid()}")
        with suppress(FileExistsError):
            os.mkdir(path, 0o700)
        status = os.lstat(path)
    except OSError:
        return None
    is_private = stat.S_ISDIR(status.st_mode) and status.st_uid == os.getuid()
    return path if is_private and not status.st_mode & 0o077 else None


def _has_place() -> bool:
    def empty() -> None:
        pass

    try:
        numba.njit(cache=True)(empty)
    except RuntimeError:  # "no locator available"
        return False
    return True


def _can_be_stored() -> bool:
    if _has_place():
        return True
    folder = _own_temporary_folder()
    if folder is None:
        return False
    numba.config.CACHE_DIR = folder
    return _has_place()


def load_compiled(comm: "MPI.Comm", load: Callable[[], None]) -> None:
    """Call compiled functions once, which compiles them or loads them. Collective on comm.

    Rank 0 goes first, so that many ranks do not write one cache at the same time. What a full disk
    does not take is compiled each time; what an older version kept, of types that are no more, is
    forgotten.
    """

    def load_or_compile() -> None:
        warned, forgotten = False, not _IS_STORED
        for _ in range(_COMPILATIONS):  # numba compiles, and only then fails to store it
            try:
                return load()
            except OSError as error:
                if comm.rank == 0 and not warned:
                    log.warning("compiled code is not kept, going on: %s", error.strerror)
                warned = True
            except (AttributeError, ImportError):
                if forgotten:  # then it is a fault of the code
                    raise
                _forget()
                forgotten = True
        return load()

    with together(comm):
        if comm.rank == 0:
            load_or_compile()
    if comm.rank > 0:
        load_or_compile()


def _fingerprint() -> str:
    """Return a hash of the rooms with compiled code: functions contain those that they call."""
    sources = hashlib.sha256()
    package = Path(__file__).parents[2]
    for room in ("contact", "elasticity"):
        for path in sorted((package / room).rglob("*.py")):
            sources.update(path.read_bytes())
    return sources.hexdigest()


_IS_STORED = _can_be_stored()
_FINGERPRINT = _fingerprint() if _IS_STORED else ""
_functions: list[Any] = []


def compiled(function: Any = None, **options: Any) -> Any:
    """Decorate a function that numba compiles, with options of ``numba.njit``.

    Without a place to keep them, functions are compiled by each process.
    """
    if function is None:
        return partial(compiled, **options)
    dispatcher = numba.njit(cache=_IS_STORED, **options)(function)
    if _IS_STORED:  # numba's own stamp is the age and size of the function's own file only
        dispatcher._cache._cache_file._source_stamp = _FINGERPRINT
    _functions.append(dispatcher)
    return dispatcher


def _forget() -> None:
    """Remove what says which of our functions have been compiled and kept."""
    for function in _functions:
        module = function.__module__.rpartition(".")[2]
        for index in Path(function.stats.cache_path).glob(f"{module}.{function.__name__}-*.nbi"):
            index.unlink(missing_ok=True)
