"""Two bodies in contact: everything that a wear history needs to know of their elasticity.

By reciprocity ``diag(m) C`` is symmetric, m being the areas. The collocated compliance C is not
quite: rows, the equations of elements, are right even for the tiniest; columns, the response of
wide elements to a tiny loaded one, carry relative errors that differ from element to element, and
exceed the tiny element's own compliance. The symmetric part alone therefore spoils the equations of
the elements at an edge, by their whole pressure where that is regular, and however fine the mesh.
"""

from collections.abc import Hashable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from mpi4py import MPI
from scipy.linalg import cho_factor, cho_solve, eigh

from ringwear_par.arrays import FloatArray
from ringwear_par.elasticity.bem.body import BodyCost, Compliance, compliance
from ringwear_par.elasticity.bem.boundary import node_wear
from ringwear_par.elasticity.mesh import ContactLine, Mesh, obliquity, pair_key, pair_slope
from ringwear_par.elasticity.sections import Body
from ringwear_par.errors import ComputationError

#: elements wider than this share of their radius are near the axis
_NEAR_AXIS = 0.1
#: largest change there, of an element's own compliance
_MOST_CHANGED = 0.25


def symmetric(line: ContactLine, normal: FloatArray) -> FloatArray:
    """Return K, ``diag(m) C`` made symmetric such that it is right at every edge. Not collective.

    The symmetric part S with a block secant correction (the update of Broyden, Fletcher, Goldfarb
    and Shanno; Schnabel, "Quasi-Newton methods using multiple secant equations", 1983),

        K = S - S P (P'S P)^-1 P'S + Y (Y'P)^-1 Y',    Y = diag(m) C P,

    by which the pressures P under a rigid flat and a rigid bowed face are those of the collocated
    equations, as far as Y'P is symmetric (what it is not vanishes with the mesh), and near edges
    and corners what behaves like them. K is positive definite where S and the symmetric part of Y'P
    are. Where there is contact at the axis but not at the edges, these two faces are no guide: S
    has been corrected there before. What K still has more than the collocated compliance, histories
    take from the gap (``contact.correction``).

    Parameters
    ----------
    normal : (n, n) float, mm/MPa, collocated compliance C.

    Returns
    -------
    (n, n) float, mm^3/MPa.

    Raises
    ------
    numpy.linalg.LinAlgError : it is not positive definite.
    """
    m, r = line.area, line.r
    total = m.sum()
    weighted = m[:, None] * normal
    part = 0.5 * (weighted + weighted.T)
    faces = np.stack([np.ones_like(r), r**2 - m @ r**2 / total], axis=1)
    p = np.linalg.solve(normal, faces)
    if line.edges[0] == 0.0:
        part += np.diag(_near_axis(line, weighted, p[:, 0]))
    p /= (scale := np.sqrt(m @ p**2 / total))
    y = m[:, None] * (faces / scale)
    sp = part @ p
    return _definite(part - _square(sp, p.T @ sp) + _square(y, y.T @ p))


def _near_axis(line: ContactLine, weighted: FloatArray, flat: FloatArray) -> FloatArray:
    """Return (n,) mm^3/MPa, what the symmetric part lacks on its diagonal near the axis.

    With it, the equations of these elements hold under a rigid flat face, whose pressure ``flat``
    varies smoothly there, as any does.
    """
    lost = 0.5 * ((weighted - weighted.T) @ flat)
    most = _MOST_CHANGED * weighted.diagonal() * flat
    guided = (line.width > _NEAR_AXIS * line.r) & (np.abs(lost) < most)
    return np.divide(lost, flat, out=np.zeros_like(flat), where=guided)


def _square(x: FloatArray, middle: FloatArray) -> FloatArray:
    """Return ``x middle^-1 x'`` with the symmetric part of a positive definite middle."""
    return x @ cho_solve(cho_factor(0.5 * (middle + middle.T)), x.T)


def _definite(matrix: FloatArray) -> FloatArray:
    """Return a matrix symmetric to the last bit, if it is positive definite."""
    matrix = 0.5 * (matrix + matrix.T)
    np.linalg.cholesky(matrix)
    return matrix


@dataclass(frozen=True)
class ContactCompliance:
    """Contact line of two bodies and its compliance, with their Young's moduli."""

    #: the contact elements
    line: ContactLine
    #: (n, n) float, mm^3/MPa, K: ``diag(m) C`` with C = C1/E1 + C2/E2 and the areas m, made
    #: symmetric (see ``symmetric``)
    matrix: FloatArray
    #: (n,) float, mm/MPa; area mean of the circumferential displacement jump per unit
    #: circumferential traction on each element
    twist: FloatArray
    #: largest ``|m C - (m C)'|`` over the largest ``|m C|``; vanishes with the mesh
    symmetry_defect: float
    #: (2, n) float, mm^2 and mm^3; force and torque on the fixed faces of lower and upper per unit
    #: pressure and unit shear on each element. Equilibrium asks for the area, and true area times
    #: arm; the difference vanishes with the mesh.
    force_reaction: FloatArray
    torque_reaction: FloatArray
    #: (n,) float, tan alpha of the normals that pressure acts along, see ``pair_slope``
    slope: FloatArray
    #: (n, n) float, mm/MPa, the compliance C as collocation gives it
    collocated: FloatArray

    @cached_property
    def excess(self) -> FloatArray:
        """(n, n) mm/MPa, what the symmetric compliance has more than the collocated: K / m - C."""
        return self.matrix / self.line.area[:, None] - self.collocated

    @property
    def obliquity(self) -> FloatArray:
        """(n,), 1 / cos alpha: true area, on which friction and wear act, over projected area."""
        return obliquity(self.slope)


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
    force_reaction, torque_reaction : (2, n) float, mm^2 and mm^3, as in ContactCompliance.
    slope : (n,) float, tan alpha of the normals that pressure acts along, see ``pair_slope``.
    key : what all this depends on, see ``pair_key``.
    cost : what it took; nothing where it was read from somewhere.
    """

    line: ContactLine
    normal: FloatArray
    twist: FloatArray
    force_reaction: FloatArray
    torque_reaction: FloatArray
    slope: FloatArray
    key: Hashable
    cost: BodyCost = field(default_factory=BodyCost)
    #: the compliance asked for last, by its moduli: histories in a row often have the same
    _last: dict[tuple[float, float], ContactCompliance] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    def __repr__(self) -> str:
        a, b = self.line.edges[[0, -1]]
        return f"<ContactPair: {self.line.n} contact elements, r = {a:g} to {b:g} mm>"

    @property
    def obliquity(self) -> FloatArray:
        """(n,), 1 / cos alpha: true area, on which friction and wear act, over projected area."""
        return obliquity(self.slope)

    def compliance(self, young: tuple[float, float]) -> ContactCompliance:
        """Return the compliance with Young's moduli (MPa) of lower and upper. Not collective.

        Raises
        ------
        ComputationError : it is not positive definite (the mesh is far too coarse).
        """
        if young not in self._last:
            joined = self._joined(young)
            self._last.clear()
            self._last[young] = joined
        return self._last[young]

    def _joined(self, young: tuple[float, float]) -> ContactCompliance:
        line = self.line
        lower, upper = 1.0 / young[0], 1.0 / young[1]
        normal = lower * self.normal[0] + upper * self.normal[1]
        weighted = line.area[:, None] * normal
        try:
            matrix = symmetric(line, normal)
        except np.linalg.LinAlgError as error:
            raise ComputationError(
                f"compliance of {line.n} contact elements: not positive definite; "
                "a finer mesh or a milder grading is needed"
            ) from error
        return ContactCompliance(
            line,
            matrix,
            (lower * self.twist[0] + upper * self.twist[1]) / line.area.sum(),
            float(np.abs(weighted - weighted.T).max() / np.abs(weighted).max()),
            self.force_reaction,
            self.torque_reaction,
            self.slope,
            normal,
        )


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
    return UpdatedGeometry(bodies, (False, False), line, mesh, comm).update(np.zeros((2, line.n)))


class UpdatedGeometry:
    """The contact pair of two bodies whose elements follow any wear: they are assembled anew.

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
        # of each body the wear and the slope of the last update, and the compliance
        self._last: dict[int, tuple[FloatArray, Compliance]] = {}

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
        line, mesh, cost = self._line, self._mesh, BodyCost()
        worn = np.where(self._wears[:, None], worn, 0.0)
        lower, upper = self._bodies
        slope = pair_slope((lower.section, upper.section), line, mesh, worn)
        for i, (body, own) in enumerate(zip(self._bodies, (slope, -slope), strict=True)):
            shape = np.stack([worn[i], own])
            if i not in self._last or not np.array_equal(self._last[i][0], shape):
                wear = node_wear(line, worn[i])
                self._last[i] = shape, compliance(body, line, mesh, self._comm, wear, own)
                cost += self._last[i][1].cost
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
            cost,
        )


def largest_stable_step(compliance: ContactCompliance, slope: FloatArray) -> float:
    """Return the largest stable explicit step, s: 2 / lambda_max(W C^-1), while all is in contact.

    Parameters
    ----------
    slope : (n,) float, mm/s/MPa, derivative of the rate of wear of both bodies together.
    """
    if not slope.any():
        return np.inf
    n = compliance.line.n
    weighted = np.diag(compliance.line.area * slope)
    largest = eigh(weighted, compliance.matrix, eigvals_only=True, subset_by_index=(n - 1, n - 1))
    return float(2.0 / largest[0])
