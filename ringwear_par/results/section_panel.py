"""The panel of deformed meridian sections, magnified."""

import math
from typing import Any

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.patches import Polygon

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.elasticity.boundary import node_wear
from ringwear_par.elasticity.boundary_fields import FACES, BoundaryFields
from ringwear_par.elasticity.mesh import ContactLine
from ringwear_par.results.drawing import COLOURS, time_unit
from ringwear_par.results.export import choose_state
from ringwear_par.results.result import Result


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


def draw_section(axes: Any, result: Result, label: str) -> None:
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
        for zone, at in enumerate(body.contours):
            axes.add_patch(
                Polygon(
                    body.nodes[at], fill=False, edgecolor="0.75", linewidth=0.8,
                    label=None if number or zone else "undeformed",
                )
            )  # fmt: skip
    for number, (outline, name) in enumerate(((lower, "lower"), (upper, "upper"))):
        for zone, at in enumerate(state.bodies[number].contours):
            axes.add_patch(
                Polygon(
                    outline[at], facecolor=(COLOURS[number], 0.12), edgecolor=COLOURS[number],
                    linewidth=0.8, label=None if zone else name,
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
    unit, seconds = time_unit(float(result.histories["time"][-1]))
    raised = "\nupper raised until they touch" if overlap > 0.005 * size else ""
    axes.set_title(
        f"{label}: {state.time / seconds:.4g} {unit}\n"
        f"displacement and wear {factor:g}\N{MULTIPLICATION SIGN}{raised}"
    )
    axes.legend(
        frameon=False, loc="upper center", bbox_to_anchor=(0.5, 0.0), borderaxespad=4.0, ncols=3,
        columnspacing=1.0, handlelength=1.2,
    )  # fmt: skip
