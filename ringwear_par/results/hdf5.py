"""HDF5 files: they appear whole, with dimension scales; what is wrong with one is a sentence.

HDF5 itself checks what it reads: numbers against their Fletcher checksums, and whatever says where
and how they are stored against those that its format has since version 1.10.
"""

import io
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from ringwear_par.errors import InputError
from ringwear_par.files.writing import atomic_write
from ringwear_par.results.variables import Variable

#: bytes below which a variable is stored in one piece, which is quicker
_ONE_CHUNK = 1e6


class UnreadableError(InputError):
    """A file that cannot be read now: it may be whole."""


@contextmanager
def reading(path: Path, software: str, kind: str, must: str = "") -> Iterator[h5py.File]:
    """Yield a file of this software to read; any error meanwhile means that it is not one.

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
        with h5py.File(path, "r") as file:
            if file.attrs.get("software") != software:
                raise ValueError("software")
            yield file
    except (InputError, MemoryError):
        raise
    except Exception as error:  # h5py has no errors of its own: any may come
        if isinstance(error, OSError) and error.errno:  # somebody writes to it, a disk is away
            raise UnreadableError(f"{path}: cannot be read: {os.strerror(error.errno)}") from error
        raise InputError(f"{path}: is not {kind}, or is damaged{must}") from error


@contextmanager
def atomic_hdf5(path: Path) -> Iterator[h5py.File]:
    """Yield a file to fill, which gets its name once it is complete. Call on one rank only.

    It is filled in memory: HDF5 may end the process where a disk is full.

    Raises
    ------
    OSError : the disk or the folder.
    """
    contents = io.BytesIO()
    with h5py.File(contents, "w", libver=("v110", "v110")) as file:
        yield file
    with atomic_write(path) as temporary:
        temporary.write_bytes(contents.getbuffer())


def write_variable(group: h5py.Group, variable: Variable, values: Any) -> None:
    """Write a variable over dimensions that the group, or the whole file, has already.

    One that is named as its only dimension becomes that dimension.
    """
    array = np.asarray(values)
    checked = array.dtype.kind in "iuf" and array.size > 0 < array.ndim
    chunks = array.shape if checked and array.nbytes < _ONE_CHUNK else None
    dataset = group.create_dataset(variable.name, data=values, fletcher32=checked, chunks=chunks)
    dataset.attrs.update(variable.attributes)
    if variable.dimensions == (variable.name,):
        dataset.make_scale(variable.name)
        return
    for axis, name in enumerate(variable.dimensions):
        owner = group if name in group else group.file
        h5py.h5ds.attach_scale(dataset.id, owner[name].id, axis)
