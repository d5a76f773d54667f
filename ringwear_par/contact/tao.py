"""The contact of one history by PETSc's TAO, on any number of ranks.

A mixed complementarity problem, solved by a semismooth method (``asils``): pressures p >= 0 with
gaps >= 0, and an approach without bounds with the balance of force, or with its given value. The
compliance is a dense matrix whose rows are shared out among the ranks.
"""

from typing import Any

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import BoolArray, FloatArray
from ringwear_par.batched import take
from ringwear_par.contact.problem import Compliance, Contact
from ringwear_par.options import CONTACT_PREFIX, set_from_options
from ringwear_par.petsc import PETSc
from ringwear_par.wear.step import StepWear

#: iterations, residual that TAO is asked for, and natural residual of a solution
_MOST, _ASKED, _ALLOWED = 100, 1e-12, 1e-8
#: largest systems that one rank factors; others take GMRES
_LARGEST_FACTORED = 1024


class TaoContact:
    """The contacts of histories, one after another. Collective on comm.

    Unknowns and equations are scaled so that compliance and wear have a unit diagonal.

    Parameters
    ----------
    by_force : whether loads are forces, N; else approaches, mm.
    allowed : natural residual of a solution, relative to the largest unknown.
    """

    def __init__(
        self,
        compliance: Compliance,
        by_force: bool,
        comm: MPI.Comm = MPI.COMM_SELF,
        allowed: float = _ALLOWED,
    ) -> None:
        self.compliance, self.by_force, self.comm, self._allowed = (
            compliance, by_force, comm, allowed,
        )  # fmt: skip
        n = len(compliance.line.r)
        base = PETSc.Mat().createDense((n + 1, n + 1), comm=comm)
        base.setUp()
        jacobian, tao = base.duplicate(), PETSc.TAO().create(comm)
        x, f, low, high = (base.createVecRight() for _ in range(4))
        start, end = base.getOwnershipRange()
        #: rows of this rank, those of them that are elements, and how many each rank has
        self._rows, self._counts = np.arange(start, end), comm.allgather(end - start)
        self._own = self._rows[self._rows < n]
        low.setArray(np.where(self._rows < n, 0.0, PETSc.NINFINITY))
        high.set(PETSc.INFINITY)
        tao.setOptionsPrefix(CONTACT_PREFIX)
        tao.setType("asils")
        tao.setConstraints(self._set_residual, f)
        tao.setJacobian(self._set_jacobian, jacobian, jacobian)
        tao.setVariableBounds((low, high))
        tao.setMaximumIterations(_MOST)
        ksp = tao.getKSP()
        if comm.size == 1 and n <= _LARGEST_FACTORED:
            ksp.setType("preonly")
            ksp.getPC().setType("lu")
        else:
            ksp.setType("gmres")
            ksp.getPC().setType("jacobi")
            ksp.setTolerances(rtol=1e-8, max_it=1000)
            ksp.setGMRESRestart(200)
        options = PETSc.Options(CONTACT_PREFIX)
        if not options.hasName("tao_fmin"):  # of the merit function: TAO's own 1e-8 ends too early
            options.setValue("tao_fmin", 1e-30)
        set_from_options(tao, CONTACT_PREFIX)
        self._base, self._jacobian, self._tao, self._ksp = base, jacobian, tao, ksp
        self._x, self._f, self._things = x, f, (tao, base, jacobian, x, f, low, high)

    def __enter__(self) -> "TaoContact":
        return self

    def __exit__(self, *_: object) -> None:
        for thing in self._things:
            thing.destroy()

    def with_compliance(self, compliance: Compliance) -> "TaoContact":
        """Solve contacts of other histories, of as many elements; return the solver."""
        self.compliance = compliance
        return self

    def solve(
        self,
        gap: FloatArray,
        load: FloatArray,
        wear: StepWear | None,
        p: FloatArray,
        d: FloatArray,
        which: BoolArray | None = None,
    ) -> Contact:
        """Return the contacts at gaps (B, n), from pressures and approaches near them.

        Parameters
        ----------
        load : (B,) N or mm.
        which : (B,) those that are solved; the others stay; None: all.
        """
        count = len(gap)
        rows = np.arange(count) if which is None else np.flatnonzero(which)
        p, d = p.copy(), d.copy() if self.by_force else load.copy()
        failed, iterations = np.zeros(count, bool), np.zeros(count, np.int64)
        for row in rows:
            if self.by_force and load[row] <= 0.0:  # the bodies just touch
                p[row], d[row] = 0.0, gap[row].min()
                continue
            self._pose(row, gap[row], float(load[row]), wear)
            for start in (p[row].copy(), np.zeros_like(p[row])):  # again from nothing
                if not np.isfinite(start).all():
                    continue
                p[row], d[row], failed[row] = self._solve(start, float(d[row]))
                iterations[row] += self._tao.getIterationNumber()
                if not failed[row]:
                    break
            else:
                failed[row] = True
        return Contact(p, d, failed, iterations)

    def filtered(self, error: FloatArray, wear: StepWear, p: FloatArray) -> FloatArray:
        """Return what is left of errors of depth (B, n) when pressures have given way to them."""
        left = error.copy()
        for row in np.flatnonzero((p > 0.0).any(axis=1)):
            self._pose(row, error[row], 0.0, wear)
            self._x.setArray(np.append(p[row] / self._to_pressure, 0.0)[self._rows])
            self._set_jacobian(None, self._x, self._jacobian, None)
            # as zeroRows does it, which in PETSc 3.18 sets all diagonals of MPI dense matrices
            apart = np.flatnonzero(p[row, self._own] <= 0.0)
            values = self._jacobian.getDenseArray()
            values[apart] = 0.0
            values[apart, self._own[apart]] = 1.0
            self._jacobian.assemble()
            pressed = np.append(-self._weight * error[row] * (p[row] > 0.0), 0.0)
            self._f.setArray(pressed[self._rows])
            self._ksp.reset()  # TAO's systems are of the elements in contact
            self._ksp.setOperators(self._jacobian)
            self._ksp.solve(self._f, self._x)
            relief = self._gathered(self._x)[:-1] * self._to_pressure
            slope = self._worn(p[row])[1]
            left[row] += slope * relief if slope.ndim == 1 else slope @ relief
        return left

    def _pose(self, row: int, gap: FloatArray, load: float, wear: StepWear | None) -> None:
        """Set the problem, its scales, and this rank's rows of the system without wear."""
        area, e, n = self.compliance.line.area, self._own, len(gap)
        if wear is not None and len(self.compliance.pair) > 1:
            wear = take(wear, np.array([row]))
        self._problem = row, gap, load, wear
        self._mean = np.full(n, load / area.sum() if self.by_force and load > 0.0 else 1.0)
        slope = self._worn(self._mean)[1]
        own = self.compliance.diagonal[row] + (slope if slope.ndim == 1 else np.diagonal(slope))
        self._weight, self._to_pressure = np.sqrt(area / own), 1.0 / np.sqrt(area * own)
        self._of_approach = float(self._weight.mean())
        values = np.zeros((len(self._rows), n + 1))
        values[: len(e), :n] = (
            self._weight[e, None] * self.compliance.matrix(row)[e] * self._to_pressure
        )
        values[: len(e), n] = -self._weight[e] / self._of_approach
        if len(e) < len(self._rows):  # the last row: of the force, or of the approach
            values[-1, :n] = area * self._to_pressure / self._of_approach * self.by_force
            values[-1, n] = not self.by_force
        self._base.getDenseArray()[:] = values
        self._base.assemble()

    def _solve(self, p: FloatArray, d: float) -> tuple[FloatArray, float, bool]:
        """Return pressures and approach of the problem, and whether they are no solution."""
        row, gap, load, _ = self._problem
        if self.by_force and not p.any():
            p, d = self._mean, float(gap.min() + (self.compliance.matrix(row) @ self._mean).mean())
        start = np.append(p / self._to_pressure, (d if self.by_force else load) * self._of_approach)
        self._x.setArray(start[self._rows])
        self._tao.setSolution(self._x)
        asked = _ASKED * float(np.linalg.norm(start)) + 1e-300
        self._tao.setTolerances(gatol=asked, grtol=0.0, gttol=0.0)
        try:
            self._tao.solve()
        except PETSc.Error:  # of a law that gives no numbers
            return p, d, True
        y = self._gathered(self._x)
        self._set_residual(None, self._x, self._f)
        f = self._gathered(self._f)
        miss = max(float(np.abs(np.minimum(y[:-1], f[:-1])).max()), abs(float(f[-1])))
        p, d = np.maximum(y[:-1] * self._to_pressure, 0.0), float(y[-1]) / self._of_approach
        return p, d, not miss <= self._allowed * max(float(np.abs(y).max()), 1e-300)

    def _worn(self, p: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return depths (n,) at pressures, and slopes (n,), or (n, n) of a non-local law."""
        wear = self._problem[3]
        if wear is None:
            return np.zeros_like(p), np.zeros_like(p)
        return wear.of_one(np.maximum(p, 0.0))

    def _set_residual(self, tao: Any, x: Any, f: Any) -> None:
        (_, gap, load, _), e = self._problem, self._own
        depth = self._worn(self._gathered(x)[:-1] * self._to_pressure)[0]
        self._base.mult(x, f)
        values = f.getArray()
        values[: len(e)] += (self._weight * (gap + depth))[e]
        if len(e) < len(self._rows):
            values[-1] -= load / self._of_approach if self.by_force else load * self._of_approach

    def _set_jacobian(self, tao: Any, x: Any, jacobian: Any, preconditioner: Any) -> None:
        e, n = self._own, len(self._weight)
        slope = self._worn(self._gathered(x)[:-1] * self._to_pressure)[1]
        self._base.copy(jacobian)
        values = jacobian.getDenseArray()
        if slope.ndim == 1:
            values[np.arange(len(e)), e] += (self._weight * slope * self._to_pressure)[e]
        else:
            values[: len(e), :n] += self._weight[e, None] * slope[e] * self._to_pressure
        jacobian.assemble()

    def _gathered(self, vector: Any) -> FloatArray:
        """Return a vector on all ranks."""
        values, whole = vector.getArray(readonly=True), np.empty(sum(self._counts))
        self.comm.Allgatherv(values, (whole, self._counts))
        return whole
