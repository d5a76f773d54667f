"""Derivatives of contact solutions, on the inverses of the Hessians that these ended with.

Elements in contact stay so, and so do the sides of kinks that elements are on.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray, inner
from ringwear_par.contact.hessians import Hessians
from ringwear_par.contact.problem import ContactProblem, ContactState, part

#: less than any stiffness
_TINY = 1e-300


class SolutionDerivatives:
    """Derivatives of the last solutions of B contact problems.

    Parameters
    ----------
    problem : the contact problems.
    hessians : of them.
    """

    def __init__(self, problem: ContactProblem, hessians: Hessians) -> None:
        self._problem, self._hessians = problem, hessians

    def response(self, gap: FloatArray, histories: IntArray | None = None) -> FloatArray:
        """Return about the changes of the last pressures, MPa, with small growths of gaps.

        Of (..., B, n) mm, or (..., h, n) of some histories, to some 1e-2 of them: for estimates of
        errors. Linear, elements in contact and forces or approaches, whichever were given, staying
        so; the wear of the step included.
        """
        problem = self._problem
        histories = problem.every if histories is None else histories
        return self._hessians.responses(histories, gap, problem.forces is not None)

    def propagate_errors(self, *errors: Any) -> IntArray:
        """Propagate errors of steps where that is diagonal, and return the other histories.

        Responses are those of ``response``. For the errors see ``Hessians.propagate_errors``.
        """
        problem = self._problem
        return self._hessians.propagate_errors(problem.every, problem.forces is not None, *errors)

    def deflections(self, d_p: FloatArray) -> FloatArray:
        """Return the changes of gaps, mm, with those of pressures, (P, B, n) MPa."""
        problem = self._problem
        products = problem.compliances.products(problem.which)
        return products.symmetric(problem.scale * d_p) / problem.weights

    def tangents(
        self,
        solution: ContactState,
        d_gap: FloatArray,
        d_force: FloatArray | None,
        d_approach: FloatArray | None,
        slope: FloatArray | None,
        histories: IntArray,
    ) -> tuple[FloatArray, FloatArray]:
        """Return derivatives of the last pressures, (P, h, n), and approaches, (P, h), of some.

        On the inverses that solutions ended with.

        Parameters
        ----------
        solution : the last solution.
        d_gap : (P, B, n) mm, derivatives of gaps at given pressures, wear included.
        d_force, d_approach : (P, B) N or mm, of the loads; the other one is None.
        slope : derivatives of the wear of the step with respect to pressure at the solution, (B, n)
            mm/MPa, or (B, n, n) where it is non-local; None where there is none.
        histories : (h,) int.
        """
        hessians, rows = self._hessians, self._problem.rows_of(histories)
        weights, scale = part(self._problem.weights, rows), part(self._problem.scale, rows)
        by_gap = hessians.solve(histories, d_gap[:, rows] * weights)
        by_approach = hessians.solve(histories, np.broadcast_to(weights, by_gap.shape[1:]).copy())
        mismatch = None if slope is None else self._hessian_mismatch(slope, rows)
        if mismatch is not None:
            by_gap -= hessians.solve(histories, np.array([mismatch(x) for x in by_gap]))
            by_approach = by_approach - hessians.solve(histories, mismatch(by_approach))
        if d_approach is None:
            # where nothing touches, the force being 0, bodies stay at the nearest element
            nearest = solution.gap[rows].argmin(axis=1)
            moved = d_gap[:, histories, nearest]
        else:
            moved = d_approach[:, rows].copy()
        stiffness = inner(weights, by_approach)
        if d_force is not None:
            carried = d_force[:, rows] + inner(weights, by_gap)
            moved = np.where(stiffness > 0.0, carried / np.maximum(stiffness, _TINY), moved)
        return (by_approach * moved[..., None] - by_gap) / scale, moved

    def _hessian_mismatch(
        self, slope: FloatArray, rows: IntArray | slice
    ) -> Callable[[FloatArray], FloatArray] | None:
        """Return the product of x (h, n) with the slopes at a solution less those of the Hessian.

        The Hessian is that of the iterate before; None where it is the same.
        """
        hessians = self._hessians
        # made as TAO's callbacks make it, so that what has not changed is 0
        change = self._problem.scaled_slopes(slope[rows], rows)
        if change.ndim == hessians.blocks.slopes.ndim:
            change -= hessians.blocks.slopes[rows]
            return (lambda x: change * x) if change.any() else None
        change -= hessians.coupling[rows]
        places = np.arange(change.shape[1])
        change[:, places, places] -= hessians.blocks.slopes[rows]
        return lambda x: np.array([matrix @ row for matrix, row in zip(change, x, strict=True)])
