"""Bodies as points and cells, and a history of them in one file of ParaView: VTKHDF 2.0.

ParaView 5.12 and later read it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.elasticity.stress.fields import (
    COMPONENTS,
    BoundaryFields,
    BoundaryState,
    StressHistory,
    StressState,
    max_shear,
    mises,
)
from ringwear_par.results.hdf5 import atomic_hdf5
from ringwear_par.results.layers import Interface

_VERSION = (2, 0)
#: VTK's numbers of a line through several points, and of a quadrangle
_POLYLINE, _QUAD = 4, 9


@dataclass(frozen=True)
class Cells:
    """What a VTK file holds: points, cells of the same number of points, fields on both."""

    #: (m, 3) float, mm
    points: FloatArray
    #: (c, q) int, points of each cell
    cells: IntArray
    #: by name, (m,), (c,) or with three columns
    point_data: dict[str, Any]
    cell_data: dict[str, Any]


def write_vtkhdf(output: Path, times: Sequence[float], contents: Sequence[Cells]) -> None:
    """Write cells at several times, s, by rename. They are the same cells, of moving points.

    Raises
    ------
    OSError : the file.
    """
    first, count = contents[0], len(times)
    (cells, corners), points = first.cells.shape, len(first.points)
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
        root["Connectivity"] = first.cells.ravel().astype(np.int64)
        root["Offsets"] = corners * np.arange(cells + 1, dtype=np.int64)
        kind = _QUAD if corners == 4 else _POLYLINE
        root["Types"] = np.full(cells, kind, dtype=np.uint8)
        root["Points"] = np.concatenate([content.points for content in contents])
        numbers = np.arange(count, dtype=np.int64)
        steps = root.create_group("Steps")
        steps.attrs["NSteps"] = np.int64(count)
        steps["Values"] = np.array(times, dtype=np.float64)
        steps["PartOffsets"] = np.zeros(count, dtype=np.int64)
        steps["NumberOfParts"] = np.ones(count, dtype=np.int64)
        steps["PointOffsets"] = points * numbers
        steps["CellOffsets"] = np.zeros((count, 1), dtype=np.int64)
        steps["ConnectivityIdOffsets"] = np.zeros((count, 1), dtype=np.int64)
        for kind_of, size in (("PointData", points), ("CellData", cells)):
            name = "point_data" if kind_of == "PointData" else "cell_data"
            data, offsets = root.create_group(kind_of), steps.create_group(f"{kind_of}Offsets")
            for field in getattr(first, name):
                values: list[Any] = [getattr(content, name)[field] for content in contents]
                data[field] = np.concatenate(values)
                offsets[field] = size * numbers


def contours(state: BoundaryState, warp: float) -> Cells:
    """Return the contours of both bodies, displaced by ``warp`` times their displacements."""
    return _both([_contour(body, warp) for body in state.bodies])


def surfaces(state: BoundaryState, warp: float, segments: int) -> Cells:
    """Return the surfaces of both bodies, revolved in so many segments."""
    return _both([_revolved(body, warp, segments) for body in state.bodies])


def stress_cells(history: StressHistory) -> list[Cells]:
    """Return the grid of stresses of each state in the plane y = 0.

    A quadrangle joins four points that at least one state has; states lose points where wear has
    taken the body or the layer away.
    """
    r, z = history.grid
    present = np.any([np.isfinite(state.grid).all(axis=-1) for state in history.states], axis=0)
    number = np.where(present, np.cumsum(present).reshape(present.shape) - 1, -1)
    corners = [number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]]
    cells = np.stack([corner.ravel() for corner in corners], axis=1)
    cells = cells[(cells >= 0).all(axis=1)]
    at = np.stack(np.meshgrid(r, z, indexing="ij"), axis=-1)[present]
    points = np.stack([at[:, 0], np.zeros(len(at)), at[:, 1]], axis=1)
    cells_of_states = []
    for state in history.states:
        values = state.grid[present]
        named = {f"stress_{name}": values[:, i].copy() for i, name in enumerate(COMPONENTS)}
        named |= {"mises": mises(values), "max_shear": max_shear(values)}
        cells_of_states.append(Cells(points, cells, named, {}))
    return cells_of_states


def interface_cells(interfaces: Sequence[Interface], state: StressState) -> Cells:
    """Return interfaces in the plane y = 0, a line for each side: pieces between mid-points."""
    lines, at = [], 0
    for interface in interfaces:
        for side, stress in zip((1, -1), interface.stress(state), strict=True):
            m = len(interface.r)
            points = np.stack([interface.r, np.zeros(m), np.full(m, interface.z)], axis=1)
            first = at + np.arange(m - 1)
            named = {f"stress_{name}": stress[:, i].copy() for i, name in enumerate(COMPONENTS)}
            place = {"body": interface.body, "layer": interface.layer, "side": side}
            lines.append(
                Cells(
                    points, np.stack([first, first + 1], axis=1), {**named, "mises": mises(stress)},
                    {name: np.full(m - 1, value) for name, value in place.items()},
                )
            )  # fmt: skip
            at += m
    return _joined(lines)


def _contour(body: BoundaryFields, warp: float) -> Cells:
    """Return a contour in the plane y = 0: a line of three points for each element."""
    displacement = body.displacement[:, [0, 2, 1]]  # theta points along y
    r, z = body.nodes.T
    points = np.stack([r, np.zeros_like(r), z], axis=1) + warp * displacement
    return Cells(
        points,
        body.elements,
        {"displacement": displacement},
        {
            "traction": body.traction[:, [0, 2, 1]],
            "pressure": body.pressure,
            "wear": body.wear,
            "face": body.face,
        },
    )


def _revolved(body: BoundaryFields, warp: float, segments: int) -> Cells:
    """Return the surface of a body: a quadrangle for each element and segment, normals outwards."""
    ends, elements = np.unique(body.elements[:, [0, 2]], return_inverse=True)
    first, last = elements.reshape(-1, 2).T
    m, k = len(ends), len(first)
    at = 2.0 * np.pi * np.arange(segments) / segments
    middle = at + np.pi / segments
    r, z = body.nodes[ends].T
    position = np.stack([r, z, np.zeros(m)], axis=1)
    displacement = _cartesian(body.displacement[ends], at)
    points = _cartesian(position, at) + warp * displacement
    present = m * np.arange(segments)[:, None]
    following = m * ((np.arange(segments)[:, None] + 1) % segments)
    corners = (present + first, following + first, following + last, present + last)

    def everywhere(values: FloatArray | IntArray) -> Any:
        return np.tile(values, segments)

    return Cells(
        points,
        np.stack(corners, axis=-1).reshape(segments * k, 4),
        {"displacement": displacement},
        {
            "traction": _cartesian(body.traction, middle),
            "pressure": everywhere(body.pressure),
            "wear": everywhere(body.wear),
            "face": everywhere(body.face),
        },
    )


def _cartesian(vectors: FloatArray, angles: FloatArray) -> FloatArray:
    """Return (segments * m, 3), vectors (m, 3) along r, z, theta turned to angles (segments,)."""
    c, s = np.cos(angles)[:, None], np.sin(angles)[:, None]
    r, z, theta = vectors.T
    turned = (c * r - s * theta, s * r + c * theta, np.broadcast_to(z, (len(angles), len(z))))
    return np.stack(turned, axis=-1).reshape(-1, 3)


def _joined(parts: Sequence[Cells]) -> Cells:
    """Return several parts, which all have the same fields, as one."""

    def every(values: Sequence[Any]) -> Any:
        if isinstance(values[0], dict):
            return {name: np.concatenate([part[name] for part in values]) for name in values[0]}
        return np.concatenate(values)

    return Cells(*(every([getattr(part, f.name) for part in parts]) for f in fields(Cells)))


def _both(bodies: Sequence[Cells]) -> Cells:
    """Return both bodies as one, with their numbers (0 lower, 1 upper) as a field."""
    first = 0
    parts = []
    for number, body in enumerate(bodies):
        of_body = {**body.cell_data, "body": np.full(len(body.cells), number)}
        parts.append(replace(body, cells=body.cells + first, cell_data=of_body))
        first += len(body.points)
    return _joined(parts)
