"""Unilateral contact, eq. (3) of the paper, as a bound-constrained problem solved by PETSc TAO.

With K the area-weighted compliance of the contact line, m the element areas and g the gap of the
undeformed, worn profiles, the pressure minimises

    1/2 p.K p + Sum m_e [(g_e - delta) p_e + Int_0^p_e depth],    p >= 0,

where ``depth`` is the wear of an implicit step (absent otherwise). The approach delta is given
(displacement control), or found so that m.p is the force: m.p grows with delta and is piecewise
linear for the threshold law, so Newton steps end.

The unknowns are scaled so that K has a unit diagonal.
"""

import math
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from ringwear_par.arrays import FloatArray
from ringwear_par.contact.newton import ActiveSetNewton
from ringwear_par.elasticity.solve import set_from_options
from ringwear_par.errors import ComputationError, InputError
from ringwear_par.wear.increment import WearIncrement

PREFIX = "contact_"
#: TAO types on offer; each gives the same answer
TAO_TYPES = ("python", "tron", "bnls")
#: up to this size every rank solves the whole problem by itself. On 2 ranks that took 0.12 s for
#: 200 steps of 400 elements against 0.31 s shared by tron, and 0.35 s against 4.2 s for 800 (see
#: scripts/benchmark.py): what limits it is the n^2 of memory a rank, not time
REPLICATED_LIMIT = 2000
#: largest relative KKT residual of an accepted solution
KKT_TOLERANCE = 1e-9
#: relative force balance at which the search for the approach ends, and that it may not exceed
FORCE_TOLERANCE = 1e-12
FORCE_LIMIT = 1e-10
_MAX_APPROACHES = 60


@dataclass(frozen=True)
class ContactState:
    """Solution of one contact problem.

    Parameters
    ----------
    pressure : (n,) float, MPa.
    gap : (n,) float, mm, between the deformed profiles.
    approach : mm.
    force : N.
    iterations : of TAO, all its solves together.
    residual : natural KKT residual, relative to the largest pressure (scaled unknowns).
    """

    pressure: FloatArray
    gap: FloatArray
    approach: float
    force: float
    iterations: int
    residual: float


@dataclass(frozen=True)
class WarmStart:
    """Where the next solve starts; with it, a restarted run repeats an uninterrupted one exactly.

    Parameters
    ----------
    scaled_pressure : (n,) float.
    rate : (n,) float, MPa/mm, derivative of pressure with respect to approach.
    gap : (n,) float, mm, of the last problem.
    approach : mm, of the last problem.
    force : N, of the last problem.
    """

    scaled_pressure: FloatArray
    rate: FloatArray
    gap: FloatArray
    approach: float
    force: float


def _reason_name(reason: int) -> str:
    names = {v: k for k, v in vars(PETSc.TAO.Reason).items() if isinstance(v, int)}
    return f"{names.get(reason, 'unknown')} ({reason})"


def _defect(q: FloatArray, gradient: FloatArray, diagonal: FloatArray) -> float:
    """Return the natural KKT residual; infinity where it is not a number."""
    worst = float(np.abs(np.minimum(q, gradient / diagonal)).max(initial=0.0))
    return worst if math.isfinite(worst) else math.inf


class ContactSolver:
    """One TAO for one contact line, used for every load, gap and wear step.

    Collective on comm, like every method. Small problems (or type "python") are solved by each
    rank on its own, without communication; larger ones are shared out by rows.

    Parameters
    ----------
    stiffness : (n, n) float, mm^3/MPa, symmetric area-weighted compliance, on every rank.
    area : (n,) float, mm^2.
    comm : communicator.
    replicated_limit : largest n that every rank solves by itself.
    """

    def __init__(
        self,
        stiffness: FloatArray,
        area: FloatArray,
        comm: MPI.Comm,
        replicated_limit: int = REPLICATED_LIMIT,
    ) -> None:
        n = len(area)
        small = comm.size == 1 or n <= replicated_limit
        options = PETSc.Options(PREFIX)
        tao_type = options.getString("tao_type", "python" if small else "tron")
        if tao_type not in TAO_TYPES:
            raise InputError(f"-{PREFIX}tao_type {tao_type}: must be one of {', '.join(TAO_TYPES)}")
        self.distributed = not small and tao_type != "python"
        self._comm = comm if self.distributed else MPI.COMM_SELF
        self.comm, self._area = comm, area
        self._x = PETSc.Vec().createMPI(n, comm=self._comm)
        self._here = slice(*self._x.getOwnershipRange())
        rows = (self._here.stop - self._here.start, n)
        sizes = ((rows[0], n), (rows[0], n))
        self._a, self._h = (
            PETSc.Mat().createDense(sizes, array=np.zeros(rows, order="F"), comm=self._comm)
            for _ in "ah"
        )
        self._diagonal = self._x.duplicate()
        self._lower, self._upper = self._x.duplicate(), self._x.duplicate()
        self._upper.set(PETSc.INFINITY)
        self._g, self._scratch = self._x.duplicate(), self._x.duplicate()
        self._scale = np.ones(n)
        self.set_compliance(stiffness)
        self._tao = self._make_tao(tao_type)
        self.tao_type = tao_type

        # the problem that the callbacks see, this rank's part
        self._linear = np.zeros(rows[0])
        self._wear: WearIncrement | None = None
        self._empty = True  # whether the last solution is without contact
        # warm start of the search for the approach
        self._first_rate = np.full(n, float(area.sum() / stiffness.sum()))
        self._rate = self._first_rate  # d pressure / d approach
        self._last: tuple[FloatArray, float, float] | None = None  # gap, approach, force

    def set_compliance(self, stiffness: FloatArray) -> None:
        """Take another stiffness of the same contact line; the warm start stays. Collective.

        Parameters
        ----------
        stiffness : (n, n) float, mm^3/MPa, symmetric area-weighted compliance, on every rank.
        """
        here, before = self._here, self._scale
        self._scale = np.sqrt(np.diag(stiffness))
        scaled = stiffness[here] / (self._scale[here, None] * self._scale)
        for matrix in (self._a, self._h):
            matrix.getDenseArray()[:] = scaled
            matrix.assemble()
        self._diagonal.set(1.0)  # to the last bit what it is again after any case without wear
        self._h.setDiagonal(self._diagonal)
        self._h.assemble()
        self._slope = np.zeros(here.stop - here.start)
        self._full = False  # whether the Hessian is more than a changed diagonal
        self._all_weights = self._area / self._scale
        self._weight, self._own_scale = self._all_weights[here], self._scale[here]
        self._slope_weight = self._weight / self._own_scale
        q = self._x.getArray(readonly=True)
        self._x.setArray(q * (self._scale / before)[here])

    def _make_tao(self, tao_type: str) -> PETSc.TAO:
        tao = PETSc.TAO().create(self._comm)
        self._newton: ActiveSetNewton | None = None
        tao.setOptionsPrefix(PREFIX)
        tao.setType(tao_type)
        if tao_type == "python":
            self._newton = ActiveSetNewton()
            tao.setPythonContext(self._newton)
        else:
            # inexact inner solves would stop the outer ones above KKT_TOLERANCE
            ksp = tao.getKSP()
            one_rank = self._comm.size == 1
            if tao_type == "bnls" and one_rank:
                ksp.setType("preonly")
                ksp.getPC().setType("cholesky")
            else:
                ksp.setType("stcg")
                ksp.getPC().setType("jacobi")
                ksp.setTolerances(rtol=1e-10)
        tao.setObjective(self._objective)
        tao.setGradient(self._gradient, self._g)
        tao.setObjectiveGradient(self._objective_gradient, self._g)
        tao.setHessian(self._hessian, self._h, self._h)
        tao.setVariableBounds((self._lower, self._upper))
        tao.setSolution(self._x)
        set_from_options(tao, PREFIX)
        return tao

    def _objective(self, tao: PETSc.TAO, x: PETSc.Vec) -> float:
        return self._objective_gradient(tao, x, self._scratch)

    def _gradient(self, tao: PETSc.TAO, x: PETSc.Vec, g: PETSc.Vec) -> None:
        self._a.mult(x, g)
        gradient = g.getArray()
        gradient += self._linear
        if self._wear is not None:
            p = x.getArray(readonly=True) / self._own_scale
            gradient += self._weight * self._wear.depth(p)

    def _objective_gradient(self, tao: PETSc.TAO, x: PETSc.Vec, g: PETSc.Vec) -> float:
        self._a.mult(x, g)
        q, linear = x.getArray(readonly=True), self._linear
        value = q @ (0.5 * g.getArray(readonly=True) + linear)
        if self._wear is not None:
            p = q / self._own_scale
            value += self._area[self._here] @ self._wear.potential(p)
            linear = linear + self._weight * self._wear.depth(p)
        g.setArray(g.getArray(readonly=True) + linear)
        return float(self._comm.allreduce(value) if self.distributed else value)

    def _slope_at(self, q: FloatArray) -> FloatArray:
        """Return what wear adds to the Hessian's diagonal."""
        if self._wear is None:
            return np.zeros_like(self._slope)
        return self._wear.slope(q / self._own_scale) * self._slope_weight

    def _hessian(self, tao: PETSc.TAO, x: PETSc.Vec, h: PETSc.Mat, _: PETSc.Mat) -> None:
        q = x.getArray(readonly=True)
        slope = self._slope_at(q)
        full = self._wear is not None and not self._wear.local
        if full or self._full:  # all entries change, or are put back
            dense = h.getDenseArray()
            dense[:] = self._a.getDenseArray(readonly=True)
            if self._wear is not None and full:
                derivative = self._wear.derivative(q / self._own_scale)
                dense += self._all_weights[:, None] * derivative / self._scale
        changed = full or self._full or bool((slope != self._slope).any())
        self._full = full
        if self._comm.allreduce(changed, MPI.LOR) if self.distributed else changed:
            self._slope = slope
            self._diagonal.setArray(1.0 + slope)
            h.setDiagonal(self._diagonal)
            h.assemble()

    def _solve_at(
        self, gap: FloatArray, approach: float, wear: WearIncrement | None
    ) -> tuple[FloatArray, int, float]:
        """Return pressure, TAO iterations and relative KKT residual at a given approach."""
        here = self._here
        self._wear = wear.part(here) if wear is not None and self.distributed else wear
        self._linear = self._weight * (gap[here] - approach)
        self._empty = bool(gap.min() >= approach)  # nothing overlaps
        if self._empty:
            self._x.set(0.0)
            self._g.setArray(self._linear)
            return np.zeros_like(gap), 0, 0.0
        overlap = self._all_weights * np.maximum(approach - gap, 0.0)
        self._tao.setTolerances(gatol=1e-12 * math.sqrt(overlap @ overlap), grtol=0.0, gttol=0.0)
        try:
            self._tao.solve()
        except PETSc.Error as error:
            raise ComputationError(
                f"contact: TAO {self.tao_type} failed (PETSc error {error.ierr})"
            ) from error
        reason, iterations = self._tao.getConvergedReason(), self._tao.getIterationNumber()
        q = self._x.getArray(readonly=True)
        if self.tao_type != "python":  # that one leaves the gradient at its solution
            self._gradient(self._tao, self._x, self._g)
        g = self._g.getArray(readonly=True)
        worst, largest = _defect(q, g, 1.0 + self._slope), float(q.max(initial=0.0))
        if worst > KKT_TOLERANCE * largest:  # at a kink of the law either side's slope will do
            worst = _defect(q, g, 1.0 + np.maximum(self._slope, self._slope_at(q)))
        if self.distributed:
            worst, largest = (self._comm.allreduce(v, MPI.MAX) for v in (worst, largest))
        p = self._gathered(q) / self._scale
        residual = worst / largest if largest > 0.0 else np.inf
        if reason <= 0 or not residual <= KKT_TOLERANCE:
            raise ComputationError(
                f"contact: TAO {self.tao_type} ended with reason {_reason_name(reason)} after "
                f"{iterations} iterations at approach {approach:.9g} mm with KKT residual "
                f"{residual:.2e} (allowed {KKT_TOLERANCE:.0e})"
            )
        return p, iterations, residual

    def _gathered(self, part: FloatArray) -> FloatArray:
        return np.concatenate(self._comm.allgather(part)) if self.distributed else part

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
        """
        if approach is not None:
            p, iterations, residual = self._solve_at(gap, approach, wear)
            self._last = gap, approach, float(self._area @ p)
        elif force == 0.0:  # the bodies just touch
            approach = float(gap.min())
            p, iterations, residual = self._solve_at(gap, approach, None)
            self._last = gap, approach, 0.0
        elif force is not None:
            p, approach, iterations, residual = self._search_approach(gap, force, wear)
        else:
            raise ValueError("force or approach must be given")
        # the gradient is the gap of the deformed, worn profiles, weighted
        opening = self._gathered(self._g.getArray(readonly=True)) / self._all_weights
        return ContactState(p, opening, approach, float(self._area @ p), iterations, residual)

    def _search_approach(
        self, gap: FloatArray, force: float, wear: WearIncrement | None
    ) -> tuple[FloatArray, float, int, float]:
        """Find the approach: Newton steps, or bisection where they do not halve the imbalance.

        The derivative comes from the last factor; without one (TAO's own types) from a secant.

        What is searched for is the approach less the smallest gap: under light loads it is far
        smaller than either.
        """
        nearest = float(gap.min())
        area, rate = self._area, self._rate
        if self._last is None:
            last_gap, last_approach, last_force = gap, float(area @ gap / area.sum()), 0.0
        else:
            last_gap, last_approach, last_force = self._last
        stiffness = float(area @ rate)
        growth = float(rate @ (area * (gap - last_gap)))
        low, high = 0.0, np.inf  # no contact, no force at low
        step = (force - last_force + growth) / stiffness
        approach, gap_above = max(last_approach - nearest + step, low), gap - nearest
        before: tuple[FloatArray, float, float] | None = None
        total = 0
        for _ in range(_MAX_APPROACHES):
            p, iterations, residual = self._solve_at(gap_above, approach, wear)
            total += iterations
            excess = float(area @ p) - force
            if abs(excess) <= FORCE_TOLERANCE * force:
                break
            low, high = (low, approach) if excess > 0.0 else (approach, high)
            slow, tangent = False, self._tangent()
            if tangent is not None:
                rate = tangent
                stiffness = float(area @ rate) or stiffness
            if before is not None:
                p_before, approach_before, excess_before = before
                slow = abs(excess) > 0.5 * abs(excess_before)
                if tangent is None and abs(approach - approach_before) > 1e-9 * abs(approach):
                    rate = (p - p_before) / (approach - approach_before)
                    stiffness = float(area @ rate) or stiffness
            before = p, approach, excess
            following = approach - excess / stiffness
            if high < np.inf:
                if slow or not low < following < high:
                    following = 0.5 * (low + high)
            elif slow:
                following = approach - 2.0 * excess / stiffness
            if following == approach:
                break
            approach = following
        if abs(excess) > FORCE_LIMIT * force:
            raise ComputationError(
                f"contact: the approach was not found: force {force + excess:.9g} N instead of "
                f"{force:.9g} N at approach {approach:.9g} mm after {_MAX_APPROACHES} trials"
            )
        self._rate, self._last = rate, (gap, nearest + approach, force)
        return p, nearest + approach, total, residual

    def _tangent(self) -> FloatArray | None:
        """Return the derivative of the pressure with respect to the approach, if it is known."""
        if self._newton is None:
            return None
        response = self._newton.response(self._all_weights)
        return None if response is None else response / self._scale

    def response(self, gap: FloatArray, force_kept: bool) -> FloatArray:
        """Return what a small growth of the gap does to the pressure of the last solution, MPa.

        Linear, elements in contact staying so, the wear of the step included. Collective.

        Parameters
        ----------
        gap : (n,) float, mm.
        force_kept : whether the approach follows so that the force stays, or stays itself.
        """
        if self._empty:
            return np.zeros_like(gap)
        right = np.stack([self._all_weights * gap, self._all_weights], axis=1)
        x = self._newton.response(right) if self._newton is not None else None
        if x is None:
            free = self._gathered(self._x.getArray(readonly=True)) > 0.0
            hessian = self._gathered(self._h.getDenseArray(readonly=True))
            x = np.zeros_like(right)
            x[free] = np.linalg.solve(hessian[np.ix_(free, free)], right[free])
        by_gap, by_approach = (x / self._scale[:, None]).T
        stiffness = self._area @ by_approach
        if force_kept and stiffness > 0.0:
            return by_approach * (self._area @ by_gap) / stiffness - by_gap
        return -by_gap

    def cold_start(self) -> None:
        """Start the next solve as a new solver would. Not collective."""
        self._x.set(0.0)
        self._rate, self._last = self._first_rate, None

    def warm(self) -> WarmStart:
        """Return where the next solve would start. Collective on comm."""
        q = self._x.getArray(readonly=True)
        q = self._gathered(q.copy())
        gap, approach, force = self._last or (np.zeros_like(q), 0.0, 0.0)
        return WarmStart(q, self._rate, gap, approach, force)

    def warm_start(self, warm: WarmStart) -> None:
        """Start the next solve where another one ended. Not collective."""
        self._x.setArray(warm.scaled_pressure[self._here])
        self._rate, self._last = warm.rate, (warm.gap, warm.approach, warm.force)

    def destroy(self) -> None:
        """Free the PETSc objects. Collective on comm."""
        for item in (
            self._tao, self._a, self._h, self._x, self._g, self._scratch, self._lower, self._upper,
            self._diagonal,
        ):  # fmt: skip
            item.destroy()

    def __enter__(self) -> "ContactSolver":
        return self

    def __exit__(self, *_: object) -> None:
        self.destroy()
