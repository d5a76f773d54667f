"""The drawing of a rig: bodies, layers, grips, load, rotation and contact line of a case."""

import itertools
import math
from typing import Any

import matplotlib
import numpy as np
from matplotlib.patches import Polygon

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import Case, Ring
from ringwear_par.cases.law import in_words
from ringwear_par.cases.units import in_signs
from ringwear_par.pictures.style import COLOURS, STYLE, NotebookFigure, plain, svg
from ringwear_par.schedules import Quantity, Table, quantity_text

#: inches of the figure, and the share of its width that bodies take; words take the rest
_WIDTH, _DRAWN = 6.6, 0.58
#: least and largest height of both bodies over their diameter that is drawn to scale; others are
#: stretched
_FLATTEST, _TALLEST = 0.42, 1.1
#: shares of the height of both bodies: least height of a layer, height of the grips, of the arrows
_LAYER, _GRIP, _ARROW = 0.03, 0.06, 0.24
_BODY_FILLS = ("#cfe3f1", "#f6dcc8")
_LAYER_FILLS = ("#7fb2d5", "#b3a2c8", "#8fc9b3")
_CONTACT = "#c1121f"
_INK = "0.15"
GRIPS = {"clamped": "clamped", "platen": "on a platen"}
#: letters of a line of words beside the bodies
_LETTERS = 32


def draw_rig(case: Case, laws: tuple[str, str] | None = None) -> NotebookFigure:
    """Return the drawing of the rig of a case: a section through the axis. Not collective.

    Radii and heights stand at the axes, in mm; layers that could not be seen are drawn thicker.

    Parameters
    ----------
    laws : wear laws of lower and upper in words, "" for none; None: those of the case.
    """
    if laws is None:
        lower, upper = ([layer.thickness for layer in ring.layers] for ring in case.rings)
        laws = in_words(case.laws[0], lower), in_words(case.laws[1], upper)
    height, ratio = _proportions(case)
    radius = max(case.lower.r[1], case.upper.r[1])
    low, high = case.lower.z[0], case.upper.z[1]
    ratio = min(max(ratio, _FLATTEST), _TALLEST)
    inches = _DRAWN * _WIDTH * ratio * (1.0 + _ARROW + 2.0 * _GRIP)
    # axes have their place, whatever layout a user prefers
    with matplotlib.rc_context({**STYLE, "figure.constrained_layout.use": False}):
        figure = NotebookFigure(figsize=(_WIDTH, inches + 0.55))
        axes = figure.add_axes(
            (0.09, 0.5 / (inches + 0.55), _DRAWN, (inches - 0.02) / (inches + 0.55))
        )
        axes.set_xlim(-1.08 * radius, 1.08 * radius)
        axes.set_ylim(low - 1.5 * _GRIP * height, high + (_ARROW + 1.5 * _GRIP) * height)
        for number in range(2):
            _draw_body(axes, case, number, height)
        _draw_contact(axes, case)
        _draw_load(axes, case, high + 1.3 * _GRIP * height, _ARROW * height, radius)
        _draw_axes(axes, case)
        _write_words(axes, case, laws)
    return figure


def rig_svg(case: Case, laws: tuple[str, str] | None = None) -> bytes:
    """Return ``draw_rig`` as a drawing (SVG) that pages can hold. Not collective."""
    return svg(draw_rig(case, laws))


def rig_html(case: Case) -> str:
    """Return ``draw_rig`` as an element of HTML, for notebooks. Not collective."""
    text = rig_svg(case).decode()
    return text[text.index("<svg") :]


def _proportions(case: Case) -> tuple[float, float]:
    """Return the height of both bodies, mm, and that over their diameter."""
    height = case.upper.z[1] - case.lower.z[0]
    return height, height / (2.0 * max(case.lower.r[1], case.upper.r[1]))


def _sign(number: int) -> float:
    """Return 1 of the lower body, whose face looks up, -1 of the upper one."""
    return 1.0 - 2.0 * number


def _draw_body(axes: Any, case: Case, number: int, height: float) -> None:
    """Draw both halves of a body, its layers, and its grip."""
    ring = case.rings[number]
    contour = case.sections[number].contour(*(ring.z if number else ring.z[::-1]))
    top, bottom = contour[:-2], contour[:-3:-1]
    _draw_part(axes, top, bottom, _BODY_FILLS[number], COLOURS[number])
    for layer, fill in zip(ring.layers, itertools.cycle(_LAYER_FILLS)):
        interface = top - (0.0, _sign(number) * max(layer.thickness, _LAYER * height))
        _draw_part(axes, top, interface, fill, COLOURS[number])
        top = interface
    _draw_grip(axes, ring, float(bottom[0, 1]), -_sign(number) * _GRIP * height)


def _draw_part(axes: Any, top: FloatArray, bottom: FloatArray, fill: str, colour: str) -> None:
    """Draw both halves of what is between two lines of increasing radii; a disc's are one."""
    right = np.concatenate([top, bottom[::-1]])
    halves = [right, right * (-1.0, 1.0)]
    if top[0, 0] == 0.0:
        halves = [np.concatenate([_mirrored(top), _mirrored(bottom)[::-1]])]
    for half in halves:
        axes.add_patch(Polygon(half, facecolor=fill, edgecolor=colour, linewidth=0.8, zorder=2))


def _mirrored(line: FloatArray) -> FloatArray:
    """Return a line from the axis on, with its mirror image before it."""
    return np.concatenate([line[::-1] * (-1.0, 1.0), line])


def _draw_grip(axes: Any, ring: Ring, grip_height: float, depth: float) -> None:
    """Hatch beyond a held face; a platen is a plate on rollers."""
    inner, outer = ring.r
    for side in (1.0, -1.0):
        near, far = grip_height, grip_height + depth
        if ring.grip == "platen":
            middle = grip_height + 0.25 * depth
            count = max(3, round(24.0 * (outer - inner) / (axes.get_xlim()[1])))
            rolls = np.linspace(inner, outer, count + 2)[1:-1]
            axes.plot(side * rolls, np.full(count, middle), "o", ms=3.0, mfc="w", mec=_INK, mew=0.7)
            near = grip_height + 0.5 * depth
        corners = [(side * inner, near), (side * outer, near), (side * outer, far)]
        axes.add_patch(
            Polygon(
                [*corners, (side * inner, far)], facecolor="none", edgecolor="0.55", hatch="/////",
                linewidth=0.0,
            )
        )  # fmt: skip
        axes.plot([side * inner, side * outer], [near, near], color=_INK, linewidth=1.2, zorder=3)


def _draw_contact(axes: Any, case: Case) -> None:
    a, b = case.contact
    r = np.linspace(a, b, 50)
    z = case.lower.z[1] + case.sections[0].depth(r)
    for side in (1.0, -1.0):
        axes.plot(side * r, z, color=_CONTACT, linewidth=2.4, solid_capstyle="butt", zorder=4)


def _draw_load(axes: Any, case: Case, foot: float, length: float, radius: float) -> None:
    """Draw what presses the upper body as an arrow along the axis, its rotation around it."""
    axes.axvline(0.0, color="0.5", linewidth=0.8, linestyle=(0, (10, 3, 2, 3)), zorder=1)
    axes.annotate(
        "", (0.0, foot), (0.0, foot + length),
        arrowprops={"arrowstyle": "-|>", "color": _INK, "linewidth": 1.6, "mutation_scale": 12.0},
    )  # fmt: skip
    turn = np.radians(np.linspace(150.0, 390.0, 60))
    x, z = 0.16 * radius * np.cos(turn), foot + length * (0.42 + 0.14 * np.sin(turn))
    axes.plot(x, z, color=_INK, linewidth=1.1)
    axes.annotate(
        "", (x[-1], z[-1]), (x[-4], z[-4]),
        arrowprops={"arrowstyle": "-|>", "color": _INK, "linewidth": 1.1, "mutation_scale": 9.0},
    )  # fmt: skip
    words = {"ha": "right", "va": "center", "color": _INK, "fontsize": 8.0}
    axes.text(-0.05 * radius, foot + 0.92 * length, pressing(case), **words)
    axes.text(-0.22 * radius, foot + 0.42 * length, turning(case), **words)


def pressing(case: Case) -> str:
    """Return the load in words: a force with its mean pressure, or a displacement."""
    load = case.load
    if load.force is not None:
        words = f"F = {_range(load.force, 'N')}"
        if isinstance(load.force, float):
            words += f" (mean pressure {load.force / case.area:.4g} MPa)"
        return words
    assert load.displacement is not None
    return f"displacement {_range(load.displacement, 'mm')}"


def turning(case: Case) -> str:
    """Return the speed in words."""
    omega = case.load.omega
    words = f"\N{GREEK SMALL LETTER OMEGA} = {_range(omega, 'rad/s')}"
    if isinstance(omega, float):
        words += f" ({30.0 * omega / math.pi:.4g} rpm)"
    return words


def _range(quantity: Quantity, unit: str) -> str:
    """Return a load as a number, or the range of its table."""
    values = np.array(quantity.y if isinstance(quantity, Table) else quantity, ndmin=1)
    ends = [values.min(), values.max()] if values.min() < values.max() else [values[0]]
    if unit == "N" and ends[-1] >= 1e4:
        ends, unit = [1e-3 * end for end in ends], "kN"
    words = f"{' to '.join(f'{end:.4g}' for end in ends)} {unit}"
    return f"{words}, in time" if isinstance(quantity, Table) else words


def _draw_axes(axes: Any, case: Case) -> None:
    """Label the radii and heights of the bodies, and no others."""
    radii = _apart({*case.lower.r, *case.upper.r, *case.contact}, 0.09 * axes.get_xlim()[1])
    heights = _apart({*case.lower.z, *case.upper.z}, 0.05 * float(np.ptp(axes.get_ylim())))
    axes.set_xticks(radii, [f"{r:.6g}" for r in radii])
    axes.set_yticks(heights, [f"{z:.6g}" for z in heights])
    axes.tick_params(labelsize=7.0)
    axes.set_xlabel("r (mm)", x=0.75, fontsize=8.0)
    axes.set_ylabel("z (mm)", fontsize=8.0)
    axes.spines["bottom"].set_bounds(0.0, axes.get_xlim()[1])
    axes.spines["left"].set_bounds(min(heights), max(heights))


def _apart(values: set[float], least: float) -> list[float]:
    """Return values, the ends first, without those whose labels would cover that of another."""
    rest: list[float] = []
    for value in (max(values), *sorted(values)):
        if all(abs(value - neighbour) >= least for neighbour in rest):
            rest.append(value)
    return rest


def _write_words(axes: Any, case: Case, laws: tuple[str, str]) -> None:
    """Write beside the bodies what they are made of and how they wear."""
    low, high = axes.get_ylim()
    blocks = [_body_words(case, number, laws[number]) for number in (1, 0)]
    a, b = case.contact
    friction = quantity_text(case.friction)
    blocks.insert(1, ["contact", f"r {a:.6g} to {b:.6g} mm, friction {friction}"])
    if unlike := _not_to_scale(case):
        blocks.append([f"not to scale: {unlike}"])
    colours = (COLOURS[1], _CONTACT, COLOURS[0], "0.45")
    inches = axes.figure.get_figheight() * axes.get_position().height
    line = 0.145 / inches
    total = (sum(map(len, blocks)) + 2.0) * line
    middle = (0.5 * (case.lower.z[1] + case.upper.z[0]) - low) / (high - low)
    at = min(0.99, max(middle + 0.5 * total, total))
    for block, colour in zip(blocks, colours, strict=False):
        for number, words in enumerate(block):
            axes.text(
                1.02, at, plain(words), transform=axes.transAxes, va="top", fontsize=7.5,
                color=colour if number == 0 else _INK, weight="bold" if number == 0 else "normal",
            )  # fmt: skip
            at -= line
        at -= line


def _not_to_scale(case: Case) -> str:
    """Return the parts of the drawing that have another scale: thin layers, flat or tall rigs."""
    height, ratio = _proportions(case)
    thin = any(layer.thickness < _LAYER * height for ring in case.rings for layer in ring.layers)
    stretched = not _FLATTEST <= ratio <= _TALLEST
    return " and ".join(["layers"] * thin + ["heights"] * stretched)


def _body_words(case: Case, number: int, law: str) -> list[str]:
    ring = case.rings[number]
    name = ("lower, stands still", "upper, turns")[number]
    (inner, outer), (low, high) = ring.r, ring.z
    words = [
        f"{name}, {GRIPS[ring.grip]}",
        f"r {inner:.6g} to {outer:.6g} mm, {high - low:.6g} mm high",
    ]
    for index, layer in enumerate(ring.layers):
        words.append(f"layer {index}: {_thickness(layer.thickness)}, {_elastic(layer)}")
    words.append(_elastic(ring))
    formula = law.partition(" with ")[0].partition(" of ")[0]
    if len(formula) > _LETTERS:
        formula = formula[: _LETTERS - 3] + "..."
    return [*words, f"wears: {formula}" if law else "does not wear"]


def _thickness(thickness: float) -> str:
    return f"{thickness:g} mm" if thickness >= 0.1 else in_signs(f"{1e3 * thickness:g} um")


def _elastic(material: Any) -> str:
    return f"E = {1e-3 * material.young:.4g} GPa, \N{GREEK SMALL LETTER NU} = {material.poisson:g}"
