"""A smooth onset of wear: k mu V p^2 / (p + p1), as user_law.toml uses it.

``p`` (n,) is the contact pressure, MPa. ``at`` knows the rest, for the elements of the contact
line: ``at.r`` (mm), ``at.speed`` (mm/s), ``at.friction``, ``at.time`` (s), ``at.wear`` and
``at.slid`` (mm, worn depth and distance slid so far) and ``at.parameters`` of the case file.

A file needs ``rate(p, at)`` only; derivatives that it does not define are found from the rate by
differences. It may define ``d_rate_dp(p, at)``, as here, and ``d_rate_dwear(p, at)`` (1/s) of a
rate that depends on ``at.wear``; and a list ``breakpoints`` of the times at which the rate jumps or
bends, which adaptive steps then meet.
"""

from numpy.typing import NDArray

from ringwear_par.wear import LocalState


def rate(p: NDArray, at: LocalState) -> NDArray:
    """Rate of wear, mm/s; 0 without pressure, and not falling with it."""
    k, p1 = at.parameters["k"], at.parameters["p1"]
    return k * at.friction * at.speed * p * p / (p + p1)


def d_rate_dp(p: NDArray, at: LocalState) -> NDArray:
    """Its derivative with respect to pressure, mm/s/MPa."""
    k, p1 = at.parameters["k"], at.parameters["p1"]
    return k * at.friction * at.speed * p * (p + 2.0 * p1) / (p + p1) ** 2
