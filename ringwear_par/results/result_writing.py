"""Writing of result files: HDF5 with dimension scales, which xarray opens with h5netcdf.

One process writes, to a temporary name beside the target, flushed and synced, then renamed: a file
that is there is whole.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import h5py
import numpy as np

from ringwear_par.elasticity.stress.boundary_fields import BODIES, BoundaryState
from ringwear_par.results.checkpoints import write_checkpoint
from ringwear_par.results.hdf5_writing import atomic_hdf5, write_variable
from ringwear_par.results.variables import (
    BOUNDARY_DIMENSIONS,
    BOUNDARY_FIELDS,
    BOUNDARY_MESH,
    BOUNDARY_STEPS_MADE,
    BOUNDARY_TIME,
    EDGE,
    EDGES,
    SOFTWARE,
)

if TYPE_CHECKING:
    from ringwear_par.results.result import Result


def write_result(path: Path, result: "Result") -> None:
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
