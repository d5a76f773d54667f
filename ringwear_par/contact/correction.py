"""Contact with the collocated compliance, by a solver of a symmetric one that is near to it.

The symmetric compliance makes contact a minimisation. What it has more than the collocated one, its
excess, is taken from the gap at pressures near the solution, and again at the solution itself until
it no longer matters: deferred correction. The excess is so small that each time leaves a few per
cent of the error, and within a history the pressures of the step before are mostly near enough.
"""

from dataclasses import replace

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.contact.problem import ContactState
from ringwear_par.contact.solver import ContactSolver
from ringwear_par.wear.increment import WearIncrement

#: errors at which pressures count as those of the collocated equations, relative to themselves or
#: to the mean pressure, whichever is larger: within steps, the next of which corrects what this one
#: left, and where a history or a geometry begins
_NEAR_ENOUGH, _EXACT = 1e-2, 1e-4
#: how often to correct at most: five times did for the worst of 200 random cases
_CORRECTIONS = 10
#: no pressure, MPa
_TINY = 1e-300


class CorrectedContact:
    """The contact of one history. Collective on the solver's communicator.

    Parameters
    ----------
    solver : of the symmetric compliance K.
    area : (n,) float, mm^2, the areas m.
    """

    def __init__(self, solver: ContactSolver, area: FloatArray) -> None:
        self.solver, self._area, self._total = solver, area, float(area.sum())
        #: the largest error that was left, and its element
        self.worst = 0.0, 0

    def take(self, matrix: FloatArray, excess: FloatArray) -> None:
        """Take K, (n, n) mm^3/MPa, which the solver has, and its excess, (n, n) mm/MPa."""
        self._excess = excess
        self._stiffness = self._area / np.diagonal(matrix)  # MPa/mm, of each element alone
        self._shift_at: tuple[FloatArray, FloatArray] | None = None

    def _shift(self, p: FloatArray) -> FloatArray:
        """Return what the excess makes of pressures, (n,) mm; remembered for the next solution."""
        if self._shift_at is None or self._shift_at[0] is not p:
            self._shift_at = p, self._excess @ p
        return self._shift_at[1]

    def solve(
        self,
        gap: FloatArray,
        near: FloatArray,
        *,
        force: float | None,
        approach: float | None,
        wear: WearIncrement | None,
        exact: bool = False,
    ) -> ContactState:
        """Solve at a given force (N) or approach (mm), as ``ContactSolver.solve`` does.

        Parameters
        ----------
        near : (n,) float, MPa, pressures near the solution.
        exact : whether to correct until no more than 1e-4 is left.
        """
        most = _EXACT if exact else _NEAR_ENOUGH
        shift, iterations = self._shift(near), 0
        for _ in range(1 + _CORRECTIONS):
            found = self.solver.solve(gap - shift, force=force, approach=approach, wear=wear)
            iterations += found.iterations
            before, shift = shift, self._shift(found.pressure)
            error, e = self._error(found, shift - before, force is not None, most)
            again = error > most
            if self.solver.distributed:  # ranks must not differ by round-off
                again = self.solver.comm.bcast(again)
            if not again:
                break
        if error > self.worst[0]:
            self.worst = error, e
        return found if iterations == found.iterations else replace(found, iterations=iterations)

    def _error(
        self, found: ContactState, change: FloatArray, force_kept: bool, most: float
    ) -> tuple[float, int]:
        """Return about how far pressures are off for a change of the shift, (n,) mm, and where.

        Relative to the pressure or to its mean, whichever is larger.
        """
        p, area = found.pressure, self._area
        errors = np.abs(change) * self._stiffness  # of each element alone: in few operations
        errors = errors / np.maximum(p, max(found.force / self._total, _TINY))
        e = int(errors.argmax())
        if errors[e] <= most or self.solver.distributed:
            return float(errors[e]), e
        touching = p > 0.0
        if not touching.any():  # the gap must be that of no pressure
            return np.inf, e
        scale = np.maximum(p, found.force / float(area @ touching))
        errors = np.where(touching, np.abs(self.solver.response(change, force_kept)) / scale, 0.0)
        e = int(errors.argmax())
        return float(errors[e]), e
