"""PETSc TAO around many contact problems on one contact line, each its own, solved in lock step.

All of them are one bound-constrained problem, whose Hessian is block-diagonal. Gaps, forces or
approaches, wear and moduli are those of each history; so are all digits of its solution, whoever
the others are.
"""

from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import FloatArray, IntArray, inner
from ringwear_par.batched import take
from ringwear_par.contact.bases import Bases, RowGroups
from ringwear_par.contact.batch_newton import BatchNewton
from ringwear_par.contact.hessians import SOLVED, Hessians
from ringwear_par.contact.problem import KKT_TOLERANCE, ContactState, WarmStart
from ringwear_par.contact.solver import ContactSolver
from ringwear_par.contact.tao import OPEN, Guard
from ringwear_par.errors import ComputationError, HistoriesError
from ringwear_par.options import CONTACT_PREFIX
from ringwear_par.petsc import PETSc
from ringwear_par.wear.increment import WearIncrement

P = TypeVar("P", bound=PETSc.Object)
#: less than any stiffness
TINY = 1e-300


def has_own_options() -> bool:
    """Tell whether the user has options for the solver of single contacts. Not collective."""
    return any(name.startswith(CONTACT_PREFIX) for name in PETSc.Options().getAll())


class _Callbacks:
    """What TAO calls, for the histories at work. Knows neither the TAO nor the solver.

    Parameters
    ----------
    hessians : of the histories.
    newton : which histories are at work, their gaps and approaches.
    area : (n,) float, mm^2.
    scale, weights : (B, n) float; pressure times scale is the unknown, gap times weights the
        gradient.
    """

    def __init__(
        self,
        hessians: Hessians,
        newton: BatchNewton,
        matrices: FloatArray,
        which: IntArray,
        area: FloatArray,
        scale: FloatArray,
        weights: FloatArray,
    ) -> None:
        self._hessians, self._newton = hessians, newton
        self._matrices, self._which, self._area = matrices, which, area
        self._groups: tuple[IntArray, RowGroups] | None = None
        self._scale, self._weights = scale, weights
        self.wear: WearIncrement | None = None
        self._part: tuple[IntArray, WearIncrement] | None = None
        self.guard = Guard()

    def pose(self, wear: WearIncrement | None) -> None:
        """Take the wear of an implicit step of all histories."""
        self.wear, self._part = wear, None

    def _worn(self, wear: WearIncrement, q: FloatArray) -> tuple[WearIncrement, FloatArray]:
        """Return the wear of the histories at work, and their pressures."""
        histories, rows = self._newton.at_work, self._newton.rows
        if rows is histories:
            if self._part is None or self._part[0] is not histories:
                self._part = histories, wear.take(histories)
            wear = self._part[1]
        return wear, q[rows] / self._scale[rows]

    def _smooth(self, q: FloatArray, g: FloatArray) -> None:
        """Set the rows of g to the gradient without wear."""
        newton, rows = self._newton, self._newton.rows
        linear = newton.gaps[rows] - newton.approaches[rows, None]
        linear *= self._weights[rows]
        if self._groups is None or self._groups[0] is not newton.at_work:
            self._groups = newton.at_work, RowGroups(self._which[rows])
        linear += self._groups[1].products(q[rows], self._matrices)
        g[rows] = linear

    def gradient(self, tao: PETSc.TAO, x: PETSc.Vec, g: PETSc.Vec) -> None:
        """Set g to the gradient at the present approaches."""
        q = x.getArray(readonly=True).reshape(self._weights.shape)
        out = g.getArray().reshape(q.shape)
        self._smooth(q, out)
        if self.wear is not None:
            (wear, p), rows = self._worn(self.wear, q), self._newton.rows
            out[rows] += self._weights[rows] * wear.depth(p)

    def objective(self, tao: PETSc.TAO, x: PETSc.Vec) -> float:
        """Return the sum of the objectives of the histories at work, at the present approaches."""
        q = x.getArray(readonly=True).reshape(self._weights.shape)
        newton, histories = self._newton, self._newton.at_work
        product = RowGroups(self._which).products(q, self._matrices)
        linear = self._weights * (newton.gaps - newton.approaches[:, None])
        objectives = inner(q, 0.5 * product + linear)[histories]
        if self.wear is not None:
            p = q[histories] / self._scale[histories]
            objectives = objectives + inner(self._area, self.wear.take(histories).potential(p))
        return float(objectives.sum())

    def objective_gradient(self, tao: PETSc.TAO, x: PETSc.Vec, g: PETSc.Vec) -> float:
        """Return the objective, set g to the gradient."""
        self.gradient(tao, x, g)
        return self.objective(tao, x)

    def hessian(self, tao: PETSc.TAO, x: PETSc.Vec, h: PETSc.Mat, _: PETSc.Mat) -> None:
        """Set the blocks of the Hessian."""
        if self.wear is None:
            return
        q, hessians = x.getArray(readonly=True).reshape(self._weights.shape), self._hessians
        (wear, p), rows = self._worn(self.wear, q), self._newton.rows
        weights, scale = self._weights[rows], self._scale[rows]
        hessians.slope[rows] = wear.d_depth_dp(p) * (weights / scale)
        if len(hessians.coupling):
            coupling = weights[..., None] * wear.jacobian(p) / scale[:, None, :]
            diagonal = np.arange(q.shape[1])
            coupling[:, diagonal, diagonal] -= hessians.slope[rows]
            hessians.coupling[rows] = coupling

    def steepest(self, q: FloatArray) -> FloatArray:
        """Return the steeper slope, (B, n), of both sides of a kink of the law."""
        if self.wear is None:
            return self._hessians.slope
        slope = self.wear.d_depth_dp(q / self._scale) * (self._weights / self._scale)
        return np.maximum(self._hessians.slope, slope)


class BatchSolver:
    """One TAO for B contact problems on one contact line. Not collective.

    PETSc's objects are freed by ``destroy``, otherwise with the last reference to the solver, at
    the latest at the end of the process.

    Parameters
    ----------
    compliances : (m, n, n) float, mm^3/MPa, symmetric area-weighted compliances.
    which : (B,) int, the compliance of each history.
    area : (n,) float, mm^2.
    speed : (m, n) float, what the slopes of most wear over pressure are in proportion to, where
        elements wear: sliding speeds, along the axis; None: they are uniform.
    """

    def __init__(
        self,
        compliances: FloatArray,
        which: IntArray,
        area: FloatArray,
        speed: FloatArray | None = None,
    ) -> None:
        self._objects: list[PETSc.Object] = []
        self._which, self._area = which, area
        count, n = len(which), len(area)
        scales = np.sqrt(np.diagonal(compliances, axis1=1, axis2=2))
        self._scaled = compliances / (scales[:, :, None] * scales[:, None, :])
        weights = area / scales
        self._speed = weights / scales if speed is None else speed * (weights / scales)
        self._speed /= self._speed.max(axis=1, keepdims=True)
        self._bases = [
            Bases(*parts) for parts in zip(self._scaled, self._speed, weights, strict=True)
        ]
        self._petsc_methods = has_own_options()
        self._set_up(scales[which], count, n)

    def _set_up(self, scale: FloatArray, count: int, n: int) -> None:
        self._every = np.arange(count)
        self._scale, self._weights = scale, self._area / scale
        self._hessians = Hessians(
            self._scaled, self._bases, self._speed, self._which, self._weights
        )
        self._newton = BatchNewton(self._hessians, self._weights)
        self._callbacks = _Callbacks(
            self._hessians,
            self._newton,
            self._scaled,
            self._which,
            self._area,
            self._scale,
            self._weights,
        )
        OPEN[self] = None
        self._x = self._register(PETSc.Vec()).createSeq(count * n, comm=MPI.COMM_SELF)
        self._g, lower, upper = (self._register(self._x.duplicate()) for _ in "glu")
        upper.set(PETSc.INFINITY)
        self._h = self._register(PETSc.Mat()).createPython(
            [count * n, count * n], self._hessians, comm=MPI.COMM_SELF
        )
        self._h.setUp()
        tao = self._tao = self._register(PETSc.TAO()).create(MPI.COMM_SELF)
        tao.setType("python")
        tao.setPythonContext(self._newton)
        guarded = self._callbacks.guard.guarded
        tao.setObjective(guarded(self._callbacks.objective))
        tao.setGradient(guarded(self._callbacks.gradient), self._g)
        tao.setObjectiveGradient(guarded(self._callbacks.objective_gradient), self._g)
        tao.setHessian(guarded(self._callbacks.hessian), self._h, self._h)
        tao.setVariableBounds((lower, upper))
        tao.setSolution(self._x)

    def _register(self, petsc_object: P) -> P:
        self._objects.append(petsc_object)
        return petsc_object

    @property
    def area(self) -> FloatArray:
        """(n,) mm^2."""
        return self._area

    def solve(
        self,
        gap: FloatArray,
        *,
        force: FloatArray | None = None,
        approach: FloatArray | None = None,
        wear: WearIncrement | None = None,
        histories: IntArray | None = None,
    ) -> ContactState:
        """Solve at given forces (B,) N or approaches (B,) mm; see ``ContactSolver.solve``.

        Parameters
        ----------
        gap : (B, n) float, mm.
        wear : of all histories.
        histories : those that are solved; None: all. The others have what they had.

        Raises
        ------
        HistoriesError : these were not solved.
        Exception : what a law raised.
        """
        newton = self._newton
        active = self._every if histories is None else histories
        newton.gaps = gap
        if approach is not None:
            newton.forces = np.zeros(0)
            newton.approaches[active] = approach[active]
            apart = gap.min(axis=1) >= approach
        elif force is not None:
            newton.forces = force
            apart = force == 0.0  # the bodies just touch
            touching = active[apart[active]]
            newton.approaches[touching] = gap[touching].min(axis=1)
        else:
            raise ValueError("force or approach must be given")
        self._callbacks.pose(wear)
        self._pose_coupling(wear)
        newton.at_work = active
        if apart.any():
            self._part(active[apart[active]])
            newton.at_work = active[~apart[active]]
        if self._petsc_methods:
            self._newton.failed[:] = False
            self._newton.failed[newton.at_work] = True
        else:
            self._run_tao()
        singles, unsolved = {}, np.zeros(len(gap), dtype=bool)
        for i in np.flatnonzero(newton.failed).tolist():
            try:
                singles[i] = self._solve_single(i, gap, force, approach, wear)
            except ComputationError:
                if len(gap) == 1:
                    raise
                unsolved[i] = True
        if unsolved.any():
            raise HistoriesError(unsolved)
        q, g = (v.getArray(readonly=True).reshape(gap.shape) for v in (self._x, self._g))
        worst, largest = self._defects(active, q, g)
        off = np.divide(worst, largest, out=np.full(len(active), np.inf), where=largest > 0.0)
        residual = np.zeros(len(gap))
        residual[active] = off
        residual[apart] = 0.0
        iterations = newton.iterations.copy()
        iterations[apart] = 0
        for i, solution in singles.items():
            residual[i], iterations[i] = solution.residual, iterations[i] + solution.iterations
        failed = ~(residual <= KKT_TOLERANCE)
        if failed.any():
            if len(gap) == 1:
                raise ComputationError(
                    f"contact: KKT residual {residual[0]:.2e} after {iterations[0]} iterations "
                    f"(allowed {KKT_TOLERANCE:.0e})"
                )
            raise HistoriesError(failed)
        p = q / self._scale
        return ContactState(
            p, g / self._weights, newton.approaches.copy(), inner(self._area, p), iterations,
            residual,
        )  # fmt: skip

    def _solve_single(
        self,
        history: int,
        gap: FloatArray,
        force: FloatArray | None,
        approach: FloatArray | None,
        wear: WearIncrement | None,
    ) -> ContactState:
        """Return the contact of one history by a TAO of its own, and continue from it.

        It is damped where sets cycle, and PETSc's own methods are at hand.
        """
        scale, newton = self._scale[history], self._newton
        matrix = self._scaled[self._which[history]] * (scale[:, None] * scale)
        increment = None if wear is None else wear.history(history)
        with ContactSolver(matrix, self._area) as solver:
            solution = solver.solve(
                gap[history],
                force=None if force is None else float(force[history]),
                approach=None if approach is None else float(approach[history]),
                wear=increment,
            )
        q, g = (v.getArray(readonly=True).reshape(gap.shape).copy() for v in (self._x, self._g))
        q[history], g[history] = solution.pressure * scale, solution.gap * self._weights[history]
        newton.approaches[history], newton.failed[history] = solution.approach, False
        self._x.setArray(q.ravel())
        self._g.setArray(g.ravel())
        # what else is active of the solution is answered on the factor of its set
        newton.at_work = np.array([history])
        self._callbacks.hessian(self._tao, self._x, self._h, self._h)
        self._hessians.refresh(newton.at_work, q > 0.0)
        return solution

    def _pose_coupling(self, wear: WearIncrement | None) -> None:
        """Make room for what non-local wear adds to the Hessian, where it is non-local."""
        blocks = self._hessians
        if wear is None:
            blocks.slope[:] = 0.0
        blocks.through_layers = wear is not None and wear.layered
        coupled, n = wear is not None and not wear.local, len(self._area)
        if coupled != bool(len(blocks.coupling)):
            blocks.coupling = np.zeros((len(self._every) if coupled else 0, n, n))

    def _part(self, histories: IntArray) -> None:
        """Take the pressures of histories that need none; the gradient is the weighted gap."""
        newton, shape = self._newton, self._weights.shape
        self._hessians.forget(histories)
        q, g = (v.getArray(readonly=True).reshape(shape).copy() for v in (self._x, self._g))
        q[histories] = 0.0
        g[histories] = self._weights[histories] * (
            newton.gaps[histories] - newton.approaches[histories, None]
        )
        self._x.setArray(q.ravel())
        self._g.setArray(g.ravel())

    def _defects(
        self, histories: IntArray, q: FloatArray, g: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the natural KKT residuals, infinite where there is none, and the largest q."""
        rows = self._rows_of(histories)
        largest = np.maximum(q[rows].max(axis=1), 0.0)
        worst = _natural(q[rows], g[rows], self._hessians.slope[rows])
        if not (worst <= KKT_TOLERANCE * largest).all():  # either side of a kink will do
            worst = _natural(q[rows], g[rows], self._callbacks.steepest(q)[rows])
        return worst, largest

    def _run_tao(self) -> None:
        """Solve the problems posed, of the histories at work."""
        if not len(self._newton.at_work):
            self._newton.failed[:] = False
            return
        self._callbacks.guard.solve(self._tao, "python")

    def response(self, gap: FloatArray) -> FloatArray:
        """Return the changes of the last pressures, MPa, with small growths (..., B, n) mm of gaps.

        Linear, elements in contact and forces or approaches, whichever were given, staying so; the
        wear of the step included.
        """
        missing = np.zeros(gap.shape[:-1]) if len(self._newton.forces) else None
        steps, _ = self._hessians.steps(self._every, self._weights * gap, missing, SOLVED)
        return steps / self._scale

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
        hessians, rows = self._hessians, self._rows_of(histories)
        weights, scale = self._weights[rows], self._scale[rows]
        right = d_gap[:, rows] * weights
        by_gap, border = hessians.solve(histories, right), hessians.solve(histories, weights)
        left = self._left_out(slope, histories)
        if left is not None:
            by_gap -= hessians.solve(histories, np.array([left(x) for x in by_gap]))
            border = border - hessians.solve(histories, left(border))
        if d_approach is None:
            # where nothing touches, the force being 0, bodies stay at the nearest element
            nearest = solution.gap[rows].argmin(axis=1)
            moved = d_gap[:, histories, nearest]
        else:
            moved = d_approach[:, rows].copy()
        stiffness = inner(weights, border)
        if d_force is not None:
            carried = d_force[:, rows] + inner(weights, by_gap)
            moved = np.where(stiffness > 0.0, carried / np.maximum(stiffness, TINY), moved)
        return (border * moved[..., None] - by_gap) / scale, moved

    def _rows_of(self, histories: IntArray) -> Any:
        """Return the rows of some histories, all by a slice, which is quicker."""
        return slice(None) if len(histories) == len(self._every) else histories

    def _left_out(
        self, slope: FloatArray | None, histories: IntArray
    ) -> Callable[[FloatArray], FloatArray] | None:
        """Return the product of x (h, n) with the slopes at a solution less those of the Hessian.

        The Hessian is that of the iterate before; None where it is the same.
        """
        if slope is None:
            return None
        rows, blocks = self._rows_of(histories), self._hessians
        weights, scale = self._weights[rows], self._scale[rows]
        if slope.ndim > self._weights.ndim:
            change = weights[..., None] * slope[rows] / scale[:, None, :] - blocks.coupling[rows]
            diagonal = np.arange(change.shape[1])
            change[:, diagonal, diagonal] -= blocks.slope[rows]
            return lambda x: np.array([matrix @ row for matrix, row in zip(change, x, strict=True)])
        # TAO's callbacks make it in the same way, so that what has not changed is 0
        change = slope[rows] * (weights / scale) - blocks.slope[rows]
        return (lambda x: change * x) if change.any() else None

    @property
    def scale(self) -> FloatArray:
        """(B, n), unknowns over pressures, 1/MPa."""
        return self._scale

    @property
    def warm(self) -> WarmStart:
        """Where the next solutions start."""
        q = self._x.getArray(readonly=True).reshape(self._weights.shape).copy()
        return WarmStart(q, self._newton.approaches.copy())

    @warm.setter
    def warm(self, warm: WarmStart) -> None:
        self._x.setArray(warm.scaled_pressure.ravel())
        self._newton.approaches[:] = warm.approach

    def products(self, matrices: FloatArray, which: IntArray, p: FloatArray) -> FloatArray:
        """Return the products of transposed matrices (m, n, n), one a history, and p (B, n).

        Or of several p, (P, B, n).
        """
        return RowGroups(which).products(p, matrices)

    def deflections(self, d_p: FloatArray) -> FloatArray:
        """Return the changes of gaps, mm, with those of pressures, (P, B, n) MPa."""
        return self.products(self._scaled, self._which, self._scale * d_p) / self._weights

    def take(self, histories: IntArray) -> "BatchSolver":
        """Return a solver of some of the histories, which starts where this one would."""
        used, which = np.unique(self._which[histories], return_inverse=True)
        solver = BatchSolver.__new__(BatchSolver)
        solver._objects = []
        solver._area, solver._scaled, solver._which = self._area, self._scaled, which
        solver._speed, solver._bases = self._speed, self._bases
        if len(used) < len(self._scaled):
            solver._scaled, solver._speed = self._scaled[used], self._speed[used]
            solver._bases = [self._bases[k] for k in used.tolist()]
        solver._set_up(self._scale[histories], len(histories), len(self._area))
        solver._petsc_methods = self._petsc_methods
        solver.warm = take(self.warm, histories)
        return solver

    def destroy(self) -> None:
        """Free the PETSc objects, if they are not yet."""
        OPEN.pop(self, None)
        while self._objects:
            self._objects.pop().destroy()

    def __del__(self) -> None:
        self.destroy()


def _natural(q: FloatArray, gradient: FloatArray, slope: FloatArray) -> FloatArray:
    """Return natural KKT residuals of (h, n), infinite where there is none."""
    worst = np.abs(np.minimum(q, gradient / (1.0 + slope))).max(axis=1)
    return np.where(np.isfinite(worst), worst, np.inf)
