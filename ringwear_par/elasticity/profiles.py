"""Contact faces as case files give them, chamfers and profiles, and what is wrong with them."""

import itertools

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.elasticity.sections import Polyline

Pair = tuple[float, float]
#: what counts as equal, relative to the size of a body
CLOSE = 1e-9


def chamfer_faults(chamfer: Pair, r: Pair, z: Pair) -> list[str]:
    """Return what is wrong with the chamfers of a ring, "key = value: sentence"."""
    said = f"chamfer = [{chamfer[0]:g}, {chamfer[1]:g}]"
    faults = []
    if r[0] == 0 and chamfer[0] > 0:
        faults.append(f"{said}: a solid disc has no inner corner; the first must be 0 (mm)")
    if sum(chamfer) >= r[1] - r[0]:
        faults.append(
            f"{said}: both together must be smaller than the width of the face, "
            f"{r[1] - r[0]:g} (mm)"
        )
    if max(chamfer) >= z[1] - z[0]:
        faults.append(f"{said}: must be smaller than the height, {z[1] - z[0]:g} (mm)")
    return faults


def chamfer_face(chamfer: Pair, r: Pair) -> Polyline:
    """Return the contact face with its corners cut off at 45 degrees, in the body's own frame."""
    (inner, outer), (a, b) = chamfer, r
    if not any(chamfer):
        return ()
    points = [(a, -inner), (a + inner, 0.0), (b - outer, 0.0), (b, -outer)]
    return tuple(p for p, keep in zip(points, (inner, True, True, outer), strict=True) if keep)


def _crosses(points: Polyline) -> bool:
    """Tell whether two segments of a polyline that are not neighbours meet."""
    xy = np.array(points)
    start, end = xy[:-1], xy[1:]

    def side(a: FloatArray, b: FloatArray, point: FloatArray) -> FloatArray:
        """Return on which side of the segments from a to b points lie, by the sign."""
        along, to = b - a, point - a
        return along[..., 0] * to[..., 1] - along[..., 1] * to[..., 0]

    low, high = np.minimum(start, end), np.maximum(start, end)
    for i in range(len(start) - 2):
        p, q, others = start[i], end[i], slice(i + 2, None)
        a, b = start[others], end[others]
        near = ((low[others] <= high[i]) & (high[others] >= low[i])).all(axis=1)
        apart = side(p, q, a) * side(p, q, b) > 0
        if (near & ~apart & (side(a, b, p) * side(a, b, q) <= 0)).any():
            return True
    return False


def profile_faults(ring: str, profile: Polyline, r: Pair, z: Pair) -> list[str]:
    """Return what is wrong with the profile of "lower" or "upper", "key = value: sentence"."""
    faults = []

    def said(i: int) -> str:
        return f"profile[{i}] = [{profile[i][0]:.12g}, {profile[i][1]:.12g}]"

    back = next((i for i, (p, q) in enumerate(itertools.pairwise(profile), 1) if q[0] <= p[0]), 0)
    if back and _crosses(profile):
        faults.append(f"{said(back)}: the profile crosses itself; r must increase along it")
    elif back:
        faults.append(
            f"{said(back)}: the face does not face the other body where r does not increase; "
            f"must be > {profile[back - 1][0]:.12g}, the radius before"
        )
    else:
        for i, end, where in ((0, r[0], "inner"), (len(profile) - 1, r[1], "outer")):
            if abs(profile[i][0] - end) > CLOSE * max(1.0, r[1]):
                faults.append(
                    f"{said(i)}: the profile must run from the inner to the outer radius; its "
                    f"{where} end must have r = {end:.12g} (mm)"
                )
    slack = CLOSE * max(1.0, *map(abs, z))
    lowest, highest = (
        (z[0] + slack, z[1] + slack) if ring == "lower" else (z[0] - slack, z[1] - slack)
    )
    for i, (_, height) in enumerate(profile):
        if ring == "lower" and not lowest < height <= highest:
            faults.append(f"{said(i)}: leaves the body; z must be > {z[0]:g} and <= {z[1]:g} (mm)")
        elif ring == "upper" and not lowest <= height < highest:
            faults.append(f"{said(i)}: leaves the body; z must be >= {z[0]:g} and < {z[1]:g} (mm)")
        else:
            continue
        break  # one sentence for all points outside
    return faults


def profile_face(ring: str, profile: Polyline, r: Pair, z: Pair) -> Polyline:
    """Return a sound profile of "lower" or "upper" in the body's own frame, its ends snapped."""
    radii = [r[0], *(p[0] for p in profile[1:-1]), r[1]]
    own = [p[1] - z[1] if ring == "lower" else z[0] - p[1] for p in profile]
    heights = [min(0.0, v) for v in own]  # the contact plane is met but for round-off
    return tuple(zip(radii, heights, strict=True)) if any(heights) else ()
