"""Contact with the collocated compliance, by a solver of a symmetric one that is near to it.

The symmetric compliance makes contact a minimisation. What it has more than the collocated one, its
excess, is taken from the gap at pressures near the solution, and again at the solution itself until
it no longer matters: deferred correction. The excess is so small that each time leaves a few per
cent of the error, and within a history the pressures of the step before are mostly near enough.
"""

from dataclasses import replace
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray, IntArray, inner
from ringwear_par.contact.problem import ContactState
from ringwear_par.contact.solver import ContactSolver
from ringwear_par.errors import ComputationError, HistoriesError
from ringwear_par.wear.increment import WearIncrement

if TYPE_CHECKING:
    from ringwear_par.contact.batch import BatchSolver

#: errors at which pressures count as those of the collocated equations, relative to themselves or
#: to the mean pressure, whichever is larger: within steps, the next of which corrects what this one
#: left, and where a history or a geometry begins
_NEAR_ENOUGH, _EXACT = 1e-2, 1e-4
#: how often to correct at most: five times did for the worst of 200 random cases
_CORRECTIONS = 10
#: no pressure, MPa
_TINY = 1e-300


class Tangents(Protocol):
    """Derivatives of contact solutions, which a solution tells of each of its corrections."""

    def solved(self, found: ContactState, at: FloatArray, asked: Any = ...) -> None:
        """Differentiate a solution on the factor that its solver has now.

        Parameters
        ----------
        found : the solution.
        at : (..., n) float, MPa, the pressures at which it was corrected.
        asked : (h,) int, of B histories those that were solved.
        """
        ...


class CorrectedContact:
    """The contact of one history. Collective on the solver's communicator.

    Parameters
    ----------
    solver : of the symmetric compliance K.
    area : (n,) float, mm^2, the areas m.
    """

    def __init__(self, solver: ContactSolver, area: FloatArray) -> None:
        self.solver, self._area, self._total = solver, area, float(area.sum())
        #: the largest error that was left, and its element
        self.worst = 0.0, 0

    def response(self, gap: FloatArray, force_kept: bool) -> FloatArray:
        """Return what a small growth (n,) mm of the gap does to the last pressures, MPa."""
        return self.solver.response(gap, force_kept)

    def take_shift(self, d_gap: FloatArray, d_p: FloatArray) -> None:
        """Take what the excess makes of derivatives of pressures, (P, n), from those of the gap."""
        d_gap -= d_p @ self._excess.T

    def products(self, matrices: FloatArray, which: int, p: FloatArray) -> FloatArray:
        """Return the product of one of some transposed matrices (m, n, n) and p (n,)."""
        return p @ matrices[which]

    def deflections(self, d_p: FloatArray) -> FloatArray:
        """Return what (P, n) MPa make of the gap by the symmetric compliance, mm."""
        return (d_p @ self._matrix) / self._area

    def tangents(
        self, found: ContactState, *how: Any, asked: Any = None
    ) -> tuple[FloatArray, FloatArray]:
        """Return derivatives of pressures and approach, see ``ContactSolver.tangents``."""
        return self.solver.tangents(found, *how)

    def take(self, matrix: FloatArray, excess: FloatArray) -> None:
        """Take K, (n, n) mm^3/MPa, which the solver has, and its excess, (n, n) mm/MPa."""
        self._matrix, self._excess = matrix, excess
        self._stiffness = self._area / np.diagonal(matrix)  # MPa/mm, of each element alone
        self._shift_at: tuple[FloatArray, FloatArray] | None = None

    def _shift(self, p: FloatArray) -> FloatArray:
        """Return what the excess makes of pressures, (n,) mm; remembered for the next solution."""
        if self._shift_at is None or self._shift_at[0] is not p:
            self._shift_at = p, self._excess @ p
        return self._shift_at[1]

    def solve(
        self,
        gap: FloatArray,
        near: FloatArray,
        *,
        force: float | None,
        approach: float | None,
        wear: WearIncrement | None,
        exact: bool = False,
        along: Tangents | None = None,
    ) -> ContactState:
        """Solve at a given force (N) or approach (mm), as ``ContactSolver.solve`` does.

        Parameters
        ----------
        near : (n,) float, MPa, pressures near the solution.
        exact : whether to correct until no more than 1e-4 is left.
        along : told of every correction.

        Raises
        ------
        ComputationError : the contact was not solved, or not corrected well enough.
        """
        most = _EXACT if exact else _NEAR_ENOUGH
        shift, iterations = self._shift(near), 0
        for _ in range(1 + _CORRECTIONS):
            found = self.solver.solve(gap - shift, force=force, approach=approach, wear=wear)
            iterations += found.iterations
            if along is not None:
                along.solved(found, near)
                near = found.pressure
            before, shift = shift, self._shift(found.pressure)
            error, e = self._error(found, shift - before, force is not None, most)
            again = not error <= most  # what is no number has not settled
            if self.solver.distributed:  # ranks must not differ by round-off
                again = self.solver.comm.bcast(again)
            if not again:
                break
        else:
            raise ComputationError(_unsettled(error, e, most))
        if error > self.worst[0]:
            self.worst = error, e
        return found if iterations == found.iterations else replace(found, iterations=iterations)

    def _error(
        self, found: ContactState, change: FloatArray, force_kept: bool, most: float
    ) -> tuple[float, int]:
        """Return about how far pressures are off for a change of the shift, (n,) mm, and where.

        Relative to the pressure or to its mean, whichever is larger.
        """
        p, area = found.pressure, self._area
        errors = _alone(change, self._stiffness, p, max(found.force / self._total, _TINY))
        e = int(errors.argmax())
        if errors[e] <= most or self.solver.distributed:
            return float(errors[e]), e
        touching = p > 0.0
        if not touching.any():  # the gap must be that of no pressure
            return np.inf, e
        scale = np.maximum(p, found.force / float(area @ touching))
        errors = np.where(touching, np.abs(self.solver.response(change, force_kept)) / scale, 0.0)
        e = int(errors.argmax())
        return float(errors[e]), e


def _alone(change: FloatArray, stiffness: FloatArray, p: FloatArray, mean: Any) -> FloatArray:
    """Return errors of pressures, each element being alone: in few operations, (..., n).

    Relative to the pressure or to its mean, whichever is larger.
    """
    return np.abs(change) * stiffness / np.maximum(p, mean)


def _unsettled(error: float, element: int, most: float) -> str:
    """Return why a contact that was corrected in vain is none."""
    return (
        f"contact: after {_CORRECTIONS} corrections for the asymmetry of the compliance the "
        f"pressure of element {element} is off by {error:.2g} of itself or of the mean (allowed "
        f"{most:g}); a finer mesh (mesh.contact_elements) or thicker layers are needed"
    )


class CorrectedBatch:
    """The contacts of B histories, each corrected as ``CorrectedContact`` does. Not collective.

    Parameters
    ----------
    solver : of the symmetric compliances.
    excess : (m, n, n) float, mm/MPa, of each compliance.
    which : (B,) int, the compliance of each history.
    stiffness : (m, n) float, MPa/mm, of each element alone.
    """

    def __init__(
        self, solver: "BatchSolver", excess: FloatArray, which: IntArray, stiffness: FloatArray
    ) -> None:
        self.solver, self._excess, self._which = solver, excess, which
        self._transposed = np.ascontiguousarray(excess.transpose(0, 2, 1))
        self._stiffness = stiffness
        count = len(which)
        self._every, self._total = np.arange(count), float(solver.area.sum())
        #: (B,) the largest errors that were left, and their elements
        self.worst = np.zeros(count), np.zeros(count, dtype=np.int64)
        self._shift_at: tuple[FloatArray, FloatArray] | None = None

    def _shift(self, p: FloatArray) -> FloatArray:
        """Return what the excess makes of pressures, (B, n) mm; remembered."""
        if self._shift_at is None or self._shift_at[0] is not p:
            self._shift_at = p, self.solver.products(self._transposed, self._which, p)
        return self._shift_at[1]

    def solve(
        self,
        gap: FloatArray,
        near: FloatArray,
        *,
        force: FloatArray | None,
        approach: FloatArray | None,
        wear: WearIncrement | None,
        exact: bool = False,
        found: tuple[BoolArray, ContactState] | None = None,
        along: Tangents | None = None,
    ) -> ContactState:
        """Solve at given forces (B,) N or approaches (B,) mm, as ``CorrectedContact.solve`` does.

        Parameters
        ----------
        found : which histories have their solution already, and it.

        Raises
        ------
        HistoriesError : some were not solved.
        """
        most = _EXACT if exact else _NEAR_ENOUGH
        asked = self._every if found is None else np.flatnonzero(~found[0])
        shift, iterations = self._shift(near), np.zeros(len(gap), dtype=np.int64)
        if found is not None:
            iterations[found[0]] = found[1].iterations[found[0]]
        residual, errors = np.zeros(len(gap)), np.zeros(len(gap))
        elements = np.zeros(len(gap), dtype=np.int64)
        for _ in range(1 + _CORRECTIONS):
            state = self.solver.solve(
                gap - shift, force=force, approach=approach, wear=wear, histories=asked
            )
            if along is not None:
                along.solved(state, near, asked)
                near = state.pressure
            iterations[asked] += state.iterations[asked]
            residual[asked] = state.residual[asked]
            before, shift = shift, self._shift(state.pressure)
            off, e = self._errors(state, shift - before, force is not None, most)
            errors[asked], elements[asked] = off[asked], e[asked]
            asked = asked[~(off[asked] <= most)]
            if not len(asked):
                break
        else:
            which = np.zeros(len(gap), dtype=bool)
            which[asked] = True
            raise HistoriesError(which)
        if found is not None:
            residual[found[0]] = found[1].residual[found[0]]
        worse = errors > self.worst[0]
        self.worst = (
            np.where(worse, errors, self.worst[0]), np.where(worse, elements, self.worst[1])
        )  # fmt: skip
        return replace(state, iterations=iterations, residual=residual)

    def _errors(
        self, found: ContactState, change: FloatArray, force_kept: bool, most: float
    ) -> tuple[FloatArray, IntArray]:
        """Return about how far pressures are off for changes of the shift, (B, n) mm, and where."""
        p, rows = found.pressure, self._every
        mean = np.maximum(np.divide(found.force, self._total), _TINY)[:, None]
        errors = _alone(change, self._stiffness[self._which], p, mean)
        elements = errors.argmax(axis=1)
        worst = errors[rows, elements]
        if not (worst > most).any():
            return worst, elements
        touching = p > 0.0
        carrying = inner(self.solver.area, touching.astype(float))
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = np.maximum(p, np.divide(found.force, carrying)[:, None])
            response = np.abs(self.solver.response(change, force_kept)) / scale
        errors = np.where(touching, response, 0.0)
        again = errors.argmax(axis=1)
        # where nothing touches the gap must be that of no pressure
        left = np.where(carrying > 0.0, errors[rows, again], np.inf)
        again = np.where(carrying > 0.0, again, elements)
        return np.where(worst > most, left, worst), np.where(worst > most, again, elements)

    def take_shift(self, d_gap: FloatArray, d_p: FloatArray) -> None:
        """Take what the excesses make of derivatives of pressures, (P, B, n), from gaps'."""
        d_gap -= self.solver.products(self._transposed, self._which, d_p)

    def products(self, matrices: FloatArray, which: IntArray, p: FloatArray) -> FloatArray:
        """Return the products of transposed matrices (m, n, n), one a history, and p (B, n)."""
        return self.solver.products(matrices, which, p)

    def deflections(self, d_p: FloatArray) -> FloatArray:
        """Return what (P, B, n) MPa make of the gaps by the symmetric compliances, mm."""
        return self.solver.deflections(d_p)

    def tangents(self, found: ContactState, *how: Any, asked: Any) -> tuple[FloatArray, FloatArray]:
        """Return derivatives of pressures and approaches of the histories asked for."""
        what: tuple[Any, ...] = (*how, asked)
        return self.solver.tangents(found, *what)

    def go_on(self, *before: "CorrectedBatch") -> None:
        """Start where others would, whose histories follow each other here."""
        q, approaches = zip(*(contacts.solver.start for contacts in before), strict=True)
        self.solver.start = np.concatenate(q), np.concatenate(approaches)
        errors, elements = zip(*(contacts.worst for contacts in before), strict=True)
        self.worst = np.concatenate(errors), np.concatenate(elements)

    def take(self, histories: IntArray) -> "CorrectedBatch":
        """Return the contacts of some of the histories."""
        used, which = np.unique(self._which[histories], return_inverse=True)
        taken = CorrectedBatch(
            self.solver.take(histories), self._excess[used], which, self._stiffness[used]
        )
        taken.worst = self.worst[0][histories], self.worst[1][histories]
        return taken

    def response(self, gap: FloatArray, force_kept: bool) -> FloatArray:
        """Return what a small growth (B, n) mm of the gap does to the last pressures, MPa."""
        return self.solver.response(gap, force_kept)
