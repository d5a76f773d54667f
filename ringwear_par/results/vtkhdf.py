"""Bodies as points and cells, and a history of them in one file of ParaView: VTKHDF 2.0.

ParaView 5.12 and later read it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.elasticity.stress.fields import COMPONENTS, max_shear, mises
from ringwear_par.results.hdf5 import atomic_hdf5

_VERSION = (2, 0)
#: VTK's numbers of a line through several points, and of a quadrangle
_POLYLINE, _QUAD = 4, 9


@dataclass(frozen=True)
class Cells:
    """What a VTK file holds at t times: points, cells, fields on both."""

    #: (t, m, 3) float, mm
    points: FloatArray
    #: (c, q) int, points of each cell, the same at all times
    cells: IntArray
    #: by name, (t, m) or (t, m, 3), and (t, c) or (t, c, 3)
    point_data: dict[str, Any]
    cell_data: dict[str, Any]


def write_vtkhdf(output: Path, times: Sequence[float], content: Cells) -> None:
    """Write cells at several times, s, by rename.

    Raises
    ------
    OSError : the file.
    """
    (count, points, _), (cells, corners) = content.points.shape, content.cells.shape
    numbers = np.arange(count, dtype=np.int64)
    with atomic_hdf5(output) as file:
        root = file.create_group("VTKHDF")
        root.attrs["Version"] = np.array(_VERSION, dtype=np.int64)
        root.attrs.create("Type", b"UnstructuredGrid", dtype="S16")
        for name, size in (
            ("NumberOfPoints", points),
            ("NumberOfCells", cells),
            ("NumberOfConnectivityIds", cells * corners),
        ):
            root[name] = np.array([size], dtype=np.int64)
        # one part, whose cells serve at all times
        root["Connectivity"] = content.cells.ravel().astype(np.int64)
        root["Offsets"] = corners * np.arange(cells + 1, dtype=np.int64)
        kind = _QUAD if corners == 4 else _POLYLINE
        root["Types"] = np.full(cells, kind, dtype=np.uint8)
        root["Points"] = content.points.reshape(-1, 3)
        steps = root.create_group("Steps")
        steps.attrs["NSteps"] = np.int64(count)
        steps["Values"] = np.array(times, dtype=np.float64)
        steps["PartOffsets"] = np.zeros(count, dtype=np.int64)
        steps["NumberOfParts"] = np.ones(count, dtype=np.int64)
        steps["PointOffsets"] = points * numbers
        steps["CellOffsets"] = np.zeros((count, 1), dtype=np.int64)
        steps["ConnectivityIdOffsets"] = np.zeros((count, 1), dtype=np.int64)
        for group, size, fields in (
            ("PointData", points, content.point_data),
            ("CellData", cells, content.cell_data),
        ):
            data, offsets = root.create_group(group), steps.create_group(f"{group}Offsets")
            for name, values in fields.items():
                data[name] = values.reshape(count * size, *values.shape[2:])
                offsets[name] = size * numbers


def boundary_cells(data: Mapping[str, Any]) -> Cells:
    """Return the contours of both bodies in the plane y = 0: a line of three points an element.

    Parameters
    ----------
    data : of a result with fields on boundaries; theta points along y.
    """
    parts: list[dict[str, Any]] = []
    first = 0
    for number, body in enumerate(BODIES):
        fields = {
            name: data[f"boundary/{body}/{name}"]
            for name in ("r", "z", "nodes", "face", "pressure", "wear")
        }
        vectors = {
            name: np.stack([data[f"boundary/{body}/{name}_{x}"] for x in ("r", "theta", "z")], -1)
            for name in ("displacement", "traction")
        }
        r, z, wear = fields["r"], fields["z"], fields["wear"]
        parts.append({
            "points": np.stack([r, np.zeros_like(r), z], axis=-1),
            "cells": (fields["nodes"] + first)[None],
            **vectors,
            "pressure": fields["pressure"],
            "wear": wear,
            "face": np.broadcast_to(fields["face"], wear.shape),
            "body": np.full(wear.shape, number),
        })  # fmt: skip
        first += r.shape[1]
    both = {name: np.concatenate([part[name] for part in parts], axis=1) for name in parts[0]}
    points, (cells,), displacement = (both.pop(n) for n in ("points", "cells", "displacement"))
    return Cells(points, cells, {"displacement": displacement}, both)


def stress_cells(data: Mapping[str, Any]) -> Cells:
    """Return the grid of stresses in the plane y = 0.

    A quadrangle joins four points that at least one state has; states lose points where wear has
    taken the body or the layer away.

    Parameters
    ----------
    data : of a result with ``stress_grid``.
    """
    stress = data["stress_grid"]
    present = np.isfinite(stress).all(axis=-1).any(axis=0)
    number = np.where(present, np.cumsum(present).reshape(present.shape) - 1, -1)
    corners = [number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]]
    cells = np.stack([corner.ravel() for corner in corners], axis=1)
    cells = cells[(cells >= 0).all(axis=1)]
    r, z = np.meshgrid(data["grid_r"], data["grid_z"], indexing="ij")
    points = np.stack([r[present], np.zeros(np.count_nonzero(present)), z[present]], axis=1)
    values = stress[:, present]
    named = {f"stress_{name}": values[..., i] for i, name in enumerate(COMPONENTS)}
    named |= {"mises": mises(values), "max_shear": max_shear(values)}
    return Cells(np.tile(points, (len(stress), 1, 1)), cells, named, {})
