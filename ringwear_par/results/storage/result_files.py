"""Result files: HDF5 with dimension scales, which xarray opens with h5netcdf.

One process writes, to a temporary name beside the target, flushed and synced, then renamed: a file
that is there is whole.
"""

from collections.abc import Mapping
from dataclasses import replace
from operator import attrgetter
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from ringwear_par.batched import one
from ringwear_par.contact.problem import ContactState, WarmStart
from ringwear_par.elasticity.mesh import ContactLine
from ringwear_par.errors import ComputationError, InputError
from ringwear_par.files.writing import check_writable
from ringwear_par.history.observers.worst_states import ENTRIES
from ringwear_par.history.state import Progress, Start, State
from ringwear_par.results import variables as table
from ringwear_par.results.result import Checkpoint, Result
from ringwear_par.results.storage import hdf5
from ringwear_par.results.storage.boundaries import read_boundaries, write_boundaries
from ringwear_par.results.storage.result_variables import coordinates, read_stress, result_variables
from ringwear_par.results.variables import Variable

_KIND = "a result file of ringwear"
#: attributes that every file has
_ATTRIBUTES = {
    "case", "title", "status", "error", "version", "begun_by", "scheme", "user_laws", "law_lower",
    "law_upper", "doubts", "ranks", "time_step", "time_steps", "time_end", "symmetry_defect",
    "energy_identity", "closing_contact", "friction", "omega", "angle",
    "nominal_area", "mean_radius", "balance_force", "balance_torque", "balance_reaction",
    "balance_volume", "balance_energy", "balance_residual",
}  # fmt: skip
#: those of bodies with layers
_OF_LAYERS = {"density_lower_layers", "density_upper_layers"}


def read_status(path: Path) -> tuple[str, int] | None:
    """Return status and last step of a result file, None if there is none. Not collective.

    Raises
    ------
    InputError : something else is there.
    """
    if not path.exists():
        return None
    with hdf5.reading(
        path,
        table.SOFTWARE,
        _KIND,
        "; must be one (--restart), another name, or be replaced by --overwrite",
    ) as file:
        status = str(file.attrs["status"])
        if "checkpoint" in file:
            return status, int(file["checkpoint"].attrs["step"])
        return status, int(_steps_made(file, {})[-1])


def read_error(path: Path) -> str:
    """Return why the run in a result file failed, "" if it did not. Not collective.

    Raises
    ------
    InputError : it is no result file.
    """
    with hdf5.reading(path, table.SOFTWARE, _KIND) as file:
        return str(file.attrs["error"])


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
    with hdf5.reading(path, table.SOFTWARE, _KIND) as file:
        return _read(file, path)


def result_of(source: Result | str | Path) -> Result:
    """Return a result, or the one in a file of this name."""
    return source if isinstance(source, Result) else open_result(source)


def _read(file: h5py.File, path: Path) -> Result:
    """Return the result in a file; any exception means that it is damaged."""
    attributes = _attributes(file)
    edges = hdf5.read_array(file["line"], table.EDGES, {})
    sizes = {"element": len(edges) - 1}
    checkpoint: Checkpoint | None = None
    if "checkpoint" in file:
        checkpoint = read_checkpoint(file["checkpoint"], sizes)
    step = hdf5.read_array(file, table.STEP, sizes)
    histories = {name: hdf5.read_array(file, v, sizes) for name, v in table.HISTORIES.items()}
    layers = {
        **_read_stored(file, table.LAYER_HISTORIES, sizes),
        # volumes may have a dimension of their own
        **_read_stored(file, table.LAYER_VOLUMES, {"step": sizes["step"]}),
        **_read_stored(file, table.LAYER_PROFILES, sizes),
    }
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
        layers=layers,
        stress=read_stress(file, sizes),
    )


def _read_stored(
    file: h5py.File, variables: Mapping[str, Variable], sizes: dict[str, int]
) -> dict[str, Any]:
    """Return the variables of a table that a file has, at all steps or at the last."""
    return {
        name: hdf5.read_array(file, variable.stored_as(file[name].ndim), sizes)
        for name, variable in variables.items()
        if name in file
    }


def _attributes(file: h5py.File) -> dict[str, Any]:
    attributes = dict(file.attrs)
    for name in ("software", "coordinates"):
        del attributes[name]
    if missing := _ATTRIBUTES - attributes.keys():
        raise ValueError(missing)
    for name in _OF_LAYERS & attributes.keys():
        attributes[name] = tuple(attributes[name].tolist())
    return attributes


def _steps_made(file: h5py.File, sizes: dict[str, int]) -> Any:
    return hdf5.read_array(
        file, table.STEPS_MADE if table.STEPS_MADE.name in file else table.STEP, sizes
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
    with hdf5.atomic_hdf5(path) as file:
        for variable, values in result_variables(result):
            hdf5.write_variable(file, variable, values)
        line = file.create_group("line")
        hdf5.write_variable(line, table.EDGE, np.arange(result.line.n + 1))
        hdf5.write_variable(line, table.EDGES, result.line.edges)
        if result.boundary:
            write_boundaries(file, result.boundary)
        if result.checkpoint is not None:
            write_checkpoint(file.create_group("checkpoint"), result.checkpoint)
        file.attrs.update(
            {
                "software": table.SOFTWARE,
                "coordinates": " ".join(coordinates(result)),
                **result.attributes,
            }
        )


# -- where a history continues: which part of a ``Checkpoint`` each variable is --------------------

_BODY = table.axis("body", "0 lower, 1 upper")
#: parts of a ``Start`` that are arrays
_STATE_ARRAYS = {
    "state.wear": Variable("wear", ("body", "element"), "mm", "wear depth"),
    "state.worn": Variable(
        "worn", ("body",), "mm3", "time integral of the rate of the worn volume"
    ),
    "state.rates": Variable("rates", ("body", "element"), "mm/s", "rate of wear"),
    "state.error": Variable(
        "error", ("element",), "mm", "estimated error of wear that time steps have made"
    ),
    "state.meshed_wear": Variable(
        "meshed_wear", ("body", "element"), "mm", "wear depth of the profiles of the elements"
    ),
    "state.gap_offset": Variable(
        "gap_offset", ("element",), "mm", "by how much gaps are smaller since slopes have turned"
    ),
    "state.through": Variable(
        "through", ("body",), "s", "when wear first got through all layers, or infinite"
    ),
    "state.contact.pressure": Variable("pressure", ("element",), "MPa", "contact pressure"),
    "state.contact.gap": Variable("gap", ("element",), "mm", "gap between the deformed profiles"),
    "warm.scaled_pressure": Variable(
        "warm_scaled_pressure", ("element",), "1", "unknowns of the contact solver"
    ),
}
#: arrays of histories whose elements follow the wear, and of bodies with layers
_OPTIONAL_ARRAYS = ("state.meshed_wear", "state.gap_offset", "state.through")
#: a number that files of earlier versions have not
_SHORTEST = "shortest_step"
#: parts that are numbers: their names in files, and their types
_STATE_NUMBERS: dict[str, tuple[str, type]] = {
    "progress.steps": ("step", int),
    "state.time": ("time", float),
    "state.energy": ("energy", float),
    "state.normal_work": ("normal_work", float),
    "state.first_approach": ("first_approach", float),
    "progress.iterations": ("iterations", int),
    "progress.next_step": ("next_step", float),
    "progress.rejected": ("rejected", int),
    "progress.interface": ("interface", float),
    "progress.shortest": (_SHORTEST, float),
    "updates": ("assemblies", int),
    "state.contact.approach": ("approach", float),
    "state.contact.force": ("force", float),
    "warm.approach": ("warm_approach", float),
}
#: other attributes: a number, and the beginning of those that hold the worst of a history
_PENDING, _WORST = "pending_iterations", "worst_"


def restored(result: Result) -> Start:
    """Return where a stored history continues.

    Raises
    ------
    InputError : it was stored without.
    """
    if result.checkpoint is None:
        raise InputError(f"{result.name}: holds no state to go on from; must be one of a run")
    return result.checkpoint.start


def write_checkpoint(group: h5py.Group, checkpoint: Checkpoint) -> None:
    """Write a checkpoint to a group of a result file, whose elements it has."""
    start = one(checkpoint.start, 0)
    group.attrs.update(
        {name: attrgetter(part)(start) for part, (name, _) in _STATE_NUMBERS.items()}
    )
    group.attrs[_PENDING] = checkpoint.pending_iterations
    group.attrs.update({f"{_WORST}{name}": values for name, values in checkpoint.worst.items()})
    hdf5.write_variable(group, _BODY, np.arange(2))
    for part, variable in _STATE_ARRAYS.items():
        values = attrgetter(part)(start)
        if values is not None:
            hdf5.write_variable(group, variable, values)


def read_checkpoint(group: h5py.Group, sizes: Mapping[str, int]) -> Checkpoint:
    """Return the checkpoint in a group of a result file.

    Parameters
    ----------
    sizes : of the dimensions of the file.

    Raises
    ------
    Exception : it is damaged, see ``reading``.
    """
    known = {**sizes, "body": 2}
    parts: dict[str, Any] = {
        part: np.array([group.attrs[name]], dtype=kind)
        for part, (name, kind) in _STATE_NUMBERS.items()
        if name in group.attrs or name != _SHORTEST
    }
    for part, variable in _STATE_ARRAYS.items():
        if variable.name in group or part not in _OPTIONAL_ARRAYS:
            histories = (
                variable.dimensions.index("body") + 1 if "body" in variable.dimensions else 0
            )
            parts[part] = np.expand_dims(hdf5.read_array(group, variable, known), histories)
    worst = {
        name.removeprefix(_WORST): tuple(values.tolist())
        for name, values in group.attrs.items()
        if name.startswith(_WORST)
    }
    if any(len(values) != ENTRIES for values in worst.values()):
        raise ValueError(_WORST)
    return Checkpoint(_start(parts), 0, int(group.attrs[_PENDING]), worst)


def _start(parts: Mapping[str, Any]) -> Start:
    """Return the start of these parts, of which it has no others."""

    def of(owner: str) -> dict[str, Any]:
        """Return the parts of an owner by their names in it."""
        paths = {part: part.rpartition(".") for part in parts}
        return {name: parts[part] for part, (table, _, name) in paths.items() if table == owner}

    zero = np.zeros(1, dtype=np.int64)
    contact = ContactState(**of("state.contact"), iterations=zero, residual=np.zeros(1))
    state = State(**of("state"), contact=contact)
    progress = replace(Progress.at_start(1), **of("progress"))
    return Start(state, progress, WarmStart(**of("warm")), int(parts["updates"][0]))
