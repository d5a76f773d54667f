"""Result files: HDF5 with dimension scales, which xarray opens with h5netcdf.

One process writes, to a temporary name beside the target, flushed and synced, then renamed: a file
that is there is whole.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from ringwear_par.elasticity.geometry.mesh import ContactLine
from ringwear_par.elasticity.stress.fields import (
    COMPONENTS,
    SIDES,
    Interfaces,
    Largest,
    StressHistory,
    StressState,
)
from ringwear_par.errors import ComputationError
from ringwear_par.files.writing import check_writable
from ringwear_par.results import variables as table
from ringwear_par.results.result import Checkpoint, Result
from ringwear_par.results.storage.boundaries import read_boundaries, write_boundaries
from ringwear_par.results.storage.checkpoints import read_checkpoint, write_checkpoint
from ringwear_par.results.storage.hdf5 import (
    atomic_hdf5,
    check_times,
    find_texts,
    read_array,
    read_number,
    read_numbers,
    read_text,
    reading,
    write_variable,
)
from ringwear_par.results.variables import Variable

_KIND = "a result file of ringwear"
#: texts and numbers that every file has, and those that it may have
_TEXTS = {
    "case", "title", "status", "error", "version", "begun_by", "scheme", "user_laws", "law_lower",
    "law_upper", "doubts",
}  # fmt: skip
_NUMBERS = {
    "ranks", "time_step", "time_steps", "time_end", "symmetry_defect", "energy_identity",
    "step_error_time", "closing_contact", "friction", "omega", "angle", "nominal_area",
    "mean_radius",
    "balance_force", "balance_torque", "balance_reaction", "balance_volume", "balance_energy",
    "balance_residual",
}  # fmt: skip
_OPTIONAL_TEXTS = {"face_lower", "face_upper", "layers_lower", "layers_upper"}
_OPTIONAL_NUMBERS = {"density_lower", "density_upper", "time_through_lower", "time_through_upper"}
_OPTIONAL_PREFIXES = ("balance_", "seconds_")
_LISTS = {"friction_times", "friction_values"}
#: densities of the layers of lower and upper
_OF_LAYERS = dict(
    zip(("density_lower_layers", "density_upper_layers"), table.LAYER_VOLUMES, strict=True)
)


def read_status(path: Path) -> tuple[str, int] | None:
    """Return status and last step of a result file, None if there is none. Not collective.

    Raises
    ------
    InputError : something else is there.
    """
    if not path.exists():
        return None
    with reading(
        path,
        table.SOFTWARE,
        _KIND,
        "; must be one (--restart), another name, or be replaced by --overwrite",
    ) as file:
        status = read_text(file.attrs["status"])
        if "checkpoint" in file:
            return status, int(file["checkpoint"].attrs["step"])
        return status, int(_steps_made(file, {})[-1])


def read_error(path: Path) -> str:
    """Return why the run in a result file failed, "" if it did not. Not collective.

    Raises
    ------
    InputError : it is no result file.
    """
    with reading(path, table.SOFTWARE, _KIND) as file:
        return read_text(file.attrs["error"])


def open_result(path: str | Path) -> Result:
    """Read a result file. Not collective.

    Raises
    ------
    InputError : it is not one.
    """
    path = Path(path)
    with reading(path, table.SOFTWARE, _KIND) as file:
        return _read(file, path)


def result_of(source: Result | str | Path) -> Result:
    """Return a result, or the one in a file of this name."""
    return source if isinstance(source, Result) else open_result(source)


def _read(file: h5py.File, path: Path) -> Result:
    """Return the result in a file; any exception means that it is damaged."""
    attributes = _attributes(file)
    edges = read_array(file["line"], table.EDGES, {})
    if not (len(edges) > 1 and np.isfinite(edges).all() and (np.diff(edges) > 0.0).all()):
        raise ValueError("edges")
    sizes = {"element": len(edges) - 1}
    checkpoint: Checkpoint | None = None
    if "checkpoint" in file:
        checkpoint = read_checkpoint(file["checkpoint"], sizes)
    step = read_array(file, table.STEP, sizes)
    histories = {name: read_array(file, v, sizes) for name, v in table.HISTORIES.items()}
    check_times(histories["time"])
    layers = {
        **_read_stored(file, table.LAYER_HISTORIES, sizes),
        # volumes may have a dimension of their own
        **_read_stored(file, table.LAYER_VOLUMES, {"step": sizes["step"]}),
        **_read_stored(file, table.LAYER_PROFILES, sizes),
    }
    for name in _OF_LAYERS.keys() & attributes.keys():
        if len(attributes[name]) != layers[_OF_LAYERS[name]].shape[1] - 1:
            raise ValueError(name)
    return Result(
        ContactLine(edges),
        step,
        _steps_made(file, sizes),
        histories,
        _read_stored(file, table.PROFILES, sizes),
        read_boundaries(file),
        attributes,
        checkpoint,
        path,
        _read_parameters(file, sizes),
        _read_stored(file, table.DERIVATIVES, sizes),
        layers=layers,
        stress=_read_stress(file, sizes),
    )


def _read_stored(
    file: h5py.File, variables: Mapping[str, Variable], sizes: dict[str, int]
) -> dict[str, Any]:
    """Return the variables of a table that a file has, at all steps or at the last."""
    return {
        name: read_array(file, variable.stored_as(file[name].ndim), sizes)
        for name, variable in variables.items()
        if name in file
    }


def _read_parameters(file: h5py.File, sizes: dict[str, int]) -> dict[str, str]:
    """Return the units of the parameters that there are derivatives with respect to."""
    if table.PARAMETER.name not in file:
        return {}
    keys, units = (
        [read_text(text) for text in find_texts(file, name, sizes, "parameter")[()].tolist()]
        for name in (table.PARAMETER.name, table.PARAMETER_UNIT.name)
    )
    return dict(zip(keys, units, strict=True))


def _attributes(file: h5py.File) -> dict[str, Any]:
    attributes = dict(file.attrs)
    for name in ("software", "coordinates"):
        del attributes[name]
    for name in _TEXTS | (_OPTIONAL_TEXTS & attributes.keys()):
        read_text(attributes[name])
    if missing := _NUMBERS - attributes.keys():
        raise ValueError(missing)
    for name in attributes:
        if name in _NUMBERS | _OPTIONAL_NUMBERS or name.startswith(_OPTIONAL_PREFIXES):
            read_number(attributes[name])
        elif name in _OF_LAYERS or name in _LISTS:
            attributes[name] = read_numbers(attributes[name])
    if attributes["status"] not in ("complete", "incomplete"):
        raise ValueError("status")
    doubts, laws = json.loads(attributes["doubts"]), json.loads(attributes["user_laws"])
    for text in (*doubts, *laws, *laws.values()):
        read_text(text)
    return attributes


def _steps_made(file: h5py.File, sizes: dict[str, int]) -> Any:
    return read_array(
        file, table.STEPS_MADE if table.STEPS_MADE.name in file else table.STEP, sizes
    )


def _read_stress(file: h5py.File, sizes: dict[str, int]) -> StressHistory | None:
    """Return the stored stresses, None where there are none; any exception means damage."""
    if table.STRESS_TIME.name not in file:
        return None
    sizes = {**sizes, "component": len(COMPONENTS), table.SIDE.name: len(SIDES)}

    def read(variable: Variable) -> Any:
        return read_array(file, variable, sizes)

    times, steps = read(table.STRESS_TIME), read(table.STRESS_STEPS_MADE)
    check_times(times)
    count = len(times)
    points, at_points = np.empty((0, 2)), np.empty((count, 0, 6))
    sides: tuple[str, ...] = ()
    if table.STRESS.name in file:
        points = np.stack([read(table.POINT_R), read(table.POINT_Z)], axis=1)
        at_points = read(table.STRESS)
        sides = tuple(find_texts(file, table.POINT_SIDE.name, sizes, "point")[()].tolist())
        if not set(sides) <= set(table.POINT_SIDES):
            raise ValueError(table.POINT_SIDE.name)
    axes, on_grid = (np.empty(0), np.empty(0)), np.empty((count, 0, 0, 6))
    if table.STRESS_GRID.name in file:
        axes = read(table.GRID_R), read(table.GRID_Z)
        on_grid = read(table.STRESS_GRID)
    surface = [read(variable) for variable in table.SURFACE_STRESS]
    none = Interfaces(np.empty(0), np.empty(0)), np.empty((count, 0, len(SIDES), 0, 6))
    lower, upper = (
        (Interfaces(read(names.r), read(names.z)), read(names.stress))
        if names.stress.name in file
        else none
        for names in table.INTERFACES
    )
    largest = [
        [Largest(*row) for row in zip(*(read(v).tolist() for v in variables), strict=True)]
        for variables in table.MAX_MISES_OF
    ]
    layers = [  # which may have a dimension of their own
        read_array(file, variable, {"stress_step": count})
        if variable.name in file
        else np.empty((count, 0))
        for variable in table.MAX_MISES_LAYERS
    ]
    states = tuple(
        StressState(
            int(steps[t]), float(times[t]), at_points[t], on_grid[t],
            (surface[0][t], surface[1][t]),
            (largest[0][t], largest[1][t]),
            (lower[1][t], upper[1][t]),
            (layers[0][t], layers[1][t]),
        )
        for t in range(count)
    )  # fmt: skip
    return StressHistory(
        points, sides, axes, float(read(table.EXCLUDE)), (lower[0], upper[0]), states
    )


# -- writing -------------------------------------------------------------------------------------


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
    with atomic_hdf5(path) as (file, check_disk):
        for variable, values in result.variables():
            write_variable(file, variable, values)
        check_disk()
        line = file.create_group("line")
        write_variable(line, table.EDGE, np.arange(result.line.n + 1))
        write_variable(line, table.EDGES, result.line.edges)
        if result.boundary:
            write_boundaries(file, result.boundary)
        if result.checkpoint is not None:
            write_checkpoint(file.create_group("checkpoint"), result.checkpoint)
        file.attrs.update(
            {
                "software": table.SOFTWARE,
                "coordinates": " ".join(result.coordinates),
                **result.attributes,
            }
        )
