"""Contact pairs stored on disk, so that a shape that is known needs no assembly.

A file for each pair, named by a hash of all that its numbers depend on, to the last bit: the shape,
mesh, Poisson's ratios and grip (``pair_key``), our version and the source of the room
``elasticity``, the libraries, the processor and the number of BLAS threads. What has changed is
thus never read; what has not been used for long makes room. The number of ranks is no part of it:
pairs whose systems one rank solves are the same on any number of ranks, and others, as those that
PETSc has options for, are not kept.

They are in ``RINGWEAR_CACHE`` (empty: nothing is kept), or else among the user's caches. Numbers of
a pair go into results unseen, so that only a folder and files are used that belong to the user and
that nobody else may write to. Whatever is wrong with folder or file, the pair is assembled. What
the user's own programs put there is believed, with a checksum of theirs: no row of a compliance can
be recomputed from it without the solution on the whole boundary, which is most of an assembly.
"""

import errno
import hashlib
import logging
import math
import os
import platform
import stat
from collections.abc import Callable, Hashable
from contextlib import suppress
from dataclasses import fields, is_dataclass
from functools import cache
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import scipy

from ringwear_par.arrays import FloatArray
from ringwear_par.files.writing import atomic_write
from ringwear_par.parallel import blas_threads, on_first_rank
from ringwear_par.version import __version__, numba_version

if TYPE_CHECKING:
    from mpi4py import MPI

log = logging.getLogger(__name__)

#: environment variable that names the folder
VARIABLE = "RINGWEAR_CACHE"
#: bytes of all files together
LIMIT = 256_000_000
#: what a file begins with; its checksum and its numbers follow
_MAGIC = b"ringwear-par contact pair 3\n"
_ENDING = ".pair"
#: part of the limit that a process writes between two looks at the size of the folder
_UNSEEN = 1 / 16
#: permissions that a folder or file of the user's own does not have
_OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH
_ANEW = "what it held is assembled anew"


def folder() -> Path | None:
    """Return the folder of stored pairs, None where none are stored. Not collective."""
    name = os.environ.get(VARIABLE)
    if name is not None:
        return Path(name) if name else None
    caches = os.environ.get("XDG_CACHE_HOME", "")
    try:
        return (Path(caches) if os.path.isabs(caches) else Path.home() / ".cache") / "ringwear-par"
    except RuntimeError:  # nobody's home
        return None


def read(
    key: Hashable, n: int, comm: "MPI.Comm", is_sound: Callable[[FloatArray], bool]
) -> FloatArray | None:
    """Return the numbers of a pair, (2, n + 3, n), None if there are none. Collective on comm.

    Parameters
    ----------
    key : that of the contact pair.
    n : number of contact elements.
    is_sound : whether numbers can be those of the pair.
    """
    return on_first_rank(comm, lambda: _read(key, n, is_sound))


def has(key: Hashable) -> bool:
    """Tell whether there is a file of a pair, whatever it holds. Not collective."""
    where = folder()
    return where is not None and (where / _name(key)).exists()


def write(key: Hashable, stacked: FloatArray, comm: "MPI.Comm") -> None:
    """Keep the numbers of a pair, (2, n + 3, n), if that is possible. On the first rank of comm."""
    where = folder()
    if comm.rank > 0 or where is None:
        return
    content = np.ascontiguousarray(stacked, dtype=np.float64).tobytes()
    if len(content) > LIMIT:
        return
    try:
        with suppress(FileExistsError):  # whatever it is, it is looked at next
            where.mkdir(0o700, parents=True)
        path = where / _name(key)
        _check_folder(where)
        with atomic_write(path, 0o600) as temporary:
            temporary.write_bytes(_MAGIC + _checksum(path.name, content) + content)
        _make_room(where, len(content))
    except OSError as error:
        _warn_of_folder(where, error)


def size(where: Path) -> tuple[int, int]:
    """Return the number and the bytes of the pairs in a folder. Not collective."""
    pairs = _files(where)
    return len(pairs), sum(bytes_ for _, bytes_, _ in pairs)


def _read(key: Hashable, n: int, is_sound: Callable[[FloatArray], bool]) -> FloatArray | None:
    where = folder()
    if where is None:
        return None
    path, shape = where / _name(key), (2, n + 3, n)
    start = len(_MAGIC) + hashlib.sha256().digest_size
    size = start + 8 * math.prod(shape)
    try:
        content = _content(path, size + 1)  # whatever lies there
    except FileNotFoundError:
        return None
    except OSError as error:
        if str(error.filename) == str(where):  # paths of ours, texts of the system
            _warn_of_folder(where, error)
        else:
            _warn(f"{path}: {error.strerror or error}; {_ANEW}")
        return None
    if len(content) == size and content[:start] == _MAGIC + _checksum(path.name, content[start:]):
        stacked = np.frombuffer(content, offset=start).reshape(shape)
        if is_sound(stacked):
            return stacked
    log.warning("%s: damaged; %s", path, _ANEW)
    return None


def _check_folder(where: Path) -> None:
    """Refuse a folder that is not the user's own, or a link to one that somebody else has made."""
    for about in (where.lstat(), where.stat()):
        _check_own(about, where)


def _content(path: Path, most: int) -> bytes:
    """Return the first bytes of a file, which must be the user's own, as its folder must be."""
    _check_folder(path.parent)
    with path.open("rb") as file:
        _check_own(os.fstat(file.fileno()), path)
        with suppress(OSError):
            os.utime(file.fileno())  # it is in use
        return file.read(most)


def _check_own(about: os.stat_result, path: Path) -> None:
    """Refuse what another user owns or may write to."""
    fault = ""
    if about.st_uid != os.geteuid():
        fault = "belongs to another user"
    elif about.st_mode & _OTHERS_WRITE and not stat.S_ISLNK(about.st_mode):
        fault = "other users may write to it"
    if fault:
        raise PermissionError(errno.EPERM, f"{fault}; must be yours alone to write to", path)


def _checksum(name: str, content: bytes) -> bytes:
    """Return a checksum of the numbers and of the pair that they are of."""
    return hashlib.sha256(name.encode() + content).digest()


def _name(key: Hashable) -> str:
    text = "\n".join((_exact_text(key), _surroundings(), str(blas_threads())))
    return hashlib.sha256(text.encode()).hexdigest()[:40] + _ENDING


def _exact_text(value: object) -> str:
    """Return a text that tells all values apart, down to the last bit, but not 1 from 1.0."""
    if is_dataclass(value):
        parts = ", ".join(f"{f.name}={_exact_text(getattr(value, f.name))}" for f in fields(value))
        return f"{type(value).__name__}({parts})"
    if isinstance(value, tuple):
        return f"({', '.join(map(_exact_text, value))})"
    return float(value).hex() if isinstance(value, Real) else repr(value)


@cache
def _surroundings() -> str:
    """Return version, source, libraries and processor, on which the last bits of a pair depend."""
    source = hashlib.sha256()
    for path in sorted(Path(__file__).parent.rglob("*.py")):
        source.update(path.read_bytes())
    processor = ""
    with suppress(OSError), open("/proc/cpuinfo", "rb") as file:
        lines = file.read(8192).decode(errors="replace").splitlines()
        processor = "\n".join(x for x in lines if x.startswith(("model name", "flags", "Features")))
    return "\n".join(
        (__version__, source.hexdigest(), np.__version__, scipy.__version__, numba_version(),
         platform.machine(), processor)
    )  # fmt: skip


#: bytes written since the last look; none was yet
_unseen = math.inf


def _make_room(where: Path, written: int) -> None:
    """Remove what was used longest ago, until the rest is below the limit."""
    global _unseen
    _unseen += written
    if _unseen <= _UNSEEN * LIMIT:
        return
    _unseen = 0.0
    pairs = sorted(_files(where))
    total = sum(bytes_ for _, bytes_, _ in pairs)
    for _, bytes_, path in pairs:
        if total <= LIMIT:
            return
        with suppress(OSError):  # it may be somebody else's
            path.unlink(missing_ok=True)
            total -= bytes_


def _files(where: Path) -> list[tuple[float, int, Path]]:
    """Return when they were used last, bytes and paths of the pairs in a folder."""
    pairs = []
    for path in where.glob(f"*{_ENDING}"):
        with suppress(OSError):  # others may remove them
            about = path.stat()
            pairs.append((about.st_mtime, about.st_size, path))
    return pairs


def _warn_of_folder(where: Path, error: OSError) -> None:
    _warn(f"assembled pairs are not kept, going on: {where}: {error.strerror or error}")


@cache
def _warn(sentence: str) -> None:
    """Say a sentence once."""
    log.warning("%s", sentence)
