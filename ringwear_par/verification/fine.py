"""Rings whose edges or faces differ in kind, and their fine solutions, stored with the package.

The stored ones are of 512 strongly graded elements, of the collocated equations as they are, not
made symmetric, and exact in time: where rings stay in full contact with p0 = 0, their wear is a sum
of exponentials. (Cones of 10 degrees lift off at their outer edge, and are stored unworn.)
``scripts/edge_references.py`` makes them, and holds them against finite elements and against a
second mesh.
"""

import json
import math
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np
from mpi4py import MPI
from scipy.interpolate import CubicSpline
from scipy.special import betaincinv

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import Case, Load, Output, Ring, Stepping
from ringwear_par.elasticity.bem.pair import ContactPair
from ringwear_par.elasticity.mesh import ContactLine, Mesh, contact_line
from ringwear_par.history.elastic.bodies import operator_key
from ringwear_par.history.elastic.pairs import assemble
from ringwear_par.verification.check import NU
from ringwear_par.wear.laws.threshold import ThresholdLaw

#: file of the stored solutions, beside this one
NAME = "edge_references.json"
#: radii of the contact (mm), force of 50 MPa on it (N), and how it wears: rad/s, 1/MPa
CONTACT, FORCE, SPEED, K = (28.5, 31.5), 28274.334, 17.0 / 3.0, 1e-7
#: s, times of the worn profiles
TIMES = (1.0, 10.0, 200.0)
#: mesh on whose rings stored solutions are: element means of coarser ones are sums of theirs
RINGS = Mesh(128)


@dataclass(frozen=True)
class Rings:
    """A pair of rings 20 mm high in the mean, the upper one 3 mm wide, both clamped."""

    #: radii, mm
    lower: tuple[float, float]
    #: MPa, of lower and upper
    young: tuple[float, float]
    #: by which both faces rise outwards; matched cones
    degrees: float = 0.0


_WIDE, _CONE = (20.0, 40.0), (1e4, 1e5)
#: where the pressure is singular at the edges, regular, or regular on a sloping face
SORTS = {
    "paper": Rings(_WIDE, _CONE),
    "soft on stiff": Rings(_WIDE, (1e5, 1e4)),
    "flush": Rings(CONTACT, (5e4, 1e4)),
    "flush, equal moduli": Rings(CONTACT, (5e4, 5e4)),
    "cones of 1 degree": Rings(CONTACT, _CONE, 1.0),
    "cones of 5 degrees": Rings(CONTACT, _CONE, 5.0),
    "cones of 10 degrees": Rings(CONTACT, _CONE, 10.0),
}


def ring_case(
    rings: Rings,
    mesh: Mesh,
    stepping: Stepping | None = None,
    k: tuple[float, float | None] = (K, None),
) -> Case:
    """Return the case of a pair of rings, adaptive to the last of TIMES where no steps are given.

    k, 1/MPa, is of lower and upper, p0 = 0; None does not wear.
    """
    rise = math.tan(math.radians(rings.degrees)) * (CONTACT[1] - CONTACT[0])
    faces = [((28.5, min(-r, 0.0)), (31.5, min(r, 0.0))) if r else () for r in (rise, -rise)]
    half = 0.5 * abs(rise)
    laws = [None if coefficient is None else ThresholdLaw(coefficient) for coefficient in k]
    return Case(
        Ring(rings.lower, (0.0, 20.0 + half), rings.young[0], NU, "clamped", faces[0]),
        Ring(CONTACT, (20.0 - half, 40.0), rings.young[1], NU, "clamped", faces[1]),
        0.1, laws[0], laws[1], Load(SPEED, FORCE),
        stepping or Stepping("adaptive", until=TIMES[-1]), mesh, Output(times=TIMES),
    )  # fmt: skip


class Pairs:
    """Contact pairs of shapes and meshes, each assembled once by ranks; they serve all moduli."""

    def __init__(self, comm: MPI.Comm) -> None:
        self._comm = comm
        self._pairs: dict[Hashable, ContactPair] = {}

    def of(self, case: Case) -> ContactPair:
        """Return the pair of a case. Collective."""
        key = operator_key(case)
        if key not in self._pairs:
            self._pairs[key] = assemble(case, self._comm)
        return self._pairs[key]


@dataclass(frozen=True)
class FineSolution:
    """A solution on the elements of a mesh."""

    #: whose contact line between the radii ``CONTACT`` it is on
    mesh: Mesh
    #: mm, unworn
    approach: float
    #: (n,) float, MPa, unworn, means over the elements
    pressure: FloatArray
    #: (n,) float, mm, off the lower ring by time (s), likewise; {} where faces lift off
    wear: dict[float, FloatArray]

    @property
    def line(self) -> ContactLine:
        """The elements."""
        return contact_line(CONTACT, self.mesh)

    def on(self, mesh: Mesh) -> "FineSolution":
        """Return the means over the elements of another mesh."""
        edges = contact_line(CONTACT, mesh).edges
        worn = {t: ring_means(self.mesh, w, edges) for t, w in self.wear.items()}
        return replace(
            self, mesh=mesh, pressure=ring_means(self.mesh, self.pressure, edges), wear=worn
        )


def ring_means(mesh: Mesh, field: FloatArray, radii: Sequence[float] | FloatArray) -> FloatArray:
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


@cache
def _stored() -> dict[str, Any]:
    return json.loads(files(__package__).joinpath(NAME).read_text("utf-8"))


def stored(name: str) -> FineSolution:
    """Return a stored solution of one of SORTS, by its name."""
    solution = _stored()[name]
    worn = {float(t): np.array(w) * 1e-3 for t, w in solution["wear_um"].items()}
    return FineSolution(RINGS, solution["approach_mm"], np.array(solution["pressure_mpa"]), worn)


def digits(name: str) -> dict[str, float]:
    """Return by how much a stored solution differs from that of another mesh.

    ``approach``, ``pressure`` (worst ring) and ``inside`` (worst from 0.02 mm on) relative,
    ``wear`` in mm.
    """
    return dict(_stored()[name]["digits"])
