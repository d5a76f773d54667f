"""``ringwear export``: stored results for ParaView and for spreadsheets (.csv)."""

import csv
from collections.abc import Iterable, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from ringwear_par.atomic import atomic_write, check_writable
from ringwear_par.cases.text import shortened
from ringwear_par.elasticity.boundary_fields import BODIES, BoundaryState
from ringwear_par.elasticity.stress.fields import StressState
from ringwear_par.elasticity.stress.measures import COMPONENTS, SIDES, max_shear, mises, principal
from ringwear_par.errors import InputError, legible
from ringwear_par.results.result import Result
from ringwear_par.results.storage.cells import (
    Cells,
    contours,
    interface_cells,
    stress_cells,
    surfaces,
)
from ringwear_par.results.storage.result_files import result_of
from ringwear_par.results.storage.stored_stresses import (
    Interface,
    interfaces_of,
    nearest_states,
    stresses,
)
from ringwear_par.results.storage.vtkhdf import write_vtkhdf
from ringwear_par.results.variables import (
    HISTORIES,
    LAYER_HISTORIES,
    LAYER_PROFILES,
    LAYER_VOLUMES,
    PROFILES,
    Variable,
)

SEGMENTS, _MOST_SEGMENTS = 72, 3600
_ENDINGS = (".vtkhdf", ".vtp", ".vtu", ".csv")
#: of stresses, and what is written so
_STRESS_ENDINGS = {".vtu": "the grid", ".vtkhdf": "the grid", ".csv": "the points"}
_INTERFACE_ENDINGS = {".vtp": "lines", ".csv": "a table"}


def export(
    run: Result | str | Path,
    output: Path,
    time: float | None = None,
    segments: int | None = None,
    scale: float | None = None,
    fields: bool = False,
    stress: bool = False,
    typed: str = "",
    interfaces: bool = False,
) -> str:
    """Write a result, or that of a file, in another format; return what was written. On one rank.

    Parameters
    ----------
    output : its ending chooses: .vtp the contours of both bodies, .vtu their revolved surfaces,
        .vtkhdf either at all stored times, .csv a table.
    time : s, the stored boundary state nearest to it is taken; None: the last. Of .vtp and .vtu.
    segments : of the revolved surface; None: 72 for .vtu, contours for .vtkhdf.
    scale : factor of the displacements that are added to the points; None: 0.
    fields : whether the table is that of the contact line rather than of the histories.
    stress : whether the stresses are written: of the grid for ParaView, as quadrangles, or of the
        points in a table.
    typed : how the time was written, for messages; "": it was a number.
    interfaces : whether the stresses along interfaces are written, as lines or in a table.

    Raises
    ------
    InputError : a file or a choice that cannot be, fields that the run has not stored.
    """
    check_export(output, time, segments, scale, fields, stress, typed, interfaces)
    result = result_of(run)
    if interfaces:
        return _export_interfaces(result, output, time)
    if stress:
        return _export_stress(result, output, time)
    if output.suffix == ".csv":
        header, rows = _contact_table(result) if fields else _history_table(result)
        _write_csv(output, header, rows)
        return f"{output}: {'contact line' if fields else 'histories'}"
    warp = scale or 0.0
    if output.suffix == ".vtkhdf":
        states = _states(result)
        write_vtkhdf(
            output,
            [state.time for state in states],
            [surfaces(s, warp, segments) if segments else contours(s, warp) for s in states],
        )
        return f"{output}: {len(states)} states from {states[0].time:g} to {states[-1].time:g} s"
    state = choose_state(result, time)
    lines = output.suffix == ".vtp"
    content = contours(state, warp) if lines else surfaces(state, warp, segments or SEGMENTS)
    _write_vtk(output, content)
    return (
        f"{output}: {state.time:g} s (step {state.step}), {len(content.points)} points, "
        f"{len(content.cells)} cells"
    )


def check_export(
    output: Path,
    time: float | None,
    segments: int | None,
    scale: float | None,
    fields: bool,
    stress: bool = False,
    typed: str = "",
    interfaces: bool = False,
) -> None:
    """Refuse what cannot be exported, before anything is read. Not collective.

    Parameters
    ----------
    typed : how the time was written, for messages; "": it was a number.

    Raises
    ------
    InputError : the reason, in one sentence.
    """
    ending = output.suffix
    for option, asked, endings in (
        ("--interfaces", interfaces, _INTERFACE_ENDINGS),
        ("--stress", stress and not interfaces, _STRESS_ENDINGS),
    ):
        if asked and ending not in endings:
            *others, last = (f"{end} ({what})" for end, what in endings.items())
            raise InputError(
                f"{option}: {output}: its ending must be {', '.join(others)} or {last}"
            )
    if ending not in _ENDINGS:
        raise InputError(f"{output}: its ending must be one of {', '.join(_ENDINGS)}")
    check_writable(output)
    if interfaces and (segments is not None or scale is not None or fields or stress):
        raise InputError(
            f"--interfaces: {output}: must be without --revolve, --scale, --fields, --stress"
        )
    if stress and (segments is not None or scale is not None or fields):
        raise InputError(f"--stress: {output}: must be without --revolve, --scale, --fields")
    if fields and ending != ".csv":
        raise InputError(f"--fields: {output} is no table; must be absent but for .csv")
    surface = ending in (".vtu", ".vtkhdf")
    if segments is not None and not (surface and 3 <= segments <= _MOST_SEGMENTS):
        raise InputError(
            f"--revolve {shortened(segments)}: must be from 3 to {_MOST_SEGMENTS}, and for .vtu "
            "and .vtkhdf only"
        )
    shown = legible(typed) if typed or time is None else f"{time:g}"
    if time is not None and ending not in (".vtp", ".vtu"):
        options = {"--stress ": stress, "--interfaces ": interfaces, "--fields ": fields}
        option = next((option for option, there in options.items() if there), "")
        raise InputError(
            f"--time {shown}: must be absent for {ending}, it is for .vtp and .vtu only; "
            f"{option or f'{ending} '}writes all stored steps"
        )
    if time is not None and not np.isfinite(time):
        raise InputError(f"--time {shown}: must be a number")
    if scale is not None and (ending == ".csv" or not np.isfinite(scale)):
        raise InputError(f"--scale {scale:g}: must be a number, and for ParaView's files only")
    if ending in (".vtp", ".vtu"):
        try:
            import pyevtk  # noqa: F401
        except ImportError as error:
            raise InputError(
                f"{output}: needs the Python package pyevtk; pip install 'ringwear-par[export]'"
            ) from error


def _export_stress(result: Result, output: Path, time: float | None) -> str:
    history = stresses(result)
    if output.suffix == ".csv":
        _write_csv(output, *_stress_table(result))
        return f"{output}: stress at {len(history.points)} points, {len(history.states)} states"
    if not len(history.grid[0]):
        raise InputError(f"{result.name}: holds no grid of stresses; must have stress.grid")
    content = stress_cells(history)
    if not len(content[0].cells):
        raise InputError(
            f"{result.name}: nothing of stress.grid is left at the stored times: wear has gone "
            "through it; must reach deeper, or stress.times be earlier"
        )
    if output.suffix == ".vtkhdf":
        times = [state.time for state in history.states]
        write_vtkhdf(output, times, content)
        return f"{output}: stress, {len(times)} states from {times[0]:g} to {times[-1]:g} s"
    chosen = len(content) - 1
    if time is not None:
        _check_time(result, time)
        chosen = int(np.argmin([abs(state.time - time) for state in history.states]))
    _write_vtk(output, content[chosen])
    return (
        f"{output}: stress at {history.states[chosen].time:g} s, {len(content[chosen].points)} "
        f"points, {len(content[chosen].cells)} cells"
    )


def _export_interfaces(result: Result, output: Path, time: float | None) -> str:
    interfaces, states = interfaces_of(result), stresses(result).states
    if output.suffix == ".csv":
        _write_csv(output, *_interface_table(interfaces, states))
        return f"{output}: stress along the interfaces, {len(states)} states"
    if time is not None:
        _check_time(result, time)
    (state,) = nearest_states(states, () if time is None else (time,))
    _write_vtk(output, interface_cells(interfaces, state))
    return f"{output}: stress along the interfaces at {state.time:g} s"


def _interface_table(
    interfaces: Sequence[Interface], states: Sequence[StressState]
) -> tuple[list[str], Iterable[Sequence[Any]]]:
    """Return the stresses along interfaces, a row for each state, interface, side and element."""
    header = [
        "step", "time (s)", "body", "layer", "side", "r (mm)", "z (mm)",
        *(f"{name} (MPa)" for name in COMPONENTS), "mises (MPa)",
    ]  # fmt: skip
    rows = (
        [state.step, state.time, BODIES[of.body], of.layer, side, r, of.z, *row]
        for state in states
        for of in interfaces
        for side, stress in zip(SIDES, of.stress(state), strict=True)
        for r, row in zip(
            of.r.tolist(), np.column_stack([stress, mises(stress)]).tolist(), strict=True
        )
    )
    return header, rows


def _stress_table(result: Result) -> tuple[list[str], Iterable[Sequence[Any]]]:
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
    return header, rows


def _states(result: Result) -> Sequence[BoundaryState]:
    if not result.boundary:
        raise InputError(
            f"{result.name}: holds no fields on the bodies' boundaries; must be computed with "
            'output.boundary = "last" or "all", or with times'
        )
    return result.boundary


def choose_state(result: Result, time: float | None) -> BoundaryState:
    """Return the stored boundary state nearest to a time, the last one for None.

    Raises
    ------
    InputError : there is none, or the run does not get there.
    """
    states = _states(result)
    if time is None:
        return states[-1]
    _check_time(result, time)
    return min(states, key=lambda state: abs(state.time - time))


def _check_time(result: Result, time: float) -> None:
    end = float(result.histories["time"][-1])
    if not 0.0 <= time <= end * (1.0 + 1e-9):
        raise InputError(f"--time {time:g}: must be from 0 to {end:g} s, the end of {result.name}")


def _columns(values: Any) -> Any:
    """Return what pyevtk takes: an array, or a tuple of contiguous components."""
    if values.ndim == 1:
        return np.ascontiguousarray(values)
    return tuple(np.ascontiguousarray(column) for column in values.T)


def _write_vtk(output: Path, content: Cells) -> None:
    """Write lines to a .vtp or quadrangles to a .vtu file, by rename."""
    from pyevtk.vtk import VtkFile, VtkFileType, VtkQuad

    lines = output.suffix == ".vtp"
    count, corners = content.cells.shape
    topology = {
        "connectivity": content.cells.ravel(),
        "offsets": corners * np.arange(1, count + 1),
    }
    if not lines:
        topology["types"] = np.full(count, VtkQuad.tid, dtype=np.uint8)
    groups: list[tuple[str, Mapping[str, Any]]] = [
        ("Points", {"points": _columns(content.points)}),
        ("Lines" if lines else "Cells", topology),
        ("PointData", {name: _columns(v) for name, v in content.point_data.items()}),
        ("CellData", {name: _columns(v) for name, v in content.cell_data.items()}),
    ]
    with atomic_write(output) as temporary:
        # pyevtk would append an ending
        kind = VtkFileType("PolyData" if lines else "UnstructuredGrid", "")
        file = VtkFile(str(temporary), kind)
        with closing(file.xml.stream):  # which pyevtk leaves open where it fails
            file.openGrid()
            sizes = {"nlines": count} if lines else {"ncells": count}
            file.openPiece(npoints=len(content.points), **sizes)
            for group, arrays in groups:
                file.openElement(group)
                for name, values in arrays.items():
                    file.addData(name, values)
                file.closeElement(group)
            file.closePiece()
            file.closeGrid()
            for _, arrays in groups:
                for values in arrays.values():
                    file.appendData(values)
            file.save()


def _history_table(result: Result) -> tuple[list[str], Iterable[Sequence[Any]]]:
    """Return the histories, a row for each stored state."""
    header = ["step", *map(_titled, HISTORIES.values())]
    columns = [result.step, *(result.histories[name] for name in HISTORIES)]
    for name, values in result.layers.items():
        if name in LAYER_HISTORIES:
            header.append(_titled(LAYER_HISTORIES[name]))
            columns.append(values)
        elif name in LAYER_VOLUMES:
            volume = LAYER_VOLUMES[name]
            header += [_titled(volume.named(f"{name}[{i}]")) for i in range(values.shape[1])]
            columns += list(values.T)
    return header, zip(*(column.tolist() for column in columns), strict=True)


def _contact_table(result: Result) -> tuple[list[str], Iterable[Sequence[Any]]]:
    """Return the contact line, a row for each stored state and element."""
    known, there = {**PROFILES, **LAYER_PROFILES}, {**result.profiles, **result.layers}
    names = [name for name in known if name in there]
    if not names:
        raise InputError(f"{result.name}: holds no field of the contact line (output.fields)")
    tables = [np.atleast_2d(there[name]) for name in names]
    stored, n = tables[0].shape  # one row where the last state's fields are stored only
    steps, times = result.step[-stored:], result.histories["time"][-stored:]
    header = ["step", "time (s)", "element", "r (mm)"]
    columns = [
        np.repeat(steps, n), np.repeat(times, n), np.tile(np.arange(n), stored),
        np.tile(result.line.r, stored), *(table.ravel() for table in tables),
    ]  # fmt: skip
    header += [_titled(known[name]) for name in names]
    return header, zip(*(column.tolist() for column in columns), strict=True)


def _titled(variable: Variable) -> str:
    return variable.name if variable.unit == "1" else f"{variable.name} ({variable.unit})"


def _write_csv(output: Path, header: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """Write a table by rename; numbers keep all their digits."""
    with (
        atomic_write(output) as temporary,
        temporary.open("w", newline="", encoding="utf-8") as file,
    ):
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        writer.writerows(rows)
