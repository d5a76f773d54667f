"""``ringwear export`` of runs: for ParaView (.vtkhdf) and for spreadsheets (.csv, .xlsx)."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

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


class Cells(NamedTuple):
    """What a VTK file holds at t times: points, cells, fields on both."""

    #: (t, m, 3) float, mm; and (c, q) int, points of each cell, the same at all times
    points: FloatArray
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
    numbers, zeros = np.arange(count), np.zeros((count, 1), dtype=np.int64)
    arrays: dict[str, Any] = {
        "NumberOfPoints": [points],
        "NumberOfCells": [cells],
        "NumberOfConnectivityIds": [cells * corners],
        # one part, whose cells serve at all times
        "Connectivity": content.cells.ravel().astype(np.int64),
        "Offsets": corners * np.arange(cells + 1),
        "Types": np.full(cells, _QUADRANGLE if corners == 4 else _LINE, dtype=np.uint8),
        "Points": content.points.reshape(-1, 3),
        "Steps/Values": np.array(times, dtype=np.float64),
        "Steps/PartOffsets": zeros[:, 0],
        "Steps/NumberOfParts": np.ones_like(numbers),
        "Steps/PointOffsets": points * numbers,
        "Steps/CellOffsets": zeros,
        "Steps/ConnectivityIdOffsets": zeros,
    }
    for group, size, fields in (
        ("PointData", points, content.point_data),
        ("CellData", cells, content.cell_data),
    ):
        for name, values in fields.items():
            arrays[f"{group}/{name}"] = values.reshape(count * size, *values.shape[2:])
            arrays[f"Steps/{group}Offsets/{name}"] = size * numbers
    with atomic_hdf5(output) as file:
        root = file.create_group("VTKHDF")
        root.attrs["Version"] = np.array([2, 0])
        root.attrs.create("Type", b"UnstructuredGrid", dtype="S16")
        for group in ("PointData", "CellData"):  # there without fields, too
            root.create_group(group)
            root.create_group(f"Steps/{group}Offsets")
        for name, values in arrays.items():
            root[name] = np.asarray(values)
        root["Steps"].attrs["NSteps"] = np.int64(count)


def _boundary_cells(states: Sequence[BoundaryState]) -> Cells:
    """Return the contours of both bodies in the plane y = 0, along which theta points.

    An element is a line of three points.
    """

    def joined(name: str) -> Any:
        """Return an array of both bodies, (t, m or c, ...)."""
        return np.array([np.concatenate([getattr(b, name) for b in s.bodies]) for s in states])

    bodies = states[0].bodies
    cells = np.concatenate([bodies[0].elements, bodies[1].elements + len(bodies[0].nodes)])
    number = np.repeat([0, 1], [len(body.elements) for body in bodies])
    points, xyz = np.insert(joined("nodes"), 1, 0.0, axis=-1), (0, 2, 1)
    of_cells = {name: joined(name) for name in ("pressure", "wear", "face")}
    of_cells["traction"] = joined("traction")[..., xyz]
    of_cells["body"] = np.tile(number, (len(states), 1))
    return Cells(points, cells, {"displacement": joined("displacement")[..., xyz]}, of_cells)


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
