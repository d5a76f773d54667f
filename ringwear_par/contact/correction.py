"""Contact with the collocated compliance, by a solver of a symmetric one that is near to it.

The symmetric compliance makes contact a minimisation. What it has more than the collocated one, its
excess, is taken from the gap at pressures near the solution: deferred correction. The excess is so
small that, repeated from the solution on, this converges by a factor of about 30 each time; within
a history, the pressures at the start of a step are near enough.
"""

from dataclasses import replace

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.contact.problem import ContactState
from ringwear_par.contact.solver import ContactSolver
from ringwear_par.wear.increment import WearIncrement

#: relative error at which pressures count as those of the collocated equations
_COLLOCATED = 1e-4
#: how often to correct, at most, what no known pressures are near, or what is stepped explicitly
CORRECTIONS = 5


class CorrectedContact:
    """The contact of one history. Collective on the solver's communicator.

    Parameters
    ----------
    solver : of the symmetric compliance K.
    area : (n,) float, mm^2, the areas m.
    """

    def __init__(self, solver: ContactSolver, area: FloatArray) -> None:
        self.solver, self._area = solver, area
        #: (n, n) mm/MPa, K / m less the collocated compliance
        self.excess = np.zeros((len(area), len(area)))
        # pressures that the last solution was corrected at, and its own
        self._last: tuple[FloatArray, FloatArray] | None = None
        self._force_kept = True

    def solve(
        self,
        gap: FloatArray,
        near: FloatArray,
        *,
        force: float | None,
        approach: float | None,
        wear: WearIncrement | None,
        corrections: int = 0,
    ) -> ContactState:
        """Solve at a given force (N) or approach (mm), as ``ContactSolver.solve`` does.

        Parameters
        ----------
        near : (n,) float, MPa, pressures near the solution.
        corrections : how often at most to repeat this from the solution on.
        """
        before, self._force_kept = 0, force is not None
        while True:
            shifted = gap - self.excess @ near
            found = self.solver.solve(shifted, force=force, approach=approach, wear=wear)
            if before:
                found = replace(found, iterations=before + found.iterations)
            self._last = near, found.pressure
            if corrections == 0 or self.errors().max() <= _COLLOCATED:
                return found
            near, before, corrections = found.pressure, found.iterations, corrections - 1

    def errors(self) -> FloatArray:
        """Return (n,), about how far the last pressures are off the collocated ones.

        Relative to the pressure or to its mean, whichever is larger; 0 where there is none.
        """
        if self._last is None:
            return np.zeros_like(self._area)
        near, p = self._last
        touching = p > 0.0
        if not touching.any():
            return np.zeros_like(p)
        off = self.solver.response(self.excess @ (p - near), self._force_kept)
        mean = float(self._area @ p) / float(self._area[touching].sum())
        return np.abs(off) / np.maximum(p, mean)

    def forget(self) -> None:
        """Forget the last solution, and start the next one as a new solver would."""
        self._last = None
        self.solver.cold_start()
