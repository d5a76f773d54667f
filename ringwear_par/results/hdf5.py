"""HDF5 files that appear whole, with the dimension scales that xarray and netCDF4 read."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py

from ringwear_par.atomic import atomic_write
from ringwear_par.results.reading import seal
from ringwear_par.results.variables import Variable


@contextmanager
def atomic_hdf5(path: Path) -> Iterator[h5py.File]:
    """Give a file to fill, which is there once it is whole. Call on one rank only.

    Raises
    ------
    OSError : the disk or the folder.
    """
    try:
        with atomic_write(path) as temporary:
            with h5py.File(temporary, "w") as file:
                yield file
            seal(temporary)
    except RuntimeError as error:  # what h5py makes of some failures of the disk
        raise OSError(None, str(error), str(path)) from error


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
