"""Figures from stored results: worn profiles, penetration histories, pressure profiles."""

import os
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from ringwear_par.case import Output, read_keys
from ringwear_par.driver import check_writable
from ringwear_par.errors import InputError
from ringwear_par.results import Result, read_result
from ringwear_par.schema import UNITS

_STYLE: dict[Any, Any] = {
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
_COLOURS = ("#1b4f8a", "#c1440e", "#3a7d44", "#6a4c93", "#444444")


def plot_files(
    paths: Sequence[Path],
    output: Path,
    panels: str = "wear,penetration",
    steps: str = "",
    profiles_of: Sequence[Path] = (),
) -> None:
    """Draw the panels of one or more result files side by side. On one rank.

    Profiles (``wear``, ``pressure``) are drawn of every file, one panel each; the histories of all
    files share a panel (``penetration``).

    Parameters
    ----------
    paths : result files.
    output : picture; its ending chooses the format.
    panels : comma-separated names.
    steps : comma-separated step numbers of the profiles; "" for the first step and four quarters.
    profiles_of : those of the files whose profiles are drawn; () for all.

    Raises
    ------
    InputError : a file that is not a result, an unknown panel or format, a step not stored.
    """
    check_figure(output)
    results = [read_result(path) for path in paths]
    for path in profiles_of:
        if path not in paths:
            raise InputError(f"--profiles-of {path}: must be one of the result files to be drawn")
    labels = _labels(results)
    drawings: list[Callable[..., None]] = []
    for panel in panels.split(","):
        if panel == "penetration":
            drawings.append(partial(_penetration, results=results, labels=labels))
        elif panel in ("wear", "pressure"):
            profile = _wear if panel == "wear" else _pressure
            for result, label in zip(results, labels, strict=True):
                if not profiles_of or result.path in profiles_of:
                    rows = _rows(result, steps)
                    drawings.append(partial(profile, result=result, label=label, rows=rows))
        else:
            raise InputError(
                f"--panels {panels}: {panel!r} must be one of wear, penetration, pressure"
            )
    with matplotlib.rc_context(_STYLE):
        columns = min(len(drawings), _COLUMNS)
        lines = -(-len(drawings) // columns)
        figure = Figure(figsize=(3.6 * columns, 3.3 * lines), layout="constrained")
        for number, draw in enumerate(drawings):
            draw(figure.add_subplot(lines, columns, number + 1))
        titles = {str(result.attributes["title"]) for result in results} - {""}
        if len(titles) == 1:
            figure.suptitle(titles.pop(), fontsize=8.0)
        temporary = output.with_name(f".{output.stem}.tmp{os.getpid()}{output.suffix}")
        try:
            figure.savefig(temporary)
            temporary.replace(output)
        finally:
            temporary.unlink(missing_ok=True)


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
    stored, last = result.steps, int(result.steps[-1])
    if not steps:
        time = result.scalars["time"]
        wished = (time[min(1, len(time) - 1)], *(time[-1] * q / 4 for q in (1, 2, 3, 4)))
        return sorted({int(np.abs(time - t).argmin()) for t in wished})
    rows = []
    for word in steps.split(","):
        if not word.strip().isdecimal() or int(word) not in stored:
            raise InputError(
                f"--steps {steps}: {word!r} is not a stored step of {result.path}; "
                f"must be among 0..{last} as stored (output.every)"
            )
        rows.append(int(np.flatnonzero(stored == int(word))[0]))
    return rows


def _field(result: Result, name: str) -> Any:
    if name not in result.fields:
        raise InputError(
            f"{result.path}: does not hold {name}; output.fields of its case left it out"
        )
    if result.fields[name].ndim == 1:
        raise InputError(
            f"{result.path}: holds {name} of the last step only; must be computed with "
            'output.profiles = "all"'
        )
    return result.fields[name]


def _labels(results: Sequence[Result]) -> list[str]:
    """Name each result by what sets its case apart, or by its file where that is too much."""
    cases = [read_keys(str(result.attributes["case"])) for result in results]
    paths = [
        path for path in UNITS if path != "title" and len({str(c.get(path)) for c in cases}) > 1
    ]
    if not 1 <= len(paths) <= 2 or any(path not in case for path in paths for case in cases):
        return [result.path.stem for result in results]
    names = [path.rpartition(".")[2] for path in paths]
    units = [f" {UNITS[path]}" if UNITS[path] not in ("-", "1") else "" for path in paths]
    return [
        ", ".join(
            f"{name} = {case[path]:g}{unit}" if not isinstance(case[path], str | list | bool)
            else f"{name} = {case[path]}"
            for name, path, unit in zip(names, paths, units, strict=True)
        )
        for case in cases
    ]  # fmt: skip


def _profiles(
    axes: Any, result: Result, label: str, rows: Sequence[int], curve: Callable[[int], Any]
) -> None:
    time = result.scalars["time"]
    for number, row in enumerate(rows):
        axes.plot(
            result.line.r, curve(row), color=_COLOURS[number % len(_COLOURS)],
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
                result.line.r, 1e3 * upper[row], color=_COLOURS[number % len(_COLOURS)],
                linestyle=_DASHES[number % len(_DASHES)],
            )  # fmt: skip
        axes.set_ylabel("worn profiles (\N{MICRO SIGN}m): lower < 0 < upper")
    else:
        axes.set_ylabel("wear depth (\N{MICRO SIGN}m)")
    axes.plot([inner - margin, inner], [0, 0], color="0.4", linewidth=0.8)
    axes.plot([outer, outer + margin], [0, 0], color="0.4", linewidth=0.8)
    axes.set_xlim(inner - margin, outer + margin)
    low, high = axes.get_ylim()
    axes.set_ylim(low - 0.3 * (high - low), high)  # room for the legend
    axes.legend(frameon=False, loc="lower center", ncols=3, columnspacing=1.0)


def _pressure(axes: Any, result: Result, label: str, rows: Sequence[int]) -> None:
    """Contact pressure along the contact line; the singular edges of the first instant are cut."""
    pressure = _field(result, "pressure")
    highest = float(pressure[list(rows)].max())
    mean = result.scalars["force"] / result.line.area.sum()
    top = 3.0 * float(mean[list(rows)].max())
    if highest > top:
        label = f"{label} (peak {highest:.0f} MPa cut)"
    _profiles(axes, result, label, rows, lambda row: pressure[row])
    if highest > 0.0:
        axes.set_ylim(0.0, min(top, 1.1 * highest))
    axes.set_ylabel("contact pressure (MPa)")
    axes.legend(frameon=False)


def _penetration(axes: Any, results: Sequence[Result], labels: Sequence[str]) -> None:
    for number, (result, label) in enumerate(zip(results, labels, strict=True)):
        axes.plot(
            result.scalars["time"], 1e3 * result.scalars["penetration"],
            color=_COLOURS[number % len(_COLOURS)], linestyle=_DASHES[number % len(_DASHES)],
            label=label,
        )  # fmt: skip
    axes.set_xlim(left=0.0)
    if all((result.scalars["penetration"] >= 0.0).all() for result in results):
        axes.set_ylim(bottom=0.0)
    axes.set_xlabel("time (s)")
    axes.set_ylabel("penetration depth (\N{MICRO SIGN}m)")
    axes.legend(frameon=False)
