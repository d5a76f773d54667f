"""HDF5 files read: whatever is wrong with one is told in a sentence.

Behind its HDF5 contents a file has a seal, their checksum, which HDF5 passes over. It is looked at
first: of damaged contents the HDF5 library may crash, or never end. A file that another program has
changed has none, and is read with care only.
"""

import logging
import math
import os
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Any, BinaryIO

import h5py
import numpy as np

from ringwear_par.errors import InputError
from ringwear_par.files import open_ordinary
from ringwear_par.results.variables import Variable

log = logging.getLogger(__name__)

_SEAL, _DIGITS = b"\nringwear-par crc32 ", 8
_SEAL_BYTES = len(_SEAL) + _DIGITS + 1
_BLOCK_BYTES = 2**22

#: most that HDF5's filters make of a byte
_DEFLATED = 1032


def seal(path: Path) -> None:
    """Add its seal to a file that is complete. Not collective.

    Raises
    ------
    OSError : the disk.
    """
    with path.open("rb+") as file:
        size = path.stat().st_size
        checksum = _checksum(file, size)
        file.seek(size)
        file.write(b"%s%0*x\n" % (_SEAL, _DIGITS, checksum))


class UnreadableError(InputError):
    """A file that cannot be read now: it may be whole."""


@contextmanager
def reading(path: Path, software: str, what: str, must: str = "") -> Iterator[h5py.File]:
    """Give a file of ours to read; anything that goes wrong meanwhile means that it is none.

    Not collective.

    Parameters
    ----------
    software : attribute of such files.
    what : "a result file of ringwear", as messages call them.
    must : how these end.

    Raises
    ------
    InputError : in one sentence; UnreadableError where it is not the file's fault.
    """
    try:
        if not path.is_file():
            fault = "is not a file" if path.exists() else "does not exist"
            raise InputError(f"{path}: {fault}; must be {what}")
        about = path.stat()
        if not _is_whole(path, about.st_ino, about.st_size, about.st_mtime_ns):
            raise InputError(f"{path}: is damaged: its checksum is not that of its contents{must}")
        with h5py.File(path, "r") as file:
            if file.attrs.get("software") != software:
                raise ValueError("software")
            yield file
    except InputError:
        raise
    except Exception as error:  # h5py has no errors of its own: any may come
        if isinstance(error, OSError) and error.errno:  # somebody writes to it, a disk is away
            raise UnreadableError(f"{path}: cannot be read: {os.strerror(error.errno)}") from error
        raise InputError(f"{path}: is not {what}, or is damaged{must}") from error


@lru_cache(maxsize=256)
def _is_whole(path: Path, inode: int, size: int, changed: int) -> bool:
    """Tell whether a file has no seal, or its own; once as long as it is the same."""
    with open_ordinary(path) as file:
        if size < _SEAL_BYTES:
            return True
        file.seek(size - _SEAL_BYTES)
        ending = file.read()
        if not ending.startswith(_SEAL):
            log.warning("%s: carries no checksum (another program wrote it): not verified", path)
            return True
        return ending[len(_SEAL) :] == b"%0*x\n" % (_DIGITS, _checksum(file, size - _SEAL_BYTES))


def _checksum(file: BinaryIO, size: int) -> int:
    """Return the CRC-32 of the first bytes of a file."""
    file.seek(0)
    checksum = 0
    while size > 0:
        block = file.read(min(size, _BLOCK_BYTES))
        if not block:
            return -1
        checksum = zlib.crc32(block, checksum)
        size -= len(block)
    return checksum


def read_array(group: h5py.Group, variable: Variable, sizes: dict[str, int]) -> Any:
    """Return the values of a variable, see ``find_array``."""
    return find_array(group, variable, sizes)[()].astype(variable.dtype, copy=False)


def find_array(group: h5py.Group, variable: Variable, sizes: dict[str, int]) -> h5py.Dataset:
    """Return a variable; its shape and type must be those that it is written with.

    Parameters
    ----------
    sizes : of the dimensions that are known; others are added.

    Raises
    ------
    ValueError : they are not.
    """
    dataset = _find(group, variable.name, variable.dimensions, sizes)
    if dataset.dtype.kind not in ("iu" if variable.integer else "f"):
        raise ValueError(variable.name)
    return dataset


def find_texts(group: h5py.Group, name: str, sizes: dict[str, int], dimension: str = "case") -> Any:
    """Return a variable of texts, one a case, as ``find_array`` does."""
    return _find(group, name, (dimension,), sizes).asstr()


def find_words(
    group: h5py.Group, name: str, sizes: dict[str, int], dimensions: Sequence[str] = ("case",)
) -> h5py.Dataset:
    """Return a variable of texts as ``find_array`` does."""
    dataset = _find(group, name, dimensions, sizes)
    if h5py.check_string_dtype(dataset.dtype) is None:
        raise ValueError(name)
    return dataset


def read_words(group: h5py.Group, name: str, sizes: dict[str, int]) -> Any:
    """Return a variable of texts, one a case, as bytes in one array."""
    words = find_words(group, name, sizes)[:]
    return words if words.dtype.kind == "S" else np.array(words.tolist() or [b""])[: len(words)]


def _find(
    group: h5py.Group, name: str, dimensions: Sequence[str], sizes: dict[str, int]
) -> h5py.Dataset:
    dataset = group[name]
    shape = tuple(map(int, dataset.shape))
    for dimension, size in zip(dimensions, shape, strict=True):
        if sizes.setdefault(dimension, size) != size:
            raise ValueError(dimension)
    # no memory for what cannot be in the file
    if math.prod(shape) * dataset.dtype.itemsize > _DEFLATED * group.file.id.get_filesize():
        raise ValueError(name)
    return dataset


def read_text(value: Any) -> str:
    """Return an attribute that must be a text.

    Raises
    ------
    ValueError : it is none, or none that can be written anywhere.
    """
    if not isinstance(value, str):
        raise ValueError(type(value))
    value.encode()
    return value


def read_number(value: Any) -> Any:
    """Return an attribute that must be a real number.

    Raises
    ------
    ValueError : it is none.
    """
    if getattr(value, "shape", None) != () or value.dtype.kind not in "iuf":
        raise ValueError(type(value))
    return value


def read_numbers(value: Any) -> tuple[float, ...]:
    """Return an attribute that must be a list of real numbers.

    Raises
    ------
    ValueError : it is none.
    """
    if len(getattr(value, "shape", ())) != 1 or value.dtype.kind not in "iuf":
        raise ValueError(type(value))
    return tuple(value.tolist())
