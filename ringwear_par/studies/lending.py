"""What cases of one pair borrow, one after another: contact solver, stresses of unit loads."""

from collections.abc import Hashable

from mpi4py import MPI

from ringwear_par.cases.case import Case
from ringwear_par.contact.solver import ContactSolver
from ringwear_par.elasticity.pair import ContactPair
from ringwear_par.history.bodies import young
from ringwear_par.history.stresses import CaseStresses, stress_key
from ringwear_par.parallel import together


class Lender:
    """Lends what is dear to make to the cases of a pair; a context manager.

    Making a solver costs as much as many steps: one serves all cases of the same moduli that
    follow each other. Stresses of unit loads are integrated once for all that ask for the same.

    Parameters
    ----------
    pair : contact pair of the cases.
    comm : communicator of what is lent; every method is collective on it.
    """

    def __init__(self, pair: ContactPair, comm: MPI.Comm) -> None:
        self.pair, self._comm = pair, comm
        self._moduli: tuple[float, float] | None = None
        self._solver: ContactSolver | None = None
        self._stresses: CaseStresses | None = None
        self._stress_key: Hashable = None

    def __enter__(self) -> "Lender":
        return self

    def __exit__(self, *_: object) -> None:
        self.drop()

    def solver(self, case: Case) -> ContactSolver | None:
        """Return the solver for a case, None where its elements follow the wear.

        Such a case would give the solver back with another compliance: its model makes its own.

        Raises
        ------
        ComputationError : the mesh is far too coarse.
        InputError : an option for PETSc.
        """
        if case.follows_wear:
            return None
        moduli = young(case)
        if self._solver is None or moduli != self._moduli:
            self.drop()
            with together(self._comm):
                matrix = self.pair.compliance(moduli).matrix
            self._solver = ContactSolver(matrix, self.pair.line.area, self._comm)
            self._moduli = moduli
        return self._solver

    def stresses(self, case: Case) -> CaseStresses | None:
        """Return what has the stresses of a case; None where it asks for none."""
        if case.stress is None:
            return None
        key = stress_key(case)
        if self._stresses is None or key != self._stress_key:
            self._stresses, self._stress_key = CaseStresses(case, self._comm), key
        return self._stresses

    def drop(self) -> None:
        """Free the solver: one that has failed is not lent again."""
        if self._solver is not None:
            self._solver.destroy()
        self._solver = None
