"""PETSc TAO around the contact problem: at a given force, or at a given approach.

The problem is in ``problem``, the search for the approach in ``approach``; here are the PETSc
objects, their distribution over ranks, and their life.
"""

from collections.abc import Callable
from typing import TypeVar

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import FloatArray
from ringwear_par.contact.approach import ApproachSearch, Trial
from ringwear_par.contact.newton import ActiveSetNewton
from ringwear_par.contact.problem import (
    KKT_TOLERANCE,
    REPLICATED_LIMIT,
    ContactProblem,
    ContactState,
)
from ringwear_par.contact.tao import OPEN, Guard
from ringwear_par.errors import ComputationError, InputError, RingwearError
from ringwear_par.options import CONTACT_PREFIX, set_from_options
from ringwear_par.petsc import PETSc
from ringwear_par.wear.increment import WearIncrement

#: TAO types on offer; each gives the same answer
TAO_TYPES = ("python", "tron", "bnls")

T = TypeVar("T")
P = TypeVar("P", bound=PETSc.Object)


class _Callbacks:
    """What TAO calls: products with the matrix, all else by the problem.

    Knows neither the TAO nor the solver, so that both are freed with the last reference to them.

    Parameters
    ----------
    problem : the own rows of the contact problem.
    matrix : the scaled compliance A.
    diagonal, scratch : vectors of the unknowns, the solver's.
    comm : communicator of both.
    """

    def __init__(
        self,
        problem: ContactProblem,
        matrix: PETSc.Mat,
        diagonal: PETSc.Vec,
        scratch: PETSc.Vec,
        comm: MPI.Comm,
    ) -> None:
        self.problem, self._matrix, self._comm = problem, matrix, comm
        self._alone = comm.size == 1
        self.diagonal, self._scratch = diagonal, scratch
        self._failed = np.zeros(1, dtype=np.int32)
        self.guard = Guard(self._alone)

    def _act(self, action: Callable[..., T], *arrays: FloatArray) -> T:
        """Return what an action returns; raise on all ranks what it raises on one."""
        failure: Exception | None = None
        try:
            result = action(*arrays)
        except Exception as error:
            failure = error
        if not self._alone:
            self._failed[0] = failure is not None
            self._comm.Allreduce(MPI.IN_PLACE, self._failed, MPI.MAX)
            if self._failed[0]:
                told = self._comm.allgather(None if failure is None else _told(failure))
                failure = failure or next(error for error in told if error is not None)
        if failure is not None:
            raise failure
        return result

    def objective(self, tao: PETSc.TAO, x: PETSc.Vec) -> float:
        """Return the objective."""
        return self.objective_gradient(tao, x, self._scratch)

    def gradient(self, tao: PETSc.TAO, x: PETSc.Vec, g: PETSc.Vec) -> None:
        """Set g to the gradient."""
        self._matrix.mult(x, g)
        self._act(self.problem.add_gradient, x.getArray(readonly=True), g.getArray())

    def objective_gradient(self, tao: PETSc.TAO, x: PETSc.Vec, g: PETSc.Vec) -> float:
        """Return the objective, set g to the gradient."""
        self._matrix.mult(x, g)
        value, gradient = self._act(
            self.problem.objective, x.getArray(readonly=True), g.getArray(readonly=True)
        )
        g.setArray(gradient)
        return value if self._alone else float(self._comm.allreduce(value))

    def hessian(self, tao: PETSc.TAO, x: PETSc.Vec, h: PETSc.Mat, _: PETSc.Mat) -> None:
        """Set h to the Hessian."""
        q = x.getArray(readonly=True)
        changed, whole = self._act(self.problem.linearise, q)
        if whole:
            dense = h.getDenseArray()
            dense[:] = self._matrix.getDenseArray(readonly=True)
            self._act(self.problem.add_coupling, q, dense)
        if changed if self._alone else self._comm.allreduce(changed, MPI.LOR):
            self.diagonal.setArray(self.problem.diagonal)
            h.setDiagonal(self.diagonal)
            h.assemble()


def _told(error: Exception) -> Exception:
    """Return an error as the other ranks are told of it."""
    if isinstance(error, RingwearError):
        return error
    return ComputationError(f"{type(error).__name__}: {error}")


class ContactSolver:
    """One TAO for one contact line, used for every load, gap and wear step.

    Collective on comm, like every method. Small problems (or type "python") are solved by each
    rank on its own, without communication; larger ones are shared out by rows.

    PETSc's objects are freed by ``destroy`` or at the end of a ``with``, otherwise with the last
    reference to the solver, at the latest at the end of the process.

    Parameters
    ----------
    compliance : (n, n) float, mm^3/MPa, symmetric area-weighted compliance, on every rank.
    area : (n,) float, mm^2.
    comm : communicator.
    replicated_limit : largest n that every rank solves by itself.

    Raises
    ------
    InputError : PETSc does not accept an option.
    """

    def __init__(
        self,
        compliance: FloatArray,
        area: FloatArray,
        comm: MPI.Comm,
        replicated_limit: int = REPLICATED_LIMIT,
    ) -> None:
        self._owned: list[PETSc.Object] = []
        self.distributed = False
        n = len(area)
        small = comm.size == 1 or n <= replicated_limit
        options = PETSc.Options(CONTACT_PREFIX)
        self.tao_type = options.getString("tao_type", "python" if small else "tron")
        if self.tao_type not in TAO_TYPES:
            raise InputError(
                f"-{CONTACT_PREFIX}tao_type {self.tao_type}: must be one of {', '.join(TAO_TYPES)}"
            )
        self.distributed = not small and self.tao_type != "python"
        self._comm = comm if self.distributed else MPI.COMM_SELF
        self.comm, self._area = comm, area
        self._search = ApproachSearch(compliance, area)
        try:
            self._make(compliance, n)
        except BaseException:
            self.destroy()
            raise

    def _make(self, compliance: FloatArray, n: int) -> None:
        """Make all that is PETSc's, each of it owned before it is there."""
        OPEN[self] = None
        self._x = self._own(PETSc.Vec()).createMPI(n, comm=self._comm)
        self._here = slice(*self._x.getOwnershipRange())
        self._problem = ContactProblem(
            compliance, self._area, self._here if self.distributed else None
        )
        rows = (self._here.stop - self._here.start, n)
        sizes = ((rows[0], n), (rows[0], n))
        self._a, self._h = (
            self._own(PETSc.Mat()).createDense(
                sizes, array=np.zeros(rows, order="F"), comm=self._comm
            )
            for _ in "ah"
        )
        self._lower, self._upper, self._g = (self._own(self._x.duplicate()) for _ in "lug")
        self._upper.set(PETSc.INFINITY)
        diagonal, scratch = (self._own(self._x.duplicate()) for _ in "ds")
        self._callbacks = _Callbacks(self._problem, self._a, diagonal, scratch, self._comm)
        self._newton = ActiveSetNewton() if self.tao_type == "python" else None
        self._tao = self._own(PETSc.TAO()).create(self._comm)
        self._fill(compliance)
        self._set_up_tao()

    def _own(self, made: P) -> P:
        self._owned.append(made)
        return made

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
            if self.tao_type == "bnls" and self._comm.size == 1:
                ksp.setType("preonly")
                ksp.getPC().setType("cholesky")
            else:
                ksp.setType("stcg")
                ksp.getPC().setType("jacobi")
                ksp.setTolerances(rtol=1e-10)
        kept = callbacks.guard.kept
        tao.setObjective(kept(callbacks.objective))
        tao.setGradient(kept(callbacks.gradient), self._g)
        tao.setObjectiveGradient(kept(callbacks.objective_gradient), self._g)
        tao.setHessian(kept(callbacks.hessian), self._h, self._h)
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
        """Solve at a given force (N) or a given approach (mm). Collective on comm.

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
        opening = self._gathered(self._g.getArray(readonly=True)) / self._problem.weights
        p, carried, iterations, residual = trial
        return ContactState(p, opening, approach, carried, iterations, residual)

    def _solve_at(self, gap: FloatArray, approach: float, wear: WearIncrement | None) -> Trial:
        """Return the contact at a given approach."""
        problem, tao = self._problem, self._tao
        problem.pose(gap, approach, wear)
        if self._newton is not None:
            self._newton.bend = problem.on_curve if problem.bends else None
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
        if self.distributed:
            worst, largest = (self._comm.allreduce(v, MPI.MAX) for v in (worst, largest))
        p = self._gathered(q) / problem.scale
        residual = worst / largest if largest > 0.0 else np.inf
        if reason <= 0 or not residual <= KKT_TOLERANCE:
            raise ComputationError(
                f"contact: TAO {self.tao_type} ended with reason {_reason_name(reason)} after "
                f"{iterations} iterations at approach {approach:.9g} mm with KKT residual "
                f"{residual:.2e} (allowed {KKT_TOLERANCE:.0e})"
            )
        return Trial(p, float(self._area @ p), iterations, residual)

    def _gathered(self, part: FloatArray) -> FloatArray:
        return np.concatenate(self._comm.allgather(part)) if self.distributed else part

    def _tangent(self) -> FloatArray | None:
        """Return the derivative of the pressure with respect to the approach, if it is known."""
        if self._newton is None:
            return None
        response = self._newton.response(self._problem.weights)
        return None if response is None else response / self._problem.scale

    def response(self, gap: FloatArray, force_kept: bool) -> FloatArray:
        """Return what a small growth of the gap does to the pressure of the last solution, MPa.

        Linear, elements in contact staying so, the wear of the step included. Collective.

        Parameters
        ----------
        gap : (n,) float, mm.
        force_kept : whether the approach follows so that the force stays, or stays itself.
        """
        problem = self._problem
        if problem.apart:
            return np.zeros_like(gap)
        right = np.stack([problem.weights * gap, problem.weights], axis=1)
        by_gap, by_approach = (self._solved(right) / problem.scale[:, None]).T
        stiffness = self._area @ by_approach
        if force_kept and stiffness > 0.0:
            return by_approach * (self._area @ by_gap) / stiffness - by_gap
        return -by_gap

    def _solved(self, right: FloatArray) -> FloatArray:
        """Return H^-1 right, (n, k), on the active set of the last solution, else 0."""
        x = self._newton.response(right) if self._newton is not None else None
        return self._solved_anew(right) if x is None else x

    def _solved_anew(self, right: FloatArray) -> FloatArray:
        """Return the same where no factor is kept."""
        free = self._gathered(self._x.getArray(readonly=True)) > 0.0
        hessian = self._gathered(self._h.getDenseArray(readonly=True))
        x = np.zeros_like(right)
        x[free] = np.linalg.solve(hessian[np.ix_(free, free)], right[free])
        return x

    def _border(self) -> FloatArray:
        """Return H^-1 weights, (n,), which does not change as long as the factor does not."""
        weights = self._problem.weights
        x = self._newton.kept_response(weights) if self._newton is not None else None
        return self._solved_anew(weights) if x is None else x

    def _solved_rows(self, right: FloatArray) -> FloatArray:
        """Return the same for right sides (k, n), to round-off."""
        x = self._newton.responses(right) if self._newton is not None else None
        return np.ascontiguousarray(self._solved_anew(right.T).T) if x is None else x

    def tangents(
        self,
        found: ContactState,
        d_gap: FloatArray,
        d_force: FloatArray | None,
        d_approach: FloatArray | None,
        slope: FloatArray | None,
    ) -> tuple[FloatArray, FloatArray]:
        """Return derivatives of the last pressures, (P, n) MPa, and of its approach, (P,) mm.

        On the factor that it ended with. Not collective: not of problems that ranks share.

        Parameters
        ----------
        found : the last solution.
        d_gap : (P, n) mm, what P numbers do to the gap at given pressure, wear included.
        d_force, d_approach : (P,) N or mm, whichever is given.
        slope : derivative of the wear of the step with respect to pressure at the solution, (n,)
            mm/MPa, or (n, n) where it is non-local; None where there is none.
        """
        problem = self._problem
        if problem.apart:
            nearest = d_gap[:, found.gap.argmin()] if d_approach is None else d_approach
            return np.zeros_like(d_gap), nearest
        weights = problem.weights
        by_gap, by_approach = self._solved_rows(weights * d_gap), self._border()
        left = problem.left_out(slope)
        if left is not None:
            by_gap -= self._solved_rows(left(by_gap))
            by_approach = by_approach - self._solved(left(by_approach))
        if d_approach is None:
            d_approach = (d_force + by_gap @ weights) / (weights @ by_approach)
        return (by_approach * d_approach[:, None] - by_gap) / problem.scale, d_approach

    def cold_start(self) -> None:
        """Start the next solve as a new solver would. Not collective."""
        self._x.set(0.0)
        self._search.restart()

    def destroy(self) -> None:
        """Free the PETSc objects, if they are not yet. Collective on comm."""
        OPEN.pop(self, None)
        while self._owned:
            self._owned.pop().destroy()

    def __del__(self) -> None:
        if not self.distributed:  # petsc4py would put its objects aside; shared ones it has to
            self.destroy()

    def __enter__(self) -> "ContactSolver":
        return self

    def __exit__(self, *_: object) -> None:
        self.destroy()


def _reason_name(reason: int) -> str:
    names = {v: k for k, v in vars(PETSc.TAO.Reason).items() if isinstance(v, int)}
    return f"{names.get(reason, 'unknown')} ({reason})"
