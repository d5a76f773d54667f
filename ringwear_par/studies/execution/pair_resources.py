"""Resources that the cases of a pair share."""

from collections.abc import Hashable

from mpi4py import MPI

from ringwear_par.cases.case import Case
from ringwear_par.elasticity.bem.pair import ContactPair
from ringwear_par.history.observers.stresses import CaseStresses, stress_key


class PairResources:
    """A contact pair and the stresses of unit loads on it, which its cases share.

    Stresses are integrated once for all cases that ask for the same.

    Parameters
    ----------
    pair : contact pair of the cases.
    comm : communicator; ``stresses`` is collective on it.
    """

    def __init__(self, pair: ContactPair, comm: MPI.Comm) -> None:
        self.pair, self._comm = pair, comm
        self._stresses: CaseStresses | None = None
        self._stress_key: Hashable = None

    def stresses(self, case: Case) -> CaseStresses | None:
        """Return the stresses of a case; None where it asks for none."""
        if case.stress is None:
            return None
        key = stress_key(case)
        if self._stresses is None or key != self._stress_key:
            self._stresses, self._stress_key = CaseStresses(case, self._comm), key
        return self._stresses
