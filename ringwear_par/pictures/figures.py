"""Figures of runs from stored results: panels side by side, see ``panel_kinds``."""

import logging
import re
from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from ringwear_par.cases.case import Output
from ringwear_par.cases.files.keys import read_keys
from ringwear_par.cases.layers import expanded
from ringwear_par.cases.schema import quantity_name, unit_under
from ringwear_par.cases.units import seconds
from ringwear_par.cases.values import RejectedError
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.errors import InputError, legible
from ringwear_par.pictures.matplotlib import add_letters, draw
from ringwear_par.pictures.panel import Panel
from ringwear_par.pictures.panel_kinds import KINDS, Drawing, Item
from ringwear_par.pictures.style import (
    MM_OF_INCH,
    STYLE,
    NotebookFigure,
    check_format,
    in_words,
    plain,
    save_figure,
)
from ringwear_par.results.files import result_of
from ringwear_par.results.result import FailedResult, Result

log = logging.getLogger(__name__)

Source = Result | str | Path
#: panels of profiles over the radius, whose axes have one scale
_PROFILES = ("wear", "pressure")
#: panels with the same scale along both axes and a bar of colours, and how much larger they are
_SECTIONS, _LARGER = {"section", "stress"}, 1.15
#: panels that are drawn by default
DEFAULT = "wear,penetration"
_MOST_COLUMNS = 3
#: inches of a panel; mm: narrowest panel, widest figure
_PANEL, _NARROWEST, _WIDEST = (3.6, 3.3), 65, 1000
#: relative difference between a time that is asked for and that of the state shown that needs no
#: remark
_NOTICED = 0.01


@matplotlib.rc_context(STYLE)
def plot(
    results: Source | Sequence[Source],
    panels: str | Sequence[str] = DEFAULT,
    steps: str = "",
    times: str = "",
    width: float | None = None,
) -> Figure:
    """Return the panels of one or more results side by side. Not collective.

    Profiles (``wear``, ``pressure``) and deformed sections (``section``, the last one stored) are
    drawn of every result, one panel each, profiles on one scale; the histories of all of them share
    a panel (``penetration``, ``approach``, ``force``, ``torque``, ``energy``, ``volume``, ``rate``,
    ``pv`` and, of bodies with layers, ``through``). Of stored stresses: ``stress``, von Mises in
    the section, one panel each; ``depth``, it along the height in the middle of the contact;
    ``interfaces``, along each of them the tractions and von Mises on both sides, two panels each;
    ``mises``, the largest over time. A panel for which a result holds nothing is left out, with a
    warning, if there are others.

    Parameters
    ----------
    results : a result or a result file, or several.
    panels : names, in a list or separated by commas.
    steps : comma-separated step numbers of the profiles.
    times : comma-separated times of the profiles, s or with a unit ("1 h"), instead of steps; the
        stored states nearest to them are drawn. Without either: the first step and four quarters;
        the last one of stresses.
    width : mm, of the figure, which then has as many panels side by side as there is room for.

    Raises
    ------
    InputError : a file that is not a result, an unknown panel, a step not stored, a time outside
        of the history, nothing that can be drawn.
    """
    single = isinstance(results, str) or not isinstance(results, Iterable)
    several: Any = [results] if single else results
    read = [_read(source, number) for number, source in enumerate(several, 1)]
    if steps and times:
        raise InputError("--times: must be absent beside --steps")
    names = panels.split(",") if isinstance(panels, str) else list(panels)
    for panel in names:
        if panel not in KINDS:
            raise InputError(
                f"--panels {legible(','.join(names))}: {legible(panel)!r} must be one of "
                f"{', '.join(KINDS)}"
            )
    items = [
        Item(result, label, _times(result, times) if times else _of_steps(result, steps))
        for result, label in zip(read, _labels(read), strict=True)
    ]
    # without the cases' title, which tells of the file and not of what --set has made of it
    return _laid_out(_drawings(names, items), width)


def _read(source: Any, number: int) -> Result:
    if isinstance(source, FailedResult):
        reason = str(source.error).partition("\n")[0]
        raise InputError(f"plot: result {number} failed ({reason}); must be results only")
    if not isinstance(source, Result | str | Path):
        kind = type(source).__name__
        raise InputError(f"plot: result {number} is a {kind}; must be a result or its file")
    return result_of(source)


@dataclass(frozen=True)
class FigureFile:
    """The picture of a run, to be drawn at its end."""

    path: Path

    def check(self, stored: Output | None) -> None:
        """Refuse a picture that cannot be written, or drawn from what a case stores.

        Raises
        ------
        InputError : the reason.
        """
        check_format(self.path)
        if stored is None:
            return
        missing = {"wear_lower", "wear_upper"} - set(stored.fields)
        if missing:
            raise InputError(
                f"{self.path}: needs {' and '.join(sorted(missing))}, which output.fields leaves "
                "out"
            )
        if stored.profiles != "all":
            raise InputError(f'{self.path}: needs output.profiles = "all"')

    def draw(self, results: Path) -> None:
        """Draw the default panels of a result file."""
        save_figure(plot(results), self.path)


def _drawings(names: Sequence[str], items: Sequence[Item]) -> list[tuple[str, Drawing]]:
    """Return the drawings of kinds of panels, with the kind; warn of those that are left out."""
    drawings: list[tuple[str, Drawing]] = []
    left_out: list[tuple[str, str]] = []
    for panel in names:
        kind = KINDS[panel]
        faults = [kind.faults(item.result) for item in items]
        left_out += [(panel, fault) for item_faults in faults for fault in item_faults]
        good = [item for item, fault in zip(items, faults, strict=True) if not fault]
        if good and (len(good) == len(items) or not kind.shared):
            drawings += [(panel, drawing) for drawing in kind.drawings(good)]
    if not drawings:
        raise InputError(*(fault for _, fault in left_out))
    for panel, fault in left_out:
        log.warning("%s is not drawn: %s", panel, fault)
    return drawings


def _laid_out(drawings: Sequence[tuple[str, Drawing]], width: float | None) -> Figure:
    """Return a figure of panels, which are named, and drawn side by side, of a width in mm."""
    most = _MOST_COLUMNS
    if width is not None:
        if not _NARROWEST <= width <= _WIDEST:
            raise InputError(f"--width {width:g} mm: must be from {_NARROWEST} to {_WIDEST} mm")
        most = max(1, int(width / _NARROWEST))
    lines = -(-len(drawings) // most)
    columns = -(-len(drawings) // lines)
    names = [panel for panel, _ in drawings]
    size = 1.0 if _SECTIONS.isdisjoint(names) else _LARGER
    # sections have the same scale along both axes and leave room that constrained ones keep
    layout: Any = "compressed" if set(names) <= _SECTIONS else "constrained"
    inches = size * _PANEL[0] * columns if width is None else width / MM_OF_INCH
    figure = NotebookFigure(figsize=(inches, size * _PANEL[1] * lines), layout=layout)
    profiles: dict[str, Any] = {}  # of one scale, or one cannot compare
    for number, (panel, drawing) in enumerate(drawings, start=1):
        axes = figure.add_subplot(lines, columns, number, sharey=profiles.get(panel))
        if panel in _PROFILES:
            profiles[panel] = axes
        # else taken when the figure is drawn, where another style may hold
        axes.tick_params(labelsize=STYLE["font.size"])
        if isinstance(drawing, Panel):
            draw(axes, drawing)
        else:
            drawing(axes)
    add_letters(figure)
    return figure


def _of_steps(result: Result, steps: str) -> list[float]:
    """Return the times of stored steps, separated by commas."""
    stored, chosen = result.step.tolist(), []
    for word in steps.split(",") if steps else ():
        if not re.fullmatch(r"\s*[0-9]{1,18}\s*", word) or int(word) not in stored:
            raise InputError(
                f"--steps {legible(steps)}: {legible(word)!r} is not a stored step of "
                f"{result.name}; must be among 0..{stored[-1]} as stored (output.every)"
            )
        chosen.append(float(result.histories["time"][stored.index(int(word))]))
    return chosen


def _times(result: Result, times: str) -> list[float]:
    """Return times, separated by commas, and say where no state is stored near them."""
    stored, chosen = result.histories["time"], []
    for word in map(str.strip, times.split(",")):
        try:
            time = seconds(word)
            if not 0 <= time <= stored[-1] * (1 + 1e-9):
                raise RejectedError
        except RejectedError as error:
            raise InputError(
                f"--times {legible(times)}: {legible(word)!r} is no time of {result.name}; "
                f'must be from 0 to {stored[-1]:g} (s), or with a unit, such as "1 h"'
            ) from error
        nearest = stored[np.abs(stored - time).argmin()]
        if abs(nearest - time) > _NOTICED * time:
            log.warning(
                "--times %s: %s has no state stored there; that of %.4g s is shown",
                word, result.name, nearest,
            )  # fmt: skip
        chosen.append(time)
    return chosen


def _labels(results: Sequence[Result]) -> list[str]:
    """Name each result by what sets its case apart, or by its file where that is too much."""
    cases = [expanded(read_keys(result.case, result.name)) for result in results]
    every_path = dict.fromkeys(path for case in cases for path in case if path != "title")
    paths = [path for path in every_path if len({str(c.get(path)) for c in cases}) > 1]
    if not 1 <= len(paths) <= 2 or any(path not in case for path in paths for case in cases):
        return [
            f"result {number}" if result.path is None else plain(result.path.stem)
            for number, result in enumerate(results, 1)
        ]
    keys = {path for case in cases for path in case}
    names = [_short(path, keys) for path in paths]
    return [
        ", ".join(
            plain(f"{name} = {_value_words(case, path)}")
            for name, path in zip(names, paths, strict=True)
        )
        for case in cases
    ]


def _value_words(case: Mapping[str, Any], path: str) -> str:
    """Return the value of a key of a case, with its unit."""
    return in_words(case[path], unit_under(path, lambda key: [case.get(key)]))


def _short(path: str, keys: Container[str]) -> str:
    """Return a parameter of a law, or the name of a quantity, with its body where both have it."""
    name, _, body = quantity_name(path).partition(", ")
    name = path.rpartition(".")[2] if path.startswith("wear.") else name
    for name_of_body, partner in (BODIES, BODIES[::-1]):
        if name_of_body in path.split(".") and path.replace(name_of_body, partner) in keys:
            return f"{name} of {body}"
    return name
