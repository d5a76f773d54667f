"""The contacts of one history, or of B histories on one pair: each is solved by its own solver.

Pressures and gaps are (..., n), what a history has one number of is a number or (B,).
"""

from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray, Numbers
from ringwear_par.contact.correction import CorrectedContact
from ringwear_par.contact.problem import ContactState
from ringwear_par.contact.solver import ContactSolver
from ringwear_par.wear.increment import WearIncrement


class Contacts:
    """The contacts of histories. Collective on the solvers' communicator.

    Parameters
    ----------
    solvers : one a history, of the symmetric compliance.
    area : (n,) float, mm^2.
    """

    def __init__(self, solvers: Sequence[ContactSolver], area: FloatArray) -> None:
        self.solvers = tuple(solvers)
        self._each = [CorrectedContact(solver, area) for solver in self.solvers]

    @property
    def worst(self) -> tuple[float, int]:
        """The largest error that corrections have left in the first history, and its element."""
        return self._each[0].worst

    def take(self, matrix: FloatArray, excess: FloatArray) -> None:
        """Take a compliance that the solvers have, see ``CorrectedContact.take``."""
        for contact in self._each:
            contact.take(matrix, excess)

    def solve(
        self,
        gap: FloatArray,
        near: FloatArray,
        force: Numbers | None,
        approach: Numbers | None,
        during: WearIncrement | None,
        found: tuple[BoolArray, ContactState] | None,
        exact: bool,
    ) -> ContactState:
        """Solve at given forces or approaches, as ``CorrectedContact.solve`` does.

        Parameters
        ----------
        found : which of B histories have their solution already, and it.
        """
        if gap.ndim == 1:
            return self._each[0].solve(
                gap, near, force=force, approach=approach, wear=during, exact=exact
            )
        return _stacked(
            [
                _one(found[1], i)
                if found is not None and found[0][i]
                else contact.solve(
                    gap[i],
                    near[i],
                    force=None if force is None else float(force[i]),
                    approach=None if approach is None else float(approach[i]),
                    wear=None if during is None else during.history(i),
                    exact=exact,
                )
                for i, contact in enumerate(self._each)
            ]
        )

    def response(self, gap: FloatArray, force_kept: bool) -> FloatArray:
        """Return what a small growth of the gap, mm, does to the last pressures, MPa."""
        if gap.ndim == 1:
            return self.solvers[0].response(gap, force_kept)
        each = zip(self.solvers, gap, strict=True)
        return np.stack([solver.response(own, force_kept) for solver, own in each])


def _stacked(solutions: Sequence[ContactState]) -> ContactState:
    """Return the solutions of B histories as one."""

    def of_all(name: str) -> Any:
        return np.array([getattr(solution, name) for solution in solutions])

    return ContactState(*(of_all(each.name) for each in fields(ContactState)))


def _one(solutions: ContactState, i: int) -> ContactState:
    """Return the solution of one of B histories."""
    return ContactState(*(getattr(solutions, each.name)[i] for each in fields(ContactState)))
