"""The symmetric compliance of a contact line that collocation nearly gives.

By reciprocity ``diag(m) C`` is symmetric. The collocated one is not quite: rows, the equations of
elements, are right even for the tiniest; columns, the response of wide elements to a tiny loaded
one, carry relative errors that differ from element to element, and exceed the tiny element's own
compliance. The symmetric part alone therefore spoils the equations of the elements at an edge,
by their whole pressure where that is regular, and however fine the mesh.
"""

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from ringwear_par.arrays import FloatArray
from ringwear_par.elasticity.geometry.mesh import ContactLine

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
