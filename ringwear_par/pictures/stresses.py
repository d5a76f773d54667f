"""Pictures of stresses: a map in the section, panels along depth, interfaces and time."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.patches import Polygon
from matplotlib.ticker import MaxNLocator

from ringwear_par.arrays import BoolArray, FloatArray
from ringwear_par.cases.files.key_values import Outline, outlines
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.elasticity.stress.fields import COMPONENTS, SIDES, mises
from ringwear_par.pictures.panel import FEW_POINTS, Axis, Band, Curve, Label, Panel
from ringwear_par.pictures.run_panels import RADIUS, stage_styles
from ringwear_par.pictures.sections import magnification
from ringwear_par.pictures.style import COLOURS
from ringwear_par.results.fields import Interface, interfaces_of, stresses
from ringwear_par.results.key_numbers import time_unit, time_words
from ringwear_par.results.result import Result

#: colours of a map, numbers beside its scale, and the share of its values that the scale covers:
#: those at edges would take it all
_LEVELS, _TICKS, _SHARE = 24, 7, 0.99
#: share of a map's longer side below which the shorter one has a scale of its own, and its share
#: then
_LEAST, _STRETCHED = 0.25, 0.5
#: mm within which a point of the grid lies on a face
_ON_FACE = 1e-9
_MISES = "von Mises stress (MPa)"
#: of the components that both sides of an interface share, words for a legend
_TRACTIONS = {
    "zz": "normal \N{GREEK SMALL LETTER SIGMA}zz (+ opens)",
    "rz": "shear \N{GREEK SMALL LETTER TAU}rz",
    "tz": "friction's \N{GREEK SMALL LETTER TAU}tz",
}
#: length of interfaces that is drawn beside the contact, over its width
_BESIDE = 0.5
#: share of the highest values that is left above and below them
_ROOM = 0.05
#: share of the radii drawn above which words mark a part that is worn through, and their height
_WIDE, _TEXT_HEIGHT = 0.2, 0.6
_DARK, _PALE = "#666666", "#808080"


def highest(maps: Sequence[FloatArray]) -> float:
    """Return the end of the scale of maps of some stresses on grids (..., 6), MPa."""
    values = np.concatenate([mises(stress).ravel() for stress in maps])
    finite = values[np.isfinite(values)]
    return float(np.quantile(finite, _SHARE)) if len(finite) else 1.0


def draw_map(axes: Any, result: Result, label: str, row: int, top: float) -> None:
    """Draw von Mises' stress on the grid, and the unworn bodies.

    Parameters
    ----------
    row : of the state with stresses.
    top : MPa, end of the scale.
    """
    of = stresses(result)
    r, z, time = of["grid_r"], of["grid_z"], float(of["stress_time"][row])
    values, sections = mises(of["stress_grid"][row]), outlines(result.case, result.name)
    under = (r > result.line.edges[0]) & (r < result.line.edges[-1])
    levels = MaxNLocator(_LEVELS).tick_values(0.0, top or 1.0)
    drawn = None
    for inside, band in _materials(sections, r, z):  # each by itself, and up to its contour
        finite = inside & np.isfinite(values)
        if finite.any():
            filled = _spread(values, finite)
            filled[under & inside.any(axis=1) & ~finite.any(axis=1)] = np.nan  # worn through
            drawn = axes.contourf(r, z, filled.T, levels, cmap="viridis", extend="max")
            drawn.set_clip_path(Polygon(band, transform=axes.transData))
    if drawn is None:
        axes.text(
            0.5, 0.5, "worn through", ha="center", va="center", color="0.4",
            transform=axes.transAxes,
        )  # fmt: skip
    else:
        ticks = levels[:: -(-len(levels) // _TICKS)]
        axes.figure.colorbar(drawn, ax=axes, label=_MISES, shrink=0.9, ticks=ticks)
    for outline in sections:
        inner, outer = outline.contour[[-1, -2], 0]
        axes.add_patch(Polygon(outline.contour, fill=False, edgecolor="0.25", linewidth=0.9))
        axes.hlines(outline.interfaces, inner, outer, color="0.25", linewidth=0.5)
    stretch = _stretch(float(r[-1] - r[0]), float(z[-1] - z[0]))
    axes.set_xlim(r[0], r[-1])
    axes.set_ylim(z[0], z[-1])
    axes.set_aspect(stretch)
    axes.set_xlabel("distance to axis (mm)")
    axes.set_ylabel("height (mm)")
    when = time_words(time, float(result.histories["time"][-1]))
    scales = {}
    if stretch != 1.0:
        scales["heights" if stretch > 1.0 else "radii"] = max(stretch, 1.0 / stretch)
    words = ", ".join(
        f"{name} {scale:.6g}\N{MULTIPLICATION SIGN}" for name, scale in scales.items()
    )
    axes.set_title(f"{label}: {when}\n{words}".rstrip())


def _stretch(width: float, height: float) -> float:
    """Return how much larger heights of a map are drawn than radii, a round factor or one."""
    ratio = height / width
    if _LEAST <= ratio <= 1.0 / _LEAST:
        return 1.0
    return magnification((_STRETCHED if ratio < 1.0 else 1.0 / _STRETCHED) / ratio)


def _materials(
    sections: Sequence[Outline], r: FloatArray, z: FloatArray
) -> Iterator[tuple[BoolArray, FloatArray]]:
    """Give the points of a grid that are of each material, (nr, nz), and its contour.

    Points between two are of that towards the contact; between the bodies, lower's.
    """
    for outline, down in zip(sections, (1.0, -1.0), strict=True):
        face = np.interp(r, *outline.contour[:-2].T)[:, None]
        ends = np.append(outline.interfaces, outline.contour[-1, 1])
        for number, end in enumerate(ends):
            in_layer = down * z >= down * end - _ON_FACE
            if number:
                in_layer = in_layer & (down * z < down * ends[number - 1] - _ON_FACE)
            low, high = sorted((end, ends[number - 1] if number else down * np.inf))
            band = outline.contour.copy()
            band[:, 1] = np.clip(band[:, 1], low, high)
            beside = z <= face + _ON_FACE if down > 0.0 else z > face + _ON_FACE
            yield in_layer & beside, band


def _spread(values: FloatArray, finite: BoolArray) -> FloatArray:
    """Return values of which those that are not known are those of the nearest that are."""
    from scipy.ndimage import distance_transform_edt

    nearest = distance_transform_edt(~finite, return_distances=False, return_indices=True)
    return values[tuple(nearest)]


def along_height(result: Result, label: str, rows: Sequence[int]) -> Panel:
    """Return von Mises' stress along the height of the grid, in the middle of the contact.

    Parameters
    ----------
    rows : of states with stresses.
    """
    of = stresses(result)
    r, z = of["grid_r"], of["grid_z"]
    inner, outer = result.line.edges[[0, -1]]
    column = int(np.abs(r - 0.5 * (inner + outer)).argmin())
    end = float(result.histories["time"][-1])
    lower, upper = outlines(result.case, result.name)
    faces = [float(np.interp(r[column], *o.contour[:-2].T)) for o in (lower, upper)]
    levels = np.concatenate([lower.interfaces - _ON_FACE, np.add(faces, _ON_FACE),
                             upper.interfaces + _ON_FACE])  # fmt: skip
    between = np.searchsorted(z, levels)  # where materials end, curves do
    height = np.insert(z, between, np.nan)
    styles = stage_styles(of["stress_time"][rows], end)
    curves = [
        Curve(np.insert(mises(stress[column]), between, np.nan), height, *style)
        for stress, style in zip(of["stress_grid"][rows], styles, strict=True)
    ]
    at = f"r = {r[column]:.4g} mm"
    highest = max((float(np.nanmax(curve.x, initial=0.0)) for curve in curves), default=0.0)
    return Panel(
        Axis(_MISES, ends=(0.0, 1.05 * highest or 1.0)),
        Axis("height (mm)", ends=(float(z[0]), float(z[-1]))),
        f"von Mises stress along the height, at {at}",
        curves=curves, levels=tuple(levels.tolist()), legend=", ".join(filter(None, (label, at))),
    )  # fmt: skip


def largest(results: Sequence[Result], labels: Sequence[str]) -> Panel:
    """Return the largest von Mises stresses of both bodies over time.

    Parameters
    ----------
    labels : of the results, "" for none.
    """
    unit, seconds = time_unit(max(float(result.histories["time"][-1]) for result in results))
    several, curves = len(results) > 1, []
    for number, (result, label) in enumerate(zip(results, labels, strict=True)):
        of = stresses(result)
        time = of["stress_time"] / seconds
        for i, body in enumerate(BODIES):
            values = of[f"max_mises_{body}"]
            if np.isfinite(values).any():
                colour = COLOURS[(number if several else i) % len(COLOURS)]
                name = ", ".join(filter(None, (label, body)))
                marked = len(time) <= FEW_POINTS
                curves.append(Curve(time, values, name, colour, number + i, 2.0, marked=marked))
    beside = ", ".join(sorted({f"{stresses(result)['stress_exclude']:g}" for result in results}))
    title, excluded = f"largest {_MISES}", f"{beside} mm and more from edges"
    return Panel(
        Axis(f"time ({unit})", zero=True), Axis(title, zero=True), title, excluded, curves=curves,
        legend=excluded,
    )  # fmt: skip


def along_interfaces(result: Result, label: str, rows: Sequence[int]) -> Iterator[Panel]:
    """Yield the tractions along each interface at some states, then von Mises' on both sides.

    Panels of one interface have one scale.

    Parameters
    ----------
    rows : of states with stresses.
    """
    chosen = [COMPONENTS.index(name) for name in _TRACTIONS]
    sides = [f"just {side}" for side in SIDES]
    for interface in interfaces_of(result):
        values = [stress[0][:, chosen].T for stress in interface.stress[rows]]
        for panel in _along(result, label, interface, rows, values, [*_TRACTIONS.values()]):
            yield replace(panel, y=replace(panel.y, label="traction on the interface (MPa)"))
    for interface in interfaces_of(result):
        values = [*mises(interface.stress[rows])]
        for panel in _along(result, label, interface, rows, values, sides):
            low, high = panel.y.ends or (0.0, 1.0)
            yield replace(panel, y=Axis(_MISES, ends=(max(low, 0.0), high)))


def _along(
    result: Result, label: str, interface: Interface, rows: Sequence[int],
    values: Sequence[FloatArray], names: Sequence[str],
) -> Iterator[Panel]:  # fmt: skip
    """Yield the panel of each state: curves under the contact and beside it, free edges shaded.

    Parameters
    ----------
    values : (c, m) MPa, by state; on the scale of all, but for what is beside free edges.
    names : of the c curves.
    """
    of, r, contact = stresses(result), interface.r, result.line.edges[[0, -1]]
    exclude = float(of["stress_exclude"])
    contour = outlines(result.case, result.name)[interface.body].contour[:, 0]
    beside = _BESIDE * float(np.ptp(contact))
    low = max(float(contour.min()), contact[0] - beside)
    high = min(float(contour.max()), contact[1] + beside)
    free = [end for end in (contour.min(), contour.max()) if low <= end <= high and end > 0.0]
    scaled = (r >= low) & (r <= high)
    for end in free:
        scaled &= np.abs(r - end) >= exclude
    extent = np.concatenate([state_values[:, scaled].ravel() for state_values in values])
    extent = np.append(extent[np.isfinite(extent)], 0.0)
    room = _ROOM * float(np.ptp(extent)) or 1.0
    bottom, top = float(extent.min()) - room, float(extent.max()) + room
    upright = np.array([bottom, top, np.nan])
    edges = Curve(
        np.repeat(contact, 3), np.tile(upright, 2), "edges of contact", _PALE, 3, 1.2
    )  # fmt: skip
    zero = Curve(np.array([low, high]), np.zeros(2), "", _DARK, 0, 1.0)
    shades = [
        Band(
            end + exclude * np.array([-1.0, 1.0]), np.full(2, bottom), np.full(2, top), "",
            "#000000", 0.1,
        )
        for end in free
    ]  # fmt: skip
    note = f"shaded: {exclude:g} mm beside free edges, where stress is infinite"
    note = note if exclude and free else ""
    end_time = float(result.histories["time"][-1])
    for at, state_values in zip(of["stress_time"][rows].tolist(), values, strict=True):
        curves = [
            Curve(r, curve, name, COLOURS[number], number)
            for number, (curve, name) in enumerate(zip(state_values, names, strict=True))
        ]
        time = time_words(at, end_time)
        lines = [": ".join(filter(None, (label, time))), interface.name, note]
        yield Panel(
            Axis(RADIUS, ends=(low, high)), Axis("", ends=(bottom, top)),
            f"{interface.name}, {time}", note, curves=[*curves, edges, zero], bands=shades,
            legend="\n".join(filter(None, lines)),
            labels=_worn_through(
                r, state_values, (low, high), bottom + _TEXT_HEIGHT * (top - bottom)
            ),
        )  # fmt: skip


def _worn_through(
    r: FloatArray, values: FloatArray, ends: tuple[float, float], height: float
) -> list[Label]:
    """Return words in the widest part of an interface that has no stress, if it is wide."""
    finite = np.isfinite(values).all(axis=0)
    gone = np.ma.clump_masked(np.ma.array(r, mask=~finite))
    first, last = max(((r[part][0], r[part][-1]) for part in gone), key=np.ptp, default=(0.0, 0.0))
    if last - first < _WIDE * (ends[1] - ends[0]):
        return []
    return [Label(0.5 * float(first + last), height, "worn through")]
