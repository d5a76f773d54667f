"""Slopes of the contact faces, and the one along whose normal an element's pressure acts.

Elements of the two faces over the same interval of radii are paired. Pressure acts along their
common normal, and the gap is what it is along the axis: with the slope t = tan alpha = dz/dr in a
body's own frame, the traction per area projected on the contact plane is (t, -1) p, and what the
body gives way is -(u_z - t u_r). The axial force is the projected area times p; friction and wear
act on the true area, which is larger by 1 / cos alpha.

Both bodies need the same slope, or their compliance would not be symmetric. Where the faces differ,
as a chamfer and a flat face do, it is the flatter one's, and none where they slope apart: the
radial motion of a flat face closes no gap.
"""

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.elasticity.geometry.mesh import ContactLine, Mesh
from ringwear_par.elasticity.geometry.sections import Section


def face_slope(
    section: Section, line: ContactLine, mesh: Mesh, worn: FloatArray | None = None
) -> FloatArray:
    """Return (..., n), tan alpha of a contact face on each element, in the body's own frame.

    Worn faces are not looked at more closely than ``mesh.geometry_tolerance``, about which their
    elements follow the wear: over elements far smaller, the round-off of depths would be a slope.

    Parameters
    ----------
    worn : (..., n) float, mm, depths worn off the elements; None for an unworn face.
    """
    slope: FloatArray = np.diff(section.depth(line.edges)) / line.width
    if worn is None:
        return slope
    r = line.gap_point
    half = np.maximum(0.5 * line.width, mesh.geometry_tolerance)
    below, above = (np.clip(r + side * half, r[0], r[-1]) for side in (-1.0, 1.0))
    lowered = _interpolated(above, r, worn) - _interpolated(below, r, worn)
    return slope - lowered / (above - below)


def _interpolated(x: FloatArray, r: FloatArray, values: FloatArray) -> FloatArray:
    """Return values (..., n) at increasing radii r (n,) interpolated at x (n,) between them."""
    i = np.clip(np.searchsorted(r, x, side="right") - 1, 0, len(r) - 2)
    start, end = values[..., i], values[..., i + 1]
    return start + (end - start) / (r[i + 1] - r[i]) * (x - r[i])


def case_slopes(
    sections: tuple[Section, Section],
    line: ContactLine,
    mesh: Mesh,
    worn: FloatArray | None = None,
) -> FloatArray:
    """Return (2, ..., n), tan alpha of the faces of lower and upper in the frame of the case.

    Parameters
    ----------
    worn : (2, ..., n) float, mm, depths worn off; None for unworn faces.
    """
    lower, upper = (
        face_slope(section, line, mesh, None if worn is None else worn[i])
        for i, section in enumerate(sections)
    )
    return np.stack([lower, -upper])


def common_slope(slopes: FloatArray) -> FloatArray:
    """Return (n,), the flatter of two slopes (2, n), 0 where they slope apart."""
    lower, upper = slopes
    flatter = np.where(np.abs(lower) < np.abs(upper), lower, upper)
    return np.where(lower * upper > 0.0, flatter, 0.0)


def pair_slope(
    sections: tuple[Section, Section],
    line: ContactLine,
    mesh: Mesh,
    worn: FloatArray | None = None,
) -> FloatArray:
    """Return (n,), tan alpha of the normals that pressure acts along, in the frame of the case.

    Arguments are those of ``case_slopes``. Lower has it in its own frame, upper the negative.
    """
    return common_slope(case_slopes(sections, line, mesh, worn))


def obliquity(slope: FloatArray) -> FloatArray:
    """Return 1 / cos alpha: true area over projected area, of slopes tan alpha."""
    return np.hypot(1.0, slope)
