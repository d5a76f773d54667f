"""Result files: HDF5 with dimension scales, which xarray opens with h5netcdf.

One process writes, to a temporary name beside the target, flushed and synced, then renamed: a file
that is there is whole. Files of other versions need not open.
"""

import io
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np

from ringwear_par.arrays import IntArray
from ringwear_par.history.state import State
from ringwear_par.results import hdf5
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

#: place of the checkpoint
_STATE = "checkpoint/state"
#: beginning of the names of its measures
_WORST = "worst_"


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
    pairs = {n: (_variable(n, data[n]), data[n]) for n in VARIABLES if n in data}
    axes: dict[str, tuple[Variable, Any]] = {}
    for name, (variable, values) in pairs.items():
        group = name[: name.rfind("/") + 1]
        for dimension, size in zip(variable.dimensions, np.shape(values), strict=True):
            if (place := f"{group}{dimension}") not in axes:
                entries = [*WORDS.get(dimension, range(size))]
                axes[place] = pairs.get(place, (axis(dimension), entries))
    return axes | pairs


def _variable(name: str, values: Any) -> Variable:
    """Return a variable; fields along the contact line may be those of the last step alone."""
    variable = VARIABLES[name]
    last = np.ndim(values) < len(variable.dimensions)
    return variable.at_last_step() if last else variable


# -- reading ---------------------------------------------------------------------------------------


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
    with hdf5.reading(path, SOFTWARE, "a result file of ringwear") as file:
        attributes = {
            name: tuple(value.tolist()) if isinstance(value, np.ndarray) else value
            for name, value in file.attrs.items()
            if name not in ("software", "coordinates")
        }
        data = dict(_arrays(file))
        if not {"case", "status"} <= attributes.keys() or not {"time", "line/edges"} <= data.keys():
            raise ValueError("incomplete")
        return Result(data, attributes, read_checkpoint(data.pop(_STATE)), path)


def result_of(source: Result | str | Path) -> Result:
    """Return a result, or the one in a file of this name."""
    return source if isinstance(source, Result) else open_result(source)


def _arrays(group: h5py.Group, before: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the variables in a group by place, without axes that are only numbered."""
    for name, item in group.items():
        place = f"{before}{name}"
        if isinstance(item, h5py.Group):
            yield from _arrays(item, f"{place}/")
        elif place in VARIABLES:
            yield place, item.asstr()[()].tolist() if item.dtype.kind == "O" else item[()]


# -- writing ---------------------------------------------------------------------------------------


def write_result(path: Path, result: Result) -> None:
    """Write a result file, complete or not, by rename. Call on one rank only.

    Raises
    ------
    OSError : the disk or the folder.
    """
    variables = variables_of(result)
    variables[_STATE] = VARIABLES[_STATE], checkpoint_bytes(result.checkpoint)
    with hdf5.atomic_hdf5(path) as file:
        for name, (variable, values) in variables.items():
            group = name.rpartition("/")[0]
            place = file.require_group(group) if group else file
            hdf5.write_variable(place, variable, values)
            if group and variable.name == "time":
                place.attrs["coordinates"] = "time"
        coordinates = " ".join(name for name in COORDINATES if name in variables)
        file.attrs.update(software=SOFTWARE, coordinates=coordinates, **result.attributes)


# -- where a history continues ---------------------------------------------------------------------


def checkpoint_bytes(checkpoint: Checkpoint) -> IntArray:
    """Return a checkpoint as the bytes of an .npz file."""
    arrays = {f"{_WORST}{name}": values for name, values in checkpoint.worst.items()}
    arrays |= {name: v for name, v in vars(checkpoint.state).items() if v is not None}
    contents = io.BytesIO()
    np.savez(contents, **arrays)
    return np.frombuffer(contents.getvalue(), dtype=np.uint8)


def read_checkpoint(contents: IntArray) -> Checkpoint:
    """Return the checkpoint of these bytes; any exception means damage."""
    with np.load(io.BytesIO(contents.tobytes()), allow_pickle=False) as arrays:
        state = {n: values for n, values in arrays.items() if not n.startswith(_WORST)}
        worst = {n.removeprefix(_WORST): arrays[n] for n in arrays.files if n not in state}
    return Checkpoint(State(**state), worst)
