"""``ringwear export`` of runs: for ParaView (.vtkhdf) and for spreadsheets (.csv, .xlsx)."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ringwear_par.elasticity.sections import BODIES
from ringwear_par.elasticity.stress.fields import BoundaryState
from ringwear_par.errors import InputError
from ringwear_par.files.spreadsheets import Table, check_xlsx, write_csv, write_xlsx
from ringwear_par.files.writing import check_writable
from ringwear_par.results.files import result_of
from ringwear_par.results.key_numbers import check_numbers, key_numbers
from ringwear_par.results.laboratory_numbers import LABORATORY_NUMBERS
from ringwear_par.results.result import Result
from ringwear_par.results.variables import VARIABLES, Variable
from ringwear_par.results.vtkhdf import boundary_cells, stress_cells, write_vtkhdf

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
        what, times, cells = "stress", result.data["stress_time"], stress_cells(result.data)
    else:
        times = [state.time for state in boundary_states(result)]
        what, cells = "both bodies", boundary_cells(result.data)
    if not len(cells.cells):
        raise InputError(
            f"{result.name}: nothing of stress.grid is left at the stored times: wear has gone "
            "through it; must reach deeper, or stress.times be earlier"
        )
    write_vtkhdf(output, times, cells)
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
    for variable in (data[n] for n in (*VARIABLES, *LABORATORY_NUMBERS) if n in data.data_vars):
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
    header = [_titled(n, table[n].attrs.get("units", "1")) for n in names]
    return name, header, frame.itertuples(index=False, name=None)


def boundary_states(result: Result) -> Sequence[BoundaryState]:
    """Return the stored states of both bodies' boundaries.

    Raises
    ------
    InputError : there are none.
    """
    if not result.boundary:
        raise InputError(
            f"{result.name}: holds no fields on the bodies' boundaries; must be computed with "
            'output.boundary = "last" or "all", or with times'
        )
    return result.boundary


def titled(variable: Variable) -> str:
    """Return the name of a variable with its unit, as headers have it."""
    return _titled(variable.name, variable.unit)


def _titled(name: str, unit: str) -> str:
    return name if unit == "1" else f"{name} ({unit})"
