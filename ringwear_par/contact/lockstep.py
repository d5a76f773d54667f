"""A primal-dual active-set Newton method for B contact problems in lock step, as a TAO solver.

The method of ``newton``, of all histories at once, each with its own sets. Under a given force the
approach is one more unknown: the step is that of the Hessian bordered by the weights of the gap, so
that the force is met, to round-off, by every step. There is no damped iteration: a history whose
sets cycle is given up, and is computed alone.
"""

from collections.abc import Callable

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray, IntArray
from ringwear_par.contact.active_sets import BROKEN, GOES_ON, advance, settle
from ringwear_par.contact.approach import FORCE_TOLERANCE
from ringwear_par.contact.blocks import HessianBlocks
from ringwear_par.contact.newton import PLAIN_ITERATIONS, ROUND_OFF, stop_if_told
from ringwear_par.contact.problem import GRADIENT_TOLERANCE
from ringwear_par.contact.tao import Method
from ringwear_par.petsc import PETSc


class LockStepNewton(Method):
    """Context of a TAO of type "python" over the (B, n) unknowns of B problems, lower bounds 0.

    Parameters
    ----------
    blocks : the Hessian.
    weights : (B, n) float, what the approach has in the gradient.
    """

    def __init__(self, blocks: HessianBlocks, weights: FloatArray) -> None:
        super().__init__()
        self._blocks, self._weights = blocks, weights
        #: (h,) the histories that are at work: others stay as they are, and so does their gradient
        self.at_work: IntArray = np.arange(len(weights))
        #: puts the unknowns of histories at work back on curves, see ``newton``, if any
        self.bend: Callable[[FloatArray, FloatArray], FloatArray] | None = None
        #: (B, n) mm, (B,) mm, and (B,) N, or (0,) where approaches are given
        self.gaps, self.approaches = np.zeros_like(weights), np.zeros(len(weights))
        self.forces = np.zeros(0)
        #: (B,) iterations of the last solution, and which were given up
        self.iterations = np.zeros(len(weights), dtype=np.int64)
        self.failed: BoolArray = np.zeros(len(weights), dtype=bool)

    def solve(self, tao: PETSc.TAO) -> None:
        """Solve the problems at work from the present values.

        At the end solution and gradient vector hold what they have there.
        """
        blocks, weights = self._blocks, self._weights
        histories = self.at_work
        self.failed[:] = False
        self.iterations[histories] = 0
        q = self._x.getArray(readonly=True).reshape(weights.shape).copy()
        free = q > 0.0
        self._begin(tao, q, free)
        gradient = self._evaluate(tao, q)
        iteration = 0
        while len(histories) and iteration < PLAIN_ITERATIONS:
            iteration += 1
            tao.computeHessian(self._x, self._hessian)
            stop_if_told(tao)
            blocks.refresh(histories, free, weights)
            steps = blocks.solve(histories, -gradient[histories])
            before = None if self.bend is None else q.copy()
            advance(
                histories, weights, blocks.border, blocks.sums, self.forces, steps, q,
                self.approaches,
            )  # fmt: skip
            if self.bend is not None and before is not None:
                q = self.bend(before, q)
            gradient = self._evaluate(tao, q)
            found = np.empty(len(histories), dtype=np.int64)
            changed = settle(
                histories, weights, self.gaps, self.approaches, self.forces, blocks.slope,
                GRADIENT_TOLERANCE, FORCE_TOLERANCE, ROUND_OFF, q, gradient, free, found,
            )  # fmt: skip
            self.iterations[histories] = iteration
            if (found == BROKEN).any():
                broken = histories[found == BROKEN]
                self.failed[broken] = True
                q[broken] = 0.0
            if (found != GOES_ON).any():
                self.at_work = histories = histories[found == GOES_ON]
            if changed and len(histories):
                gradient = self._evaluate(tao, q)
        self.failed[histories] = True
        self._x.setArray(q.ravel())
        tao.setIterationNumber(iteration)
        tao.setConvergedReason(PETSc.TAO.Reason.CONVERGED_GATOL)

    def _begin(self, tao: PETSc.TAO, q: FloatArray, free: BoolArray) -> None:
        """Let the sets be those of the present values; where nothing touches, guess."""
        histories = self.at_work
        none = histories[~free[histories].any(axis=1)]
        if len(none):
            q[none] = 0.0
            free[none] = True if len(self.forces) else self._evaluate(tao, q)[none] < 0.0
        q[histories] = np.where(free[histories], q[histories], 0.0)

    def _evaluate(self, tao: PETSc.TAO, q: FloatArray) -> FloatArray:
        self._x.setArray(q.ravel())
        tao.computeGradient(self._x, self._g)
        stop_if_told(tao)
        return self._g.getArray(readonly=True).reshape(q.shape).copy()
