"""Stress on the boundary, from tractions and from the strains that displacements have along it.

At the mid-point of an element, with s along the boundary and n its outward normal,

    sigma_ss = E/(1-nu^2) (eps_ss + nu eps_tt) + nu/(1-nu) sigma_nn,

the hoop stress likewise, and G (du_theta/ds - u_theta/r dr/ds) for the shear s, theta; sigma_nn,
sigma_ns and sigma_n,theta are the tractions.
"""

import itertools
import math
from dataclasses import dataclass

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.elasticity.bem.body import BoundaryResponse
from ringwear_par.elasticity.bem.boundary import BoundaryMesh
from ringwear_par.elasticity.sections import CORNER_ANGLE

#: mid-points that a stress between them is interpolated from
_WINDOW = 4


def mid_stress(response: BoundaryResponse) -> FloatArray:
    """Return (k, 6, n) MPa, the stress at the mid-points of elements for each load.

    Components are rr, tt, zz, rz, rt, tz. Not collective.
    """
    boundary, poisson = response.boundary, response.material.poisson
    displacement, traction = response.material.young * response.displacement, response.traction
    nodes, (first, middle, last) = boundary.nodes, boundary.elements.T
    along = nodes[last] - nodes[first]
    length = np.hypot(*along.T)
    sr, sz = (along / length[:, None]).T[:, :, None]  # (k, 1) each; the normal is (sz, -sr)
    r = nodes[middle, 0][:, None]
    slope = (displacement[last] - displacement[first]) / length[:, None, None]
    strain = slope[:, 0] * sr + slope[:, 1] * sz
    hoop = displacement[middle, 0] / r
    nn = traction[:, 0] * sz - traction[:, 1] * sr
    ns = traction[:, 0] * sr + traction[:, 1] * sz
    modulus, lateral = 1.0 / (1.0 - poisson**2), poisson / (1.0 - poisson) * nn
    ss = modulus * (strain + poisson * hoop) + lateral
    tt = modulus * (hoop + poisson * strain) + lateral
    st = 0.5 / (1.0 + poisson) * (slope[:, 2] - displacement[middle, 2] / r * sr)
    nt = traction[:, 2]
    return np.stack(
        [
            ss * sr**2 + nn * sz**2 + 2.0 * ns * sr * sz,
            tt,
            ss * sz**2 + nn * sr**2 - 2.0 * ns * sr * sz,
            (ss - nn) * sr * sz + ns * (sz**2 - sr**2),
            st * sr + nt * sz,
            st * sz - nt * sr,
        ],
        axis=1,
    )


@dataclass(frozen=True)
class Faces:
    """A boundary's elements in runs that are smooth, and where they lie along them.

    Runs end at corners and where the contact line or the fixed face does, as stresses jump there.
    """

    #: elements of each run, in the direction of travel
    runs: tuple[IntArray, ...]
    #: (k,) int, run of each element
    run: IntArray
    #: (k,) float, mm, arc of its mid-point from the start of its run
    middle: FloatArray
    #: (3, k) float, mm, size of elements about its first, middle and last node
    sizes: FloatArray

    def size(self, element: IntArray, t: FloatArray) -> FloatArray:
        """Return the size of elements about points of some, varying smoothly, mm."""
        first, middle, last = self.sizes[:, element]
        return np.where(
            t < 0.5, first + (middle - first) * 2.0 * t, middle + (last - middle) * (2.0 * t - 1.0)
        )

    def weights(self, element: int, t: float) -> tuple[IntArray, FloatArray]:
        """Return elements, and by what their stresses make that at a point of one.

        Parameters
        ----------
        t : place on the element, 0 to 1.
        """
        run = self.runs[self.run[element]]
        arc, x = self.middle[element] + (t - 0.5) * self.sizes[1, element], self.middle[run]
        if len(run) == 1:
            return run, np.ones(1)
        after = int(np.searchsorted(x, arc))
        if 0 < after < len(run):
            start = min(max(after - _WINDOW // 2, 0), max(len(run) - _WINDOW, 0))
            # stresses are powers of the distance from the ends: smooth in its logarithm
            whole = x[-1] + 0.5 * self.sizes[1, run[-1]]
            x, arc = np.log(x / (whole - x)), math.log(arc / (whole - arc))
        else:  # beyond the last mid-points in straight lines
            start = 0 if after == 0 else len(run) - 2
        chosen = slice(start, start + (_WINDOW if 0 < after < len(run) else 2))
        x = x[chosen]
        weights = np.ones(len(x))
        for i, j in itertools.permutations(range(len(x)), 2):
            weights[i] *= (arc - x[j]) / (x[i] - x[j])
        return run[chosen], weights


def faces(boundary: BoundaryMesh) -> Faces:
    """Return the smooth runs of a boundary's elements. Not collective."""
    nodes, elements, k = boundary.nodes, boundary.elements, len(boundary.elements)
    kind = np.zeros(k, dtype=np.int64)
    for i, name in enumerate(("contact", "fixed", "above", "below"), 1):
        kind[getattr(boundary, name)] = i
    along = nodes[elements[:, 2]] - nodes[elements[:, 0]]
    length, angle = np.hypot(*along.T), np.arctan2(along[:, 1], along[:, 0])
    # one after another in the direction of travel
    order = np.arange(k) if elements[0, 2] == elements[1, 0] else np.arange(k)[::-1]
    before = np.roll(order, 1)
    turn = (angle[order] - angle[before] + math.pi) % (2.0 * math.pi) - math.pi
    starts = (kind[order] != kind[before]) | (np.abs(turn) > CORNER_ANGLE)
    starts |= elements[order, 0] != elements[before, 2]
    first = int(starts.argmax())
    runs = np.split(np.roll(order, -first), np.flatnonzero(np.roll(starts, -first))[1:])
    number, middle, sizes = np.zeros(k, np.int64), np.zeros(k), np.tile(length, (3, 1))
    for i, members in enumerate(runs):
        number[members] = i
        ends = np.cumsum(length[members])
        middle[members] = ends - 0.5 * length[members]
        between = np.interp(ends[:-1], middle[members], length[members])
        sizes[2, members[:-1]] = sizes[0, members[1:]] = between
    return Faces(tuple(runs), number, middle, sizes)
