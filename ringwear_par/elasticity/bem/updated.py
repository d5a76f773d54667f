"""Elasticity of bodies whose elements follow the worn profile: assembled anew at each update."""

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import FloatArray
from ringwear_par.elasticity.bem.body import Compliance, compliances
from ringwear_par.elasticity.bem.boundary import node_wear
from ringwear_par.elasticity.bem.pair import ContactPair, join_bodies
from ringwear_par.elasticity.mesh import ContactLine, Mesh, pair_key, pair_slope
from ringwear_par.elasticity.sections import Body


class UpdatedGeometry:
    """The contact pair of two bodies for any wear of them, whatever updates came before.

    Parameters
    ----------
    bodies : lower and upper.
    wears : which of them wear, and so move.
    line : contact elements.
    mesh : discretisation.
    comm : communicator of ``update``.
    """

    def __init__(
        self,
        bodies: tuple[Body, Body],
        wears: tuple[bool, bool],
        line: ContactLine,
        mesh: Mesh,
        comm: MPI.Comm,
    ) -> None:
        self._bodies, self._wears = bodies, np.array(wears)
        self._line, self._mesh, self._comm = line, mesh, comm
        # of each body the last compliance, and the wear and the slope that it is of
        self._last: list[tuple[FloatArray, Compliance] | None] = [None, None]

    def update(self, worn: FloatArray) -> ContactPair:
        """Return the pair after wear, its cost being that of this update. Collective on comm.

        A body is assembled unless its wear and the directions of the pressure on it, which turn
        with the other face, are those of the last update.

        Parameters
        ----------
        worn : (2, n) float, mm >= 0, wear of the elements of lower and upper.

        Raises
        ------
        ComputationError : the wear leaves too little of a body, or a factorisation failed.
        """
        line, mesh = self._line, self._mesh
        worn = np.where(self._wears[:, None], worn, 0.0)
        lower, upper = self._bodies
        slope = pair_slope((lower.section, upper.section), line, mesh, worn)
        shapes = [np.stack(shape) for shape in zip(worn, (slope, -slope), strict=True)]
        changed = [
            i
            for i, last in enumerate(self._last)
            if last is None or not np.array_equal(last[0], shapes[i])
        ]
        new = compliances(
            [self._bodies[i] for i in changed], line, mesh, self._comm,
            [shapes[i][1] for i in changed], [node_wear(line, shapes[i][0]) for i in changed],
        )  # fmt: skip
        for i, compliance in zip(changed, new, strict=True):
            self._last[i] = shapes[i], compliance
        both = [last[1] for last in self._last if last is not None]
        contact = float(line.edges[0]), float(line.edges[-1])
        key = pair_key(self._bodies, contact, mesh)
        return join_bodies(line, both, slope, (key, worn.tobytes()) if worn.any() else key, new)
