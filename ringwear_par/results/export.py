"""``ringwear export`` of runs: for ParaView (.vtkhdf) and for spreadsheets (.csv, .xlsx)."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ringwear_par.elasticity.sections import BODIES
from ringwear_par.elasticity.stress.fields import (
    COMPONENTS,
    SIDES,
    BoundaryState,
    StressState,
    max_shear,
    mises,
    principal,
)
from ringwear_par.errors import InputError, legible
from ringwear_par.files.spreadsheets import Table, check_xlsx, write_csv, write_xlsx
from ringwear_par.files.text import shortened
from ringwear_par.files.writing import check_writable
from ringwear_par.results.files import result_of, variables_of
from ringwear_par.results.key_numbers import check_numbers, key_numbers
from ringwear_par.results.laboratory_numbers import LABORATORY_NUMBERS
from ringwear_par.results.layers import Interface, interfaces_of, stresses
from ringwear_par.results.result import Result
from ringwear_par.results.variables import (
    HISTORIES,
    LAYER_HISTORIES,
    LAYER_PROFILES,
    LAYER_VOLUMES,
    PROFILES,
    Variable,
)
from ringwear_par.results.vtkhdf import (
    contours,
    interface_cells,
    stress_cells,
    surfaces,
    write_vtkhdf,
)

_MOST_SEGMENTS = 3600
#: options by the ending of the file: one of them, or --revolve and --scale
_CHOICES = {
    ".vtkhdf": ("--revolve", "--scale", "--stress", "--interfaces"),
    ".csv": ("--fields", "--stress", "--interfaces"),
    ".xlsx": (),
}
DECIMALS = ("point", "comma")


def export(
    run: Result | str | Path,
    output: Path,
    segments: int | None = None,
    scale: float | None = None,
    fields: bool = False,
    stress: bool = False,
    interfaces: bool = False,
    decimal: str = "point",
) -> str:
    """Write a result, or that of a file, in another format; return a sentence on the file.

    On one rank.

    Parameters
    ----------
    output : its ending chooses: .vtkhdf both bodies at all stored times, .csv a table, .xlsx all
        tables as sheets.
    segments : of the revolved surfaces; None: contours.
    scale : factor of the displacements that are added to the points; None: 0.
    fields : whether the table is that of the contact line rather than of the histories.
    stress : whether the stresses are written: of the grid for ParaView, as quadrangles, or of the
        points in a table.
    interfaces : whether the stresses along interfaces are written, as lines or in a table.
    decimal : "point" or "comma", of numbers in a .csv.

    Raises
    ------
    InputError : a file or a choice that cannot be, fields that the run has not stored.
    """
    check_writable(output)
    check_tables(output, decimal)
    wanted = {"--revolve": segments is not None, "--scale": scale is not None,
              "--fields": fields, "--stress": stress, "--interfaces": interfaces}  # fmt: skip
    chosen = [name for name, value in wanted.items() if value]
    allowed = _CHOICES.get(output.suffix)
    if allowed is None:
        raise InputError(f"{output}: its ending must be one of {', '.join(_CHOICES)}")
    if chosen not in ([], ["--revolve", "--scale"], *([name] for name in allowed)) or not (
        {*chosen} <= {*allowed}
    ):
        must = f"one of {', '.join(allowed)}" if allowed else "without options of runs"
        raise InputError(f"{' '.join(chosen)}: {output}: must be {must}")
    if segments is not None and not 3 <= segments <= _MOST_SEGMENTS:
        raise InputError(f"--revolve {shortened(segments)}: must be from 3 to {_MOST_SEGMENTS}")
    if scale is not None and not np.isfinite(scale):
        raise InputError(f"--scale {scale:g}: must be a number")
    result = result_of(run)
    if output.suffix == ".xlsx":
        return f"{output}: {write_xlsx(output, run_sheets(result))}"
    if output.suffix == ".csv":
        if interfaces:
            sheet = _interface_table(interfaces_of(result), stresses(result).states)
        elif stress:
            sheet = _stress_table(result)
        else:
            sheet = _contact_table(result) if fields else _history_table(result)
        write_csv(output, sheet, decimal)
        return f"{output}: {sheet[0]}"
    if interfaces:
        return _export_interfaces(result, output)
    if stress:
        return _export_stress(result, output)
    states, warp = boundary_states(result), scale or 0.0
    times = [state.time for state in states]
    contents = [surfaces(s, warp, segments) if segments else contours(s, warp) for s in states]
    write_vtkhdf(output, times, contents)
    return f"{output}: {_states_from(times)}"


def _states_from(times: Sequence[float]) -> str:
    """Return how many states there are, and their times (s)."""
    return f"{len(times)} states from {times[0]:g} to {times[-1]:g} s"


def check_tables(output: Path, decimal: str) -> None:
    """Refuse tables that cannot be written. Not collective.

    Raises
    ------
    InputError : decimal commas of something else than a .csv; openpyxl is missing.
    """
    if decimal not in DECIMALS or (decimal != "point" and output.suffix != ".csv"):
        raise InputError(
            f"--decimal {legible(decimal)}: {output}: must be {' or '.join(DECIMALS)}, and for "
            ".csv only"
        )
    if output.suffix == ".xlsx":
        check_xlsx(output)


def _export_stress(result: Result, output: Path) -> str:
    history = stresses(result)
    if not len(history.grid[0]):
        raise InputError(f"{result.name}: holds no grid of stresses; must have stress.grid")
    content = stress_cells(history)
    if not len(content[0].cells):
        raise InputError(
            f"{result.name}: nothing of stress.grid is left at the stored times: wear has gone "
            "through it; must reach deeper, or stress.times be earlier"
        )
    times = [state.time for state in history.states]
    write_vtkhdf(output, times, content)
    return f"{output}: stress, {_states_from(times)}"


def _export_interfaces(result: Result, output: Path) -> str:
    interfaces, states = interfaces_of(result), stresses(result).states
    times = [state.time for state in states]
    write_vtkhdf(output, times, [interface_cells(interfaces, state) for state in states])
    return f"{output}: stress along the interfaces, {_states_from(times)}"


def run_sheets(result: Result) -> list[Table]:
    """Return the tables of a run: key numbers, histories, and what else it has stored."""
    sheets = [_number_table(result), _history_table(result)]
    if result.profiles or result.layers:
        sheets.append(_contact_table(result))
    if result.stress is not None and result.stress.states and len(result.stress.points):
        sheets.append(_stress_table(result))
    return sheets


def _number_table(result: Result) -> Table:
    """Return the key numbers at the end, and the checks."""
    numbers = [*key_numbers(result), *check_numbers(result)]
    rows = [(n.group, n.label, float(n.value), n.unit, n.note) for n in numbers]
    return "numbers", ("group", "quantity", "value", "unit", "note"), rows


def _interface_table(interfaces: Sequence[Interface], states: Sequence[StressState]) -> Table:
    """Return the stresses along interfaces, a row for each state, interface, side and element."""
    header = [
        "step", "time (s)", "body", "layer", "side", "r (mm)", "z (mm)",
        *(f"{name} (MPa)" for name in COMPONENTS), "mises (MPa)",
    ]  # fmt: skip
    rows = (
        [state.step, state.time, BODIES[line.body], line.layer, side, r, line.z, *row]
        for state in states
        for line in interfaces
        for side, stress in zip(SIDES, line.stress(state), strict=True)
        for r, row in zip(
            line.r.tolist(), np.column_stack([stress, mises(stress)]).tolist(), strict=True
        )
    )
    return "stress along the interfaces", header, rows


def _stress_table(result: Result) -> Table:
    """Return the stresses at points, a row for each stored state and point."""
    history = stresses(result)
    if not len(history.points):
        raise InputError(f"{result.name}: holds no stresses at points; must have stress.points")
    header = [
        "step", "time (s)", "r (mm)", "z (mm)", *(f"{name} (MPa)" for name in COMPONENTS),
        "mises (MPa)", "max_shear (MPa)", *(f"principal_{i} (MPa)" for i in (1, 2, 3)), "side",
    ]  # fmt: skip
    places = history.points.tolist()
    rows = (
        [state.step, state.time, *place, *row, side]
        for state in history.states
        for place, side, row in zip(
            places, history.sides,
            np.column_stack(
                [state.points, mises(state.points), max_shear(state.points),
                 principal(state.points)]
            ).tolist(),
            strict=True,
        )
    )  # fmt: skip
    return "stress", header, rows


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


def _history_table(result: Result) -> Table:
    """Return the histories, a row for each stored state."""
    columns: dict[str, Any] = {"step": result.step}
    variables = variables_of(result)
    for name in (*HISTORIES, *LAYER_HISTORIES, *LAYER_VOLUMES, *LABORATORY_NUMBERS):
        variable, values = variables.get(name, (HISTORIES["time"], np.empty((0, 0))))
        if values.ndim == 1:
            columns[titled(variable)] = values
        for i, column in enumerate(values.T if values.ndim == 2 else ()):
            columns[titled(variable.named(f"{name}[{i}]"))] = column
    return "histories", [*columns], zip(*(c.tolist() for c in columns.values()), strict=True)


def _contact_table(result: Result) -> Table:
    """Return the contact line, a row for each stored state and element."""
    variables, fields = {**PROFILES, **LAYER_PROFILES}, {**result.profiles, **result.layers}
    names = [name for name in variables if name in fields]
    if not names:
        raise InputError(f"{result.name}: holds no field of the contact line (output.fields)")
    tables = [np.atleast_2d(fields[name]) for name in names]
    stored, n = tables[0].shape  # one row where the last state's fields are stored only
    steps, times = result.step[-stored:], result.histories["time"][-stored:]
    header = ["step", "time (s)", "element", "r (mm)"]
    columns = [
        np.repeat(steps, n), np.repeat(times, n), np.tile(np.arange(n), stored),
        np.tile(result.line.r, stored), *(table.ravel() for table in tables),
    ]  # fmt: skip
    header += [titled(variables[name]) for name in names]
    rows = zip(*(column.tolist() for column in columns), strict=True)
    return "contact line", header, rows


def titled(variable: Variable) -> str:
    """Return the name of a variable with its unit, as headers have it."""
    return variable.name if variable.unit == "1" else f"{variable.name} ({variable.unit})"
