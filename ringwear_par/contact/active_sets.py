"""What the lock-step Newton method does to each history, compiled: its step, and whether it ends.

Arrays of all histories are (B, n) and (B,); each function goes through some of them, one by one.
"""

import math

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray, IntArray
from ringwear_par.elasticity.compiling import compiled

#: what ``settle`` finds
GOES_ON, SETTLED, BROKEN = 0, 1, 2


@compiled
def advance(
    histories: IntArray,
    weights: FloatArray,
    border: FloatArray,
    sums: FloatArray,
    forces: FloatArray,
    steps: FloatArray,
    q: FloatArray,
    approaches: FloatArray,
) -> None:
    """Make the Newton steps of some histories, whose approach follows so that the force is met.

    Parameters
    ----------
    histories : (h,) int.
    weights : (B, n) float, what the approach has in the gradient.
    border, sums : (B, n) and (B,) float, H^-1 weights and what the weights make of it.
    forces : (B,) float, N; (0,) where approaches are given.
    steps : (h, n) float, -H^-1 gradient.
    q, approaches : (B, n) and (B,) float, changed in place.
    """
    for place, history in enumerate(histories):
        change = 0.0
        if len(forces):
            carried = 0.0
            for i in range(q.shape[1]):
                carried += weights[history, i] * (q[history, i] + steps[place, i])
            change = (forces[history] - carried) / sums[history]
            approaches[history] += change
        for i in range(q.shape[1]):
            q[history, i] += steps[place, i] + change * border[history, i]


@compiled
def settle(
    histories: IntArray,
    weights: FloatArray,
    gaps: FloatArray,
    approaches: FloatArray,
    forces: FloatArray,
    slope: FloatArray,
    tolerance: float,
    force_tolerance: float,
    round_off: float,
    q: FloatArray,
    gradient: FloatArray,
    free: BoolArray,
    found: IntArray,
) -> bool:
    """Find which histories have settled; the others go on with the sets that the signs tell.

    Parameters
    ----------
    histories : (h,) int.
    slope : (B, n) float, what wear added to the diagonal, else 1, of the Hessian.
    tolerance : norm of the gradient at which a history ends, relative to that of the overlap.
    force_tolerance : imbalance of force at which it does, relative.
    round_off : or the largest change of q that is left, relative to the largest q.
    q, gradient : (B, n) float; q is put to 0 where it leaves the set.
    free : (B, n) bool, in place.
    found : (h,) int, GOES_ON, SETTLED or BROKEN, where there are no numbers any more.

    Returns
    -------
    Whether any q was changed.
    """
    n, changed = q.shape[1], False
    for place, history in enumerate(histories):
        same, square, overlap, worst, largest, carried = True, 0.0, 0.0, 0.0, 0.0, 0.0
        for i in range(n):
            x, g = q[history, i], gradient[history, i]
            keep = x > 0.0 if free[history, i] else g < 0.0
            if keep != free[history, i]:
                same = False
            diagonal = 1.0 + slope[history, i]
            defect = min(g, x * diagonal)
            square += defect * defect
            worst = max(worst, abs(defect / diagonal))
            largest = max(largest, x)
            carried += weights[history, i] * x
            over = max(approaches[history] - gaps[history, i], 0.0) * weights[history, i]
            overlap += over * over
        if not math.isfinite(square + carried):
            found[place] = BROKEN
            continue
        fine = math.sqrt(square) <= tolerance * math.sqrt(overlap) or worst <= round_off * largest
        if len(forces) and not abs(carried - forces[history]) <= force_tolerance * forces[history]:
            fine = False
        found[place] = SETTLED if same and fine else GOES_ON
        if same:
            continue
        for i in range(n):
            keep = q[history, i] > 0.0 if free[history, i] else gradient[history, i] < 0.0
            free[history, i] = keep
            if not keep and q[history, i] != 0.0:
                q[history, i] = 0.0
                changed = True
    return changed


@compiled
def natural(
    histories: IntArray,
    slope: FloatArray,
    q: FloatArray,
    gradient: FloatArray,
    worst: FloatArray,
    largest: FloatArray,
) -> None:
    """Set the natural KKT residuals and the largest q, (h,), of some histories."""
    for place, history in enumerate(histories):
        most, top = 0.0, 0.0
        for i in range(q.shape[1]):
            off = abs(min(q[history, i], gradient[history, i] / (1.0 + slope[history, i])))
            if not off <= most:  # nor NaN
                most = off
            top = max(top, q[history, i])
        worst[place] = most if math.isfinite(most) else np.inf
        largest[place] = top


@compiled(fastmath={"contract", "reassoc"})
def follow(
    weights: FloatArray,
    scale: FloatArray,
    border: FloatArray,
    sums: FloatArray,
    d_forces: FloatArray,
    d_q: FloatArray,
    d_approaches: FloatArray,
) -> None:
    """Make derivatives of pressures and approaches of what gaps alone do, for some histories.

    Parameters
    ----------
    weights, scale, border, sums : (h, n) and (h,) float, as of ``advance``.
    d_forces : (P, h) float, N, of the forces; (P, 0) where approaches are given.
    d_q : (P, h, n) float, H^-1 times the derivatives of the weighted gaps; pressures in place.
    d_approaches : (P, h) float, mm; replaced where forces are given and something touches.
    """
    for k in range(d_q.shape[0]):
        for h in range(d_q.shape[1]):
            x = d_q[k, h]
            if d_forces.shape[1] and sums[h] > 0.0:
                carried = 0.0
                for i in range(len(x)):
                    carried += weights[h, i] * x[i]
                d_approaches[k, h] = (d_forces[k, h] + carried) / sums[h]
            for i in range(len(x)):
                x[i] = (border[h, i] * d_approaches[k, h] - x[i]) / scale[h, i]
