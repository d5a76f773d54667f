"""Minimisers of least squares within bounds: TAO's ``brgn``, and SciPy's as the second opinion."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray
from ringwear_par.contact.tao import Guard
from ringwear_par.identification.least_squares import Evaluation
from ringwear_par.identification.problem import Method
from ringwear_par.options import FIT_PREFIX, set_from_options
from ringwear_par.petsc import PETSc

Residuals = Callable[[FloatArray], Evaluation]

#: of the gradient, in units in which one is a standard deviation away from the optimum
_GRADIENT = 1e-5
#: largest gradient of what still counts as an optimum, where a line search sees round-off only
_GOOD_GRADIENT = 1e-2
#: iterations on one scale, and how often the scale is that of the place reached
_ITERATIONS, _SCALES = 8, 10
#: relative decrease of the sum of squares that is none
_NO_GAIN = 1e-9
#: relative to the Jacobian: keeps steps finite in directions that nothing is known of
_REGULARISER = 1e-10


@dataclass(frozen=True, eq=False)
class Optimum:
    """Where a minimiser ended.

    Parameters
    ----------
    x : (u,) unknowns.
    evaluation : residuals there.
    converged : whether the gradient within the bounds vanishes.
    iterations : of the minimiser.
    """

    x: FloatArray
    evaluation: Evaluation
    converged: bool
    iterations: int


def minimise(
    evaluate: Residuals,
    start: FloatArray,
    bounds: tuple[FloatArray, FloatArray],
    method: Method,
    held: BoolArray | None = None,
) -> Optimum:
    """Return the least squares near a start, within bounds. Not collective.

    Parameters
    ----------
    evaluate : residuals and Jacobian at unknowns (u,).
    start : (u,) within the bounds.
    held : (u,) bool, unknowns that stay where they are.

    Raises
    ------
    ComputationError : of ``evaluate``.
    """
    free = np.ones(len(start), dtype=bool) if held is None else ~held
    lower, upper = (bound[free] for bound in bounds)
    if not free.any():
        return Optimum(start, evaluate(start), True, 0)

    def whole(part: FloatArray) -> FloatArray:
        x = start.copy()
        x[free] = part
        return x

    widths = np.where(np.isfinite(upper - lower), upper - lower, 1.0)
    solve = _brgn if method == "brgn" else _scipy
    x, iterations = start, 0
    for _ in range(_SCALES):
        found = evaluate(x)
        sizes = np.linalg.norm(found.jacobian[:, free], axis=0)
        scale = np.where(sizes > 0, 1.0 / np.where(sizes > 0, sizes, 1.0), widths)
        problem = _Scaled(lambda part: evaluate(whole(part)), scale, lower, upper, free)
        part, more = solve(problem, x[free])
        before, x = found, whole(np.clip(part, lower, upper))
        found, iterations = evaluate(x), iterations + more
        gain = before.objective - found.objective
        if more < _ITERATIONS or not gain > _NO_GAIN * (1.0 + found.objective):
            break
    return Optimum(x, found, problem.gradient(x[free], found) <= _GOOD_GRADIENT, iterations)


class _Scaled:
    """A problem over free unknowns divided by their scale, which remembers its last point."""

    def __init__(
        self,
        evaluate: Residuals,
        scale: FloatArray,
        lower: FloatArray,
        upper: FloatArray,
        free: BoolArray,
    ) -> None:
        self._evaluate, self.scale, self._free = evaluate, scale, free
        self.lower, self.upper = lower, upper
        self._last: tuple[bytes, FloatArray, FloatArray] = b"", np.empty(0), np.empty((0, 0))

    def _at(self, y: FloatArray) -> tuple[bytes, FloatArray, FloatArray]:
        if self._last[0] != y.tobytes():
            found = self._evaluate(np.clip(y * self.scale, self.lower, self.upper))
            jacobian = found.jacobian[:, self._free] * self.scale
            self._last = y.tobytes(), found.residuals, jacobian
        return self._last

    def residuals(self, y: FloatArray) -> FloatArray:
        """Return the residuals."""
        return self._at(y)[1]

    def jacobian(self, y: FloatArray) -> FloatArray:
        """Return their derivatives with respect to scaled unknowns."""
        return self._at(y)[2]

    def gradient(self, part: FloatArray, found: Evaluation) -> float:
        """Return the norm of the gradient, without what bounds hold, by each unknown's own sd."""
        jacobian = found.jacobian[:, self._free]
        size = np.linalg.norm(jacobian, axis=0)
        slope = jacobian.T @ found.residuals / np.where(size > 0, size, 1.0)
        out = ((part <= self.lower) & (slope > 0)) | ((part >= self.upper) & (slope < 0))
        return float(np.linalg.norm(np.where(out, 0.0, slope)))


def _brgn(problem: _Scaled, start: FloatArray) -> tuple[FloatArray, int]:
    """Return the optimum of TAO's regularised Gauss-Newton method, and its iterations."""
    scale = problem.scale
    y = start / scale
    guard = Guard()

    def residuals(_: PETSc.TAO, at: PETSc.Vec, f: PETSc.Vec) -> None:
        f.setArray(problem.residuals(at.getArray(readonly=True).copy()))

    def jacobian(_: PETSc.TAO, at: PETSc.Vec, j: PETSc.Mat, __: PETSc.Mat) -> None:
        j.getDenseArray()[:] = problem.jacobian(at.getArray(readonly=True).copy())
        j.assemble()

    count = len(problem.residuals(y))
    x, f = PETSc.Vec().createSeq(len(y)), PETSc.Vec().createSeq(count)
    matrix = PETSc.Mat().createDense((count, len(y)), comm=PETSc.COMM_SELF)
    matrix.setUp()
    low, high = x.duplicate(), x.duplicate()
    x.setArray(y)
    low.setArray(np.maximum(problem.lower / scale, PETSc.NINFINITY))
    high.setArray(np.minimum(problem.upper / scale, PETSc.INFINITY))
    tao = PETSc.TAO().create(PETSc.COMM_SELF)
    try:
        tao.setOptionsPrefix(FIT_PREFIX)
        tao.setType("brgn")
        tao.setResidual(guard.kept(residuals), f)
        tao.setJacobianResidual(guard.kept(jacobian), matrix, matrix)
        tao.setBRGNRegularizerWeight(_REGULARISER)
        tao.setVariableBounds((low, high))
        tao.setTolerances(gatol=_GRADIENT, grtol=0.0, gttol=0.0)
        tao.setMaximumIterations(_ITERATIONS)
        tao.setSolution(x)
        set_from_options(tao, FIT_PREFIX)
        guard.solve(tao, "brgn")
        return x.getArray(readonly=True) * scale, tao.getIterationNumber()
    finally:
        for each in (tao, matrix, f, x, low, high):
            each.destroy()


def _scipy(problem: _Scaled, start: FloatArray) -> tuple[FloatArray, int]:
    """Return the optimum of SciPy's trust region method, and its evaluations."""
    from scipy.optimize import least_squares

    scale = problem.scale
    low, high = problem.lower / scale, problem.upper / scale
    inside = np.clip(start / scale, low, high)
    found = least_squares(
        problem.residuals, inside, problem.jacobian, (low, high), x_scale="jac", xtol=1e-10,
        ftol=1e-12, gtol=_GRADIENT, max_nfev=_ITERATIONS,
    )  # fmt: skip
    return found.x * scale, found.nfev
