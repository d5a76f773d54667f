"""A primal-dual active-set Newton method for B contact problems at once, as a TAO solver.

For min f(x), x >= 0, with f convex and its gradient piecewise linear, as in contact with a
threshold wear law: on each guess of the active set the Newton step is exact, so the method ends
in a few steps, in one where the set of the last solve still holds. Each history has its own sets.
Under a given force the approach is one more unknown: the step is that of the Hessian bordered by
the weights of the gap, so that the force is met, to round-off, by every step.

Hintermueller, Ito and Kunisch, SIAM J. Optim. 13 (2002) 865-888. A history whose sets cycle is
left for the damped iteration at given approaches, of one history at a time: Bertsekas' projected
Newton method, SIAM J. Control Optim. 20 (1982).
"""

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray, IntArray, inner
from ringwear_par.contact.hessians import NEAR, SOLVED, Hessians
from ringwear_par.contact.problem import FORCE_TOLERANCE, GRADIENT_TOLERANCE, ContactProblem, part
from ringwear_par.contact.tao import Guard
from ringwear_par.petsc import PETSc

PLAIN_ITERATIONS = 25
ROUND_OFF = 1e-13
#: share of the slope at the start of a damped step that is left at its end, and the shortest step
_SLOPE_LEFT, _SHORTEST = 1e-8, 1e-10


class ActiveSetNewton:
    """Context of a TAO of type "python" over the (B, n) unknowns of B problems, lower bounds 0.

    Parameters
    ----------
    problem : the problems; those at work are solved.
    hessians : of them.
    guard : keeps what is raised.
    """

    def __init__(self, problem: ContactProblem, hessians: Hessians, guard: Guard) -> None:
        self._problem, self._hessians, self._guard = problem, hessians, guard
        #: whether the damped iteration is wanted, of the one history that is at work
        self.damped = False
        #: (B,) plain steps, and natural residuals relative to largest unknowns; (u,) which
        #: histories did not end
        self.iterations = np.zeros(len(problem.every), dtype=np.int64)
        self.residuals: FloatArray = np.zeros(len(problem.every))
        self.unsolved: IntArray = problem.every[:0]
        self._monitored = False
        self._forget()

    def _forget(self) -> None:
        self._x, self._g = PETSc.Vec(), PETSc.Vec()

    def destroy(self, tao: PETSc.TAO) -> None:
        """Forget what is the TAO's, before it is freed."""
        self._forget()

    def setUp(self, tao: PETSc.TAO) -> None:
        """Take the TAO's vectors; look whether somebody watches."""
        self._x, self._g = tao.getSolution(), tao.getGradient()[0]
        self._monitored = PETSc.Options(tao.getOptionsPrefix()).hasName("tao_monitor")

    def solve(self, tao: PETSc.TAO) -> None:
        """Solve the problems at work from the present values.

        At the end solution and gradient vector hold what they have there.
        """
        self._guard.guarded(self._solve)(tao)
        del tao  # what was raised keeps this frame, which must not keep the TAO

    def _solve(self, tao: PETSc.TAO) -> None:
        q, g = (self._problem.rows_in(vector.getArray()) for vector in (self._x, self._g))
        iterate = self._iterate_damped if self.damped else self._iterate
        left, iterations = iterate(tao, q, g)
        self.unsolved = np.sort(left)
        tao.setIterationNumber(iterations)
        reasons = PETSc.TAO.Reason
        ended = not self.damped or not len(left)  # plain steps have damped ones to follow them
        tao.setConvergedReason(reasons.CONVERGED_GATOL if ended else reasons.DIVERGED_MAXITS)

    def _iterate(self, tao: PETSc.TAO, q: FloatArray, g: FloatArray) -> tuple[IntArray, int]:
        """Take plain steps; return the histories that did not end, and the number of steps."""
        problem, hessians = self._problem, self._hessians
        broken: list[int] = []
        free = q > 0.0
        self._begin(q, g, free)
        self._evaluate(q, g, recall=True)
        iteration, limit = 0, min(PLAIN_ITERATIONS, tao.getMaximumIterations())
        while len(problem.at_work) and iteration < limit:
            iteration += 1
            histories, rows = problem.at_work, problem.rows
            hessians.set_slopes(rows, *problem.slopes(q[rows], True))
            hessians.refresh(histories, free)
            missing = None
            if problem.forces is not None:
                missing = problem.forces[rows] - inner(part(problem.weights, rows), q[rows])
            steps, changes = hessians.steps(histories, g[rows], missing, NEAR)
            problem.approaches[rows] += changes
            q[rows] += steps
            self._evaluate(q, g)
            self.iterations[histories] = iteration
            if self._monitored:
                self._monitor(tao, iteration)
            lost, cleared = self._settle(q, g, free)
            broken += lost
            if cleared and len(problem.at_work):
                self._evaluate(q, g)
        return np.array([*broken, *problem.at_work.tolist()], dtype=np.int64), iteration

    def _settle(self, q: FloatArray, g: FloatArray, free: BoolArray) -> tuple[list[int], bool]:
        """Let histories that have settled rest, and the others go on with the sets of the signs.

        Unknowns that leave their set become 0. Return the histories whose unknowns are no numbers,
        and whether any unknowns of others became 0.
        """
        problem, histories = self._problem, self._problem.at_work
        fine, broken, same = self._judge(q, g, free)
        if (settled := fine & same & ~broken).all():
            problem.at_work = histories[:0]
            return [], False
        lost, leaving = histories[broken], histories[~same & ~broken]
        cleared = np.zeros(len(leaving), dtype=bool)
        self._problem.loops.change_sets(len(leaving), q.shape[1], leaving, q, g, free, cleared)
        q[lost], problem.is_known[lost] = 0.0, False
        problem.at_work = histories[~(settled | broken)]
        return lost.tolist(), bool(cleared.any())

    def _judge(
        self, q: FloatArray, g: FloatArray, free: BoolArray
    ) -> tuple[BoolArray, BoolArray, BoolArray]:
        """Return whether histories at work, (h,), are optimal, are not finite, keep their sets.

        See the loop of this name.
        """
        problem, histories = self._problem, self._problem.at_work
        verdicts = np.empty((3, len(histories)), dtype=bool)
        with_forces = problem.forces is not None
        forces = problem.approaches if problem.forces is None else problem.forces
        problem.loops.judge(
            len(histories), q.shape[1], histories, problem.which, q, g, self._hessians.diagonal,
            problem.compliances.weights, problem.gaps, problem.approaches, forces, with_forces,
            free, self.residuals, *verdicts, ROUND_OFF, GRADIENT_TOLERANCE, FORCE_TOLERANCE,
        )  # fmt: skip
        fine, broken, same = verdicts
        return fine, broken, same

    def _begin(self, q: FloatArray, g: FloatArray, free: BoolArray) -> None:
        """Let the sets be those of the present values; where nothing touches, guess."""
        if q.min() > 0.0:
            return
        histories, rows = self._problem.at_work, self._problem.rows
        none = histories[~free[rows].any(axis=1)]
        if len(none):
            q[none] = 0.0
            if self._problem.forces is not None:
                free[none] = True
            else:
                self._evaluate(q, g)
                free[none] = g[none] < 0.0
        if not (q[rows] >= 0.0).all():
            q[rows] = np.where(free[rows], q[rows], 0.0)
            self._problem.is_known[histories] = False

    def _iterate_damped(self, tao: PETSc.TAO, q: FloatArray, g: FloatArray) -> tuple[IntArray, int]:
        """Take damped steps of the history at work; return it if it did not end, and their number.

        Its approach is given.
        """
        histories = self._problem.at_work
        row, free = int(histories[0]), np.zeros(q.shape, dtype=bool)
        q[row] = np.maximum(q[row], 0.0)
        self._evaluate(q, g)
        limit = tao.getMaximumIterations()
        for iteration in range(1, limit + 1):
            free[row] = (q[row] > 0.0) | (g[row] < 0.0)
            self._hessians.set_slopes(self._problem.rows, *self._problem.slopes(q[[row]], True))
            self._hessians.refresh(histories, free, in_bases=False)
            (step,), _ = self._hessians.steps(histories, g[[row]], None, SOLVED)
            self._search(q, g, row, step)
            if self._monitored:
                self._monitor(tao, iteration)
            free[row] = q[row] > 0.0
            fine, broken, same = self._judge(q, g, free)
            if broken[0]:
                break
            if fine[0] and same[0]:
                return histories[:0], iteration
        return histories, iteration

    def _search(self, q: FloatArray, g: FloatArray, row: int, step: FloatArray) -> None:
        """Take the projected step of a row, so short that the convex objective is sure to fall.

        It does where the gradient at the end still points along the way there; gradients are far
        cheaper than objectives. Both become those at the end.
        """
        x, gradient = q[row], g[row]
        start, length, slope_at_start = x.copy(), 1.0, gradient.copy()
        while True:
            x[:] = np.maximum(start + length * step, 0.0)
            self._evaluate(q, g)
            way = x - start
            before, after = float(slope_at_start @ way), float(gradient @ way)
            if after <= -_SLOPE_LEFT * before or length < _SHORTEST:
                return
            length *= max(0.1, before / (before - after))  # where a straight line would vanish

    def _monitor(self, tao: PETSc.TAO, iteration: int) -> None:
        """Let whoever watches see objective and projected gradient of the histories at work."""
        x, gradient = (
            self._problem.rows_in(vector.getArray(readonly=True))[self._problem.rows]
            for vector in (self._x, self._g)
        )
        residual = float(np.linalg.norm(np.where(x > 0.0, gradient, np.minimum(gradient, 0.0))))
        tao.monitor(iteration, tao.computeObjective(self._x), residual)

    def _evaluate(self, q: FloatArray, g: FloatArray, recall: bool = False) -> None:
        """Compute the gradient at the present unknowns, or ``recall`` what is known of them."""
        rows = self._problem.rows
        if isinstance(rows, slice):
            self._problem.gradient(q, recall, g)
        else:
            g[rows] = self._problem.gradient(q[rows], recall)
