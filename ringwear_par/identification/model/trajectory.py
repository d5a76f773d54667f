"""A history, as far as measurements can see it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import Case
from ringwear_par.elasticity.stress.boundary_fields import BODIES


@dataclass(frozen=True, eq=False)
class Trajectory:
    """What is read of a history, at its steps, the start included.

    The last axis of all but ``time`` holds the value and, where there are any, its derivatives.

    Parameters
    ----------
    time : (s,) s.
    approach : (s, q) mm.
    torque : (s, q) N mm.
    volume : (2, s, q) mm^3, worn off lower and upper.
    wear : (2, s, n, q) mm.
    mass : (2, s, q) g, lost by lower and upper by the densities of their layers; NaN where these
        are not known.
    """

    time: FloatArray
    approach: FloatArray
    torque: FloatArray
    volume: FloatArray
    wear: FloatArray
    mass: FloatArray


def lost_mass(case: Case, body: int, wear: FloatArray, keys: Sequence[str] = ()) -> FloatArray:
    """Return the mass (g) that layers and body of lower (0) or upper (1) have lost, (s, q).

    NaN where a density is not known, and of a body without layers, whose volume tells it.

    Parameters
    ----------
    wear : (s, n, q) mm, along the axis, and its derivatives.
    keys : of the q - 1 derivatives, of which thicknesses of layers move where these end.
    """
    ring = case.rings[body]
    if not ring.layers or None in ring.densities:
        return np.full((len(wear), wear.shape[-1]), np.nan)
    densities = np.array(ring.densities, dtype=float)
    depth = densities[-1] * wear  # of mass
    names = [f"{BODIES[body]}.layers[{i}].thickness" for i in range(len(ring.layers))]
    for i, (end, more) in enumerate(
        zip(case.layer_ends(body), densities[:-1] - densities[1:], strict=True)
    ):
        ends = np.zeros((len(end), wear.shape[-1]))
        ends[:, 0] = end
        ends[:, 1:] = [float(key in names[: i + 1]) for key in keys]
        depth = depth + more * np.where(wear[..., :1] < end[:, None], wear, ends)
    return np.einsum("e,seq->sq", case.line.area, depth)
