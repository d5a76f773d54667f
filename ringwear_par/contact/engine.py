"""PETSc TAO around B >= 1 contact problems on one contact line, each its own.

All of them are one bound-constrained problem, whose Hessian is block-diagonal. Our own method
solves them in lock step: gaps, forces or approaches, wear and moduli are those of each history; so
are all digits of its solution, whoever the others are. PETSc's methods, whose line searches would
mix histories, have them one after another.
"""

from typing import Any, TypeVar

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import BoolArray, FloatArray, IntArray, inner
from ringwear_par.batched import take
from ringwear_par.compiled.contact_rows import GRADIENT_TOLERANCE
from ringwear_par.contact.approach import find_approach
from ringwear_par.contact.hessians import Hessians
from ringwear_par.contact.newton import ActiveSetNewton
from ringwear_par.contact.problem import (
    KKT_TOLERANCE,
    ContactProblem,
    ContactState,
    WarmStart,
    part,
)
from ringwear_par.contact.scaled_compliances import ScaledCompliances
from ringwear_par.contact.tao import OPEN, Guard
from ringwear_par.errors import ComputationError, HistoriesError, InputError
from ringwear_par.options import CONTACT_PREFIX, set_from_options
from ringwear_par.petsc import PETSc
from ringwear_par.wear.increment import WearIncrement

#: TAO types on offer, "python" being our own; each gives the same answer
TAO_TYPES = ("python", "tron", "bnls")

P = TypeVar("P", bound=PETSc.Object)


class _Callbacks:
    """What TAO calls. Knows neither the TAO nor the engine, so that the last reference frees them.

    Vectors are of all histories, of which those at work are set, or of the only one at work.

    Parameters
    ----------
    problem : the contact problems.
    hessians : of them.
    """

    def __init__(self, problem: ContactProblem, hessians: Hessians) -> None:
        self._problem, self._hessians = problem, hessians
        self.guard = Guard()

    def _let_be(self, x: PETSc.Vec) -> None:
        """Let the unknowns of the histories at work be these."""
        rows = self._problem.rows
        self._problem.unknowns[rows] = self._rows_in(x.getArray(readonly=True), rows)

    def _rows_in(self, vector: FloatArray, rows: IntArray | slice) -> FloatArray:
        """Return rows of a vector, which may be of the only history at work, or have more room."""
        unknowns = self._problem.unknowns
        if vector.size == unknowns.shape[1]:
            return vector[None]
        part_of: FloatArray = vector[: unknowns.size].reshape(unknowns.shape)[rows]
        return part_of

    def gradient(self, tao: PETSc.TAO, x: PETSc.Vec, g: PETSc.Vec) -> None:
        """Set g to the gradient at the present approaches."""
        problem = self._problem
        self._let_be(x)
        problem.evaluate()
        values = g.getArray()
        if values.size == problem.unknowns.shape[1]:
            values[:] = problem.gradients[problem.at_work[0]]
        else:
            values[: problem.unknowns.size].reshape(problem.unknowns.shape)[problem.rows] = (
                problem.gradients[problem.rows]
            )

    def objective(self, tao: PETSc.TAO, x: PETSc.Vec) -> float:
        """Return the sum of the objectives at the present approaches."""
        self._let_be(x)
        return self._problem.objective()

    def objective_gradient(self, tao: PETSc.TAO, x: PETSc.Vec, g: PETSc.Vec) -> float:
        """Return the objective, set g to the gradient."""
        self.gradient(tao, x, g)
        return self._problem.objective()

    def hessian(self, tao: PETSc.TAO, x: PETSc.Vec, h: PETSc.Mat, _: PETSc.Mat) -> None:
        """Set the Hessian of the only history at work."""
        problem, hessians = self._problem, self._hessians
        self._let_be(x)
        problem.evaluate()
        hessians.set_slopes(problem.at_work, *problem.slopes())
        h.getDenseArray()[:] = hessians.matrix(int(problem.at_work[0]))
        h.assemble()


class ContactEngine:
    """One TAO for B contact problems on one contact line. Not collective.

    PETSc's objects are freed by ``destroy`` or at the end of a ``with``, otherwise with the last
    reference to the engine, at the latest at the end of the process.

    Parameters
    ----------
    compliances : of the contact line.
    which : (B,) int, the compliance of each history.
    tao_type : one of ``TAO_TYPES``; None: that of PETSc's options.

    Raises
    ------
    InputError : PETSc does not accept an option.
    """

    def __init__(
        self, compliances: ScaledCompliances, which: IntArray, tao_type: str | None = None
    ) -> None:
        self._objects: list[PETSc.Object] = []
        if tao_type is None:
            tao_type = PETSc.Options(CONTACT_PREFIX).getString("tao_type", TAO_TYPES[0])
        if tao_type not in TAO_TYPES:
            raise InputError(
                f"-{CONTACT_PREFIX}tao_type {tao_type}: must be one of {', '.join(TAO_TYPES)}"
            )
        self.compliances, self.which, self._tao_type = compliances, which, tao_type
        self._problem = ContactProblem(compliances, which)
        self.loops = self._problem.loops
        self._hessians = Hessians(compliances, which)
        self._callbacks = _Callbacks(self._problem, self._hessians)
        #: (B,) iterations of the last solutions
        self._iterations = np.zeros(len(which), dtype=np.int64)
        #: our own method; None: one of PETSc's is at work
        self._newton: ActiveSetNewton | None = None
        if tao_type == TAO_TYPES[0]:
            guard = self._callbacks.guard
            self._newton = ActiveSetNewton(self._problem, self._hessians, guard)
            self._iterations = self._newton.iterations
        OPEN[self] = None
        try:
            self._set_up_tao()
        except BaseException:
            self.destroy()
            raise

    def _set_up_tao(self) -> None:
        """Make all that is PETSc's, each of it owned before it is there."""
        comm, callbacks = MPI.COMM_SELF, self._callbacks
        guarded = callbacks.guard.guarded
        tao = self._tao = self._register(PETSc.TAO()).create(comm)
        x = self._x = self._register(PETSc.Vec())
        gradient = self._register(PETSc.Vec())
        tao.setOptionsPrefix(CONTACT_PREFIX)
        tao.setType(self._tao_type)
        if self._newton is not None:
            x.createWithArray(self._problem.unknowns.reshape(-1), comm=comm)
            gradient.createWithArray(self._problem.gradients.reshape(-1), comm=comm)
            tao.setPythonContext(self._newton)
        else:
            size = len(self._problem.area)
            x.createSeq(size, comm=comm)
            gradient.createSeq(size, comm=comm)
            hessian = self._register(PETSc.Mat()).createDense([size, size], comm=comm)
            hessian.setUp()
            # inexact inner solves would stop the outer ones above KKT_TOLERANCE
            ksp = tao.getKSP()
            if self._tao_type == "bnls":
                ksp.setType("preonly")
                ksp.getPC().setType("cholesky")
            else:
                ksp.setType("stcg")
                ksp.getPC().setType("jacobi")
                ksp.setTolerances(rtol=1e-10)
            tao.setHessian(guarded(callbacks.hessian), hessian, hessian)
        lower, upper = (self._register(x.duplicate()) for _ in "lu")
        lower.set(0.0)
        upper.set(PETSc.INFINITY)
        tao.setObjective(guarded(callbacks.objective))
        tao.setGradient(guarded(callbacks.gradient), gradient)
        tao.setObjectiveGradient(guarded(callbacks.objective_gradient), gradient)
        tao.setVariableBounds((lower, upper))
        tao.setSolution(x)
        set_from_options(tao, CONTACT_PREFIX)

    def _register(self, petsc_object: P) -> P:
        self._objects.append(petsc_object)
        return petsc_object

    # -- solutions ---------------------------------------------------------------------------------

    def solve(
        self,
        gap: FloatArray,
        *,
        force: FloatArray | None = None,
        approach: FloatArray | None = None,
        wear: WearIncrement | None = None,
        histories: IntArray | None = None,
    ) -> ContactState:
        """Solve at given forces (B,) N or approaches (B,) mm.

        Parameters
        ----------
        gap : (B, n) float, mm, of the undeformed profiles at the start of the step.
        force, approach : one of them.
        wear : wear of an implicit step, of all histories.
        histories : those that are solved; None: all. The others have what they had.

        Raises
        ------
        ComputationError : TAO failed, the KKT residual or the force balance is too large;
            HistoriesError of several histories.
        Exception : what a law raised.
        """
        problem = self._problem
        active = problem.every if histories is None else histories
        apart = problem.pose(gap, force, approach, wear, active)
        self._hessians.pose(wear)
        self._iterations[active] = 0
        if apart.any():
            self._separate(active[apart[active]])
        unsolved, failed = self._solve_together(), np.zeros(len(gap), dtype=bool)
        for history in unsolved.tolist():
            try:
                self._solve_alone(history)
            except ComputationError:
                if len(gap) == 1:
                    raise
                failed[history] = True
        residual = self._residuals(active, apart)
        if not (residual <= KKT_TOLERANCE).all() or failed.any():
            failed |= ~(residual <= KKT_TOLERANCE)
            if len(gap) == 1:
                raise ComputationError(self._failure(0, float(residual[0])))
            raise HistoriesError(failed)
        p, gap = problem.last_pressures(), problem.gaps_of(problem.gradients)
        return ContactState(
            p, gap, problem.approaches.copy(), inner(problem.area, p), self._iterations.copy(),
            residual,
        )  # fmt: skip

    def response(self, gap: FloatArray, histories: IntArray | None = None) -> FloatArray:
        """Return about the changes of the last pressures, MPa, with small growths of gaps.

        Of (..., B, n) mm, or (..., h, n) of some histories, to some 1e-2 of them: for estimates of
        errors. Linear, on the inverses that solutions ended with: elements in contact and forces or
        approaches, whichever were given, stay so, and so do the sides of kinks; the wear of the
        step is included.
        """
        problem = self._problem
        histories = problem.every if histories is None else histories
        return self._hessians.responses(histories, gap, problem.forces is not None)

    def propagate_errors(self, *errors: Any) -> IntArray:
        """Propagate errors of steps where that is diagonal, and return the other histories.

        Responses are those of ``response``. For the errors see ``Hessians.propagate_errors``.
        """
        problem = self._problem
        return self._hessians.propagate_errors(problem.every, problem.forces is not None, *errors)

    def _residuals(self, histories: IntArray, apart: BoolArray) -> FloatArray:
        """Return natural KKT residuals of all, as Newton's method saw them last if these will do.

        Parameters
        ----------
        histories : (h,) int, of which there are new solutions.
        apart : (B,) bool, which need no pressure.
        """
        if self._newton is not None and (self._newton.residuals <= KKT_TOLERANCE).all():
            return self._newton.residuals.copy()
        residual = np.zeros(len(apart))
        residual[histories] = self._problem.residuals(histories, self._hessians.blocks.slopes)
        residual[apart] = 0.0
        return residual

    def _failure(self, history: int, residual: float) -> str:
        """Return why a contact was not solved."""
        names = {v: k for k, v in vars(PETSc.TAO.Reason).items() if isinstance(v, int)}
        reason = self._tao.getConvergedReason()
        return (
            f"contact: TAO {self._tao_type} ended with reason {names.get(reason, 'unknown')} "
            f"({reason}) after {self._tao.getIterationNumber()} iterations at approach "
            f"{self._problem.approaches[history]:.9g} mm with KKT residual {residual:.2e} (allowed "
            f"{KKT_TOLERANCE:.0e})"
        )

    def _solve_together(self) -> IntArray:
        """Solve the problems at work in lock step; return those that are to be solved alone."""
        at_work = self._problem.at_work
        if self._newton is None or not len(at_work):
            return at_work
        self._callbacks.guard.solve(self._tao, self._tao_type)
        return self._newton.unsolved

    def _separate(self, histories: IntArray) -> None:
        """Take the pressures of histories that need none; the gradient is the weighted gap."""
        problem = self._problem
        problem.unknowns[histories], problem.contacts.are_known[histories] = 0.0, False
        problem.gradients[histories] = part(problem.weights, histories) * (
            problem.gaps[histories] - problem.approaches[histories, None]
        )
        self._hessians.forget(histories)
        if self._newton is not None:
            self._newton.residuals[histories] = 0.0

    def _solve_alone(self, history: int) -> None:
        """Solve the problem of a history at its approach, or at approaches up to that of its force.

        By damped steps of our own, or by a method of PETSc's.
        """
        problem = self._problem
        row = problem.at_work = np.array([history])
        gaps, forces = problem.gaps, problem.forces
        problem.unknowns[history] = 0.0
        if self._newton is not None:
            self._newton.damped = True
        try:
            if forces is None:
                self._solve_at_approach(history)
                return
            # what is searched for is the approach less the smallest gap: under light loads it is
            # far smaller than either
            nearest = float(gaps[history].min())
            problem.gaps, problem.forces = gaps.copy(), None
            problem.gaps[history] -= nearest
            compliances, number, area = self.compliances, self.which[history], problem.area
            weights, scale = compliances.weights[number], compliances.scale[number]
            matrix = compliances.matrix(int(number))
            force = float(forces[history])
            stiffness = float(area.sum() ** 2 / (scale @ matrix @ scale))  # of uniform pressure
            mean = float(area @ problem.gaps[history] / area.sum())

            def contact_at(approach: float) -> tuple[float, float]:
                problem.approaches[history] = approach
                self._solve_at_approach(history)
                response = self._hessians.solve(row, weights[None])[0]
                return float(weights @ problem.unknowns[history]), float(weights @ response)

            find_approach(force, mean + force / stiffness, stiffness, contact_at)
            problem.approaches[history] += nearest
        finally:
            problem.gaps, problem.forces = gaps, forces
            if self._newton is not None:
                self._newton.damped = False

    def _solve_at_approach(self, history: int) -> None:
        """Solve the problem of a history, the one at work, at its approach.

        Raises
        ------
        ComputationError : TAO failed, or the KKT residual is too large.
        """
        problem, tao, row = self._problem, self._tao, self._problem.at_work
        beyond = problem.approaches[history] - problem.gaps[history]
        overlap = self.compliances.weights[self.which[history]] * np.maximum(beyond, 0.0)
        if not overlap.any():
            self._separate(row)
            return
        tao.setTolerances(
            gatol=GRADIENT_TOLERANCE * float(np.linalg.norm(overlap)), grtol=0.0, gttol=0.0
        )
        if self._newton is None:
            self._x.setArray(problem.unknowns[history])
        self._callbacks.guard.solve(tao, self._tao_type)
        if self._newton is None:
            problem.unknowns[history] = self._x.getArray(readonly=True)
        self._iterations[history] += tao.getIterationNumber()
        problem.evaluate()
        self._hessians.set_slopes(row, *problem.slopes())
        (residual,) = problem.residuals(row, self._hessians.blocks.slopes)
        if tao.getConvergedReason() <= 0 or not residual <= KKT_TOLERANCE:
            raise ComputationError(self._failure(history, float(residual)))
        # what else is needed of the solution is answered on the inverse of its set
        self._hessians.refresh(row, problem.unknowns > 0.0)

    # -- some of the histories, and the end --------------------------------------------------------

    @property
    def scale(self) -> FloatArray:
        """(B, n), or (1, n) if it is the same of all: unknowns over pressures, 1/MPa."""
        return self._problem.scale

    @property
    def warm(self) -> WarmStart:
        """Where the next solutions start."""
        return WarmStart(self._problem.unknowns.copy(), self._problem.approaches.copy())

    @warm.setter
    def warm(self, warm: WarmStart) -> None:
        self._problem.unknowns[:], self._problem.approaches[:] = warm.scaled_pressure, warm.approach
        self._problem.contacts.are_known[:] = False

    def keep(self, histories: IntArray) -> None:
        """Go on with some of the histories, in ascending order, in the first rows of vectors."""
        count = len(histories)
        self.which = self.which[histories]
        self._problem.keep(histories)
        self._hessians.keep(histories)
        self._iterations = np.zeros(count, dtype=np.int64)
        if self._newton is not None:
            self._newton.iterations, self._newton.residuals = self._iterations, np.zeros(count)

    def take(self, histories: IntArray) -> "ContactEngine":
        """Return an engine of some of the histories, which starts where this one would."""
        used, which = np.unique(self.which[histories], return_inverse=True)
        engine = ContactEngine(self.compliances.take(used), which, self._tao_type)
        engine.warm = take(self.warm, histories)
        return engine

    def destroy(self) -> None:
        """Free the PETSc objects, if they are not yet."""
        OPEN.pop(self, None)
        while self._objects:
            self._objects.pop().destroy()

    def __del__(self) -> None:
        self.destroy()

    def __enter__(self) -> "ContactEngine":
        return self

    def __exit__(self, *_: object) -> None:
        self.destroy()
