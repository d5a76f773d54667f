"""PETSc TAO around one contact problem: at a given force, or at a given approach.

The problem is in ``problem``, the search for the approach in ``approach``; here are the PETSc
objects and their life. Histories whose sets of elements cycle are solved so, and all where the user
asks for a TAO of PETSc's own.
"""

from typing import TypeVar

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import FloatArray
from ringwear_par.contact.approach import ApproachSearch, Trial
from ringwear_par.contact.newton import ActiveSetNewton
from ringwear_par.contact.problem import KKT_TOLERANCE, ContactProblem, ContactState
from ringwear_par.contact.tao import OPEN, Guard
from ringwear_par.errors import ComputationError, InputError
from ringwear_par.options import CONTACT_PREFIX, set_from_options
from ringwear_par.petsc import PETSc
from ringwear_par.wear.increment import WearIncrement

#: TAO types on offer; each gives the same answer
TAO_TYPES = ("python", "tron", "bnls")

P = TypeVar("P", bound=PETSc.Object)


class _Callbacks:
    """What TAO calls: products with the matrix, all else by the problem.

    Knows neither the TAO nor the solver, so that both are freed with the last reference to them.

    Parameters
    ----------
    problem : the contact problem.
    matrix : the scaled compliance A.
    diagonal, scratch : vectors of the unknowns, the solver's.
    """

    def __init__(
        self, problem: ContactProblem, matrix: PETSc.Mat, diagonal: PETSc.Vec, scratch: PETSc.Vec
    ) -> None:
        self.problem, self._matrix = problem, matrix
        self.diagonal, self._scratch = diagonal, scratch
        self.guard = Guard()

    def objective(self, tao: PETSc.TAO, x: PETSc.Vec) -> float:
        """Return the objective."""
        return self.objective_gradient(tao, x, self._scratch)

    def gradient(self, tao: PETSc.TAO, x: PETSc.Vec, g: PETSc.Vec) -> None:
        """Set g to the gradient."""
        self._matrix.mult(x, g)
        self.problem.add_gradient(x.getArray(readonly=True), g.getArray())

    def objective_gradient(self, tao: PETSc.TAO, x: PETSc.Vec, g: PETSc.Vec) -> float:
        """Return the objective, set g to the gradient."""
        self._matrix.mult(x, g)
        value, gradient = self.problem.objective(
            x.getArray(readonly=True), g.getArray(readonly=True)
        )
        g.setArray(gradient)
        return value

    def hessian(self, tao: PETSc.TAO, x: PETSc.Vec, h: PETSc.Mat, _: PETSc.Mat) -> None:
        """Set h to the Hessian."""
        q = x.getArray(readonly=True)
        changed, whole = self.problem.linearise(q)
        if whole:
            dense = h.getDenseArray()
            dense[:] = self._matrix.getDenseArray(readonly=True)
            self.problem.add_coupling(q, dense)
        if changed:
            self.diagonal.setArray(self.problem.diagonal)
            h.setDiagonal(self.diagonal)
            h.assemble()


class ContactSolver:
    """One TAO for one contact line, used for every load, gap and wear step.

    Not collective. PETSc's objects are freed by ``destroy`` or at the end of a ``with``, otherwise
    with the last reference to the solver, at the latest at the end of the process.

    Parameters
    ----------
    compliance : (n, n) float, mm^3/MPa, symmetric area-weighted compliance.
    area : (n,) float, mm^2.

    Raises
    ------
    InputError : PETSc does not accept an option.
    """

    def __init__(self, compliance: FloatArray, area: FloatArray) -> None:
        self._objects: list[PETSc.Object] = []
        options = PETSc.Options(CONTACT_PREFIX)
        self.tao_type = options.getString("tao_type", "python")
        if self.tao_type not in TAO_TYPES:
            raise InputError(
                f"-{CONTACT_PREFIX}tao_type {self.tao_type}: must be one of {', '.join(TAO_TYPES)}"
            )
        self._area = area
        self._search = ApproachSearch(compliance, area)
        try:
            self._make(compliance, len(area))
        except BaseException:
            self.destroy()
            raise

    def _make(self, compliance: FloatArray, n: int) -> None:
        """Make all that is PETSc's, each of it owned before it is there."""
        OPEN[self] = None
        self._x = self._register(PETSc.Vec()).createSeq(n, comm=MPI.COMM_SELF)
        self._problem = ContactProblem(compliance, self._area)
        self._a, self._h = (
            self._register(PETSc.Mat()).createDense(
                (n, n), array=np.zeros((n, n), order="F"), comm=MPI.COMM_SELF
            )
            for _ in "ah"
        )
        self._lower, self._upper, self._g = (self._register(self._x.duplicate()) for _ in "lug")
        self._upper.set(PETSc.INFINITY)
        diagonal, scratch = (self._register(self._x.duplicate()) for _ in "ds")
        self._callbacks = _Callbacks(self._problem, self._a, diagonal, scratch)
        self._newton = ActiveSetNewton() if self.tao_type == "python" else None
        self._tao = self._register(PETSc.TAO()).create(MPI.COMM_SELF)
        self._fill(compliance)
        self._set_up_tao()

    def _register(self, petsc_object: P) -> P:
        self._objects.append(petsc_object)
        return petsc_object

    def _fill(self, compliance: FloatArray) -> None:
        """Set A, and the Hessian to it."""
        scaled = self._problem.scaled(compliance)
        for matrix in (self._a, self._h):
            matrix.getDenseArray()[:] = scaled
            matrix.assemble()
        diagonal = self._callbacks.diagonal
        diagonal.set(1.0)  # to the last bit what it is again after any case without wear
        self._h.setDiagonal(diagonal)
        self._h.assemble()

    def _set_up_tao(self) -> None:
        tao, callbacks = self._tao, self._callbacks
        tao.setOptionsPrefix(CONTACT_PREFIX)
        tao.setType(self.tao_type)
        if self._newton is not None:
            tao.setPythonContext(self._newton)
        else:
            # inexact inner solves would stop the outer ones above KKT_TOLERANCE
            ksp = tao.getKSP()
            if self.tao_type == "bnls":
                ksp.setType("preonly")
                ksp.getPC().setType("cholesky")
            else:
                ksp.setType("stcg")
                ksp.getPC().setType("jacobi")
                ksp.setTolerances(rtol=1e-10)
        guarded = callbacks.guard.guarded
        tao.setObjective(guarded(callbacks.objective))
        tao.setGradient(guarded(callbacks.gradient), self._g)
        tao.setObjectiveGradient(guarded(callbacks.objective_gradient), self._g)
        tao.setHessian(guarded(callbacks.hessian), self._h, self._h)
        tao.setVariableBounds((self._lower, self._upper))
        tao.setSolution(self._x)
        set_from_options(tao, CONTACT_PREFIX)

    def solve(
        self,
        gap: FloatArray,
        *,
        force: float | None = None,
        approach: float | None = None,
        wear: WearIncrement | None = None,
    ) -> ContactState:
        """Solve at a given force (N) or a given approach (mm).

        Parameters
        ----------
        gap : (n,) float, mm, of the undeformed profiles at the start of the step.
        force, approach : one of them.
        wear : wear of an implicit step.

        Raises
        ------
        ComputationError : TAO failed, the KKT residual or the force balance is too large.
        LawError : a user's wear law failed.
        """
        search = self._search
        if approach is not None:
            trial = self._solve_at(gap, approach, wear)
            search.last = gap, approach, trial.force
        elif force == 0.0:  # the bodies just touch
            approach = float(gap.min())
            trial = self._solve_at(gap, approach, None)
            search.last = gap, approach, 0.0
        elif force is not None:
            approach, trial = search.find(
                gap, force, lambda gap, approach: self._solve_at(gap, approach, wear), self._tangent
            )
        else:
            raise ValueError("force or approach must be given")
        # the gradient is the gap of the deformed, worn profiles, weighted
        opening = self._g.getArray(readonly=True) / self._problem.weights
        p, carried, iterations, residual = trial
        return ContactState(p, opening, approach, carried, iterations, residual)

    def _solve_at(self, gap: FloatArray, approach: float, wear: WearIncrement | None) -> Trial:
        """Return the contact at a given approach."""
        problem, tao = self._problem, self._tao
        problem.pose(gap, approach, wear)
        if problem.apart:
            self._x.set(0.0)
            self._g.setArray(problem.gradient_apart())
            return Trial(np.zeros_like(gap), 0.0, 0, 0.0)
        tao.setTolerances(gatol=problem.tolerance(gap, approach), grtol=0.0, gttol=0.0)
        self._callbacks.guard.solve(self._tao, self.tao_type)
        reason, iterations = tao.getConvergedReason(), tao.getIterationNumber()
        q = self._x.getArray(readonly=True)
        if self._newton is None:  # that one leaves the gradient at its solution
            self._callbacks.gradient(tao, self._x, self._g)
        worst, largest = problem.defect(q, self._g.getArray(readonly=True))
        p = q / problem.scale
        residual = worst / largest if largest > 0.0 else np.inf
        if reason <= 0 or not residual <= KKT_TOLERANCE:
            raise ComputationError(
                f"contact: TAO {self.tao_type} ended with reason {_reason_name(reason)} after "
                f"{iterations} iterations at approach {approach:.9g} mm with KKT residual "
                f"{residual:.2e} (allowed {KKT_TOLERANCE:.0e})"
            )
        return Trial(p, float(self._area @ p), iterations, residual)

    def _tangent(self) -> FloatArray | None:
        """Return the derivative of the pressure with respect to the approach, if it is known."""
        if self._newton is None:
            return None
        response = self._newton.response(self._problem.weights)
        return None if response is None else response / self._problem.scale

    def destroy(self) -> None:
        """Free the PETSc objects, if they are not yet."""
        OPEN.pop(self, None)
        while self._objects:
            self._objects.pop().destroy()

    def __del__(self) -> None:
        self.destroy()

    def __enter__(self) -> "ContactSolver":
        return self

    def __exit__(self, *_: object) -> None:
        self.destroy()


def _reason_name(reason: int) -> str:
    names = {v: k for k, v in vars(PETSc.TAO.Reason).items() if isinstance(v, int)}
    return f"{names.get(reason, 'unknown')} ({reason})"
