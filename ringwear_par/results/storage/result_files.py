"""Result files: HDF5 with dimension scales, which xarray opens with h5netcdf.

One process writes, to a temporary name beside the target, flushed and synced, then renamed: a file
that is there is whole.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from ringwear_par.atomic import check_writable
from ringwear_par.elasticity.geometry.mesh import ContactLine
from ringwear_par.elasticity.stress.boundary_fields import (
    BODIES,
    FACES,
    BoundaryFields,
    BoundaryState,
)
from ringwear_par.elasticity.stress.fields import Interfaces, Largest, StressHistory, StressState
from ringwear_par.elasticity.stress.measures import COMPONENTS, SIDES
from ringwear_par.errors import ComputationError
from ringwear_par.results.result import Checkpoint, Result
from ringwear_par.results.storage.checkpoints import read_checkpoint, write_checkpoint
from ringwear_par.results.storage.hdf5 import (
    atomic_hdf5,
    find_texts,
    read_array,
    read_number,
    read_numbers,
    read_text,
    reading,
    write_variable,
)
from ringwear_par.results.variables import (
    BOUNDARY_DIMENSIONS,
    BOUNDARY_FIELDS,
    BOUNDARY_MESH,
    BOUNDARY_STEPS_MADE,
    BOUNDARY_TIME,
    D_HISTORIES,
    D_PROFILES,
    EDGE,
    EDGES,
    EXCLUDE,
    GRID_R,
    GRID_Z,
    HISTORIES,
    INTERFACES,
    LAYER_PROFILES,
    LAYER_VOLUMES,
    LAYERS,
    MAX_MISES_LAYERS,
    MAX_MISES_OF,
    PARAMETER,
    PARAMETER_UNIT,
    POINT_R,
    POINT_SIDE,
    POINT_SIDES,
    POINT_Z,
    PROFILES,
    SIDE,
    SOFTWARE,
    STEP,
    STEPS_MADE,
    STRESS,
    STRESS_GRID,
    STRESS_STEPS_MADE,
    STRESS_TIME,
    SURFACE_STRESS,
    Variable,
)

_KIND = "a result file of ringwear"
#: texts and numbers that every file has, and those that it may have
_TEXTS = {
    "case", "title", "status", "version", "begun_by", "scheme", "user_laws", "law_lower",
    "law_upper", "doubts",
}  # fmt: skip
_NUMBERS = {
    "ranks", "time_step", "time_steps", "time_end", "symmetry_defect", "energy_identity",
    "step_error_time", "closing_contact", "friction", "omega", "angle", "nominal_area",
    "mean_radius",
    "balance_force", "balance_torque", "balance_reaction", "balance_volume", "balance_energy",
    "balance_residual",
}  # fmt: skip
_OPTIONAL_TEXTS = {"error", "face_lower", "face_upper", "layers_lower", "layers_upper"}
_OPTIONAL_NUMBERS = {"density_lower", "density_upper", "time_through_lower", "time_through_upper"}
_OPTIONAL_PREFIXES = ("balance_", "seconds_")
#: densities of the layers of lower and upper
_OF_LAYERS = dict(zip(("density_lower_layers", "density_upper_layers"), LAYER_VOLUMES, strict=True))


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
        SOFTWARE,
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
    with reading(path, SOFTWARE, _KIND) as file:
        return read_text(file.attrs.get("error", ""))


def open_result(path: str | Path) -> Result:
    """Read a result file. Not collective.

    Raises
    ------
    InputError : it is not one.
    """
    path = Path(path)
    with reading(path, SOFTWARE, _KIND) as file:
        return _read(file, path)


def result_of(source: Result | str | Path) -> Result:
    """Return a result, or the one in a file of this name."""
    return source if isinstance(source, Result) else open_result(source)


def _read(file: h5py.File, path: Path) -> Result:
    """Return the result in a file; any exception means that it is damaged."""
    attributes = _attributes(file)
    edges = read_array(file["line"], EDGES, {})
    if not (len(edges) > 1 and np.isfinite(edges).all() and (np.diff(edges) > 0.0).all()):
        raise ValueError("edges")
    sizes = {"element": len(edges) - 1}
    checkpoint: Checkpoint | None = None
    if "checkpoint" in file:
        checkpoint = read_checkpoint(file["checkpoint"], sizes)
    step = read_array(file, STEP, sizes)
    histories = {name: read_array(file, variable, sizes) for name, variable in HISTORIES.items()}
    _check_times(histories["time"])
    layers = _read_layers(file, sizes)
    for name in _OF_LAYERS.keys() & attributes.keys():
        if len(attributes[name]) != layers[_OF_LAYERS[name]].shape[1] - 1:
            raise ValueError(name)
    return Result(
        ContactLine(edges),
        step,
        _steps_made(file, sizes),
        histories,
        {
            name: read_array(file, _as_stored(file, variable), sizes)
            for name, variable in PROFILES.items()
            if name in file
        },
        _read_boundary(file),
        attributes,
        checkpoint,
        path,
        *_read_derivatives(file, sizes),
        layers=layers,
        stress=_read_stress(file, sizes),
    )


def _read_layers(file: h5py.File, sizes: dict[str, int]) -> dict[str, Any]:
    """Return the variables of layers by name; nothing of most."""
    layers = {}
    for name, variable in LAYERS.items():
        if name not in file:
            continue
        if name in LAYER_VOLUMES:  # which may have a dimension of their own
            layers[name] = read_array(file, variable, {"step": sizes["step"]})
        else:
            last = name in LAYER_PROFILES
            layers[name] = read_array(file, _as_stored(file, variable) if last else variable, sizes)
    return layers


def _read_derivatives(
    file: h5py.File, sizes: dict[str, int]
) -> tuple[dict[str, str], dict[str, Any]]:
    """Return the parameters with their units, and the derivatives by name; nothing of most."""
    if PARAMETER.name not in file:
        return {}, {}
    keys, units = (
        [read_text(text) for text in find_texts(file, name, sizes, PARAMETER.name)[()].tolist()]
        for name in (PARAMETER.name, PARAMETER_UNIT.name)
    )
    derivatives = {
        name: read_array(file, variable, sizes)
        for name, variable in D_HISTORIES.items()
        if name in file
    }
    for name, variable in D_PROFILES.items():
        if name in file:
            last = file[name].ndim == 2
            derivatives[name] = read_array(
                file, variable.at_last_step() if last else variable, sizes
            )
    return dict(zip(keys, units, strict=True)), derivatives


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
        elif name in _OF_LAYERS:
            attributes[name] = read_numbers(attributes[name])
    if attributes["status"] not in ("complete", "incomplete"):
        raise ValueError("status")
    doubts, laws = json.loads(attributes["doubts"]), json.loads(attributes["user_laws"])
    for text in (*doubts, *laws, *laws.values()):
        read_text(text)
    return attributes


def _check_times(times: Any) -> None:
    if not (len(times) and np.isfinite(times).all() and (np.diff(times) >= 0.0).all()):
        raise ValueError("time")


def _as_stored(file: h5py.File, variable: Variable) -> Variable:
    """Return a field as it is stored, at all steps or the last."""
    return variable if file[variable.name].ndim == 2 else variable.at_last_step()


def _steps_made(file: h5py.File, sizes: dict[str, int]) -> Any:
    return read_array(file, STEPS_MADE if STEPS_MADE.name in file else STEP, sizes)


def _read_boundary(file: h5py.File) -> tuple[BoundaryState, ...]:
    """Return the stored fields on the boundaries, () where there are none."""
    if "boundary" not in file:
        return ()
    groups = [file["boundary"][name] for name in BODIES]
    sizes: dict[str, int] = {}
    times = read_array(groups[0], BOUNDARY_TIME, sizes)
    _check_times(times)
    steps = read_array(groups[0], BOUNDARY_STEPS_MADE, sizes).tolist()
    bodies = [_read_body(group, len(times)) for group in groups]
    return tuple(
        BoundaryState(step, time, (lower, upper))
        for step, time, lower, upper in zip(steps, times.tolist(), *bodies, strict=True)
    )


def _read_body(group: h5py.Group, states: int) -> list[BoundaryFields]:
    sizes = {"boundary_step": states, "corner": 3}
    elements, face = (read_array(group, variable, sizes) for variable in BOUNDARY_MESH.values())
    table = {
        attribute: np.stack([read_array(group, v, sizes) for v in variables], axis=-1)
        for attribute, variables in BOUNDARY_FIELDS.items()
    }
    for numbers, size in ((elements, sizes["boundary_node"]), (face, len(FACES))):
        if not ((numbers >= 0) & (numbers < size)).all():
            raise ValueError(group.name)
    return [
        BoundaryFields(
            table["nodes"][t], elements, face, table["displacement"][t], table["traction"][t],
            table["pressure"][t, :, 0], table["wear"][t, :, 0],
        )
        for t in range(states)
    ]  # fmt: skip


def _read_stress(file: h5py.File, sizes: dict[str, int]) -> StressHistory | None:
    """Return the stored stresses, None where there are none; any exception means damage."""
    if STRESS_TIME.name not in file:
        return None
    sizes = {**sizes, "component": len(COMPONENTS), SIDE.name: len(SIDES)}

    def read(variable: Variable) -> Any:
        return read_array(file, variable, sizes)

    times, steps = read(STRESS_TIME), read(STRESS_STEPS_MADE)
    if not (len(times) and np.isfinite(times).all() and (np.diff(times) >= 0.0).all()):
        raise ValueError(STRESS_TIME.name)
    count = len(times)
    points, at_points = np.empty((0, 2)), np.empty((count, 0, 6))
    sides: tuple[str, ...] = ()
    if STRESS.name in file:
        points = np.stack([read(POINT_R), read(POINT_Z)], axis=1)
        at_points = read(STRESS)
        sides = tuple(find_texts(file, POINT_SIDE.name, sizes, "point")[()].tolist())
        if not set(sides) <= set(POINT_SIDES):
            raise ValueError(POINT_SIDE.name)
    axes, on_grid = (np.empty(0), np.empty(0)), np.empty((count, 0, 0, 6))
    if STRESS_GRID.name in file:
        axes = read(GRID_R), read(GRID_Z)
        on_grid = read(STRESS_GRID)
    surface = [read(variable) for variable in SURFACE_STRESS]
    none = Interfaces(np.empty(0), np.empty(0)), np.empty((count, 0, len(SIDES), 0, 6))
    lower, upper = (
        (Interfaces(read(of.r), read(of.z)), read(of.stress)) if of.stress.name in file else none
        for of in INTERFACES
    )
    largest = [
        [Largest(*row) for row in zip(*(read(v).tolist() for v in variables), strict=True)]
        for variables in MAX_MISES_OF
    ]
    layers = [  # which may have a dimension of their own
        read_array(file, variable, {"stress_step": count})
        if variable.name in file
        else np.empty((count, 0))
        for variable in MAX_MISES_LAYERS
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
    return StressHistory(points, sides, axes, float(read(EXCLUDE)), (lower[0], upper[0]), states)


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
        write_variable(line, EDGE, np.arange(result.line.n + 1))
        write_variable(line, EDGES, result.line.edges)
        if result.boundary:
            for i, name in enumerate(BODIES):
                _write_boundary(file.create_group(f"boundary/{name}"), result.boundary, i)
        if result.checkpoint is not None:
            write_checkpoint(file.create_group("checkpoint"), result.checkpoint)
        file.attrs.update(
            {"software": SOFTWARE, "coordinates": " ".join(result.coordinates), **result.attributes}
        )


def _write_boundary(group: h5py.Group, states: Sequence[BoundaryState], body: int) -> None:
    """Write the fields on the boundary of one body, 0 or 1, at all stored times."""
    fields = [state.bodies[body] for state in states]
    first = fields[0]
    sizes = (len(states), len(first.nodes), len(first.elements), first.elements.shape[1])
    for variable, size in zip(BOUNDARY_DIMENSIONS.values(), sizes, strict=True):
        write_variable(group, variable, np.arange(size))
    write_variable(group, BOUNDARY_TIME, np.array([state.time for state in states]))
    write_variable(group, BOUNDARY_STEPS_MADE, np.array([state.step for state in states]))
    write_variable(group, BOUNDARY_MESH["nodes"], first.elements)
    write_variable(group, BOUNDARY_MESH["face"], first.face)
    for attribute, variables in BOUNDARY_FIELDS.items():
        table = np.array([getattr(f, attribute) for f in fields])
        columns = table.reshape(*table.shape[:2], len(variables))
        for column, variable in enumerate(variables):
            write_variable(group, variable, columns[..., column])
    group.attrs["coordinates"] = BOUNDARY_TIME.name
