"""Cases whose solutions are known: the paper's rings, and rings with other edges and faces."""

import math
from dataclasses import dataclass, replace

import numpy as np
from wearing import ThresholdLaw

from ringwear_par.cases.case import Case, Load, Output, Ring, Stepping

#: Poisson's ratio of all of them
NU = 0.3
#: our reading of the paper's speed, rad/s
OMEGA = 85.0 / 24.0
#: radii of the contact (mm), force of 50 MPa on it (N), and how other rings wear: rad/s, 1/MPa
CONTACT, FORCE, SPEED, K = (28.5, 31.5), 28274.334, 17.0 / 3.0, 1e-7
#: s, times of their worn profiles
TIMES = (1.0, 10.0, 200.0)


def paper_case(
    mesh,
    pressure=80.0,
    p0=(40.0, None),
    stepping=Stepping("implicit", 1.0, 200),  # noqa: B008  (it is frozen)
    young=100e3,
    k=(1e-7, 1e-7),
):
    """Return the paper's rings (load and speed are our reading), p0 of lower and upper in MPa."""
    laws = [ThresholdLaw(ki, pi) if pi is not None else None for ki, pi in zip(k, p0, strict=True)]
    case = Case(
        Ring((20.0, 40.0), (0.0, 20.0), 10e3, NU, "clamped"),
        Ring(CONTACT, (20.0, 40.0), young, NU, "clamped"),
        0.1, laws[0], laws[1], Load(OMEGA, 1.0), stepping, mesh, Output(),
    )  # fmt: skip
    return replace(case, load=Load(OMEGA, pressure * case.area))


def round_face(r, radius):
    """Return the face of a sphere (inner radius 0) or of a torus between two radii, 200 points."""
    samples = np.linspace(*r, 200)
    middle = 0.0 if r[0] == 0.0 else 0.5 * sum(r)
    fall = np.sqrt(radius**2 - (samples - middle) ** 2) - radius
    return tuple((float(a), float(b)) for a, b in zip(samples, fall, strict=True))


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


def ring_case(rings, mesh, stepping=None, k=(K, None)):
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


def moduli_of(case):
    """Return Young's moduli of lower and upper, MPa."""
    return case.lower.young, case.upper.young


def collocated(pair, moduli):
    """Return the compliance of a pair with Young's moduli (MPa), (n, n) mm/MPa."""
    return pair.normal[0] / moduli[0] + pair.normal[1] / moduli[1]
