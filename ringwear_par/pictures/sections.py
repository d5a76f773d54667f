"""The panel of deformed meridian sections, magnified."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.patches import Polygon

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.cases.files.key_values import outlines
from ringwear_par.elasticity.stress.fields import FACES, BoundaryFields
from ringwear_par.pictures.run_panels import pressure_limit
from ringwear_par.pictures.style import COLOURS
from ringwear_par.results.fields import boundaries
from ringwear_par.results.key_numbers import time_words
from ringwear_par.results.result import Result

#: what the largest displacement is drawn as, over the size of both bodies; what the deepest face
#: with its wear is drawn as at most, over the lower body's height
_MOVED, _DEEPEST = 0.1, 0.4


def magnification(most: float) -> float:
    """Return the round factor nearest to one, in logarithms."""
    if not np.isfinite(most):
        return 1.0
    power = 10.0 ** math.floor(math.log10(most))
    return float(power * min((1.0, 2.0, 5.0, 10.0), key=lambda x: abs(math.log(most / power / x))))


def _factor(bodies: Sequence[BoundaryFields], planes: Sequence[float]) -> float:
    """Return by how much displacements, wear and shapes of faces are magnified, all alike."""
    size = float(np.ptp(np.concatenate([body.nodes for body in bodies]), axis=0).max())
    height = min(float(np.ptp(body.nodes[:, 1])) for body in bodies)
    moved = max(float(np.hypot(*body.displacement[:, :2].T).max()) for body in bodies)
    deepest = max(
        float(np.abs(body.nodes[_face_nodes(body), 1] - plane).max())
        for body, plane in zip(bodies, planes, strict=True)
    )
    most = [
        share * whole / part
        for share, whole, part in ((_MOVED, size, moved), (_DEEPEST, height, deepest))
        if part > 0.0
    ]
    return magnification(min(most, default=math.inf))


def _face_nodes(body: BoundaryFields) -> IntArray:
    """Return the nodes of the face that looks to the other body, the contact line and beside it."""
    face_numbers = [FACES.index(name) for name in ("contact", "free")]
    return np.unique(body.elements[np.isin(body.face, face_numbers)])


def _drawn(body: BoundaryFields, plane: float, upward: float, factor: float) -> FloatArray:
    """Return (m, 2) mm, nodes along a contour moved by magnified displacement, wear and shape.

    All of them, or faces that touch would not do so in the picture. What is under the face gives
    way to it, sides and interfaces.

    Parameters
    ----------
    plane : mm, height of the contact plane.
    upward : 1 where the contact face looks up, -1 where it looks down.
    """
    at, face = body.nodes.copy(), _face_nodes(body)
    at[face, 1] = plane + factor * (at[face, 1] - plane)
    rest = np.setdiff1d(np.arange(len(at)), face)
    along = face[at[face, 0].argsort(kind="stable")]
    most = np.interp(at[rest, 0], at[along, 0], upward * at[along, 1])
    at[rest, 1] = upward * np.minimum(upward * at[rest, 1], most)
    return at + factor * body.displacement[:, :2]


def _contact_elements(body: BoundaryFields) -> tuple[IntArray, IntArray]:
    """Return the elements of the contact line by increasing radius, and (n, 3) their nodes."""
    elements = np.flatnonzero(body.face == FACES.index("contact"))
    elements = elements[body.nodes[body.elements[elements, 1], 0].argsort()]
    return elements, body.elements[elements]


def draw_section(axes: Any, result: Result, label: str) -> None:
    """Deformed meridian sections, magnified, with the contact pressure as colour."""
    state = boundaries(result)[-1]
    sections = outlines(result.case, result.name)
    planes = [outline.plane for outline in sections]
    factor = _factor(state.bodies, planes)
    lower, upper = (
        _drawn(body, plane, upward, factor)
        for body, plane, upward in zip(state.bodies, planes, (1.0, -1.0), strict=True)
    )
    elements, faces = (
        list(both) for both in zip(*(_contact_elements(body) for body in state.bodies), strict=True)
    )
    for number, body in enumerate(state.bodies):
        for zone, at in enumerate(body.contours):
            axes.add_patch(
                Polygon(
                    body.nodes[at], fill=False, edgecolor="0.55", linewidth=0.8,
                    label=None if number or zone else "undeformed, 1\N{MULTIPLICATION SIGN}",
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
    ends = np.sort(state.bodies[0].nodes[faces[0]][:, [0, 2], 0], axis=1)
    area = math.pi * np.diff(np.square(ends), axis=1)[:, 0]  # of elements, or of parts of them
    top = pressure_limit(area, p[None])
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
    time = time_words(state.time, float(result.histories["time"][-1]))
    shaped = any(np.ptp(outline.contour[:-2, 1]) > 0.0 for outline in sections)
    magnified = "displacement, wear, faces' shape" if shaped else "displacement and wear"
    layers = any(len(outline.interfaces) for outline in sections)
    axes.set_title(
        f"{label}: {time}\n"
        f"{magnified} {factor:g}\N{MULTIPLICATION SIGN}"
        + "\nlayers 1\N{MULTIPLICATION SIGN}"
        * layers
    )
    axes.legend(
        frameon=False, loc="upper center", bbox_to_anchor=(0.5, 0.0), borderaxespad=4.0, ncols=3,
        columnspacing=1.0, handlelength=1.2,
    )  # fmt: skip
