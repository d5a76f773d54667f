"""Projected conjugate gradients for contact problems in bases that all but diagonalise them.

With a force that is missing, solutions carry it, and so does each iterate: the change of approach
is the multiplier of that condition. Gould, Hribar and Nocedal, SIAM J. Sci. Comput. 23 (2001)
1376-1395.
"""

from typing import NamedTuple

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray, inner
from ringwear_par.contact.row_products import RowProducts

_MOST_ITERATIONS = 200


class ModalHessians(NamedTuple):
    """Hessians of h problems in their bases, 1 + Psi' slope Psi + change K'."""

    #: (h,) int, of their bases, and (m, n, n) float, all of these, transposed, and K' in them
    numbers: IntArray
    psi: FloatArray
    psi_t: FloatArray
    differences: FloatArray
    #: (h, n) float, and (h, 1) float; None: 0
    slope: FloatArray
    change: FloatArray | None
    #: (h, n) float, about their inverses, which are diagonal
    inverse: FloatArray
    #: (h, n) float, weights of the gap, and what these inverses make of them
    force: FloatArray
    response: FloatArray
    #: (h,) float, inner products of both
    stiffness: FloatArray


def solve_iteratively(
    hessians: ModalHessians, right: FloatArray, missing: FloatArray | None, tolerance: float
) -> tuple[FloatArray, FloatArray]:
    """Return solutions (h, n) in the bases, and changes of approaches, (h,).

    Parameters
    ----------
    right : (h, n) float.
    missing : (h,) float, N; None: approaches stay.
    tolerance : of residuals, relative to the first.
    """
    numbers, psi, psi_t, differences, slope, change, inverse, force, response, stiffness = hessians
    groups, count = RowProducts(numbers), len(right)
    solutions, multipliers, multiplier = np.zeros_like(right), np.zeros(count), np.zeros(count)

    def apply(x: FloatArray, some: IntArray | None = None) -> FloatArray:
        if some is not None:
            x = x[some]
        groups_of = groups if some is None else RowProducts(numbers[some])
        bent = groups_of.of(x, psi_t)
        bent *= slope if some is None else slope[some]
        product = groups_of.of(bent, psi)
        product += x
        if change is not None:
            more = groups_of.of(x, differences)
            more *= change if some is None else change[some]
            product += more
        return product

    def project() -> FloatArray:
        if missing is not None:
            more = divided(inner(response, r), stiffness)
            np.subtract(r, force * more[:, None], out=r)
            np.add(multiplier, more, out=multiplier)
        return inverse * r

    rows, x, r = np.arange(count), np.zeros_like(right), right.copy()
    if missing is not None and missing.any():
        x = response * divided(missing, stiffness)[:, None]
        # of so little as is mostly missing, the round-off of the last step, r is that of none
        size = tolerance * tolerance * inner(inverse * r, r)
        much = np.flatnonzero(missing * missing > size * stiffness)
        if len(much):
            r[much] -= apply(x, much)
    direction = project()
    size = inner(r, direction)
    small, going = tolerance * tolerance * size, np.ones(count, dtype=bool)
    for _ in range(_MOST_ITERATIONS):
        ended = going & ~(size > small)
        if ended.any():
            solutions[rows[ended]], multipliers[rows[ended]] = x[ended], -multiplier[ended]
            going &= ~ended
            if not going.any():
                break
            if 2 * going.sum() <= len(going):  # to leave rows out takes some iterations' time
                rows, x, r, direction, size, small, multiplier, numbers = (
                    a[going] for a in (rows, x, r, direction, size, small, multiplier, numbers)
                )
                slope, inverse, force, response, stiffness = (
                    a[going] for a in (slope, inverse, force, response, stiffness)
                )
                if change is not None:
                    change = change[going]
                groups, going = RowProducts(numbers), going[going]
        product = apply(direction)
        length = divided(size, inner(direction, product))[:, None]
        x += length * direction
        product *= length
        r -= product
        z = project()
        before, size = size, inner(r, z)
        direction *= divided(size, before)[:, None]
        direction += z
    else:
        solutions[rows[going]], multipliers[rows[going]] = x[going], -multiplier[going]
    return solutions, multipliers


def divided(force: FloatArray, stiffness: FloatArray) -> FloatArray:
    """Return forces over stiffnesses, (h,); 0 where nothing touches."""
    return np.divide(force, stiffness, out=np.zeros_like(force), where=stiffness > 0.0)
