"""Minimisers of least squares within bounds: TAO's ``brgn``, and SciPy's as the second opinion."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray
from ringwear_par.contact.tao import Guard
from ringwear_par.identification.definition.parameter_rules import ordered_keys
from ringwear_par.identification.estimation.misfit import Evaluation, Misfit
from ringwear_par.identification.model.histories import HistoryError
from ringwear_par.identification.model.noise import NuisanceProjection
from ringwear_par.identification.model.rounds import WaitFor
from ringwear_par.options import FIT_PREFIX, set_from_options
from ringwear_par.petsc import PETSc

Residuals = Callable[[FloatArray], Evaluation]

#: of the gradient, in units in which one is a standard deviation away from the optimum
_GRADIENT = 1e-5
#: largest gradient of what still counts as an optimum, where a line search sees round-off only
_GOOD_GRADIENT = 1e-2
#: iterations on one scale, and how often the scale is that of the place reached
_ITERATIONS, _SCALES = 8, 10
#: decrease of half the sum of squares that counts as none: 0.01 sd along the valley
_NO_GAIN = 1e-4
#: trials one after another without such a decrease that end the search where readings bend, and
#: what may be between them
_STILL, _NEAR = 4, 1e-2
#: how much larger residuals are where there is no history
_FAR = 1e3
#: relative to the Jacobian: keeps steps finite in directions that nothing is known of
_REGULARISER = 1e-10


@dataclass(frozen=True, eq=False)
class Optimum:
    """Where a minimiser ended."""

    #: (u,) unknowns.
    x: FloatArray
    #: residuals there.
    evaluation: Evaluation
    #: whether the gradient within the bounds vanishes.
    converged: bool
    #: of the minimiser.
    iterations: int
    #: at which it has had histories computed.
    points: int


def minimise(
    misfit: Misfit,
    start: FloatArray,
    wait_for: WaitFor | None = None,
    fixed: int | None = None,
) -> Optimum:
    """Return the least squares near a start (u,), within bounds. Not collective.

    Unknowns without bounds on which residuals depend linearly are at every trial the best for the
    others; one fitted key may be ``fixed``. Histories of trials are forgotten, but for those at the
    optimum; ``wait_for`` has those at a point computed with those of other searches.
    """
    new_points: list[FloatArray] = []

    def evaluate(x: FloatArray) -> Evaluation:
        if not misfit.responses.are_known(x):
            new_points.append(x)
            if wait_for is not None:
                wait_for(x)
        return misfit.evaluate(x)

    free = ~misfit.idle
    if fixed is not None:
        free[fixed] = False
    box = _Box.of(misfit, start, free)
    nonlinear, linear = free & ~misfit.linear, free & misfit.linear
    bent = any(experiment.bends_within for experiment in misfit.problem.experiments)
    x, iterations, still = start, 0, False
    solve = _brgn if misfit.problem.settings.method == "brgn" else _scipy
    for _ in range(_SCALES):
        problem = _Reduced(evaluate, x, box, nonlinear, linear)
        if not nonlinear.any():
            x = problem.whole(problem.start)
            break
        before = problem.residuals(problem.start)
        problem.patience = _STILL if bent else None
        try:
            part, more = solve(problem)
        except _NoProgressError:
            x, still = problem.best, True
            break
        x, iterations = problem.whole(part), iterations + more
        gain = 0.5 * float(before @ before) - evaluate(x).objective
        if more < _ITERATIONS or not gain > _NO_GAIN:
            break
    evaluation = evaluate(x)
    misfit.responses.forget(new_points, x)
    good = still or _gradient(evaluation, x, box, free) <= _GOOD_GRADIENT
    return Optimum(x, evaluation, good, iterations, len(new_points))


@dataclass(frozen=True, eq=False)
class _Box:
    """Coordinates in which all that bounds and rules allow is a box.

    Those of most unknowns are the unknowns; one that is never less than another counts from it.
    """

    #: (u, u), coordinates of the unknowns, and the unknowns of coordinates
    forward: FloatArray
    back: FloatArray
    #: (u,) of the coordinates
    low: FloatArray
    high: FloatArray

    @classmethod
    def of(cls, misfit: Misfit, x: FloatArray, free: BoolArray) -> "_Box":
        """Return the box of a misfit whose unknowns stay at x but for those that are free."""
        forward, low, high = np.eye(len(x)), misfit.lower.copy(), misfit.upper.copy()
        for i, j in ordered_keys(misfit.problem.parameters):
            if free[i] and free[j]:
                forward[i, j] = -1.0
                low[i] = max(misfit.lower[i] - misfit.upper[j], 0.0)
                high[i] = misfit.upper[i] - misfit.lower[j]
            elif free[i]:
                low[i] = max(low[i], x[j])
            elif free[j]:
                high[j] = min(high[j], x[i])
        return cls(forward, np.linalg.inv(forward), low, high)


def _gradient(evaluation: Evaluation, x: FloatArray, box: _Box, free: BoolArray) -> float:
    """Return the norm of the gradient, without what bounds hold, by each coordinate's own sd."""
    jacobian, z = evaluation.jacobian @ box.back, box.forward @ x
    size = np.linalg.norm(jacobian, axis=0)
    slope = jacobian.T @ evaluation.residuals / np.where(size > 0, size, 1.0)
    out = ((z <= box.low) & (slope > 0)) | ((z >= box.high) & (slope < 0)) | ~free
    return float(np.linalg.norm(np.where(out, 0.0, slope)))


class _NoProgressError(Exception):
    """The latest trials brought no decrease that counts."""


class _Reduced:
    """A problem over nonlinear coordinates, in units of their scale where it starts.

    Remembers its last point, as minimisers ask for residuals and Jacobian one after the other. At
    each trial linear unknowns are the best for the others. After ``patience`` trials in vain it
    raises ``_NoProgressError`` (None: never); ``best`` (u,) are the unknowns of the best one since
    then.
    """

    def __init__(
        self,
        evaluate: Residuals,
        x: FloatArray,
        box: _Box,
        nonlinear: BoolArray,
        linear: BoolArray,
    ) -> None:
        self._evaluate, self._box, self._nonlinear, self._linear = evaluate, box, nonlinear, linear
        self._z = box.forward @ x
        self._low, self._high = box.low[nonlinear], box.high[nonlinear]
        self._scale = np.ones(int(nonlinear.sum()))
        self.patience: int | None = None
        self.best, self._least, self._vain = x, np.inf, 0
        self._last: tuple[bytes, FloatArray, FloatArray, FloatArray] | None = None
        start = self._z[nonlinear]
        sizes = np.linalg.norm(self._at(start)[2], axis=0)
        widths = np.where(np.isfinite(self._high - self._low), self._high - self._low, 1.0)
        self._scale = np.where(sizes > 0, 1.0 / np.where(sizes > 0, sizes, 1.0), widths)
        #: where it starts, and the bounds
        self.start, self.low, self.high = (
            value / self._scale for value in (start, self._low, self._high)
        )
        self._last = None
        self._at(self.start)

    def _at(self, y: FloatArray) -> tuple[bytes, FloatArray, FloatArray, FloatArray]:
        """Return residuals, Jacobian and unknowns."""
        if self._last is None or self._last[0] != y.tobytes():
            z = self._z.copy()
            z[self._nonlinear] = np.clip(y * self._scale, self._low, self._high)
            x = self._box.back @ z
            try:
                evaluation = self._evaluate(x)
            except HistoryError:  # a trial too far: a ring worn through, say
                if self._last is None:
                    raise
                far = np.full_like(self._last[1], _FAR * (1.0 + np.abs(self._last[1]).max()))
                self._last = y.tobytes(), far, np.zeros_like(self._last[2]), x
                return self._last
            residuals, jacobian = (
                evaluation.residuals,
                (evaluation.jacobian @ self._box.back)[:, self._nonlinear] * self._scale,
            )
            if self._linear.any():
                projection = NuisanceProjection(evaluation.jacobian[:, self._linear])
                x[self._linear] -= projection.solution(residuals)
                residuals, jacobian = projection.rest(residuals), projection.rest(jacobian)
            self._last = y.tobytes(), residuals, jacobian, x
            self._judge(x, 0.5 * float(residuals @ residuals))
        return self._last

    def _judge(self, x: FloatArray, objective: float) -> None:
        """Count trials near the best one that are in vain: gradients jump where readings bend."""
        if objective < self._least - _NO_GAIN:
            self._vain = 0
        elif objective < self._least + _NEAR:
            self._vain += 1
        if objective < self._least:
            self.best, self._least = x, objective
        if self.patience is not None and self._vain >= self.patience:
            raise _NoProgressError

    def residuals(self, y: FloatArray) -> FloatArray:
        """Return the residuals at the best linear unknowns."""
        return self._at(y)[1]

    def jacobian(self, y: FloatArray) -> FloatArray:
        """Return their derivatives, but for terms that vanish with the residuals."""
        return self._at(y)[2]

    def whole(self, y: FloatArray) -> FloatArray:
        """Return all unknowns."""
        return self._at(y)[3]


def _brgn(problem: _Reduced) -> tuple[FloatArray, int]:
    """Return the optimum of TAO's regularised Gauss-Newton method, and its iterations."""
    y = problem.start
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
    low.setArray(np.maximum(problem.low, PETSc.NINFINITY))
    high.setArray(np.minimum(problem.high, PETSc.INFINITY))
    tao = PETSc.TAO().create(PETSc.COMM_SELF)
    try:
        tao.setOptionsPrefix(FIT_PREFIX)
        tao.setType("brgn")
        tao.setResidual(guard.guarded(residuals), f)
        tao.setJacobianResidual(guard.guarded(jacobian), matrix, matrix)
        tao.setBRGNRegularizerWeight(_REGULARISER)
        tao.setVariableBounds((low, high))
        tao.setTolerances(gatol=_GRADIENT, grtol=0.0, gttol=0.0)
        tao.setMaximumIterations(_ITERATIONS)
        tao.setSolution(x)
        set_from_options(tao, FIT_PREFIX)
        guard.solve(tao, "brgn")
        return x.getArray(readonly=True).copy(), tao.getIterationNumber()
    finally:
        for petsc_object in (tao, matrix, f, x, low, high):
            petsc_object.destroy()


def _scipy(problem: _Reduced) -> tuple[FloatArray, int]:
    """Return the optimum of SciPy's trust region method, and its evaluations."""
    from scipy.optimize import least_squares

    inside = np.clip(problem.start, problem.low, problem.high)
    outcome = least_squares(
        problem.residuals, inside, problem.jacobian, (problem.low, problem.high), x_scale="jac",
        xtol=1e-10, ftol=1e-12, gtol=_GRADIENT, max_nfev=_ITERATIONS,
    )  # fmt: skip
    return outcome.x, outcome.nfev
