"""Contact faces as case files give them: shapes with names, and polylines."""

import itertools
import math
from typing import NamedTuple

import numpy as np

from ringwear_par.elasticity.sections import Polyline

Pair = tuple[float, float]
#: what counts as equal, relative to the size of a body
CLOSE = 1e-9
#: the shapes that have names, and the units of their numbers
SHAPE_UNITS = {"crown": "mm", "sphere": "mm", "cone": "deg", "fillet": "mm", "trace": "mm"}
#: points of a crown or sphere, and of a fillet's quarter of a circle
_SAMPLES, _ARC = 101, 31


class Shape(NamedTuple):
    """A contact face by the name of its shape."""

    #: one of ``SHAPE_UNITS``, or "chamfer"
    name: str
    #: what it has: radii in mm (of a chamfer or fillet one or two), an angle in degrees, radii and
    #: heights in mm in turns
    numbers: tuple[float, ...]


def contact_face(
    ring: str, given: Shape | Polyline, r: Pair, z: Pair
) -> tuple[Polyline, list[str]]:
    """Return the face of "lower" or "upper" in its own frame, () for the flat one; or its faults.

    Parameters
    ----------
    given : a shape, or a polyline in the frame of the case.
    r, z : mm, radii of the body, and heights of its ends in the frame of the case.

    Returns
    -------
    face, faults : the faults as "key = value: sentence"; with any, the face is ().
    """
    if isinstance(given, Shape):
        faults = _shape_faults(given, r, z)
        return (() if faults else _shape_face(given, r)), faults
    faults = _profile_faults(ring, given, r, z)
    return (() if faults else _profile_face(ring, given, r, z)), faults


def _shape_faults(shape: Shape, r: Pair, z: Pair) -> list[str]:
    """Return the faults of a shape."""
    (a, b), height, first = r, z[1] - z[0], shape.numbers[0]
    entry, faults = f"profile = {{ {shape.name} = {first:g} }}", []
    if shape.name == "crown" and first <= 0.5 * (b - a):
        faults.append(f"{entry}: must be > {0.5 * (b - a):g}, half the width of the face (mm)")
    elif shape.name == "sphere" and first <= b:
        faults.append(f"{entry}: must be > {b:g}, the outer radius (mm)")
    elif shape.name in ("chamfer", "fillet"):
        inner, outer = _at_edges(shape.numbers, r)
        entry = f"{shape.name} = [{inner:g}, {outer:g}]"
        entry = f"profile = {{ {entry} }}" if shape.name == "fillet" else entry
        if a == 0 and inner > 0:
            faults.append(f"{entry}: a solid disc has no inner corner; the first must be 0 (mm)")
        if inner + outer >= b - a:
            faults.append(f"{entry}: both together must be < {b - a:g}, the width of the face (mm)")
    elif shape.name == "trace":
        entry, end = f"profile: a trace from r = {first:g}", shape.numbers[-2]
        if first > a + CLOSE * b or end < b - CLOSE * b:
            faults.append(f"{entry} to {end:g} mm; must cover the face, from {a:g} to {b:g} mm")
    deepest = 0.0 if faults else -min((depth for _, depth in _shape_face(shape, r)), default=0.0)
    if deepest >= height:
        faults.append(
            f"{entry}: recedes by {deepest:g}; must be < {height:g}, the height of the body (mm)"
        )
    return faults


def _shape_face(shape: Shape, r: Pair) -> Polyline:
    """Return a face of a sound shape in the body's own frame, its highest point at z = 0.

    Curves are sampled so densely that they are taken for smooth.
    """
    (a, b), numbers = r, shape.numbers
    if shape.name in ("chamfer", "fillet"):
        return _edged(*_at_edges(numbers, r), r, shape.name)
    if shape.name == "trace":
        radii, heights = np.array(numbers[::2]), np.array(numbers[1::2])
        x = np.unique([a, *radii[(radii > a) & (radii < b)], b])
        z = np.interp(x, radii, heights)
    else:
        x, size = np.linspace(a, b, _SAMPLES), numbers[0]
        if shape.name == "cone":
            x = np.array([a, b])
            z = -math.tan(math.radians(size)) * x
        else:
            centre = 0.5 * (a + b) if shape.name == "crown" else 0.0
            z = -((x - centre) ** 2) / (size + np.sqrt(size**2 - (x - centre) ** 2))
    z = z - z.max()
    return tuple(zip(x.tolist(), z.tolist(), strict=True)) if z.any() else ()


def _at_edges(numbers: tuple[float, ...], r: Pair) -> Pair:
    """Return the sizes at the inner and outer edge; one number is for the edges that there are."""
    inner = 0.0 if len(numbers) == 1 and r[0] == 0 else numbers[0]
    return inner, numbers[-1]


def _edged(inner: float, outer: float, r: Pair, name: str) -> Polyline:
    """Return the flat face with edges cut off at 45 degrees or rounded by quarters of circles."""
    edge = np.array([[1.0, -1.0], [0.0, 0.0]])  # of size 1, from the side face to the flat one
    if name == "fillet":
        angles = np.radians(np.linspace(90.0, 0.0, _ARC))
        edge = np.stack([np.sin(angles), np.cos(angles) - 1.0], axis=1)
    a, b = r
    points = [(a, 0.0), (b, 0.0)]
    if inner > 0:
        points[:1] = [(a + inner * (1.0 - x), inner * z) for x, z in edge]
    if outer > 0:
        points[-1:] = [(b - outer * (1.0 - x), outer * z) for x, z in edge[::-1]]
    return tuple((float(x), float(z)) for x, z in points) if inner or outer else ()


def _profile_faults(ring: str, profile: Polyline, r: Pair, z: Pair) -> list[str]:
    """Return the faults of a polyline."""
    faults = []

    def point(i: int) -> str:
        return f"profile[{i}] = [{profile[i][0]:.12g}, {profile[i][1]:.12g}]"

    back = next((i for i, (p, q) in enumerate(itertools.pairwise(profile), 1) if q[0] <= p[0]), 0)
    if back:
        faults.append(
            f"{point(back)}: the face does not face the other body where r does not increase; "
            f"must be > {profile[back - 1][0]:.12g}, the radius before"
        )
    for i, end, where in ((0, r[0], "inner"), (len(profile) - 1, r[1], "outer")):
        if not back and abs(profile[i][0] - end) > CLOSE * max(1.0, r[1]):
            faults.append(
                f"{point(i)}: the profile must run from the inner to the outer radius; its "
                f"{where} end must have r = {end:.12g} (mm)"
            )
    slack = CLOSE * max(1.0, *map(abs, z))
    low, high = (">", "<=") if ring == "lower" else (">=", "<")
    for i, (_, height) in enumerate(profile):
        depth = z[1] - height if ring == "lower" else height - z[0]
        if not -slack <= depth < z[1] - z[0] - slack:
            faults.append(
                f"{point(i)}: leaves the body; z must be {low} {z[0]:g} and {high} {z[1]:g} (mm)"
            )
            break  # one sentence for all points outside
    return faults


def _profile_face(ring: str, profile: Polyline, r: Pair, z: Pair) -> Polyline:
    """Return a sound polyline in the body's own frame, its ends snapped."""
    radii = [r[0], *(p[0] for p in profile[1:-1]), r[1]]
    heights_of_points = [p[1] - z[1] if ring == "lower" else z[0] - p[1] for p in profile]
    heights = [min(0.0, v) for v in heights_of_points]  # the contact plane is met but for round-off
    return tuple(zip(radii, heights, strict=True)) if any(heights) else ()
