"""HDF5 files: they appear whole, with dimension scales; what is wrong with one is a sentence.

Behind its HDF5 contents a file has a seal, their checksum, which HDF5 passes over. It is looked at
first: of damaged contents the HDF5 library may crash, or never end. A file that another program has
changed has none, and is read with care only.
"""

import io
import logging
import math
import os
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Any, BinaryIO

import h5py
import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.errors import InputError
from ringwear_par.files.writing import atomic_write
from ringwear_par.results.variables import Variable

log = logging.getLogger(__name__)

_SEAL, _DIGITS = b"\nringwear-par crc32 ", 8
_SEAL_BYTES = len(_SEAL) + _DIGITS + 1
_BLOCK_BYTES = 2**22

#: most bytes that HDF5's filters make of one
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
def reading(path: Path, software: str, kind: str, must: str = "") -> Iterator[h5py.File]:
    """Yield a file of this software to read; any error meanwhile means that it is not one.

    Not collective.

    Parameters
    ----------
    software : attribute of such files.
    kind : "a result file of ringwear", as messages call them.
    must : how these end.

    Raises
    ------
    InputError : in one sentence; UnreadableError where it is not the file's fault.
    """
    try:
        if not path.is_file():
            fault = "is not a file" if path.exists() else "does not exist"
            raise InputError(f"{path}: {fault}; must be {kind}")
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
        raise InputError(f"{path}: is not {kind}, or is damaged{must}") from error


@lru_cache(maxsize=256)
def _is_whole(path: Path, inode: int, size: int, changed: int) -> bool:
    """Tell whether a file has no seal, or its own; once as long as it is the same."""
    with path.open("rb") as file:
        if size < _SEAL_BYTES:
            return True
        file.seek(size - _SEAL_BYTES)
        ending = file.read()
        if not ending.startswith(_SEAL):
            try:
                h5py.File(path, "r").close()
            except OSError:
                return True  # the reader reports it
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


def check_times(times: FloatArray) -> None:
    """Refuse times that no history has, or that there are none.

    Raises
    ------
    ValueError : they do not increase, or are not finite.
    """
    if not (len(times) and np.isfinite(times).all() and (np.diff(times) >= 0.0).all()):
        raise ValueError("time")


# -- writing -------------------------------------------------------------------------------------


class _Disk(io.FileIO):
    """The disk under an HDF5 file, which is emptied; HDF5 never hears that it is full.

    HDF5 writes again while it takes its objects down, and a second failure ends the process. So
    the first one is kept for ``check``, and what is written from then on stays in memory.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path, "w+")
        self._failure: tuple[int | None, str] | None = None  # an error would hold frames
        self._unwritten: list[tuple[int, bytes]] = []

    def check(self) -> None:
        """Raise what the disk has failed with, if it has."""
        if self._failure is not None:
            raise OSError(*self._failure)

    def readinto(self, buffer: Any) -> int:
        """Read from the place; what was never written is 0."""
        wanted, place = memoryview(buffer), self.tell()
        size = super().readinto(wanted)
        wanted[size:] = bytes(len(wanted) - size)
        for start, data in self._unwritten:
            low, high = max(start, place), min(start + len(data), place + len(wanted))
            if low < high:
                wanted[low - place : high - place] = data[low - start : high - start]
        return len(wanted)

    def write(self, data: Any) -> int:
        """Write to the place: to the disk, to memory once that has failed."""
        left, place = memoryview(data), self.tell()
        try:
            while len(left) and self._failure is None:
                left = left[super().write(left) :]
        except OSError as error:
            self._failure = error.errno, error.strerror or str(error)
        if len(left):
            self._unwritten.append((place + len(data) - len(left), bytes(left)))
        return len(data)

    def truncate(self, size: int | None = None) -> int:
        """Give the file a size."""
        size = self.tell() if size is None else size
        try:
            if self._failure is None:
                super().truncate(size)
        except OSError as error:
            self._failure = error.errno, error.strerror or str(error)
        return size


@contextmanager
def atomic_hdf5(path: Path, sealed: bool = True) -> Iterator[tuple[h5py.File, Callable[[], None]]]:
    """Yield a file to fill, which gets its name once it is complete. Call on one rank only.

    With it comes what raises the error of a disk that has failed since: it need not be called, but
    saves the memory and the time of what is written for nothing.

    Parameters
    ----------
    sealed : whether its checksum is added, which other programs pass over.

    Raises
    ------
    OSError : the disk or the folder.
    """
    with atomic_write(path) as temporary:
        with closing(_Disk(temporary)) as disk:
            try:
                with h5py.File(disk, "w") as file:
                    yield file, disk.check
            finally:
                disk.check()
        if sealed:
            seal(temporary)


def write_variable(group: h5py.Group, variable: Variable, values: Any) -> None:
    """Write a variable over dimensions that the group, or one that it is in, has already.

    One that is named as its only dimension becomes that dimension.
    """
    dataset = group.create_dataset(variable.name, data=values)
    dataset.attrs.update(variable.attributes)
    if variable.dimensions == (variable.name,):
        dataset.make_scale(variable.name)
        return
    for axis, name in enumerate(variable.dimensions):
        dataset.dims[axis].attach_scale(_scale(group, name))


def _scale(group: h5py.Group, name: str) -> h5py.Dataset:
    """Return the dimension of this name in a group or the nearest one that it is in."""
    while name not in group and group.name != "/":
        group = group.parent
    return group[name]
