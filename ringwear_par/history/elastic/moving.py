"""The elasticity of elements that follow the wear."""

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import Case
from ringwear_par.elasticity.bem.pair import BodyCost, ContactCompliance, ContactPair
from ringwear_par.elasticity.geometry.mesh import ContactLine
from ringwear_par.errors import ComputationError
from ringwear_par.history.elastic.bodies import young
from ringwear_par.history.elastic.pairs import updated_geometry


class MovingGeometry:
    """The elasticity of a case whose elements follow the wear, and what following took.

    Parameters
    ----------
    case : the case.
    comm : communicator of the collective methods.
    """

    def __init__(self, case: Case, comm: MPI.Comm) -> None:
        self._young, self._geometry = young(case), updated_geometry(case, comm)
        #: (2, n) mm, the wear that the elements have followed
        self.meshed_wear = np.zeros((2, case.line.n))
        #: what following it took so far, and how often that was done
        self.cost, self.updates = BodyCost(), 0

    def unworn(self) -> ContactPair:
        """Return the pair before any wear. Collective."""
        return self._geometry.update(np.zeros_like(self.meshed_wear))

    def compliance(self, wear: FloatArray) -> ContactCompliance:
        """Let the elements follow a wear, (2, n) mm, and return their compliance. Collective.

        Raises
        ------
        ComputationError : the worn bodies cannot be computed.
        """
        pair = self._geometry.update(wear)
        try:
            compliance = pair.compliance(self._young)
        except ComputationError as error:
            raise ComputationError(_slivers(pair.line, wear) or str(error)) from error
        self.meshed_wear, self.cost = wear, self.cost + pair.cost
        return compliance


def _slivers(line: ContactLine, shape: FloatArray) -> str:
    """Return where a worn face stands out by more than elements are wide; "" for nowhere."""
    rises = np.abs(np.diff(shape, axis=-1))
    steep = rises / np.minimum(line.width[1:], line.width[:-1])
    body, e = np.unravel_index(steep.argmax(), steep.shape)
    if steep[body, e] <= 1.0:
        return ""
    less, more = sorted((e, e + 1), key=lambda place: shape[body, place])
    return (
        f"elements that follow the wear: {('lower', 'upper')[body]} is worn by "
        f"{shape[body, more]:.4g} mm at r = {line.r[more]:.6g} mm and by "
        f"{shape[body, less]:.4g} mm at r = {line.r[less]:.6g} mm beside it; what stands out "
        f"by {steep[body, e]:.2g} times the width of an element is no face that can be computed"
        ': mesh.geometry = "fixed", or laws of wear that differ less, must be used'
    )
