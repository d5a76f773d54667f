"""Result files read: see ``writing`` for what they are."""

from pathlib import Path
from typing import Any

import h5py
import numpy as np

from ringwear_par.elasticity.boundary_fields import BODIES, BoundaryFields, BoundaryState
from ringwear_par.elasticity.mesh import ContactLine
from ringwear_par.errors import InputError
from ringwear_par.results.checkpoints import Checkpoint, read_checkpoint
from ringwear_par.results.result import Result, balance_attributes
from ringwear_par.results.variables import (
    BOUNDARY_FIELDS,
    HISTORIES,
    PROFILES,
    SOFTWARE,
)

#: balances in the order in which files of version 0.1.0 have them, without names
_BALANCES = ("force", "torque", "reaction", "volume", "energy", "residual")


def read_status(path: Path) -> tuple[str, int] | None:
    """Return status and last step of a result file, None if there is none. Not collective.

    Raises
    ------
    InputError : something else is there.
    """
    if not path.exists():
        return None
    try:
        with h5py.File(path, "r") as file:
            if file.attrs.get("software") == SOFTWARE:
                status = str(file.attrs["status"])
                if "checkpoint" in file:
                    return status, int(file["checkpoint"].attrs["step"])
                return status, int(_steps_made(file)[-1])
    except (OSError, KeyError):
        pass
    raise InputError(
        f"{path}: exists and is not a result file of ringwear, or is damaged; must be a new name "
        "or such a file"
    )


def read_error(path: Path) -> str:
    """Return why the run in a result file failed, "" if it did not. Not collective."""
    with h5py.File(path, "r") as file:
        return str(file.attrs.get("error", ""))


def open_result(path: str | Path) -> Result:
    """Read a result file. Not collective.

    Raises
    ------
    InputError : it is not one.
    """
    path = Path(path)
    if not path.exists():
        raise InputError(f"{path}: does not exist; must be a result file of ringwear")
    try:
        with h5py.File(path, "r") as file:
            if file.attrs.get("software") == SOFTWARE:
                return _read(file, path)
    except (OSError, KeyError, RuntimeError):
        pass
    raise InputError(f"{path}: is not a result file of ringwear, or is damaged")


def result_of(source: Result | str | Path) -> Result:
    """Return a result, or the one in a file of this name."""
    return source if isinstance(source, Result) else open_result(source)


def _read(file: h5py.File, path: Path) -> Result:
    attributes = dict(file.attrs)
    for name in ("software", "coordinates"):
        del attributes[name]
    checkpoint: Checkpoint | None = None
    if "checkpoint" in file:
        checkpoint = read_checkpoint(file["checkpoint"])
        if "line" not in file:  # version 0.1.0
            values = file["checkpoint"].attrs["balances"].tolist()
            attributes |= balance_attributes(dict(zip(_BALANCES, values, strict=True)))
    return Result(
        ContactLine(file["line/edges" if "line" in file else "checkpoint/edges"][:]),
        file["step"][:],
        _steps_made(file),
        {name: file[name][:] for name in HISTORIES},
        {name: file[name][:] for name in PROFILES if name in file},
        _read_boundary(file),
        attributes,
        checkpoint,
        path,
    )


def _steps_made(group: h5py.Group) -> Any:
    return group["steps_made" if "steps_made" in group else "step"][:]


def _read_boundary(file: h5py.File) -> tuple[BoundaryState, ...]:
    """Return the stored fields on the boundaries, () where there are none."""
    if "boundary" not in file:
        return ()
    groups = [file["boundary"][name] for name in BODIES]
    steps, times = _steps_made(groups[0]).tolist(), groups[0]["time"][:].tolist()
    return tuple(
        BoundaryState(step, time, (lower, upper))
        for step, time, lower, upper in zip(steps, times, *map(_read_body, groups), strict=True)
    )


def _read_body(group: h5py.Group) -> list[BoundaryFields]:
    elements, face = group["nodes"][:], group["face"][:]
    table = {
        attribute: np.stack([group[variable.name][:] for variable in variables], axis=-1)
        for attribute, variables in BOUNDARY_FIELDS.items()
    }
    return [
        BoundaryFields(
            table["nodes"][t], elements, face, table["displacement"][t], table["traction"][t],
            table["pressure"][t, :, 0], table["wear"][t, :, 0],
        )
        for t in range(len(group["time"]))
    ]  # fmt: skip
