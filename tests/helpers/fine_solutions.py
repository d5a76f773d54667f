"""Element values of pressures, and stored fine solutions of the rings of ``reference_cases.SORTS``.

The stored ones are means over 128 elements of solutions on 512 strongly graded ones, of the
collocated equations as they are, not made symmetric, and exact in time (see ``worn_exactly``). They
agree with 384 elements to ``digits``. Cones of 10 degrees lift off at their outer edge, and are
stored unworn.
"""

import json
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from reference_cases import CONTACT, SPEED, TIMES, K, collocated, moduli_of
from scipy.interpolate import CubicSpline
from scipy.linalg import lu_factor, lu_solve
from scipy.special import betaincinv

from ringwear_par.elasticity.mesh import Mesh, contact_line

#: on whose elements stored solutions are: those of coarser meshes are sums of theirs
RINGS = Mesh(128)


def pressure_at(line, p, r):
    """Return the pressure at a radius from element values, all positive.

    Cubic interpolation of log p against log(s1/s2), s1 and s2 being the distances to the edges, in
    which powers of the distance to an edge are straight lines.
    """
    inner, outer = line.edges[0], line.edges[-1]
    if inner == 0.0:  # no edge on the axis
        position, x = line.r, r
    else:
        position = np.log((line.r - inner) / (outer - line.r))
        x = math.log((r - inner) / (outer - r))
    return float(np.exp(CubicSpline(position, np.log(p))(x)))


def ring_means(mesh, field, radii):
    """Return the means between radii (mm) of a field given by its means over elements.

    The integral from the inner edge on, a cubic spline over the element number, in which it is
    smooth whatever the grading, and exact where radii are element ends.
    """
    edges, ends = np.asarray(radii), contact_line(CONTACT, mesh)
    (a, b), g = CONTACT, mesh.grading
    inner, outer = (np.clip(x / (b - a), 0.0, 1.0) for x in (edges - a, b - edges))
    number = mesh.contact_elements * np.where(
        inner < 0.5, betaincinv(g, g, inner), 1.0 - betaincinv(g, g, outer)
    )
    # of the difference to the mean, so that few digits are lost at the outer edge
    mean = float(ends.area @ field / ends.area.sum())
    integral = np.append(0.0, np.cumsum(ends.area * (field - mean)))
    along = CubicSpline(np.arange(ends.n + 1), integral)(number)
    return mean + np.diff(along) / (np.pi * np.diff(edges**2))


@dataclass(frozen=True)
class FineSolution:
    """Means over the elements of a mesh, and by how much two fine meshes differ in them."""

    #: mm, unworn
    approach: float
    #: (n,) MPa, unworn
    pressure: np.ndarray
    #: (n,) mm, off the lower ring by time (s); {} where faces lift off
    wear: dict[float, np.ndarray]
    #: ``approach``, ``pressure`` (worst ring) and ``inside`` relative, ``wear`` in mm
    digits: dict[str, float]


def stored(name, mesh=RINGS):
    """Return the stored solution of one of SORTS on the elements of a mesh."""
    path = Path(__file__).with_name("fine_solutions.json")
    solution = json.loads(path.read_text("utf-8"))[name]
    edges = contact_line(CONTACT, mesh).edges
    worn = {
        float(time): ring_means(RINGS, np.array(depths) * 1e-3, edges)
        for time, depths in solution["wear_um"].items()
    }
    pressure = ring_means(RINGS, np.array(solution["pressure_mpa"]), edges)
    return FineSolution(solution["approach_mm"], pressure, worn, solution["digits"])


def worn_exactly(case, pair):
    """Return unworn pressure, approach and the wear by TIMES of rings in full contact with p0 = 0.

    C p = delta - w and m p = F give p = p_0 - R w, and with the rates s p of wear w' = s p_0 - B w
    with B = s R: a sum of exponentials of its eigenvalues, one of which is zero.
    """
    line, matrix = case.line, collocated(pair, moduli_of(case))
    factor, m = lu_factor(matrix), line.area
    flat, across = lu_solve(factor, np.ones_like(m)), lu_solve(factor, m, trans=1)
    approach = case.load.force / (m @ flat)
    p, s = approach * flat, K * case.friction * SPEED * line.arm * np.hypot(1.0, pair.slope)
    response = lu_solve(factor, np.eye(line.n)) - np.outer(flat, across) / (m @ flat)
    # scaled such that a symmetric diag(m) C would make it symmetric
    scale = np.sqrt(s / m)
    rates, modes = np.linalg.eig((s / scale)[:, None] * response * scale)
    shares = np.linalg.solve(modes, s * p / scale)
    rates[np.argmin(np.abs(rates))] = 0.0  # the mean depth, which nothing evens out

    def worn(time):
        grown = np.full_like(rates, time)
        np.divide(-np.expm1(-rates * time), rates, out=grown, where=rates != 0.0)
        return scale * (modes @ (grown * shares)).real

    return p, approach, {time: worn(time) for time in TIMES}
