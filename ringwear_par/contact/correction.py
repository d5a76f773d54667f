"""Contact with the collocated compliance, by a solver of a symmetric one that is near to it.

The symmetric compliance makes contact a minimisation. What it has more than the collocated one, its
excess, is taken from the gap at pressures near the solution, and again at the solution itself until
it no longer matters: deferred correction. The excess is so small that each time leaves a few per
cent of the error, and within a history the pressures of the step before are mostly near enough.
"""

from dataclasses import replace

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray, IntArray, inner
from ringwear_par.contact.engine import ContactEngine
from ringwear_par.contact.problem import ContactInputs, ContactState, WarmStart
from ringwear_par.errors import ComputationError, HistoriesError

#: errors at which pressures count as those of the collocated equations, relative to themselves or
#: to the mean pressure, whichever is larger: within steps, the next of which corrects what this one
#: left, and where a history or a geometry begins
_NEAR_ENOUGH, _EXACT = 1e-2, 1e-4
#: how often to correct at most: five times did for the worst of 200 random cases
_CORRECTIONS = 10


def _unsettled(error: float, element: int, largest_allowed: float) -> str:
    """Return why a contact that was corrected in vain is none."""
    return (
        f"contact: after {_CORRECTIONS} corrections for the asymmetry of the compliance the "
        f"pressure of element {element} is off by {error:.2g} of itself or of the mean (allowed "
        f"{largest_allowed:g}); a finer mesh (mesh.contact_elements) or thicker layers are needed"
    )


class CorrectedContacts:
    """The contacts of B histories, each corrected by itself. Not collective.

    Parameters
    ----------
    engine : solves with the symmetric compliances.
    """

    def __init__(self, engine: ContactEngine) -> None:
        self.engine, self._products = engine, engine.compliances.products(engine.which)
        count = len(engine.which)
        self._every, self._total = np.arange(count), float(engine.compliances.area.sum())
        #: (B,) the largest errors that were left, and their elements
        self.largest_errors = np.zeros(count), np.zeros(count, dtype=np.int64)
        self._shift_at: tuple[FloatArray, FloatArray] | None = None

    def _shift(self, p: FloatArray) -> FloatArray:
        """Return the gap that the excess opens at pressures, (B, n) mm; remembered."""
        if self._shift_at is None or self._shift_at[0] is not p:
            self._shift_at = p, self.gap_of_excess(p)
        return self._shift_at[1]

    def gap_of_excess(self, p: FloatArray) -> FloatArray:
        """Return the gap that the excess opens at pressures (..., B, n), or changes of both."""
        return self._products.gap_of_excess(p)

    def __enter__(self) -> "CorrectedContacts":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Free what is PETSc's; where it would start stays known. Not collective."""
        self.engine.destroy()

    @property
    def warm(self) -> WarmStart:
        """Where the next solutions start, also after ``close``."""
        return self.engine.warm

    @warm.setter
    def warm(self, warm: WarmStart) -> None:
        self.engine.warm = warm

    def solve(
        self,
        inputs: ContactInputs,
        pressure_guess: FloatArray,
        *,
        exact: bool = False,
        already_solved: tuple[BoolArray, ContactState] | None = None,
    ) -> ContactState:
        """Return the contacts at given forces or approaches.

        Parameters
        ----------
        inputs : gaps, loads, and the wear of an implicit step.
        pressure_guess : (B, n) float, MPa, pressures near the solution.
        exact : whether to correct until no more than 1e-4 is left.
        already_solved : which histories have their solution already, and it.

        Raises
        ------
        ComputationError : one was not solved, or not corrected well enough; HistoriesError of
            several histories.
        """
        gap, wear = inputs.gap, inputs.wear
        largest_allowed = _EXACT if exact else _NEAR_ENOUGH
        count, shift, not_converged = len(gap), self._shift(pressure_guess), self._every
        iterations, elements = np.zeros((2, count), dtype=np.int64)
        residual, errors = np.zeros((2, count))
        if already_solved is not None:
            solved, solution = already_solved
            not_converged = np.flatnonzero(~solved)
            iterations[solved] = solution.iterations[solved]
            residual[solved] = solution.residual[solved]
        first_of_all = not_converged is self._every
        for _ in range(1 + _CORRECTIONS):
            state = self.engine.solve(
                gap - shift,
                force=inputs.force,
                approach=inputs.approach,
                wear=wear,
                histories=not_converged,
            )
            before, shift = shift, self._shift(state.pressure)
            error, element = self._errors(state, before, shift, largest_allowed)
            if first_of_all:
                iterations, residual, errors, elements = (
                    state.iterations, state.residual, error, element,
                )  # fmt: skip
                first_of_all = False
            else:
                iterations[not_converged] += state.iterations[not_converged]
                residual[not_converged] = state.residual[not_converged]
                errors[not_converged] = error[not_converged]
                elements[not_converged] = element[not_converged]
            fine = error <= largest_allowed
            if fine.all():
                break
            not_converged = not_converged[~fine[not_converged]]
            if not len(not_converged):
                break
        else:
            if count == 1:
                raise ComputationError(
                    _unsettled(float(error[0]), int(element[0]), largest_allowed)
                )
            which = np.zeros(count, dtype=bool)
            which[not_converged] = True
            raise HistoriesError(which)
        before_errors, before_elements = self.largest_errors
        worse = errors > before_errors
        if worse.any():
            self.largest_errors = (
                np.where(worse, errors, before_errors), np.where(worse, elements, before_elements)
            )  # fmt: skip
        if state.iterations is iterations:
            return state
        return replace(state, iterations=iterations, residual=residual)

    def _errors(
        self,
        solution: ContactState,
        before: FloatArray,
        after: FloatArray,
        largest_allowed: float,
    ) -> tuple[FloatArray, IntArray]:
        """Return the errors of pressures for a change of shift, (B, n) mm, and their elements.

        Of the worst element of each history, relative to its pressure or to the mean, whichever is
        larger. As if each element were alone, in few operations; where that is too large, by the
        response of all.
        """
        p, area = solution.pressure, self.engine.compliances.area
        largest, elements = np.empty(len(p)), np.empty(len(p), dtype=np.int64)
        self.engine.loops.correction_errors(
            *p.shape, self.engine.which, before, after, self.engine.compliances.stiffness, p,
            solution.force, self._total, largest, elements,
        )  # fmt: skip
        too_large = largest > largest_allowed
        if not too_large.any():
            return largest, elements
        touching = p > 0.0
        carrying = inner(area, touching.astype(float))
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = np.maximum(p, np.divide(solution.force, carrying)[:, None])
            errors = np.where(touching, np.abs(self.engine.response(after - before)) / scale, 0.0)
        worst = errors.argmax(axis=1)
        # where nothing touches the gap must be that of no pressure
        response = np.where(carrying > 0.0, errors[self._every, worst], np.inf)
        worst = np.where(carrying > 0.0, worst, elements)
        return np.where(too_large, response, largest), np.where(too_large, worst, elements)

    def keep(self, histories: IntArray) -> None:
        """Go on with some of the histories, in ascending order."""
        self.engine.keep(histories)
        errors, elements = self.largest_errors
        self.largest_errors = errors[histories], elements[histories]
        self._products = self.engine.compliances.products(self.engine.which)
        self._shift_at, self._every = None, np.arange(len(histories))

    def take(self, histories: IntArray) -> "CorrectedContacts":
        """Return the contacts of some of the histories."""
        errors, elements = self.largest_errors
        taken = CorrectedContacts(self.engine.take(histories))
        taken.largest_errors = errors[histories], elements[histories]
        return taken
