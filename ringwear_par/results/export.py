"""``ringwear export`` of runs: for ParaView (.vtkhdf) and for spreadsheets (.csv, .xlsx)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.elasticity.stress.fields import COMPONENTS, BoundaryState, max_shear, mises
from ringwear_par.errors import InputError
from ringwear_par.files.spreadsheets import Table, check_xlsx, write_csv, write_xlsx
from ringwear_par.files.writing import check_writable
from ringwear_par.results.fields import boundaries
from ringwear_par.results.files import atomic_hdf5, result_of
from ringwear_par.results.key_numbers import check_numbers, key_numbers
from ringwear_par.results.result import Result
from ringwear_par.results.variables import VARIABLES

if TYPE_CHECKING:
    import xarray

_ENDINGS = (".vtkhdf", ".csv", ".xlsx")
#: axes of the rows of each table, and those that become columns of it
_COLUMNS = ("layer", "layer_upper", "component", "principal_value")
_TABLES = {
    "histories": ("step",),
    "contact line": ("step", "element"),
    "contact line, last": ("element",),
    "largest stress": ("stress_step",),
    "stress at points": ("stress_step", "point"),
    **{
        f"interfaces of {body}": (
            "stress_step", f"interface_{body}", "side", f"interface_element_{body}",
        )
        for body in BODIES
    },
}  # fmt: skip
#: VTK's numbers of a line through several points, and of a quadrangle
_LINE, _QUADRANGLE = 4, 9


def export(run: Result | str | Path, output: Path) -> str:
    """Write a result, or that of a file, in another format; return a sentence on the file.

    On one rank.

    Parameters
    ----------
    output : its ending chooses: .vtkhdf the stored boundaries of both bodies, else the grid of
        stresses; .csv the histories; .xlsx all tables as sheets.

    Raises
    ------
    InputError : a file that cannot be, fields that the run has not stored.
    """
    check_writable(output)
    if output.suffix not in _ENDINGS:
        raise InputError(f"{output}: its ending must be one of {', '.join(_ENDINGS)}")
    if output.suffix == ".xlsx":
        check_xlsx(output)
    result = result_of(run)
    if output.suffix == ".xlsx":
        return f"{output}: {write_xlsx(output, run_sheets(result))}"
    if output.suffix == ".csv":
        write_csv(output, _table(result.to_xarray(), "histories"))
        return f"{output}: histories"
    if "stress_grid" in result.data and not result.boundary:
        what, times, cells = "stress", result.data["stress_time"], _stress_cells(result.data)
    else:
        states = boundaries(result)
        what, times = "both bodies", [state.time for state in states]
        cells = _boundary_cells(states)
    if not len(cells.cells):
        raise InputError(
            f"{result.name}: nothing of stress.grid is left at the stored times: wear has gone "
            "through it; must reach deeper, or stress.times be earlier"
        )
    _write_vtkhdf(output, times, cells)
    return f"{output}: {what}, {len(times)} states from {times[0]:g} to {times[-1]:g} s"


def run_sheets(result: Result) -> list[Table]:
    """Return the tables of a run: key numbers, histories, and what else it has stored."""
    numbers = [*key_numbers(result), *check_numbers(result)]
    rows = [(n.group, n.label, float(n.value), n.unit, n.note) for n in numbers]
    tables = [_table(result.to_xarray(), name) for name in _TABLES]
    header = ("group", "quantity", "value", "unit", "note")
    return [("numbers", header, rows), *(table for table in tables if table[1])]


def _table(data: "xarray.Dataset", name: str) -> Table:
    """Return the variables over the axes of a table, a row for each place on these axes.

    Where there are none, the table has no columns.
    """
    import xarray

    axes, columns = _TABLES[name], {}
    for variable in (data[n] for n in VARIABLES if n in data.data_vars):
        if variable.dims == axes:
            columns[str(variable.name)] = variable
        elif variable.dims[:-1] == axes and variable.dims[-1] in _COLUMNS:
            rest = variable.dims[-1]
            for i, entry in enumerate(data[rest].values.tolist()):
                columns[f"{variable.name}[{entry}]"] = variable.isel({rest: i}, drop=True)
    if not columns:
        return name, (), ()
    table = xarray.Dataset(columns)
    names = [*axes, *(str(c) for c in table.coords if c not in axes), *columns]
    frame = table.to_dataframe(dim_order=[*axes]).reset_index()[names]
    header = [titled(n, table[n].attrs.get("units", "1")) for n in names]
    return name, header, frame.itertuples(index=False, name=None)


def titled(name: str, unit: str) -> str:
    """Return the name of a variable with its unit, as headers have it."""
    return name if unit == "1" else f"{name} ({unit})"


# -- for ParaView ----------------------------------------------------------------------------------


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


def _write_vtkhdf(output: Path, times: Sequence[float], content: Cells) -> None:
    """Write cells at several times, s, by rename, as VTKHDF 2.0, which ParaView 5.12 reads.

    Raises
    ------
    OSError : the file.
    """
    (count, points, _), (cells, corners) = content.points.shape, content.cells.shape
    numbers = np.arange(count, dtype=np.int64)
    with atomic_hdf5(output) as file:
        root = file.create_group("VTKHDF")
        root.attrs["Version"] = np.array([2, 0])
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
        root["Types"] = np.full(cells, _QUADRANGLE if corners == 4 else _LINE, dtype=np.uint8)
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


def _boundary_cells(states: Sequence[BoundaryState]) -> Cells:
    """Return the contours of both bodies in the plane y = 0, along which theta points.

    An element is a line of three points.
    """

    def joined(name: str, columns: Sequence[int] | None = None) -> Any:
        """Return an array of both bodies, (t, m or c, ...)."""
        values = [
            np.concatenate([getattr(body, name) for body in state.bodies]) for state in states
        ]
        return np.array(values) if columns is None else np.array(values)[..., columns]

    bodies = states[0].bodies
    cells = np.concatenate([bodies[0].elements, bodies[1].elements + len(bodies[0].nodes)])
    number = np.repeat([0, 1], [len(body.elements) for body in bodies])
    nodes, xyz = joined("nodes"), (0, 2, 1)
    points = np.stack([nodes[..., 0], np.zeros(nodes.shape[:2]), nodes[..., 1]], axis=-1)
    of_cells = {name: joined(name) for name in ("pressure", "wear", "face")}
    of_cells |= {"traction": joined("traction", xyz), "body": np.tile(number, (len(states), 1))}
    return Cells(points, cells, {"displacement": joined("displacement", xyz)}, of_cells)


def _stress_cells(data: Mapping[str, Any]) -> Cells:
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
