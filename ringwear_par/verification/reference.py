"""Exact and converged solutions, for tests and ``ringwear verify``. Units: mm, N, MPa, s."""

import math
from collections.abc import Callable, Iterable

import numpy as np

from ringwear_par.arrays import FloatArray

#: rigid flat annulus a/b on a half-space: F / (2 E* b delta), and p(mid) / p(mean)
ANNULUS = {
    0.25: (0.99783289, 0.60987),
    0.5: (0.98101790, 0.62600),
    0.75: (0.92126984, 0.63400),
    0.9: (0.82102978, 0.63615),
}
#: exponent of the pressure at a frictionless 90-degree corner on a half-plane, nu = 0.3, by E2/E1
EDGE_EXPONENT = {
    1.0: -0.2260, 2.0: -0.3103, 5.0: -0.4005, 10.0: -0.4443, 100.0: -0.4937, math.inf: -0.5,
}  # fmt: skip
#: decay exp(-L kappa omega E* t) to the steady state, rigid annulus a/b = 0.5, two lowest L
DECAY_FORCE = (2.749, 4.963)
DECAY_APPROACH = (0.5747, 2.853)
#: explicit limit on uniform constant elements: wear per step < this x h p / E*
EXPLICIT_LIMIT = 1.485
#: paper's rings, unworn, 50 MPa mean pressure (28274.334 N), top clamped, mu = 0.1: an independent
#: finite element solution; pressures by radius
PAPER_APPROACH = 0.0365486
PAPER_TORQUE = 84908.2
PAPER_PRESSURE = {30.0: 34.392, 28.6: 85.388, 31.4: 84.186}
#: the same, lower with a bonded layer of E = 100 GPa, nu = 0.3, 0.05 mm thick
COATED_APPROACH = 0.0360214
COATED_PRESSURE = {30.0: 33.576, 28.6: 61.120, 31.4: 60.176}
#: stresses (MPa) of the lower one of them by kind and depth (mm) under r = 30
PAPER_STRESS = {
    ("von Mises", 0.05): 15.4735, ("von Mises", 0.2): 15.7083,
    ("largest shear", 0.05): 8.7740, ("largest shear", 0.2): 9.0225,
}  # fmt: skip
#: other rings under the same load (see ``fine``), independent finite elements: approach (mm), p(30)
#: and mean pressures (MPa) at the inner and the outer edge, between these distances (mm) from it
EDGE_DISTANCES = (0.0, 0.001, 0.005, 0.02, 0.1, 0.3)
EDGE_APPROACH = {"soft on stiff": 0.0993234, "flush": 0.1158667}
EDGE_MIDDLE = {"soft on stiff": 48.83, "flush": 50.06}
EDGE_PRESSURE = {
    "soft on stiff": (
        (71.37, 66.08, 62.49, 58.68, 55.48),
        (60.33, 55.89, 52.93, 50.01, 48.04),
    ),
    "flush": (
        (54.43, 54.42, 54.40, 54.26, 53.85),
        (45.76, 45.77, 45.79, 45.93, 46.32),
    ),
}
#: matched cones on flush rings, E = 1e4 under 1e5, same load, independent finite elements: approach
#: (mm) and pressures (MPa) at these radii (mm), by the degrees by which the faces rise outwards
CONE_RADII = (28.6, 29.0, 30.0, 31.0, 31.4)
CONE_APPROACH = {0.0: 0.106211, 1.0: 0.107978, -1.0: 0.104985}
CONE_PRESSURE = {
    1.0: (60.03, 56.24, 50.07, 44.07, 40.74),
    -1.0: (48.43, 49.71, 50.00, 50.24, 51.49),
}


def contact_modulus(*bodies: tuple[float, float]) -> float:
    """Return E* (MPa) of bodies given as (E, nu): 1/E* = Sum (1 - nu^2)/E."""
    return 1.0 / sum((1.0 - nu * nu) / young for young, nu in bodies)


def lame_displacement(
    r: FloatArray, a: float, b: float, inner: float, outer: float, young: float, nu: float
) -> FloatArray:
    """Return u_r (mm) of a ring a < r < b in plane strain under inner and outer pressure (MPa)."""
    big_a = (inner * a * a - outer * b * b) / (b * b - a * a)
    big_b = (inner - outer) * a * a * b * b / (b * b - a * a)
    return (1.0 + nu) / young * ((1.0 - 2.0 * nu) * big_a * r + big_b / r)


def polar_moment(a: float, b: float) -> float:
    """Return J (mm^4) of a ring a < r < b."""
    return 0.5 * math.pi * (b**4 - a**4)


def flat_cylinder_force(modulus: float, a: float, approach: float) -> float:
    """Return the force (N) of a rigid flat cylinder of radius a on a half-space."""
    return 2.0 * modulus * a * approach


def flat_cylinder_pressure(a: float, r: FloatArray) -> FloatArray:
    """Return the mean of p over the rings between radii r (mm), relative to F / (pi a^2)."""
    return -np.diff(np.sqrt(1.0 - (r / a) ** 2)) * a * a / np.diff(r**2)


def hertz(modulus: float, radius: float, approach: float) -> tuple[float, float, float]:
    """Return force (N), contact radius (mm) and largest pressure (MPa) of a rigid sphere."""
    force = 4.0 / 3.0 * modulus * math.sqrt(radius) * approach**1.5
    a = math.sqrt(radius * approach)
    return force, a, 1.5 * force / (math.pi * a * a)


def hertz_stress(r: FloatArray, depth: FloatArray, nu: float) -> FloatArray:
    """Return (p, 4) rr, tt, zz, rz of a half-space under sqrt(1 - r^2), z upwards (Huber)."""
    x = r * r + depth * depth - 1.0
    u = 0.5 * (x + np.hypot(x, 2.0 * depth))  # of the ellipsoid through the point
    s = np.sqrt(u)
    cosine, arc = depth / s, s * np.arctan(1.0 / s)
    square = u / (u * u + depth * depth)
    safe = np.where(r > 0.0, r, 1.0)
    lateral = (1.0 - 2.0 * nu) / 3.0 * (1.0 - cosine**3) / safe**2
    rr = lateral + cosine**3 * square
    rr += cosine * (u * (1.0 - nu) / (1.0 + u) + (1.0 + nu) * arc - 2.0)
    tt = -lateral - cosine * (2.0 * nu + u * (1.0 - nu) / (1.0 + u) - (1.0 + nu) * arc)
    on_axis = -(1.0 + nu) * (1.0 - depth * np.arctan(1.0 / depth)) + 0.5 / (1.0 + depth**2)
    rr, tt = (np.where(r > 0.0, stress, on_axis) for stress in (rr, tt))
    rz = r * depth**2 / (u * u + depth * depth) * s / (1.0 + u)
    return np.stack([rr, tt, -(cosine**3) * square, rz], axis=1)


def hertz_largest_shear(nu: float) -> tuple[float, float]:
    """Return the largest shear stress over p_max, and its depth over a, on the axis of Hertz."""
    depth = np.linspace(0.3, 0.7, 40001)
    rr, _, zz, _ = hertz_stress(np.zeros_like(depth), depth, nu).T
    shear = 0.5 * np.abs(rr - zz)
    return float(shear.max()), float(depth[shear.argmax()])


def torsion_stress(
    r: FloatArray, depth: FloatArray, transformed: Callable[[FloatArray], FloatArray]
) -> FloatArray:
    """Return (p, 2) rt, tz of a half-space under circumferential tractions q(r), z upwards.

    Parameters
    ----------
    depth : > 0.05 or so, as the integrals over wave numbers are cut.
    transformed : Int q r J1(x r) dr of wave numbers x.
    """
    from scipy.special import jv

    nodes, weights = np.polynomial.legendre.leggauss(2000)
    most = 40.0 / depth.min()
    x, w = 0.5 * most * (nodes + 1.0), 0.5 * most * weights
    values = w * x * transformed(x) * np.exp(-x * depth[:, None])
    waves = x * r[:, None]
    return np.stack([-(values * jv(2, waves)).sum(1), (values * jv(1, waves)).sum(1)], axis=1)


def hertz_shear(x: FloatArray) -> FloatArray:
    """Return Int q r J1(x r) dr of q = sqrt(1 - r^2) on r < 1."""
    from scipy.special import jv

    nodes, weights = np.polynomial.legendre.leggauss(400)
    phi, w = 0.25 * math.pi * (nodes + 1.0), 0.25 * math.pi * weights
    values = w * np.sin(phi) * np.cos(phi) ** 2 * jv(1, x[:, None] * np.sin(phi))
    return values.sum(1)


def reissner_sagoci_shear(shear: float, x: FloatArray) -> FloatArray:
    """Return Int q r J1(x r) dr of q = 4 G r / (pi sqrt(1 - r^2)), of a disc turned by 1 rad."""
    return 4.0 * shear / math.pi * (np.sin(x) - x * np.cos(x)) / x**2


def cone_force(modulus: float, slope: float, approach: float) -> float:
    """Return the force (N) of a rigid cone whose flank has that slope (tangent) to the plane."""
    return 2.0 * modulus * approach**2 / (math.pi * slope)


def reissner_sagoci_torque(shear: float, a: float, angle: float) -> float:
    """Return the torque (N mm) that turns a disc of radius a on a half-space by an angle (rad)."""
    return 16.0 / 3.0 * shear * a**3 * angle


def steady_constant(force: float, p0: float, a: float, b: float) -> float:
    """Return c (N/mm) of the steady pressure p0 + c/r at constant force in full contact."""
    return (force - math.pi * p0 * (b * b - a * a)) / (2.0 * math.pi * (b - a))


def bathed_approach(apexes: Iterable[float], young: Iterable[float], nu: float, p: float) -> float:
    """Return the approach (mm) of matched cones all of whose free faces bear p (MPa) as well.

    Both bodies shrink in proportion, cones stay cones, and their contact bears p everywhere.

    Parameters
    ----------
    apexes : mm, heights of the apex of the cones above the fixed faces, which leave u_r free.
    """
    return (1.0 - 2.0 * nu) * p * sum(h / e for h, e in zip(apexes, young, strict=True))
