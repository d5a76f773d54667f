"""VTKHDF files, read by the rules of their format."""

import itertools

import h5py
import numpy as np


def vtkhdf_step(file, number):
    """Points, cells, types and fields at a step of a VTKHDF file, by the rules of its format."""
    root = file["VTKHDF"]
    assert (root.attrs["Type"], list(root.attrs["Version"])) == (b"UnstructuredGrid", [2, 0])
    steps = root["Steps"]
    part = steps["PartOffsets"][number]
    assert steps["NumberOfParts"][number] == 1
    m, k, ids = (
        int(root[f"NumberOf{name}"][part]) for name in ("Points", "Cells", "ConnectivityIds")
    )
    at, cell = steps["PointOffsets"][number], steps["CellOffsets"][number, 0]
    first = steps["ConnectivityIdOffsets"][number, 0]
    offsets = root["Offsets"][cell + part : cell + part + k + 1]
    connectivity = root["Connectivity"][first : first + ids]
    fields = {}
    for data, size in (("PointData", m), ("CellData", k)):
        for name, values in root[data].items():
            begin = steps[f"{data}Offsets"][name][number]
            fields[name] = values[begin : begin + size]
    cells = np.array([connectivity[a:b] for a, b in itertools.pairwise(offsets)])
    return {
        **fields, "points": root["Points"][at : at + m], "cells": cells,
        "types": root["Types"][cell : cell + k],
    }  # fmt: skip


def last_state(path, number=-1):
    """The last state of a VTKHDF file, or another one."""
    with h5py.File(path) as file:
        count = int(file["VTKHDF/Steps"].attrs["NSteps"])
        return vtkhdf_step(file, number % count)
