"""Unilateral contact, eq. (3) of the paper, as a bound-constrained problem.

With K the area-weighted compliance of the contact line, m the element areas and g the gap of the
undeformed, worn profiles, the pressure minimises at an approach delta

    1/2 p.K p + Sum m_e [(g_e - delta) p_e + Int_0^p_e depth],    p >= 0,

where ``depth`` is the wear of an implicit step (absent otherwise).

The unknowns are scaled so that K has a unit diagonal: ``q = s p``, ``A = K / (s s')``.
"""

import math
from dataclasses import dataclass

import numpy as np

from ringwear_par.arrays import FloatArray, Numbers
from ringwear_par.wear.increment import WearIncrement

#: largest relative KKT residual of an accepted solution
KKT_TOLERANCE = 1e-9
#: norm of the gradient at which a solver ends, relative to that of the overlap
GRADIENT_TOLERANCE = 1e-12


@dataclass(frozen=True)
class ContactInputs:
    """What B contact solutions depend on, beside the compliances.

    Parameters
    ----------
    gap : (B, n) float, mm, of the undeformed, worn profiles.
    force, approach : (B,) float, N or mm; the other one is None.
    wear : of an implicit step; None: profiles stay.
    """

    gap: FloatArray
    force: FloatArray | None
    approach: FloatArray | None
    wear: WearIncrement | None = None


@dataclass(frozen=True)
class ContactState:
    """Solution of B contact problems: numbers (B,), fields (B, n); of one without this axis.

    Parameters
    ----------
    pressure : (B, n) float, MPa.
    gap : (B, n) float, mm, between the deformed profiles.
    approach : (B,) float, mm.
    force : (B,) float, N.
    iterations : (B,) int, of TAO, all its solves together.
    residual : (B,) float, natural KKT residual, relative to the largest pressure (scaled unknowns).
    """

    pressure: FloatArray
    gap: FloatArray
    approach: Numbers
    force: Numbers
    iterations: Numbers
    residual: Numbers


@dataclass(frozen=True)
class WarmStart:
    """Where the next solves start; with it, a restarted run repeats an uninterrupted one exactly.

    Parameters
    ----------
    scaled_pressure : (B, n) float, unknowns of the last problems.
    approach : (B,) float, mm, of the last problems.
    """

    scaled_pressure: FloatArray
    approach: FloatArray


class ContactProblem:
    """The contact problem of one contact line at a given approach.

    All that a solver's callbacks know: the linear term, the wear and what they did to the Hessian.
    The products with A are the caller's.

    Parameters
    ----------
    compliance : (n, n) float, mm^3/MPa, symmetric area-weighted compliance K.
    area : (n,) float, mm^2.
    """

    def __init__(self, compliance: FloatArray, area: FloatArray) -> None:
        self.area, self._linear = area, np.zeros_like(area)
        self._wear: WearIncrement | None = None
        #: whether no pressure is needed: nothing overlaps
        self.apart = True
        self.take(compliance)

    def take(self, compliance: FloatArray) -> None:
        """Take another compliance of the same contact line."""
        #: (n,), pressure times this is the unknown
        self.scale = np.sqrt(np.diag(compliance))
        #: (n,), gap times this is the gradient
        self.weights = self.area / self.scale
        self._slope_weight = self.weights / self.scale
        # what wear adds to the diagonal of the Hessian, and whether it adds more than that
        self._slope, self._coupled = np.zeros_like(self.area), False
        self._coupling: FloatArray | float = 0.0

    def scaled(self, compliance: FloatArray) -> FloatArray:
        """Return A."""
        return compliance / (self.scale[:, None] * self.scale)

    def pose(self, gap: FloatArray, approach: float, wear: WearIncrement | None) -> None:
        """Set the problem.

        Parameters
        ----------
        gap : (n,) float, mm.
        approach : mm.
        wear : wear of an implicit step.
        """
        self.apart = bool(gap.min() >= approach)
        self._linear, self._wear = self.weights * (gap - approach), wear

    def tolerance(self, gap: FloatArray, approach: float) -> float:
        """Return the norm of the gradient at which a solver may end."""
        overlap = self.weights * np.maximum(approach - gap, 0.0)
        return GRADIENT_TOLERANCE * math.sqrt(overlap @ overlap)

    def gradient_apart(self) -> FloatArray:
        """Return the gradient where no pressure is needed: the weighted gap."""
        return self._linear

    def add_gradient(self, q: FloatArray, product: FloatArray) -> None:
        """Make of A q, in place, the gradient."""
        product += self._linear
        if self._wear is not None:
            product += self.weights * self._wear.depth(q / self.scale)

    def objective(self, q: FloatArray, product: FloatArray) -> tuple[float, FloatArray]:
        """Return the objective, and the gradient; ``product`` is A q."""
        linear = self._linear
        value = q @ (0.5 * product + linear)
        if self._wear is not None:
            p = q / self.scale
            value += self.area @ self._wear.potential(p)
            linear = linear + self.weights * self._wear.depth(p)
        return float(value), product + linear

    def _slope_at(self, q: FloatArray) -> FloatArray:
        if self._wear is None:
            return np.zeros_like(self._slope)
        return self._wear.d_depth_dp(q / self.scale) * self._slope_weight

    def linearise(self, q: FloatArray) -> tuple[bool, bool]:
        """Take the Hessian at q; return whether it changed, and whether by more than its diagonal.

        Where by more, it is now A and what ``add_coupling`` adds; its diagonal
        is ``diagonal`` in any case.
        """
        slope, coupled = self._slope_at(q), self._wear is not None and not self._wear.local
        whole = coupled or self._coupled  # all entries change, or are put back
        changed = whole or bool((slope != self._slope).any())
        self._slope, self._coupled = slope, coupled
        return changed, whole

    @property
    def diagonal(self) -> FloatArray:
        """Diagonal of the Hessian."""
        return 1.0 + self._slope

    def add_coupling(self, q: FloatArray, hessian: FloatArray) -> None:
        """Add the slopes of non-local wear to the Hessian."""
        if self._wear is not None and self._coupled:
            derivative = self._wear.jacobian(q / self.scale)
            self._coupling = self.weights[:, None] * derivative / self.scale
            hessian += self._coupling

    def defect(self, q: FloatArray, gradient: FloatArray) -> tuple[float, float]:
        """Return the natural KKT residual, infinite where it is no number, and the largest q."""
        worst, largest = _natural(q, gradient, self.diagonal), float(q.max(initial=0.0))
        if worst > KKT_TOLERANCE * largest:  # at a kink of the law either side's slope will do
            worst = _natural(q, gradient, 1.0 + np.maximum(self._slope, self._slope_at(q)))
        return worst, largest


def _natural(q: FloatArray, gradient: FloatArray, diagonal: FloatArray) -> float:
    worst = float(np.abs(np.minimum(q, gradient / diagonal)).max(initial=0.0))
    return worst if math.isfinite(worst) else math.inf
