"""Exact and converged solutions. Units: mm, N, MPa, s.

Bodies with bonded layers: fields that vary with the radius as Bessel functions of k r depend on the
height by ordinary differential equations. Through a layer they are solved by an exponential
(Thomson, Haskell), and for one layer on a half-space in closed form (Burmister, 1945).
"""

import math

import numpy as np
from scipy.linalg import expm
from scipy.special import ellipe, j0, j1, jv

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
#: other rings under the same load (see ``reference_cases``), independent finite elements: approach
#: (mm), p(30) and mean pressures (MPa) at the inner and the outer edge, between distances (mm)
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


def contact_modulus(*bodies):
    """Return E* (MPa) of bodies given as (E, nu): 1/E* = Sum (1 - nu^2)/E."""
    return 1.0 / sum((1.0 - nu * nu) / young for young, nu in bodies)


def lame_displacement(r, a, b, inner, outer, young, nu):
    """Return u_r (mm) of a ring a < r < b in plane strain under inner and outer pressure (MPa)."""
    big_a = (inner * a * a - outer * b * b) / (b * b - a * a)
    big_b = (inner - outer) * a * a * b * b / (b * b - a * a)
    return (1.0 + nu) / young * ((1.0 - 2.0 * nu) * big_a * r + big_b / r)


def flat_cylinder_pressure(r):
    """Return the mean of p over the rings between radii r <= 1, relative to the mean of all."""
    return -np.diff(np.sqrt(1.0 - r**2)) / np.diff(r**2)


def hertz(modulus, radius, approach):
    """Return force (N), contact radius (mm) and largest pressure (MPa) of a rigid sphere."""
    force = 4.0 / 3.0 * modulus * math.sqrt(radius) * approach**1.5
    a = math.sqrt(radius * approach)
    return force, a, 1.5 * force / (math.pi * a * a)


def hertz_stress(r, depth, nu):
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


def hertz_largest_shear(nu):
    """Return the largest shear stress over p_max, and its depth over a, on the axis of Hertz."""
    depth = np.linspace(0.3, 0.7, 40001)
    rr, _, zz, _ = hertz_stress(np.zeros_like(depth), depth, nu).T
    shear = 0.5 * np.abs(rr - zz)
    return float(shear.max()), float(depth[shear.argmax()])


def torsion_stress(r, depth, transformed):
    """Return (p, 2) rt, tz of a half-space under circumferential tractions q(r), z upwards.

    Depths are > 0.05 or so, as the integrals over wave numbers x are cut; ``transformed`` is a
    function of them, Int q r J1(x r) dr.
    """
    nodes, weights = np.polynomial.legendre.leggauss(2000)
    most = 40.0 / depth.min()
    x, w = 0.5 * most * (nodes + 1.0), 0.5 * most * weights
    values = w * x * transformed(x) * np.exp(-x * depth[:, None])
    waves = x * r[:, None]
    return np.stack([-(values * jv(2, waves)).sum(1), (values * jv(1, waves)).sum(1)], axis=1)


def hertz_shear(x):
    """Return Int q r J1(x r) dr of q = sqrt(1 - r^2) on r < 1."""
    nodes, weights = np.polynomial.legendre.leggauss(400)
    phi, w = 0.25 * math.pi * (nodes + 1.0), 0.25 * math.pi * weights
    return (w * np.sin(phi) * np.cos(phi) ** 2 * j1(x[:, None] * np.sin(phi))).sum(1)


def reissner_sagoci_shear(shear, x):
    """Return Int q r J1(x r) dr of q = 4 G r / (pi sqrt(1 - r^2)), of a disc turned by 1 rad."""
    return 4.0 * shear / math.pi * (np.sin(x) - x * np.cos(x)) / x**2


def reissner_sagoci_torque(shear):
    """Return the torque (N mm) that turns a disc of radius 1 mm on a half-space by 1 rad."""
    return 16.0 / 3.0 * shear


def steady_constant(force, p0, a, b):
    """Return c (N/mm) of the steady pressure p0 + c/r at constant force in full contact."""
    return (force - math.pi * p0 * (b * b - a * a)) / (2.0 * math.pi * (b - a))


def shear_modulus(material):
    """Return G (MPa)."""
    return 0.5 * material.young / (1.0 + material.poisson)


def bathed_circle(r, thickness, layer, base):
    """Return u_z (mm, downwards) of a layered half-space under pressure 1 on r < 1, without shear.

    A layer and a base are materials, radii r <= 1. Burmister's function is what the surface gives
    way under pressure J0(k r), over what a half-space of the layer's material does.
    """
    last = 22.0 / thickness  # above it the layer hides what is below to 1e-15
    panels = np.linspace(0.0, last, 2 + math.ceil(last / 50.0))
    x, w = np.polynomial.legendre.leggauss(64)
    half = 0.5 * np.diff(panels)
    k = (panels[:-1, None] + half[:, None] * (1.0 + x)).ravel()
    weight = (half[:, None] * w).ravel()
    ratio = shear_modulus(layer) / shear_modulus(base)
    layer_factor, base_factor = 3.0 - 4.0 * layer.poisson, 3.0 - 4.0 * base.poisson
    lam = 1.0 - (1.0 + layer_factor) / (1.0 + ratio * base_factor)
    kappa = (ratio - 1.0) / (ratio + layer_factor)
    kh = k * thickness
    th = np.exp(-2.0 * kh)
    above = 1.0 + 4.0 * kappa * kh * th - lam * kappa * th**2
    burmister = above / (1.0 - (lam + kappa + 4.0 * kappa * kh**2) * th + lam * kappa * th**2)
    more = (weight * (burmister - 1.0) * j1(k) / k) @ j0(k[:, None] * r)
    return (1.0 - layer.poisson) / shear_modulus(layer) * (2.0 / math.pi * ellipe(r**2) + more)


def normal_mode(k, layers):
    """Return the field under pressure J0(k r) on bonded layers, the last held at its base.

    Layers are thickness and material, from the top downwards. (layers + 1, 4): amplitudes of u_r
    and sigma_rz, times J1(k r), and of u_z and sigma_zz, times J0(k r), in the order u_r, u_z,
    sigma_rz, sigma_zz; at the top, the interfaces and the base.
    """
    up = [np.eye(4)]  # from the base to each level
    for h, material in reversed(layers):
        nu, shear = material.poisson, shear_modulus(material)
        lame = 2.0 * shear * nu / (1.0 - 2.0 * nu)
        whole = lame + 2.0 * shear
        matrix = np.array([  # of y' = A y along z
            [0.0, k, 1.0 / shear, 0.0],
            [-k * lame / whole, 0.0, 0.0, 1.0 / whole],
            [k * k * (whole - lame * lame / whole), 0.0, 0.0, k * lame / whole],
            [0.0, 0.0, -k, 0.0],
        ])  # fmt: skip
        up.insert(0, expm(h * matrix) @ up[0])
    base = np.zeros(4)
    base[2:] = np.linalg.solve(up[0][2:, 2:], [0.0, -1.0])
    return np.array([step @ base for step in up])


def torsion_mode(k, layers):
    """Return the field under shear J1(k r) on bonded layers, as ``normal_mode`` does.

    (layers + 1, 2): amplitudes of u_theta and sigma_ztheta, times J1(k r).
    """
    up = [np.array([0.0, 1.0])]
    for h, material in reversed(layers):
        stiff, (u, t) = k * shear_modulus(material), up[0]
        cosh, sinh = math.cosh(k * h), math.sinh(k * h)
        up.insert(0, np.array([cosh * u + sinh / stiff * t, stiff * sinh * u + cosh * t]))
    return np.array(up) / up[0][1]
