"""A history of cells in one file, as ParaView 5.12 and later read it: VTKHDF 2.0."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ringwear_par.results.storage.cells import Cells
from ringwear_par.results.storage.hdf5 import atomic_hdf5

_VERSION = (2, 0)
#: VTK's numbers of a line through several points, and of a quadrangle
_POLYLINE, _QUAD = 4, 9


def write_vtkhdf(output: Path, times: Sequence[float], contents: Sequence[Cells]) -> None:
    """Write cells at several times, s, by rename. They are the same cells, of moving points.

    Raises
    ------
    OSError : the file.
    """
    first, count = contents[0], len(times)
    (cells, corners), points = first.cells.shape, len(first.points)
    with atomic_hdf5(output, sealed=False) as (file, _):
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
