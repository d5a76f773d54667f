"""HDF5 files that appear whole, with the dimension scales that xarray and netCDF4 read."""

import io
import os
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import h5py

from ringwear_par.atomic import atomic_write
from ringwear_par.results.hdf5_reading import seal
from ringwear_par.results.variables import Variable


class _Disk(io.RawIOBase):
    """The disk under an HDF5 file; HDF5 never hears that it is full.

    HDF5 writes again while it takes its objects down, and a second failure ends the process. So
    the first one is kept for ``check``, and what is written from then on stays in memory.

    Parameters
    ----------
    path : of a file, which is emptied.

    Raises
    ------
    OSError : it cannot be made.
    """

    def __init__(self, path: Path) -> None:
        self._handle = os.open(path, os.O_RDWR | os.O_TRUNC)
        self._place = 0
        self._failure: tuple[int | None, str] | None = None  # an error would hold frames
        self._kept: list[tuple[int, bytes]] = []

    def check(self) -> None:
        """Raise what the disk has failed with, if it has."""
        if self._failure is not None:
            raise OSError(*self._failure)

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Go to a place, counted from the beginning or from the end."""
        start = os.fstat(self._handle).st_size if whence == os.SEEK_END else 0
        self._place = start + offset
        return self._place

    def tell(self) -> int:
        """Return the place."""
        return self._place

    def readinto(self, buffer: Any) -> int:
        """Read from the place; what was never written is 0."""
        wanted, size = memoryview(buffer), 0
        while size < len(wanted):
            there = os.preadv(self._handle, [wanted[size:]], self._place + size)
            if not there:
                break
            size += there
        wanted[size:] = bytes(len(wanted) - size)
        for start, data in self._kept:
            low, high = max(start, self._place), min(start + len(data), self._place + len(wanted))
            if low < high:
                wanted[low - self._place : high - self._place] = data[low - start : high - start]
        return len(wanted)

    def write(self, data: Any) -> int:
        """Write to the place: to the disk, to memory once that has failed."""
        left = memoryview(data)
        try:
            while len(left) and self._failure is None:
                written = os.pwrite(self._handle, left, self._place + len(data) - len(left))
                left = left[written:]
        except OSError as error:
            self._failure = error.errno, error.strerror or str(error)
        if len(left):
            self._kept.append((self._place + len(data) - len(left), bytes(left)))
        return len(data)

    def truncate(self, size: int | None = None) -> int:
        """Give the file a size."""
        size = self._place if size is None else size
        try:
            if self._failure is None:
                os.ftruncate(self._handle, size)
        except OSError as error:
            self._failure = error.errno, error.strerror or str(error)
        return size

    def close(self) -> None:
        """Close the file; some disks tell only now that they are full.

        Raises
        ------
        OSError : they do.
        """
        if not self.closed:
            super().close()
            self._kept.clear()
            os.close(self._handle)


@contextmanager
def atomic_hdf5(path: Path, sealed: bool = True) -> Iterator[tuple[h5py.File, Callable[[], None]]]:
    """Give a file to fill, which is there once it is whole. Call on one rank only.

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
