"""Result files: HDF5 with dimension scales, which xarray opens with h5netcdf.

One process writes, to a temporary name beside the target, flushed and synced, then renamed: a file
that is there is whole. Files of other versions need not open.
"""

import io
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

import h5py
import numpy as np

from ringwear_par.arrays import IntArray
from ringwear_par.elasticity.stress.fields import COMPONENTS, SIDES
from ringwear_par.errors import ComputationError, InputError
from ringwear_par.files.writing import check_writable
from ringwear_par.history.state import Start
from ringwear_par.results import hdf5
from ringwear_par.results.fields import stress_measures
from ringwear_par.results.laboratory_numbers import LABORATORY_NUMBERS, laboratory_numbers
from ringwear_par.results.result import Checkpoint, Result
from ringwear_par.results.variables import (
    COORDINATES,
    EDGE_ELEMENT,
    LAYER,
    SOFTWARE,
    STATE_NUMBER,
    UPPER_LAYER,
    VARIABLES,
    Variable,
    edge_elements,
    to_dataset,
)

if TYPE_CHECKING:
    import xarray

_KIND = "a result file of ringwear"
#: coordinates that are texts
_TEXTS = {"component": list(COMPONENTS), "side": list(SIDES)}
#: place of the checkpoint
_STATE = "checkpoint/state"
#: what is computed from the data of a result when these are written
_DERIVED = {
    "r", "width", EDGE_ELEMENT.name, "principal", "interface_mises_lower", "interface_mises_upper",
    *(f"{name}{place}" for name in ("mises", "max_shear") for place in ("", "_grid")),
    *(f"max_mises{end}" for end in ("", "_r", "_z", "_layer")),
}  # fmt: skip


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
    pairs = {name: (_variable(name, data), values) for name, values in data.items()}
    numbers = laboratory_numbers(result)
    pairs |= {name: (LABORATORY_NUMBERS[name], v) for name, v in numbers.items()}
    axes: dict[str, tuple[Variable, Any]] = {}
    for name, (variable, values) in pairs.items():
        group = name[: name.rfind("/") + 1]
        for dimension, size in zip(variable.dimensions, np.shape(values), strict=True):
            place = f"{group}{dimension}"
            numbered = _TEXTS.get(dimension, np.arange(size))
            axes[place] = pairs.get(place, (VARIABLES[place], numbered))
    return axes | pairs


def _variable(name: str, data: Mapping[str, Any]) -> Variable:
    """Return a variable as a result has it.

    Fields along the contact line may be those of the last step alone. Layers of upper have an axis
    of their own where lower has other numbers of them.
    """
    variable = VARIABLES[name]
    if name == "step" and "steps_made" in data:
        return STATE_NUMBER
    if np.ndim(data[name]) < len(variable.dimensions):
        return variable.at_last_step()
    if UPPER_LAYER.name in variable.dimensions and np.ndim(data[name]) > 1:
        lower = data.get("worn_volume_lower_layers")
        if lower is None or lower.shape[1] == data[name].shape[1]:
            return replace(variable, dimensions=(*variable.dimensions[:-1], LAYER.name))
    return variable


# -- reading ---------------------------------------------------------------------------------------


def open_result(path: str | Path) -> Result:
    """Read a result file. Not collective.

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
    with hdf5.reading(path, SOFTWARE, _KIND) as file:
        attributes = {
            name: tuple(value.tolist()) if isinstance(value, np.ndarray) else value
            for name, value in file.attrs.items()
            if name not in ("software", "coordinates")
        }
        data = dict(_arrays(file))
        if not {"case", "status"} <= attributes.keys() or not {"time", "line/edges"} <= data.keys():
            raise ValueError("incomplete")
        checkpoint = read_checkpoint(data.pop(_STATE)) if _STATE in data else None
        return Result(data, attributes, checkpoint, path)


def result_of(source: Result | str | Path) -> Result:
    """Return a result, or the one in a file of this name."""
    return source if isinstance(source, Result) else open_result(source)


def _arrays(group: h5py.Group) -> Iterator[tuple[str, Any]]:
    """Yield the data in a group by place."""
    for name, item in group.items():
        place = f"{group.name}/{name}".lstrip("/")
        if isinstance(item, h5py.Group):
            yield from _arrays(item)
            continue
        variable = VARIABLES.get(place)
        if variable is None or place in _DERIVED or place in _TEXTS:
            continue
        if variable.dimensions == (name,) and variable.integer and place not in ("step", _STATE):
            continue  # numbers an axis
        yield place, item.asstr()[()].tolist() if item.dtype.kind == "O" else item[()]


# -- writing ---------------------------------------------------------------------------------------


def save(result: Result, path: str | Path) -> None:
    """Write a result to a file. Not collective.

    The process that calls this writes. Where several have the same result and write the same
    file, it is whole at any time, and in the end that of one of them.

    Raises
    ------
    InputError : a file that cannot be written.
    ComputationError : the disk.
    """
    path = Path(path)
    check_writable(path)
    try:
        write_result(path, result)
    except OSError as error:
        raise ComputationError(f"{path}: {error.strerror or error}") from error


def write_result(path: Path, result: Result) -> None:
    """Write a result file, complete or not, by rename. Call on one rank only.

    Raises
    ------
    OSError : the disk or the folder.
    """
    variables = variables_of(result)
    if result.checkpoint is not None:
        variables[_STATE] = VARIABLES[_STATE], checkpoint_bytes(result.checkpoint)
    with hdf5.atomic_hdf5(path) as file:
        for name, (variable, values) in variables.items():
            group, _, short = name.rpartition("/")
            place = file.require_group(group) if group else file
            hdf5.write_variable(place, variable.named(short), values)
            if short == "time" and group:
                place.attrs["coordinates"] = short
        coordinates = " ".join(name for name in COORDINATES if name in variables)
        file.attrs.update(software=SOFTWARE, coordinates=coordinates, **result.attributes)


# -- where a history continues ---------------------------------------------------------------------

#: beginning of the names of the worst of a history among the arrays
_WORST = "worst."


def checkpoint_bytes(checkpoint: Checkpoint) -> IntArray:
    """Return a checkpoint as the bytes of an .npz file: arrays of one history."""
    parts = _parts(checkpoint.start)
    parts |= {f"{_WORST}{name}": values for name, values in checkpoint.worst.items()}
    contents = io.BytesIO()
    np.savez(contents, pending_iterations=checkpoint.pending_iterations, **parts)
    return np.frombuffer(contents.getvalue(), dtype=np.uint8)


def read_checkpoint(contents: IntArray) -> Checkpoint:
    """Return the checkpoint of these bytes; any exception means damage."""
    with np.load(io.BytesIO(contents.tobytes()), allow_pickle=False) as file:
        parts = {name: file[name] for name in file.files}
    worst = {
        name.removeprefix(_WORST): tuple(values.tolist())
        for name, values in parts.items()
        if name.startswith(_WORST)
    }
    return Checkpoint(_whole(Start, parts), 0, int(parts["pending_iterations"]), worst)


def _parts(whole: Any, prefix: str = "") -> dict[str, Any]:
    """Return the arrays and numbers in nested dataclasses by place, but for those that are None."""
    parts: dict[str, Any] = {}
    for field in fields(whole):
        value, place = getattr(whole, field.name), f"{prefix}{field.name}"
        if is_dataclass(value):
            parts |= _parts(value, f"{place}.")
        elif value is not None:
            parts[place] = value
    return parts


def _whole(kind: Any, parts: Mapping[str, Any], prefix: str = "") -> Any:
    """Return a dataclass of its parts, see ``_parts``."""
    values: dict[str, Any] = {}
    for field in fields(kind):
        place = f"{prefix}{field.name}"
        inner = next((k for k in (field.type, *get_args(field.type)) if is_dataclass(k)), None)
        if inner is None:
            values[field.name] = parts.get(place)
        elif any(name.startswith(f"{place}.") for name in parts):
            values[field.name] = _whole(inner, parts, f"{place}.")
    return kind(**values)


def restored(result: Result) -> Start:
    """Return where a stored history continues.

    Raises
    ------
    InputError : it was stored without.
    """
    if result.checkpoint is None:
        raise InputError(f"{result.name}: holds no state to go on from; must be one of a run")
    return result.checkpoint.start
