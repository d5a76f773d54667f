"""Two bodies in contact: everything that a wear history needs to know of their elasticity.

By reciprocity ``diag(m) C`` is symmetric, m being the areas. The collocated compliance C is not
quite: rows, the equations of elements, are right even for the tiniest; columns, the response of
wide elements to a tiny loaded one, carry relative errors that differ from element to element, and
exceed the tiny element's own compliance. So contacts are solved with C as it is: its symmetric part
alone would spoil the equations of the elements at an edge, by their whole pressure where that is
regular, and however fine the mesh.
"""

from collections.abc import Hashable
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import FloatArray
from ringwear_par.elasticity.bem.body import Compliance, compliance
from ringwear_par.elasticity.bem.boundary import node_wear
from ringwear_par.elasticity.mesh import ContactLine, Mesh, pair_key, pair_slope
from ringwear_par.elasticity.sections import Body


@dataclass(frozen=True)
class ContactPair:
    """What the boundary elements say of two bodies at Young's modulus 1, eq. (5).

    Moduli, load, speed, friction and wear laws scale it or come later, so that one pair serves
    every case of the same shape, mesh, Poisson's ratios and grip.

    Parameters
    ----------
    line : the contact elements.
    normal : (2, n, n) float, mm/MPa; what lower and upper give way under unit pressure.
    twist : (2, n) float, mm^3/MPa; area integral of the circumferential displacement per unit
        circumferential traction.
    force_reaction, torque_reaction : (2, n) float, mm^2 and mm^3; force and torque on the fixed
        faces per unit pressure and unit shear on each element. Equilibrium asks for the area, and
        true area times arm; the difference vanishes with the mesh.
    slope : (n,) float, tan alpha of the normals that pressure acts along, see ``pair_slope``.
    key : what all this depends on, see ``pair_key``.
    seconds : (2,) float, s, wall time on this rank that assembly and solution took.
    """

    line: ContactLine
    normal: FloatArray
    twist: FloatArray
    force_reaction: FloatArray
    torque_reaction: FloatArray
    slope: FloatArray
    key: Hashable
    seconds: FloatArray

    def __repr__(self) -> str:
        a, b = self.line.edges[[0, -1]]
        return f"<ContactPair: {self.line.n} contact elements, r = {a:g} to {b:g} mm>"


def assemble_pair(
    bodies: tuple[Body, Body], line: ContactLine, mesh: Mesh, comm: MPI.Comm
) -> ContactPair:
    """Assemble and condense lower and upper. Collective on comm, the same on all ranks.

    Parameters
    ----------
    line : the contact elements that ``contact_line`` makes with this mesh and these sections.

    Raises
    ------
    ComputationError : a factorisation failed.
    """
    return UpdatedGeometry(bodies, line, mesh, comm).update(np.zeros((2, line.n)))


class UpdatedGeometry:
    """The contact pair of two bodies whose elements follow any wear: they are assembled anew.

    Parameters
    ----------
    bodies : lower and upper.
    line : contact elements.
    mesh : discretisation.
    comm : communicator of ``update``.
    """

    def __init__(
        self,
        bodies: tuple[Body, Body],
        line: ContactLine,
        mesh: Mesh,
        comm: MPI.Comm,
    ) -> None:
        self._bodies, self._line, self._mesh, self._comm = bodies, line, mesh, comm
        # of each body the wear and the slope of the last update, and the compliance
        self._last: dict[int, tuple[FloatArray, Compliance]] = {}

    def update(self, worn: FloatArray) -> ContactPair:
        """Return the pair after wear, its seconds being those of this update. Collective on comm.

        A body is assembled unless its wear and the directions of the pressure on it, which turn
        with the other face, are those of the last update.

        Parameters
        ----------
        worn : (2, n) float, mm >= 0, wear of the elements of lower and upper.

        Raises
        ------
        ComputationError : the wear leaves too little of a body, or a factorisation failed.
        """
        line, mesh, seconds = self._line, self._mesh, np.zeros(2)
        lower, upper = self._bodies
        slope = pair_slope((lower.section, upper.section), line, mesh, worn)
        for i, (body, own) in enumerate(zip(self._bodies, (slope, -slope), strict=True)):
            shape = np.stack([worn[i], own])
            if i not in self._last or not np.array_equal(self._last[i][0], shape):
                wear = node_wear(line, worn[i])
                self._last[i] = shape, compliance(body, line, mesh, self._comm, wear, own)
                seconds += self._last[i][1].seconds
        both = [self._last[i][1] for i in range(2)]
        key = pair_key(self._bodies, (float(line.edges[0]), float(line.edges[-1])), mesh)
        return ContactPair(
            line,
            np.array([body.normal for body in both]),
            np.array([line.area @ body.torsion for body in both]),
            np.array([body.force_reaction for body in both]),
            np.array([body.torque_reaction for body in both]),
            slope,
            (key, worn.tobytes()) if worn.any() else key,
            seconds,
        )
