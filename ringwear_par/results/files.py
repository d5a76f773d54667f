"""HDF5 files with dimension scales, which xarray opens with h5netcdf; those of results.

One process writes, to a temporary name beside the target, flushed and synced, then renamed: a file
that is there is whole. HDF5 itself checks what it reads: numbers against their Fletcher checksums,
and whatever says where and how they are stored against those that its format has since version
1.10. Files of other versions of ringwear need not open.
"""

import io
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np

from ringwear_par.arrays import IntArray
from ringwear_par.errors import InputError
from ringwear_par.files.writing import atomic_write
from ringwear_par.history.state import State
from ringwear_par.results.fields import stress_measures
from ringwear_par.results.result import Checkpoint, Result
from ringwear_par.results.variables import (
    COORDINATES,
    EDGE_ELEMENT,
    SOFTWARE,
    VARIABLES,
    WORDS,
    Variable,
    axis,
    edge_elements,
    to_dataset,
)

if TYPE_CHECKING:
    import xarray

#: bytes below which a variable is stored in one piece, which is quicker
_ONE_CHUNK = 1e6
#: type and shape of a text in HDF5
_TEXT, _SCALAR = h5py.string_dtype(), h5py.h5s.create(h5py.h5s.SCALAR)
_STORED_TEXT = h5py.h5t.py_create(_TEXT, logical=True)
#: place of the checkpoint
_STATE = "checkpoint/state"
#: beginning of the names of its measures
_WORST = "worst_"

# -- any file --------------------------------------------------------------------------------------


class UnreadableError(InputError):
    """A file that cannot be read now: it may be whole."""


@contextmanager
def reading(path: Path, software: str, kind: str) -> Iterator[h5py.File]:
    """Yield a file of this software to read; any error meanwhile means that it is not one.

    Parameters
    ----------
    software : attribute of such files.
    kind : "a result file of ringwear", as messages call them.

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
        raise InputError(f"{path}: is not {kind}, or is damaged") from error


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
    _describe(dataset, variable.attributes)
    if variable.dimensions == (variable.name,):
        dataset.make_scale(variable.name)
        return
    for number, name in enumerate(variable.dimensions):
        owner = group if name in group else group.file
        scale = h5py.h5d.open(owner.id, name.encode())
        h5py.h5ds.attach_scale(dataset.id, scale, number)


def _describe(item: h5py.File | h5py.Dataset, attributes: Mapping[str, Any]) -> None:
    """Write attributes as ``item.attrs.update`` does, but texts in a third of its time."""
    for name, value in attributes.items():
        if isinstance(value, str):
            attribute = h5py.h5a.create(item.id, name.encode(), _STORED_TEXT, _SCALAR)
            attribute.write(np.array(value, dtype=_TEXT))
        else:
            item.attrs[name] = value


# -- a result as variables -------------------------------------------------------------------------


def to_xarray(result: Result) -> "xarray.Dataset":
    """Return the dataset that xarray makes of a result's file, see ``Result.to_xarray``."""
    variables = {name: pair for name, pair in variables_of(result).items() if "/" not in name}
    coordinates = [name for name in COORDINATES if name in variables]
    return to_dataset([*variables.values()], result.attributes, coordinates)


def variables_of(result: Result) -> dict[str, tuple[Variable, Any]]:
    """Return every variable of a result with its values, by its place in the file; axes first."""
    data = {**result.data, "r": result.line.r, "width": result.line.width}
    if "pressure" in data:
        data[EDGE_ELEMENT.name] = edge_elements(data["pressure"]).astype(EDGE_ELEMENT.dtype)
    data |= stress_measures(data)
    pairs: dict[str, tuple[Variable, Any]] = {}
    axes: dict[str, tuple[Variable, Any]] = {}
    for name, variable in VARIABLES.items():
        if name not in data:
            continue
        if np.ndim(data[name]) < len(variable.dimensions):
            variable = variable.at_last_step()
        pairs[name] = variable, data[name]
        group = name.rpartition("/")[0]
        for dimension, size in zip(variable.dimensions, np.shape(data[name]), strict=True):
            place = f"{group}/{dimension}" if group else dimension
            if place not in data:
                axes[place] = axis(dimension), [*WORDS.get(dimension, range(size))]
            else:
                axes[place] = VARIABLES[place], data[place]
    return axes | pairs


# -- results ---------------------------------------------------------------------------------------


def open_result(path: str | Path) -> Result:
    """Read a result file.

    Returns
    -------
    Result : as ``simulate`` returned it.

    Raises
    ------
    InputError : it is not one.

    Examples
    --------
    >>> import ringwear_par as rw
    >>> rw.simulate(rw.read_case("scripts/cases/paper.toml", {"title": "mine"})).save("run.h5")
    >>> rw.open_result("run.h5")
    <Result: mine (run.h5): 64 contact elements, 201 states of 200 steps until 200 s, complete>
    """
    path = Path(path)
    with reading(path, SOFTWARE, "a result file of ringwear") as file:
        attributes = {
            name: tuple(value.tolist()) if isinstance(value, np.ndarray) else value
            for name, value in file.attrs.items()
            if name not in ("software", "coordinates")
        }
        places: list[str] = []
        file.visit(places.append)
        items = {place: file[place] for place in places if place in VARIABLES}
        data = {
            place: item.asstr()[()].tolist() if item.dtype.kind == "O" else item[()]
            for place, item in items.items()
        }
        if not {"case", "status"} <= attributes.keys() or not {"time", "line/edges"} <= data.keys():
            raise ValueError("incomplete")
        return Result(data, attributes, read_checkpoint(data.pop(_STATE)), path)


def result_of(source: Result | str | Path) -> Result:
    """Return a result, or the one in a file of this name."""
    return source if isinstance(source, Result) else open_result(source)


def write_result(path: Path, result: Result) -> None:
    """Write a result file, complete or not, by rename. Call on one rank only.

    Raises
    ------
    OSError : the disk or the folder.
    """
    variables = variables_of(result)
    variables[_STATE] = VARIABLES[_STATE], checkpoint_bytes(result.checkpoint)
    with atomic_hdf5(path) as file:
        for name, (variable, values) in variables.items():
            group = name.rpartition("/")[0]
            place = file.require_group(group) if group else file
            write_variable(place, variable, values)
            if group and variable.name == "time":
                place.attrs["coordinates"] = "time"
        coordinates = " ".join(name for name in COORDINATES if name in variables)
        about = {"software": SOFTWARE, "coordinates": coordinates, **result.attributes}
        _describe(file, about)


def checkpoint_bytes(checkpoint: Checkpoint) -> IntArray:
    """Return a checkpoint as the bytes of an .npy file of one record."""
    arrays = {f"{_WORST}{name}": values for name, values in checkpoint.worst.items()}
    arrays |= {name: v for name, v in vars(checkpoint.state).items() if v is not None}
    record = np.zeros((), [(name, values.dtype, values.shape) for name, values in arrays.items()])
    for name, values in arrays.items():
        record[name] = values
    contents = io.BytesIO()
    np.save(contents, record, allow_pickle=False)
    return np.frombuffer(contents.getvalue(), dtype=np.uint8)


def read_checkpoint(contents: IntArray) -> Checkpoint:
    """Return the checkpoint of these bytes; any exception means damage."""
    record = np.load(io.BytesIO(contents.tobytes()), allow_pickle=False)
    arrays = {name: record[name] for name in record.dtype.names}
    state = {name: values for name, values in arrays.items() if not name.startswith(_WORST)}
    worst = {n.removeprefix(_WORST): v for n, v in arrays.items() if n not in state}
    return Checkpoint(State(**state), worst)
