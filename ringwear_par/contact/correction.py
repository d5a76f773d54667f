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
from ringwear_par.batched import concat
from ringwear_par.contact.problem import ContactInputs, ContactState, WarmStart
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
    """Derivatives of contact solutions, which take part in each correction."""

    def solved(
        self, wear: WearIncrement | None, solution: ContactState, at: FloatArray,
        histories: IntArray,
    ) -> None:  # fmt: skip
        """Differentiate a solution on the factor that its solver has now.

        Parameters
        ----------
        wear : of the implicit step that the contact is of, if any.
        solution : the solution.
        at : (B, n) float, MPa, the pressures at which it was corrected.
        histories : (h,) int, the histories that were solved.
        """
        ...


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


class CorrectedContacts:
    """The contacts of B histories, each corrected by itself. Not collective.

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
        self.largest_errors = np.zeros(count), np.zeros(count, dtype=np.int64)
        self._shift_at: tuple[FloatArray, FloatArray] | None = None
        self._warm: WarmStart | None = None  # once the solver is freed

    def _shift(self, p: FloatArray) -> FloatArray:
        """Return the gap that the excess opens at pressures, (B, n) mm; remembered."""
        if self._shift_at is None or self._shift_at[0] is not p:
            self._shift_at = p, self.solver.products(self._transposed, self._which, p)
        return self._shift_at[1]

    def __enter__(self) -> "CorrectedContacts":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Free the solver; where it would start stays known. Not collective."""
        if self._warm is None:
            self._warm = self.solver.warm
            self.solver.destroy()

    @property
    def warm(self) -> WarmStart:
        """Where the next solutions start, also after ``close``."""
        return self.solver.warm if self._warm is None else self._warm

    @warm.setter
    def warm(self, warm: WarmStart) -> None:
        self.solver.warm = warm

    def solve(
        self,
        inputs: ContactInputs,
        near: FloatArray,
        *,
        exact: bool = False,
        already_solved: tuple[BoolArray, ContactState] | None = None,
        along: Tangents | None = None,
    ) -> ContactState:
        """Return the contacts at given forces or approaches.

        Parameters
        ----------
        inputs : gaps, loads, and the wear of an implicit step.
        near : (B, n) float, MPa, pressures near the solution.
        exact : whether to correct until no more than 1e-4 is left.
        already_solved : which histories have their solution already, and it.
        along : takes every correction.

        Raises
        ------
        ComputationError : one was not solved, or not corrected well enough; HistoriesError of
            several histories.
        """
        gap, wear = inputs.gap, inputs.wear
        most = _EXACT if exact else _NEAR_ENOUGH
        active = self._every if already_solved is None else np.flatnonzero(~already_solved[0])
        shift, iterations = self._shift(near), np.zeros(len(gap), dtype=np.int64)
        if already_solved is not None:
            iterations[already_solved[0]] = already_solved[1].iterations[already_solved[0]]
        residual, errors = np.zeros(len(gap)), np.zeros(len(gap))
        elements = np.zeros(len(gap), dtype=np.int64)
        for _ in range(1 + _CORRECTIONS):
            state = self.solver.solve(
                gap - shift,
                force=inputs.force,
                approach=inputs.approach,
                wear=wear,
                histories=active,
            )
            if along is not None:
                along.solved(wear, state, near, active)
                near = state.pressure
            iterations[active] += state.iterations[active]
            residual[active] = state.residual[active]
            before, shift = shift, self._shift(state.pressure)
            off, e = self._errors(state, shift - before, most)
            errors[active], elements[active] = off[active], e[active]
            active = active[~(off[active] <= most)]
            if not len(active):
                break
        else:
            if len(gap) == 1:
                raise ComputationError(_unsettled(float(off[0]), int(e[0]), most))
            which = np.zeros(len(gap), dtype=bool)
            which[active] = True
            raise HistoriesError(which)
        if already_solved is not None:
            residual[already_solved[0]] = already_solved[1].residual[already_solved[0]]
        worse = errors > self.largest_errors[0]
        before_errors, before_elements = self.largest_errors
        self.largest_errors = (
            np.where(worse, errors, before_errors), np.where(worse, elements, before_elements)
        )  # fmt: skip
        return replace(state, iterations=iterations, residual=residual)

    def _errors(
        self, solution: ContactState, change: FloatArray, most: float
    ) -> tuple[FloatArray, IntArray]:
        """Return about how far pressures are off for changes of the shift, (B, n) mm, and where."""
        p, rows = solution.pressure, self._every
        mean = np.maximum(np.divide(solution.force, self._total), _TINY)[:, None]
        errors = _alone(change, self._stiffness[self._which], p, mean)
        elements = errors.argmax(axis=1)
        worst = errors[rows, elements]
        if not (worst > most).any():
            return worst, elements
        touching = p > 0.0
        carrying = inner(self.solver.area, touching.astype(float))
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = np.maximum(p, np.divide(solution.force, carrying)[:, None])
            response = np.abs(self.solver.response(change)) / scale
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
        """Return the changes of gaps, mm, with those of pressures, (P, B, n) MPa, symmetric."""
        return self.solver.deflections(d_p)

    def tangents(
        self,
        solution: ContactState,
        d_gap: FloatArray,
        d_force: FloatArray | None,
        d_approach: FloatArray | None,
        slope: FloatArray | None,
        histories: IntArray,
    ) -> tuple[FloatArray, FloatArray]:
        """Return derivatives of pressures and approaches, see ``BatchSolver.tangents``."""
        return self.solver.tangents(solution, d_gap, d_force, d_approach, slope, histories)

    def start_from(self, *before: "CorrectedContacts") -> None:
        """Start where others would, whose histories follow each other here."""
        self.warm = concat([contacts.warm for contacts in before])
        errors, elements = zip(*(contacts.largest_errors for contacts in before), strict=True)
        self.largest_errors = np.concatenate(errors), np.concatenate(elements)

    def take(self, histories: IntArray) -> "CorrectedContacts":
        """Return the contacts of some of the histories."""
        used, which = np.unique(self._which[histories], return_inverse=True)
        taken = CorrectedContacts(
            self.solver.take(histories), self._excess[used], which, self._stiffness[used]
        )
        taken.largest_errors = self.largest_errors[0][histories], self.largest_errors[1][histories]
        return taken

    def response(self, gap: FloatArray) -> FloatArray:
        """Return changes of the last pressures, MPa, with small growths (..., B, n) mm of gaps."""
        return self.solver.response(gap)
