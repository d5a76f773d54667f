"""Panels of stresses along interfaces: what pulls and shears there, von Mises on both sides."""

from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray
from ringwear_par.cases.files.key_values import outlines
from ringwear_par.elasticity.stress.fields import StressState
from ringwear_par.elasticity.stress.measures import COMPONENTS, SIDES, mises
from ringwear_par.pictures.style import COLOURS, DASHES, set_legend
from ringwear_par.results.instants import time_words
from ringwear_par.results.result import Result
from ringwear_par.results.storage.stored_stresses import Interface, interfaces_of, stresses

#: how far beside the contact is drawn, over its width
_BESIDE = 0.5
#: share of the highest values that is left above and below them
_ROOM = 0.05
#: share of the radii drawn from which on a part that is worn through is told in words, and where
_WIDE, _TEXT_HEIGHT = 0.2, 0.6
#: of the components that both sides share, words for a legend
_TRACTIONS = {
    "zz": r"normal $\sigma_{zz}$ (+ opens)",
    "rz": r"shear $\tau_{rz}$",
    "tz": r"friction's $\tau_{tz}$",
}


def interface_drawings(
    result: Result, label: str, states: Sequence[StressState]
) -> Iterator[partial[None]]:
    """Yield drawings of tractions along each interface at some states, then of von Mises."""
    for draw in (draw_tractions, draw_both_sides):
        for interface in interfaces_of(result):
            for state in states:
                yield partial(
                    draw, result=result, label=label, interface=interface, states=states,
                    state=state,
                )  # fmt: skip


def draw_tractions(
    axes: Any, result: Result, label: str, interface: Interface, states: Sequence[StressState],
    state: StressState,
) -> None:  # fmt: skip
    """Draw the normal and the shear tractions, the same on both sides.

    Parameters
    ----------
    states : those that have a panel each, on one scale.
    """
    chosen = [COMPONENTS.index(name) for name in _TRACTIONS]

    def values(of: StressState) -> FloatArray:
        return interface.stress(of)[0][:, chosen].T

    axes.axhline(0.0, color="0.4", linewidth=0.8)
    _draw(axes, result, interface, [values(of) for of in states], values(state), _TRACTIONS)
    axes.set_ylabel("traction on the interface (MPa)")
    set_legend(axes, 2, _title(result, label, interface, state))


def draw_both_sides(
    axes: Any, result: Result, label: str, interface: Interface, states: Sequence[StressState],
    state: StressState,
) -> None:  # fmt: skip
    """Draw von Mises' stress above and below an interface, see ``draw_tractions``."""

    def values(of: StressState) -> FloatArray:
        return mises(interface.stress(of))

    names = {side: f"just {side}" for side in SIDES}
    _draw(axes, result, interface, [values(of) for of in states], values(state), names)
    axes.set_ylim(bottom=0.0)
    axes.set_ylabel("von Mises stress (MPa)")
    set_legend(axes, 2, _title(result, label, interface, state))


def _draw(
    axes: Any, result: Result, interface: Interface, scale: Sequence[FloatArray],
    values: FloatArray, names: dict[str, str],
) -> None:  # fmt: skip
    """Draw curves under the contact and beside it, free edges shaded.

    Parameters
    ----------
    scale : (c, m) each, MPa, what the axis has room for but beside free edges.
    values : (c, m) float, MPa, the curves.
    """
    r, contact = interface.r, result.line.edges[[0, -1]]
    for number, (curve, name) in enumerate(zip(values, names.values(), strict=True)):
        axes.plot(r, curve, color=COLOURS[number], linestyle=DASHES[number], label=name)
    low, high = _drawn_range(result, interface)
    for number, edge in enumerate(contact):
        axes.axvline(
            edge, color="0.6", linewidth=0.8, linestyle=":",
            label=None if number else "edges of contact",
        )  # fmt: skip
    scaled, exclude = (r >= low) & (r <= high), stresses(result).exclude
    for end in _free_edges(result, interface):
        scaled &= np.abs(r - end) >= exclude
        axes.axvspan(end - exclude, end + exclude, color="0.9", linewidth=0.0)
    axes.set_xlim(low, high)
    extent = np.concatenate([curves[:, scaled].ravel() for curves in scale])
    extent = np.append(extent[np.isfinite(extent)], 0.0)
    room = _ROOM * float(np.ptp(extent)) or 1.0
    axes.set_ylim(extent.min() - room, extent.max() + room)
    _tell_worn_through(axes, r, np.isfinite(values).all(axis=0))
    axes.set_xlabel("distance to axis (mm)")


def _tell_worn_through(axes: Any, r: FloatArray, known: BoolArray) -> None:
    """Say in the widest part of an interface that has no stress what has become of it."""
    low, high = axes.get_xlim()
    gone = np.ma.clump_masked(np.ma.array(r, mask=~known))
    first, last = max(((r[part][0], r[part][-1]) for part in gone), key=np.ptp, default=(low, low))
    if last - first >= _WIDE * (high - low):
        axes.text(
            0.5 * (first + last), _TEXT_HEIGHT, "worn through", ha="center",
            transform=axes.get_xaxis_transform(),
        )  # fmt: skip
    if not known.any():
        axes.set_yticks([])


def _drawn_range(result: Result, interface: Interface) -> tuple[float, float]:
    """Return the radii between which an interface is drawn, mm."""
    inner, outer = result.line.edges[[0, -1]]
    beside = _BESIDE * (outer - inner)
    first, last = _ends(result, interface)
    return max(first, inner - beside), min(last, outer + beside)


def _ends(result: Result, interface: Interface) -> tuple[float, float]:
    """Return the radii of the ends of an interface, mm."""
    contour = outlines(result.case, result.name)[interface.body].contour
    return float(contour[:, 0].min()), float(contour[:, 0].max())


def _free_edges(result: Result, interface: Interface) -> list[float]:
    """Return the radii of the ends of an interface that are drawn and not on the axis, mm."""
    low, high = _drawn_range(result, interface)
    return [end for end in _ends(result, interface) if low <= end <= high and end > 0.0]


def _title(result: Result, label: str, interface: Interface, state: StressState) -> str:
    time = time_words(state.time, float(result.histories["time"][-1]))
    title = f"{label}: {time}\n{interface.name}"
    exclude = stresses(result).exclude
    if exclude and _free_edges(result, interface):
        title += f"\nshaded: {exclude:g} mm beside free edges, where stress is infinite"
    return title
