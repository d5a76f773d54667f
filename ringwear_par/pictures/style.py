"""What all figures share: one style, colours that stay apart, texts of values."""

import io
import logging
import math
import re
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

from ringwear_par.cases.faces import SHAPE_UNITS
from ringwear_par.cases.units import in_signs
from ringwear_par.cases.values import is_number
from ringwear_par.errors import InputError, legible
from ringwear_par.files.text import shortened
from ringwear_par.files.writing import atomic_write, check_writable

log = logging.getLogger(__name__)

STYLE: dict[Any, Any] = {
    "font.size": 9.0,
    "axes.titlesize": 9.0,
    "legend.fontsize": 8.0,
    "lines.linewidth": 1.3,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.formatter.useoffset": False,  # ticks are read by themselves
    "savefig.dpi": 200,
}
#: fonts in files as fonts: publishers refuse Type 3, and texts in drawings can be edited
_FONTS: dict[Any, Any] = {"pdf.fonttype": 42, "ps.fonttype": 42, "svg.fonttype": "none"}
#: after Okabe and Ito: the colour-blind see them as different; their contrast on white is 3 at
#: least; in print without colour dashes tell lines apart
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#c2699a", "#222222")
#: line styles that stay apart in print without colour
DASHES: tuple[Any, ...] = ("-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)))
#: the dark part of a map whose lightness grows evenly; its contrast on white is 3 at least
_EARLY, _LATE = 0.58, 0.0
MM_OF_INCH = 25.4
#: least width of a figure, as a share of its usual width
_LEAST_WIDTH = 0.85
#: pixels of an inch in a notebook, and how many times as many its pictures have for fine screens
_NOTEBOOK_DPI, _FINE = 100.0, 2


class NotebookFigure(Figure):
    """A figure that notebooks show and whose files hold fonts as publishers want them.

    It belongs to no window: matplotlib's list of open figures does not know it.
    """

    def savefig(self, fname: Any, **options: Any) -> None:
        """Write the figure, see ``matplotlib.figure.Figure.savefig``."""
        with matplotlib.rc_context(_FONTS):
            super().savefig(fname, **options)

    def _repr_png_(self) -> tuple[bytes, dict[str, int]]:
        """Return the picture that a notebook shows, and its size there in pixels."""
        picture = io.BytesIO()
        self.savefig(picture, format="png", dpi=_FINE * _NOTEBOOK_DPI)
        width, height = (int(_NOTEBOOK_DPI * inches) for inches in self.get_size_inches())
        return picture.getvalue(), {"width": width, "height": height}


@cache
def stage_colour(share: float) -> str:
    """Return the colour of a stage in time, from 0 to 1, the later the darker; so in grey too."""
    return to_hex(matplotlib.colormaps["viridis"](_EARLY + (_LATE - _EARLY) * share))


def plain(text: str) -> str:
    """Return a text of a user as matplotlib draws it, letter by letter, on one line."""
    return legible(text, 200).replace("$", r"\$")


def number_text(value: float, digits: int) -> str:
    """Return a number in so many digits, its exponent short."""
    return re.sub(r"e([+-])0*", lambda e: "e" + e[1].strip("+"), f"{value:.{digits}g}")


def in_words(value: Any, unit: str = "") -> str:
    """Return a raw value of a case key, which has a unit or none, as a legend has room for it."""
    unit = f" {in_signs(unit)}" if unit else ""
    if is_number(value):
        return f"{value:g}{unit}"
    if isinstance(value, dict) and set(value) == {"r"}:
        return f"profile of {len(value['r'])} radii"
    if isinstance(value, dict) and len(value) == 1:
        ((name, size),) = value.items()
        if name == "trace":
            return f"trace of {len(size)} points"
        return f"{name} {in_words(size, SHAPE_UNITS.get(name, ''))}"
    if isinstance(value, list) and value and isinstance(value[0], list):
        ends = value[0][1], value[-1][1]
        if all(len(pair) == 2 and all(map(is_number, pair)) for pair in value):
            return f"{ends[0]:g} to {ends[1]:g}{unit} in {len(value)} points"
    return value if isinstance(value, str) else shortened(value)


def check_format(output: Path) -> None:
    """Refuse a picture that cannot be written. Not collective.

    Raises
    ------
    InputError : the reason.
    """
    check_writable(output)
    formats = NotebookFigure().canvas.get_supported_filetypes()
    if output.suffix[1:].lower() not in formats:
        raise InputError(f"{output}: its ending must be one of {', '.join(sorted(formats))}")


def of_width(figure: Figure, width: float | None) -> Figure:
    """Return a figure with another width, mm, its texts as large as before; None: as it is.

    Raises
    ------
    InputError : its texts would have no room.
    """
    if width is None:
        return figure
    least = math.ceil(_LEAST_WIDTH * MM_OF_INCH * figure.get_figwidth())
    if width < least:
        raise InputError(f"--width {width:g} mm: must be {least} mm at least for this figure")
    figure.set_figwidth(width / MM_OF_INCH)
    return figure


def save_figure(figure: Figure, output: Path, dpi: float | None = None) -> None:
    """Write a picture by rename, in the format of its ending. On one rank.

    Parameters
    ----------
    dpi : points of an inch of pictures that are no drawings; None: those of the style.

    Raises
    ------
    InputError : what is drawn is too large for matplotlib's axes.
    OSError : the disk or the folder.
    """
    try:
        picture = _drawn(figure, output.suffix[1:].lower(), dpi)
    except ArithmeticError as error:
        raise InputError(f"{output}: cannot be drawn: {error}; values are too large") from error
    with atomic_write(output) as temporary:
        temporary.write_bytes(picture)


def svg(figure: Figure) -> bytes:
    """Return a figure as a drawing (SVG); equal figures give equal texts."""
    content = io.BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": "ringwear"}):
        figure.savefig(content, format="svg", metadata={"Date": None, "Creator": None})
    return content.getvalue()


def picture(draw: Callable[[], Figure], name: str) -> bytes | None:
    """Return a picture, PNG; None, with a warning, where its numbers are too large for axes.

    Parameters
    ----------
    name : what the warning calls it.
    """
    try:
        return _drawn(draw(), "png")
    except (ArithmeticError, TypeError, ValueError) as error:
        log.warning("%s: cannot be drawn: %s", name, error)
        return None


def _drawn(figure: Figure, form: str, dpi: float | None = None) -> bytes:
    """Return a figure in a format: backends leave files open where the disk fails."""
    content = io.BytesIO()
    with matplotlib.rc_context(STYLE):
        figure.savefig(content, format=form, dpi=dpi or STYLE["savefig.dpi"])
    return content.getvalue()
