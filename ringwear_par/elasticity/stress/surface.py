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
from ringwear_par.elasticity.bem.boundary import BoundaryMesh
from ringwear_par.elasticity.sections import CORNER_ANGLE

#: mid-points that a stress between them is interpolated from
_WINDOW = 4


def mid_stress(
    boundary: BoundaryMesh, poisson: float, displacement: FloatArray, traction: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the stress at the mid-points of elements, for each load. Not collective.

    Parameters
    ----------
    displacement : (m, 3, n) float, mm, of nodes in r, z and theta at Young's modulus 1.
    traction : (k, 3, n) float, MPa, likewise of elements.

    Returns
    -------
    normal : (k, 4, n) float, MPa, rr, tt, zz, rz.
    torsion : (k, 2, n) float, MPa, rt, tz.
    """
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
    normal = np.stack(
        [
            ss * sr**2 + nn * sz**2 + 2.0 * ns * sr * sz,
            tt,
            ss * sz**2 + nn * sr**2 - 2.0 * ns * sr * sz,
            (ss - nn) * sr * sz + ns * (sz**2 - sr**2),
        ],
        axis=1,
    )
    st = 0.5 / (1.0 + poisson) * (slope[:, 2] - displacement[middle, 2] / r * sr)
    nt = traction[:, 2]
    return normal, np.stack([st * sr + nt * sz, st * sz - nt * sr], axis=1)


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
    nodes, elements = boundary.nodes, boundary.elements
    k = len(elements)
    kind = np.zeros(k, dtype=np.int64)
    for i, name in enumerate(("contact", "fixed", "above", "below"), 1):
        kind[getattr(boundary, name)] = i
    follow, starts = _following(elements)
    along = nodes[elements[:, 2]] - nodes[elements[:, 0]]
    length, angle = np.hypot(*along.T), np.arctan2(along[:, 1], along[:, 0])

    def breaks(e: int) -> bool:
        """Tell whether a run ends behind an element."""
        neighbour = follow[e]
        if neighbour < 0 or kind[neighbour] != kind[e]:
            return True
        turn = (angle[neighbour] - angle[e] + math.pi) % (2.0 * math.pi) - math.pi
        return bool(abs(turn) > CORNER_ANGLE)

    heads = [*starts, *(int(follow[e]) for e in range(k) if follow[e] >= 0 and breaks(e))]
    runs = []
    for head in heads:
        run, e = [head], head
        while not breaks(e) and follow[e] != head:
            e = int(follow[e])
            run.append(e)
        runs.append(np.array(run))
    number, middle, sizes = np.zeros(k, np.int64), np.zeros(k), np.tile(length, (3, 1))
    for i, members in enumerate(runs):
        number[members] = i
        ends = np.cumsum(length[members])
        middle[members] = ends - 0.5 * length[members]
        between = np.interp(ends[:-1], middle[members], length[members])
        sizes[2, members[:-1]] = sizes[0, members[1:]] = between
    return Faces(tuple(runs), number, middle, sizes)


def _following(elements: IntArray) -> tuple[IntArray, list[int]]:
    """Return the element behind each, -1 for none, and those that none comes before."""
    by_first = {int(first): e for e, first in enumerate(elements[:, 0])}
    follow = np.array([by_first.get(int(last), -1) for last in elements[:, 2]])
    return follow, sorted(set(range(len(elements))) - set(follow.tolist()))
