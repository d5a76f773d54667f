"""A primal-dual active-set Newton method for B contact problems at once, as a TAO solver.

The method of ``newton``, of all histories at once, each with its own sets. Under a given force the
approach is one more unknown: the step is that of the Hessian bordered by the weights of the gap, so
that the force is met, to round-off, by every step. There is no damped iteration: a history whose
sets cycle is given up, and is computed alone.
"""

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray, IntArray, inner
from ringwear_par.contact.approach import FORCE_TOLERANCE
from ringwear_par.contact.hessians import NEAR, Hessians
from ringwear_par.contact.newton import PLAIN_ITERATIONS, ROUND_OFF, stop_if_told
from ringwear_par.contact.problem import GRADIENT_TOLERANCE
from ringwear_par.contact.tao import Method
from ringwear_par.petsc import PETSc


class BatchNewton(Method):
    """Context of a TAO of type "python" over the (B, n) unknowns of B problems, lower bounds 0.

    Parameters
    ----------
    hessians : of the problems.
    weights : (B, n) float, what the approach has in the gradient.
    """

    def __init__(self, hessians: Hessians, weights: FloatArray) -> None:
        super().__init__()
        self._hessians, self._weights = hessians, weights
        #: (h,) the histories at work: others stay as they are, and so does their gradient
        self.at_work: IntArray = np.arange(len(weights))
        #: (B, n) mm, (B,) mm, and (B,) N, or (0,) where approaches are given
        self.gaps, self.approaches = np.zeros_like(weights), np.zeros(len(weights))
        self.forces = np.zeros(0)
        #: (B,) iterations of the last solution, and which were given up
        self.iterations = np.zeros(len(weights), dtype=np.int64)
        self.failed: BoolArray = np.zeros(len(weights), dtype=bool)

    @property
    def rows(self) -> IntArray | slice:
        """The rows of the histories at work, all by a slice, which is quicker."""
        return slice(None) if len(self.at_work) == len(self._weights) else self.at_work

    def solve(self, tao: PETSc.TAO) -> None:
        """Solve the problems at work from the present values.

        At the end solution and gradient vector hold what they have there.
        """
        hessians, weights = self._hessians, self._weights
        self.failed[:] = False
        self.iterations[self.at_work] = 0
        q = self._x.getArray().reshape(weights.shape)
        g = self._g.getArray().reshape(weights.shape)
        free = q > 0.0
        self._begin(tao, q, g, free)
        self._evaluate(tao)
        iteration = 0
        while len(self.at_work) and iteration < PLAIN_ITERATIONS:
            iteration += 1
            histories, rows = self.at_work, self.rows
            tao.computeHessian(self._x, self._hessian)
            stop_if_told(tao)
            hessians.refresh(histories, free)
            missing = None
            if len(self.forces):
                missing = self.forces[rows] - inner(weights[rows], q[rows])
            steps, changes = hessians.steps(histories, g[rows], missing, NEAR)
            self.approaches[rows] += changes
            q[rows] += steps
            self._evaluate(tao)
            self.iterations[histories] = iteration
            again = self._settle(q, g, free)
            if again and len(self.at_work):
                self._evaluate(tao)
        self.failed[self.at_work] = True
        tao.setIterationNumber(iteration)
        tao.setConvergedReason(PETSc.TAO.Reason.CONVERGED_GATOL)

    def _settle(self, q: FloatArray, g: FloatArray, free: BoolArray) -> bool:
        """Let histories that have settled rest, and the others go on with the sets of the signs.

        Unknowns that leave their set become 0; return whether any does.
        """
        histories, rows = self.at_work, self.rows
        x, slopes, weights = q[rows], g[rows], self._weights[rows]
        before = free[rows]
        keep = np.where(before, x > 0.0, slopes < 0.0)
        same = (keep == before).all(axis=1)
        diagonal = 1.0 + self._hessians.slope[rows]
        defect = np.minimum(slopes, x * diagonal)
        square = inner(defect, defect)
        overlap = np.maximum(self.approaches[rows][:, None] - self.gaps[rows], 0.0) * weights
        fine = np.sqrt(square) <= GRADIENT_TOLERANCE * np.sqrt(inner(overlap, overlap))
        if not fine.all():
            # where wear makes the diagonal large, round-off in q is more than the tolerance in g
            largest = np.maximum(x.max(axis=1), 0.0)
            fine |= np.abs(defect / diagonal).max(axis=1) <= ROUND_OFF * largest
        carried = inner(weights, x)
        if len(self.forces):
            force = self.forces[rows]
            fine &= np.abs(carried - force) <= FORCE_TOLERANCE * force
        broken = ~np.isfinite(square + carried)
        if same.all() and fine.all() and not broken.any():
            self.at_work = histories[:0]
            return False
        leaving = ~same & ~broken
        free[rows] = np.where(leaving[:, None], keep, before)
        cleared = (leaving[:, None] & ~keep & (x != 0.0)) | broken[:, None]
        q[rows] = np.where(cleared, 0.0, x)
        self.failed[histories[broken]] = True
        self.at_work = histories[~((same & fine) | broken)]
        return bool(cleared[~broken].any())

    def _begin(self, tao: PETSc.TAO, q: FloatArray, g: FloatArray, free: BoolArray) -> None:
        """Let the sets be those of the present values; where nothing touches, guess."""
        histories = self.at_work
        none = histories[~free[histories].any(axis=1)]
        if len(none):
            q[none] = 0.0
            if len(self.forces):
                free[none] = True
            else:
                self._evaluate(tao)
                free[none] = g[none] < 0.0
        q[histories] = np.where(free[histories], q[histories], 0.0)

    def _evaluate(self, tao: PETSc.TAO) -> None:
        """Compute the gradient at the present unknowns."""
        tao.computeGradient(self._x, self._g)
        stop_if_told(tao)
