"""A primal-dual active-set Newton method as a TAO solver (type "python").

For min f(x), x >= 0, with f convex and its gradient piecewise linear, as in contact with a
threshold wear law: on each guess of the active set the Newton step is exact, so the method ends
in a few steps, in one where the set of the last solve still holds. The Cholesky factor is kept for
as long as the Hessian and the active set stay the same.

Hintermueller, Ito and Kunisch, SIAM J. Optim. 13 (2002) 865-888; the damped iteration that takes
over if the sets cycle is Bertsekas' projected Newton method, SIAM J. Control Optim. 20 (1982).
"""

import math

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotrs

from ringwear_par.arrays import BoolArray, FloatArray
from ringwear_par.contact.tao import Method
from ringwear_par.petsc import PETSc

PLAIN_ITERATIONS = 25
ROUND_OFF = 1e-13


class ActiveSetNewton(Method):
    """Context of a TAO of type "python" on one rank, with a dense Hessian and lower bounds 0.

    Converged when the active set repeats and the natural residual min(g, diag(H) x) is below the
    TAO's absolute gradient tolerance, or at the round-off of x.
    """

    def __init__(self) -> None:
        super().__init__()
        self._factor: FloatArray | None = None
        self._free: BoolArray = np.empty(0, dtype=bool)
        self._diagonal: FloatArray | float = 1.0
        self._state = -1
        self._monitored = False

    def setUp(self, tao: PETSc.TAO) -> None:
        """Take the TAO's vectors and its Hessian; look whether somebody watches."""
        super().setUp(tao)
        self._monitored = PETSc.Options(tao.getOptionsPrefix()).hasName("tao_monitor")

    def destroy(self, tao: PETSc.TAO) -> None:
        """Forget the factor, and what is the TAO's."""
        self._factor, self._state = None, -1
        super().destroy(tao)

    def solve(self, tao: PETSc.TAO) -> None:
        """Minimise from the solution vector's present value.

        At the end the TAO's gradient vector holds the gradient at the solution.
        """
        x = self._x.getArray(readonly=True).copy()
        free = x > 0.0
        tolerance = tao.getTolerances()[0]
        limit = tao.getMaximumIterations()
        if not free.all():
            if not free.any():
                free = self._evaluate(tao, np.zeros_like(x)) < 0.0
            x[~free] = 0.0
        gradient = self._evaluate(tao, x)
        for iteration in range(1, limit + 1):
            if iteration <= PLAIN_ITERATIONS:
                if free.all():  # the same in fewer operations: most steps of most histories
                    x += self._newton_step(tao, gradient, free)
                    gradient = self._evaluate(tao, x)
                    keep = x > 0.0
                    settled = bool(keep.all())
                else:
                    x[free] += self._newton_step(tao, gradient[free], free)
                    gradient = self._evaluate(tao, x)
                    keep = np.where(free, x > 0.0, gradient < 0.0)
                    settled = bool((keep == free).all())
                if not settled:
                    x[~keep] = 0.0
                    gradient = self._evaluate(tao, x)
                    free = keep
            else:
                x = np.maximum(x, 0.0)
                gradient = self._evaluate(tao, x)
                free = (x > 0.0) | (gradient < 0.0)
                step = np.zeros_like(x)
                step[free] = self._newton_step(tao, gradient[free], free)
                x, gradient = self._search(tao, x, gradient, step)
                settled = bool((gradient[x == 0.0] >= 0.0).all())
                free = x > 0.0
            defect = np.minimum(gradient, x * self._diagonal)
            residual = math.sqrt(defect @ defect)
            if self._monitored:
                tao.monitor(iteration, tao.computeObjective(self._x), residual)
            # where wear makes the diagonal large, round-off in x is more than the tolerance in g
            if settled and (
                residual <= tolerance
                or np.abs(defect / self._diagonal).max() <= ROUND_OFF * x.max(initial=0.0)
            ):
                tao.setIterationNumber(iteration)
                tao.setConvergedReason(PETSc.TAO.Reason.CONVERGED_GATOL)
                return
        tao.setIterationNumber(limit)
        tao.setConvergedReason(PETSc.TAO.Reason.DIVERGED_MAXITS)

    def _evaluate(self, tao: PETSc.TAO, x: FloatArray) -> FloatArray:
        self._x.setArray(x)
        tao.computeGradient(self._x, self._g)
        stop_if_told(tao)
        return self._g.getArray(readonly=True).copy()

    def _newton_step(self, tao: PETSc.TAO, gradient: FloatArray, free: BoolArray) -> FloatArray:
        if not len(gradient):
            return np.empty(0)
        hessian = self._hessian
        tao.computeHessian(self._x, hessian)
        stop_if_told(tao)
        state = hessian.stateGet()
        if self._factor is None or state != self._state or (free != self._free).any():
            block = hessian.getDenseArray(readonly=True)
            self._diagonal = block.diagonal().copy()
            if not free.all():
                block = block[np.ix_(free, free)]
            self._factor, info = dpotrf(block, lower=1, clean=0)
            if info != 0:  # not positive definite: the caller sees the failure
                self._factor = None
                return np.full(np.count_nonzero(free), np.nan)
            self._state, self._free = state, free.copy()
        step, _ = dpotrs(self._factor, gradient, lower=1)
        return -step

    def response(self, right: FloatArray) -> FloatArray | None:
        """Return H^-1 right, (n,) or (n, k), on the active set of the last Newton step, else 0.

        None where there is no factor.
        """
        if self._factor is None:
            return None
        if self._free.all():
            return dpotrs(self._factor, right, lower=1)[0]
        x = np.zeros_like(right)
        x[self._free], _ = dpotrs(self._factor, right[self._free], lower=1)
        return x

    def _search(
        self,
        tao: PETSc.TAO,
        x: FloatArray,
        gradient: FloatArray,
        step: FloatArray,
    ) -> tuple[FloatArray, FloatArray]:
        """Shorten the projected step until the objective, being convex, is sure to fall.

        It does where the gradient at the end still points along the way there; gradients are far
        cheaper than objectives.
        """
        length = 1.0
        while True:
            trial = np.maximum(x + length * step, 0.0)
            after = self._evaluate(tao, trial)
            way = trial - x
            before, slope = float(gradient @ way), float(after @ way)
            if slope <= -1e-8 * before or length < 1e-10:
                return trial, after
            length *= max(0.1, before / (before - slope))  # where a straight line would vanish


def stop_if_told(tao: PETSc.TAO) -> None:
    """Leave a solution that a callback has ended.

    Raises
    ------
    RuntimeError : one has; what it raised itself is kept elsewhere.
    """
    if tao.getConvergedReason() == PETSc.TAO.Reason.DIVERGED_USER:
        raise RuntimeError("a callback has failed")
