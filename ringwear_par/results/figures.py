"""Figures from stored results: worn profiles, histories, pressure profiles, deformed sections."""

import io
import math
import re
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.atomic import atomic_write, check_writable
from ringwear_par.cases.case import Output
from ringwear_par.cases.keys import read_keys
from ringwear_par.cases.schema import UNITS
from ringwear_par.cases.text import shortened
from ringwear_par.cases.values import is_number
from ringwear_par.elasticity.boundary_fields import FACES, BoundaryFields
from ringwear_par.elasticity.mesh import ContactLine, node_wear
from ringwear_par.errors import InputError, legible
from ringwear_par.results.export import choose_state
from ringwear_par.results.files import result_of
from ringwear_par.results.result import FailedResult, Result

Source = Result | str | Path

STYLE: dict[Any, Any] = {
    "font.size": 9.0,
    "axes.titlesize": 9.0,
    "legend.fontsize": 8.0,
    "lines.linewidth": 1.3,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "savefig.dpi": 200,
}
#: line styles that stay apart in print without colour
_DASHES = ("-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)))
_COLUMNS = 3
#: as many points of a curve, or fewer, are marked
_FEW_POINTS = 20
COLOURS = ("#1b4f8a", "#c1440e", "#3a7d44", "#6a4c93", "#444444")


def plot(
    results: Source | Sequence[Source],
    panels: str | Sequence[str] = "wear,penetration",
    steps: str = "",
    profiles_of: Sequence[Source] = (),
) -> Figure:
    """Return the panels of one or more results side by side. Not collective.

    Profiles (``wear``, ``pressure``) and deformed sections (``section``, the last one stored) are
    drawn of every result, one panel each; the histories of all of them share a panel
    (``penetration``).

    Parameters
    ----------
    results : a result or a result file, or several.
    panels : names, in a list or separated by commas.
    steps : comma-separated step numbers of the profiles; "" for the first step and four quarters.
    profiles_of : those of the results whose profiles and sections are drawn; () for all.

    Raises
    ------
    InputError : a file that is not a result, an unknown panel, a step not stored.
    """
    given: Any = results
    one = isinstance(given, str) or not isinstance(given, Iterable)
    sources = [given] if one else [*given]
    for number, source in enumerate(sources, 1):
        if isinstance(source, FailedResult):
            why = str(source.error).partition("\n")[0]
            raise InputError(f"plot: result {number} failed ({why}); must be results only")
        if not isinstance(source, Result | str | Path):
            told = type(source).__name__
            raise InputError(f"plot: result {number} is a {told}; must be a result or its file")
    names = panels.split(",") if isinstance(panels, str) else list(panels)
    with matplotlib.rc_context(STYLE):
        return _drawn_panels([_place(s) for s in sources], names, steps, map(_place, profiles_of))


def plot_files(
    paths: Sequence[Path],
    output: Path,
    panels: str = "wear,penetration",
    steps: str = "",
    profiles_of: Sequence[Path] = (),
) -> None:
    """Write a picture of one or more result files, see ``plot``. On one rank.

    Parameters
    ----------
    output : its ending chooses the format.

    Raises
    ------
    InputError : what ``plot`` refuses, or another format.
    """
    check_figure(output)
    save_figure(plot(paths, panels, steps, profiles_of), output)


def save_figure(figure: Figure, output: Path) -> None:
    """Write a picture by rename, in the format of its ending. On one rank.

    Raises
    ------
    InputError : what is drawn is too large for matplotlib's axes.
    OSError : the disk or the folder.
    """
    picture = io.BytesIO()  # backends leave files open where the disk fails
    with matplotlib.rc_context(STYLE):
        try:
            figure.savefig(picture, format=output.suffix[1:].lower())
        except ArithmeticError as error:
            raise InputError(f"{output}: cannot be drawn: {error}; values are too large") from error
    with atomic_write(output) as temporary:
        temporary.write_bytes(picture.getbuffer())


def _place(source: Source) -> Result | Path:
    return Path(source) if isinstance(source, str) else source


def _drawn_panels(
    sources: Sequence[Result | Path],
    panels: Sequence[str],
    steps: str,
    profiles_of: Iterable[Result | Path],
) -> Figure:
    results = [result_of(source) for source in sources]
    chosen = list(profiles_of)
    for source in chosen:
        if source not in sources:
            name = source.name if isinstance(source, Result) else source
            raise InputError(f"--profiles-of {name}: must be one of the result files to be drawn")
    labels = _labels(results)
    profiled = [
        (result, label)
        for source, result, label in zip(sources, results, labels, strict=True)
        if not chosen or source in chosen
    ]
    drawings: list[Callable[..., None]] = []
    for panel in panels:
        if panel == "penetration":
            drawings.append(partial(_penetration, results=results, labels=labels))
        elif panel in ("wear", "pressure"):
            profile = _wear if panel == "wear" else _pressure
            for result, label in profiled:
                rows = _rows(result, steps)
                drawings.append(partial(profile, result=result, label=label, rows=rows))
        elif panel == "section":
            for result, label in profiled:
                choose_state(result, None)  # refuses a file without
                drawings.append(partial(_section, result=result, label=label))
        else:
            raise InputError(
                f"--panels {legible(','.join(panels))}: {legible(panel)!r} must be one of wear, "
                "penetration, pressure, section"
            )
    columns = min(len(drawings), _COLUMNS)
    lines = -(-len(drawings) // columns)
    # sections have the same scale along both axes and leave room that constrained ones keep
    layout: Any = "compressed" if set(panels) == {"section"} else "constrained"
    figure = Figure(figsize=(3.6 * columns, 3.3 * lines), layout=layout)
    for number, draw in enumerate(drawings):
        axes = figure.add_subplot(lines, columns, number + 1)
        # else taken when the figure is drawn, where another style may hold
        axes.tick_params(labelsize=STYLE["font.size"])
        draw(axes)
    titles = {str(result.attributes["title"]) for result in results} - {""}
    if len(titles) == 1:
        figure.suptitle(plain(titles.pop()), fontsize=8.0)
    return figure


def check_figure(output: Path, stored: Output | None = None) -> None:
    """Refuse a picture that cannot be written, or drawn from what a case stores. Not collective.

    Raises
    ------
    InputError : the reason.
    """
    check_writable(output)
    formats = Figure().canvas.get_supported_filetypes()
    if output.suffix[1:].lower() not in formats:
        raise InputError(f"{output}: its ending must be one of {', '.join(sorted(formats))}")
    if stored is None:
        return
    missing = {"wear_lower", "wear_upper"} - set(stored.fields)
    if missing:
        raise InputError(
            f"{output}: needs {' and '.join(sorted(missing))}, which output.fields leaves out"
        )
    if stored.profiles != "all":
        raise InputError(f'{output}: needs output.profiles = "all"')


def _rows(result: Result, steps: str) -> list[int]:
    stored, last = result.step, int(result.step[-1])
    if not steps:
        time = result.histories["time"]
        wished = (time[min(1, len(time) - 1)], *(time[-1] * q / 4 for q in (1, 2, 3, 4)))
        return sorted({int(np.abs(time - t).argmin()) for t in wished})
    rows = []
    for word in steps.split(","):
        if not re.fullmatch(r"\s*[0-9]{1,18}\s*", word) or int(word) not in stored:
            raise InputError(
                f"--steps {legible(steps)}: {legible(word)!r} is not a stored step of "
                f"{result.name}; must be among 0..{last} as stored (output.every)"
            )
        rows.append(int(np.flatnonzero(stored == int(word))[0]))
    return rows


def _field(result: Result, name: str) -> Any:
    if name not in result.profiles:
        raise InputError(
            f"{result.name}: does not hold {name}; output.fields of its case left it out"
        )
    if result.profiles[name].ndim == 1:
        raise InputError(
            f"{result.name}: holds {name} of the last step only; must be computed with "
            'output.profiles = "all"'
        )
    return result.profiles[name]


def plain(text: str) -> str:
    """Return a text of a user as matplotlib draws it, letter by letter, on one line."""
    return legible(text, 200).replace("$", r"\$")


def _labels(results: Sequence[Result]) -> list[str]:
    """Name each result by what sets its case apart, or by its file where that is too much."""
    cases = [read_keys(result.case, result.name) for result in results]
    paths = [
        path for path in UNITS if path != "title" and len({str(c.get(path)) for c in cases}) > 1
    ]
    if not 1 <= len(paths) <= 2 or any(path not in case for path in paths for case in cases):
        return [
            f"result {number}" if result.path is None else plain(result.path.stem)
            for number, result in enumerate(results, 1)
        ]
    names = [path.rpartition(".")[2] for path in paths]
    units = [f" {UNITS[path]}" if UNITS[path] not in ("-", "1") else "" for path in paths]
    return [
        ", ".join(
            f"{name} = {case[path]:g}{unit}" if is_number(case[path])
            else plain(f"{name} = {shortened(case[path])}")
            for name, path, unit in zip(names, paths, units, strict=True)
        )
        for case in cases
    ]  # fmt: skip


def _profiles(
    axes: Any, result: Result, label: str, rows: Sequence[int], curve: Callable[[int], Any]
) -> None:
    time = result.histories["time"]
    for number, row in enumerate(rows):
        axes.plot(
            result.line.r, curve(row), color=COLOURS[number % len(COLOURS)],
            linestyle=_DASHES[number % len(_DASHES)], label=f"{time[row]:.3g} s",
        )  # fmt: skip
    axes.set_xlabel("distance to axis (mm)")
    axes.set_title(label)


def _wear(axes: Any, result: Result, label: str, rows: Sequence[int]) -> None:
    """Worn profiles: the contact face of lower falls below 0, that of upper rises above it."""
    inner, outer = result.line.edges[[0, -1]]
    margin = 0.15 * (outer - inner)
    lower, upper = _field(result, "wear_lower"), _field(result, "wear_upper")
    _profiles(axes, result, label, rows, lambda row: -1e3 * lower[row])
    if upper.any():
        for number, row in enumerate(rows):
            axes.plot(
                result.line.r, 1e3 * upper[row], color=COLOURS[number % len(COLOURS)],
                linestyle=_DASHES[number % len(_DASHES)],
            )  # fmt: skip
        axes.set_ylabel("worn profiles (\N{MICRO SIGN}m): lower < 0 < upper")
    else:
        axes.set_ylabel("wear depth (\N{MICRO SIGN}m)")
    axes.plot([max(inner - margin, 0.0), inner], [0, 0], color="0.4", linewidth=0.8)
    axes.plot([outer, outer + margin], [0, 0], color="0.4", linewidth=0.8)
    axes.set_xlim(max(inner - margin, 0.0), outer + margin)
    low, high = axes.get_ylim()
    axes.set_ylim(low - 0.3 * (high - low), high)  # room for the legend
    axes.legend(frameon=False, loc="lower center", ncols=3, columnspacing=1.0)


def _pressure(axes: Any, result: Result, label: str, rows: Sequence[int]) -> None:
    """Contact pressure along the contact line; the singular edges of the first instant are cut."""
    pressure = _field(result, "pressure")
    highest = float(pressure[list(rows)].max())
    touched = (pressure[list(rows)] > 0.0) @ result.line.area  # mm^2
    mean = result.histories["force"][list(rows)] / np.where(touched > 0.0, touched, np.inf)
    top = 3.0 * float(mean.max())
    if highest > top:
        label = f"{label}\npeak {highest:.0f} MPa cut"
    _profiles(axes, result, label, rows, lambda row: pressure[row])
    if highest > 0.0:
        axes.set_ylim(0.0, min(top, 1.1 * highest))
    axes.set_ylabel("contact pressure (MPa)")
    axes.legend(frameon=False)


def _penetration(axes: Any, results: Sequence[Result], labels: Sequence[str]) -> None:
    for number, (result, label) in enumerate(zip(results, labels, strict=True)):
        few = len(result.histories["time"]) <= _FEW_POINTS
        axes.plot(
            result.histories["time"], 1e3 * result.histories["penetration"],
            color=COLOURS[number % len(COLOURS)], linestyle=_DASHES[number % len(_DASHES)],
            label=label, marker="o" if few else "", markersize=2.5,
        )  # fmt: skip
    axes.set_xlim(left=0.0)
    if all((result.histories["penetration"] >= 0.0).all() for result in results):
        axes.set_ylim(bottom=0.0)
    axes.set_xlabel("time (s)")
    axes.set_ylabel("penetration depth (\N{MICRO SIGN}m)")
    axes.legend(frameon=False)


def magnification(displacement: float, size: float) -> float:
    """Return the round factor that makes the largest displacement about a tenth of a size."""
    if not displacement > 0.0:
        return 1.0
    exact = 0.1 * size / displacement
    power = 10.0 ** math.floor(math.log10(exact))
    return float(power * min((1.0, 2.0, 5.0, 10.0), key=lambda x: abs(math.log(exact / power / x))))


def _drawn(body: BoundaryFields, line: ContactLine, upward: float, factor: float) -> FloatArray:
    """Return (m, 2) mm, nodes along a contour moved by magnified displacement and wear.

    Wear as well, or faces that touch would not do so in the picture. Sides end where the face does.

    Parameters
    ----------
    upward : 1 where the contact face looks up, -1 where it looks down.
    """
    at = body.nodes.copy()
    elements, corners = _contact_elements(body)
    ends = corners[:, [0, 2]]
    ends = np.take_along_axis(ends, body.nodes[ends, 0].argsort(axis=1), axis=1)
    depth, more = body.wear[elements], upward * (factor - 1.0)
    at[corners[:, 1], 1] -= more * depth
    along = np.append(ends[:, 0], ends[-1, 1])
    at[along, 1] -= more * node_wear(line, depth)
    for name, end in (("inner_side", along[0]), ("outer_side", along[-1])):
        side = np.unique(body.elements[body.face == FACES.index(name)])
        if end in side:
            at[side, 1] = upward * np.minimum(upward * at[side, 1], upward * at[end, 1])
    return at + factor * body.displacement[:, :2]


def _contact_elements(body: BoundaryFields) -> tuple[IntArray, IntArray]:
    """Return the elements of the contact line by increasing radius, and (n, 3) their nodes."""
    elements = np.flatnonzero(body.face == FACES.index("contact"))
    elements = elements[body.nodes[body.elements[elements, 1], 0].argsort()]
    return elements, body.elements[elements]


def _section(axes: Any, result: Result, label: str) -> None:
    """Deformed meridian sections, magnified, with the contact pressure as colour.

    Where faces are not flat, magnified displacements make bodies overlap whose gap is not
    magnified; the upper one is then raised in the picture until they only touch.
    """
    state = choose_state(result, None)
    size = float(np.ptp(np.concatenate([body.nodes for body in state.bodies]), axis=0).max())
    moved = max(float(np.hypot(*body.displacement[:, :2].T).max()) for body in state.bodies)
    factor = magnification(moved, size)
    lower, upper = (
        _drawn(body, result.line, upward, factor)
        for body, upward in zip(state.bodies, (1.0, -1.0), strict=True)
    )
    elements, faces = (
        list(both) for both in zip(*(_contact_elements(body) for body in state.bodies), strict=True)
    )
    overlap = float((lower[faces[0][:, 1], 1] - upper[faces[1][:, 1], 1]).max())
    upper[:, 1] += max(overlap, 0.0)
    for number, body in enumerate(state.bodies):
        axes.add_patch(
            Polygon(
                body.nodes, fill=False, edgecolor="0.75", linewidth=0.8,
                label=None if number else "undeformed",
            )
        )  # fmt: skip
    for number, (outline, name) in enumerate(((lower, "lower"), (upper, "upper"))):
        axes.add_patch(
            Polygon(
                outline, facecolor=(COLOURS[number], 0.12), edgecolor=COLOURS[number],
                linewidth=0.8, label=name,
            )
        )  # fmt: skip
    p = state.bodies[0].pressure[elements[0]]
    # singular edges of the first instant would take all the colours
    area = result.line.area[p > 0.0].sum()
    top = 3.0 * float(result.line.area @ p / area) if area else 0.0
    pressure = LineCollection(
        list(lower[faces[0]]), cmap="plasma", linewidth=2.5, capstyle="round", zorder=3
    )
    pressure.set_array(p)
    pressure.set_clim(float(p.min()), min(float(p.max()), top) or 1.0)
    axes.add_collection(pressure)
    axes.figure.colorbar(
        pressure, ax=axes, label="contact pressure (MPa)", shrink=0.8,
        extend="max" if p.max() > top else "neither",
    )  # fmt: skip
    axes.margins(0.05)
    axes.autoscale_view()
    axes.set_aspect("equal")
    axes.set_xlabel("distance to axis (mm)")
    axes.set_ylabel("height (mm)")
    raised = "\nupper raised until they touch" if overlap > 0.005 * size else ""
    axes.set_title(
        f"{label}: {state.time:g} s\n"
        f"displacement and wear {factor:g}\N{MULTIPLICATION SIGN}{raised}"
    )
    axes.legend(
        frameon=False, loc="upper center", bbox_to_anchor=(0.5, 0.0), borderaxespad=4.0, ncols=3,
        columnspacing=1.0, handlelength=1.2,
    )  # fmt: skip
