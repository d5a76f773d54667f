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

from ringwear_par.arrays import BoolArray, FloatArray, IntArray
from ringwear_par.contact.hessians import SOLVED, Hessians
from ringwear_par.contact.problem import ContactProblem
from ringwear_par.contact.tao import Guard
from ringwear_par.petsc import PETSc

PLAIN_ITERATIONS = 25
_ENDED = PETSc.TAO.Reason.CONVERGED_GATOL
_NOT_ENDED = PETSc.TAO.Reason.DIVERGED_MAXITS
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
        self._free: BoolArray = np.zeros((0, 0), dtype=bool)
        self._monitored = False

    def setUp(self, tao: PETSc.TAO) -> None:
        """Look whether somebody watches."""
        self._monitored = PETSc.Options(tao.getOptionsPrefix()).hasName("tao_monitor")

    def solve(self, tao: PETSc.TAO) -> None:
        """Solve the problems at work from the present values.

        At the end unknowns and gradients, which are in the TAO's vectors, are those there.
        """
        self._guard.guarded(self._solve)(tao)
        del tao  # what was raised keeps this frame, which must not keep the TAO

    def _solve(self, tao: PETSc.TAO) -> None:
        iterate = self._iterate_damped if self.damped else self._iterate
        unsolved, iterations = iterate(tao)
        self.unsolved = np.sort(unsolved) if len(unsolved) else unsolved
        tao.setIterationNumber(iterations)
        ended = not self.damped or not len(unsolved)  # plain steps have damped ones to follow them
        tao.setConvergedReason(_ENDED if ended else _NOT_ENDED)

    def _iterate(self, tao: PETSc.TAO) -> tuple[IntArray, int]:
        """Take plain steps; return the histories that did not end, and the number of steps."""
        problem, hessians = self._problem, self._hessians
        every_lost: list[int] = []
        if self._free.shape != problem.unknowns.shape:
            self._free = np.empty(problem.unknowns.shape, dtype=bool)
        free = np.greater(problem.unknowns, 0.0, out=self._free)
        self._begin(free)
        problem.evaluate(recall=True)
        iteration, limit = 0, min(PLAIN_ITERATIONS, tao.getMaximumIterations())
        while len(problem.at_work) and iteration < limit:
            iteration += 1
            histories = problem.at_work
            hessians.take_steps(problem, free)
            n_settled, n_lost = problem.judge(hessians.blocks.diagonals, free, self.residuals)
            self.iterations[histories] = iteration
            if self._monitored:
                self._monitor(tao, iteration)
            if n_settled == len(histories):
                return histories[:0], iteration
            if n_settled or n_lost:
                settled, lost = problem.judged()
                every_lost += histories[lost].tolist()
                problem.go_on(~(settled | lost))
        return np.array([*every_lost, *problem.at_work.tolist()], dtype=np.int64), iteration

    def _begin(self, free: BoolArray) -> None:
        """Let the sets be those of the present values; where nothing touches, guess."""
        problem = self._problem
        q, g, histories, rows = (
            problem.unknowns, problem.gradients, problem.at_work, problem.rows,
        )  # fmt: skip
        if free.all():
            return
        none = histories[~free[rows].any(axis=1)]
        if len(none):
            q[none] = 0.0
            if problem.forces is not None:
                free[none] = True
            else:
                problem.evaluate()
                free[none] = g[none] < 0.0
        if not (q[rows] >= 0.0).all():
            q[rows] = np.where(free[rows], q[rows], 0.0)
            problem.contacts.are_known[histories] = False

    def _iterate_damped(self, tao: PETSc.TAO) -> tuple[IntArray, int]:
        """Take damped steps of the history at work; return it if it did not end, and their number.

        Its approach is given.
        """
        problem, histories = self._problem, self._problem.at_work
        q, g, row = problem.unknowns, problem.gradients, int(histories[0])
        free = np.zeros(q.shape, dtype=bool)
        q[row] = np.maximum(q[row], 0.0)
        problem.evaluate()
        limit = tao.getMaximumIterations()
        for iteration in range(1, limit + 1):
            free[row] = (q[row] > 0.0) | (g[row] < 0.0)
            self._hessians.set_slopes(histories, *problem.slopes())
            self._hessians.refresh(histories, free, in_bases=False)
            (step,), _ = self._hessians.steps(histories, g[[row]], None, SOLVED)
            self._search(row, step)
            if self._monitored:
                self._monitor(tao, iteration)
            free[row] = q[row] > 0.0
            settled, lost = problem.judge(self._hessians.blocks.diagonals, free, self.residuals)
            if lost:
                break
            if settled:
                return histories[:0], iteration
        return histories, iteration

    def _search(self, row: int, step: FloatArray) -> None:
        """Take the projected step of a row, so short that the convex objective is sure to fall.

        It does where the gradient at the end still points along the way there; gradients are far
        cheaper than objectives. Both become those at the end.
        """
        x, gradient = self._problem.unknowns[row], self._problem.gradients[row]
        start, length, slope_at_start = x.copy(), 1.0, gradient.copy()
        while True:
            x[:] = np.maximum(start + length * step, 0.0)
            self._problem.evaluate()
            way = x - start
            before, after = float(slope_at_start @ way), float(gradient @ way)
            if after <= -_SLOPE_LEFT * before or length < _SHORTEST:
                return
            length *= max(0.1, before / (before - after))  # where a straight line would vanish

    def _monitor(self, tao: PETSc.TAO, iteration: int) -> None:
        """Let whoever watches see objective and projected gradient of the histories at work."""
        problem = self._problem
        x, gradient = problem.unknowns[problem.rows], problem.gradients[problem.rows]
        residual = float(np.linalg.norm(np.where(x > 0.0, gradient, np.minimum(gradient, 0.0))))
        tao.monitor(iteration, problem.objective(), residual)
