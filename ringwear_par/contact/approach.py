"""The approach at which the contact carries a given force.

The force grows with the approach and is piecewise linear for the threshold law, so that Newton
steps end. The derivative comes from the solver where it has one, otherwise from a secant.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.errors import ComputationError

#: relative force balance at which the search ends, and that it may not exceed
FORCE_TOLERANCE = 1e-12
FORCE_LIMIT = 1e-10
_MAX_APPROACHES = 60


class Trial(NamedTuple):
    """The contact at a given approach.

    Parameters
    ----------
    pressure : (n,) float, MPa.
    force : N.
    iterations : of the solver.
    residual : natural KKT residual, relative to the largest pressure.
    """

    pressure: FloatArray
    force: float
    iterations: int
    residual: float


class ApproachSearch:
    """Finds approaches for one contact line; starts where the last search ended.

    Parameters
    ----------
    compliance : (n, n) float, mm^3/MPa.
    area : (n,) float, mm^2.
    """

    def __init__(self, compliance: FloatArray, area: FloatArray) -> None:
        self._area = area
        self._first_rate = np.full(len(area), float(area.sum() / compliance.sum()))
        self.restart()

    def restart(self) -> None:
        """Forget all searches."""
        #: (n,) MPa/mm, derivative of the pressure with respect to the approach
        self.rate: FloatArray = self._first_rate
        #: gap (mm), approach (mm) and force (N) of the last problem
        self.last: tuple[FloatArray, float, float] | None = None

    def find(
        self,
        gap: FloatArray,
        force: float,
        solve_at: Callable[[FloatArray, float], Trial],
        tangent_at_last: Callable[[], FloatArray | None],
    ) -> tuple[float, Trial]:
        """Return the approach and the contact there, the iterations being those of all trials.

        Newton steps, or bisection where they do not halve the imbalance. What is searched for is
        the approach less the smallest gap: under light loads it is far smaller than either.

        Parameters
        ----------
        gap : (n,) float, mm.
        force : N, positive.
        solve_at : solves the contact with a gap (mm) at an approach (mm).
        tangent_at_last : returns the derivative of the pressure with respect to the approach,
            (n,) MPa/mm, at the last solution, where it is known.

        Raises
        ------
        ComputationError : the force is not met.
        """
        nearest = float(gap.min())
        area: FloatArray = self._area
        rate: FloatArray = self.rate
        if self.last is None:
            last_gap, last_approach, last_force = gap, float(area @ gap / area.sum()), 0.0
        else:
            last_gap, last_approach, last_force = self.last
        stiffness = float(area @ rate)
        growth = float(rate @ (area * (gap - last_gap)))
        low, high = 0.0, np.inf  # no contact, no force at low
        step = (force - last_force + growth) / stiffness
        approach, gap_above = max(last_approach - nearest + step, low), gap - nearest
        before: tuple[FloatArray, float, float] | None = None
        total = 0
        for _ in range(_MAX_APPROACHES):
            p, carried, iterations, residual = solve_at(gap_above, approach)
            total += iterations
            excess = carried - force
            if abs(excess) <= FORCE_TOLERANCE * force:
                break
            low, high = (low, approach) if excess > 0.0 else (approach, high)
            slow, tangent = False, tangent_at_last()
            if tangent is not None:
                rate = tangent
                stiffness = float(area @ rate) or stiffness
            if before is not None:
                p_before, approach_before, excess_before = before
                slow = abs(excess) > 0.5 * abs(excess_before)
                if tangent is None and abs(approach - approach_before) > 1e-9 * abs(approach):
                    rate = np.divide(p - p_before, approach - approach_before)
                    stiffness = float(area @ rate) or stiffness
            before = p, approach, excess
            following = approach - excess / stiffness
            if high < np.inf:
                if slow or not low < following < high:
                    following = 0.5 * (low + high)
            elif slow:
                following = approach - 2.0 * excess / stiffness
            if following == approach:
                break
            approach = following
        if abs(excess) > FORCE_LIMIT * force:
            raise ComputationError(
                f"contact: the approach was not found: force {force + excess:.9g} N instead of "
                f"{force:.9g} N at approach {approach:.9g} mm after {_MAX_APPROACHES} trials"
            )
        self.rate, self.last = rate, (gap, nearest + approach, force)
        return nearest + approach, Trial(p, carried, total, residual)
