"""A smooth onset of wear: k mu V p^2 / (p + p1), as user_law.toml uses it.

``p`` (n,) is the contact pressure, MPa. ``at`` knows the rest, for the elements of the contact
line: ``at.r`` (mm), ``at.speed`` (mm/s), ``at.friction``, ``at.time`` (s), ``at.wear`` and
``at.slid`` (mm, worn depth and distance slid so far) and ``at.parameters`` of the case file.
A law whose rate depends on ``at.wear`` should define ``wear_slope(p, at)`` too (1/s); one that
switches with ``at.time`` should name the times in a list ``knots``, which adaptive steps then meet.
"""

from numpy.typing import NDArray

from ringwear_par.wear.law import LocalState


def rate(p: NDArray, at: LocalState) -> NDArray:
    """Rate of wear, mm/s; 0 without pressure, and not falling with it."""
    k, p1 = at.parameters["k"], at.parameters["p1"]
    return k * at.friction * at.speed * p * p / (p + p1)


def slope(p: NDArray, at: LocalState) -> NDArray:
    """Its derivative with respect to pressure, mm/s/MPa."""
    k, p1 = at.parameters["k"], at.parameters["p1"]
    return k * at.friction * at.speed * p * (p + 2.0 * p1) / (p + p1) ** 2
