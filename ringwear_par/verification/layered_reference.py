"""Exact solutions for bodies with bonded layers, of ``verify`` and of tests.

Fields that vary with the radius as Bessel functions of k r depend on the height by ordinary
differential equations. Through a layer they are solved by an exponential (Thomson, Haskell), and
for one layer on a half-space in closed form (Burmister, 1945). Units: mm, MPa.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm
from scipy.special import ellipe, j0, j1

from ringwear_par.arrays import FloatArray
from ringwear_par.elasticity.geometry.sections import Material
from ringwear_par.verification import reference

#: of the wave number times the thickness, from which on a layer hides what is below to 1e-15
_DEEP = 22.0


def shear_modulus(material: Material) -> float:
    """Return G (MPa)."""
    return 0.5 * material.young / (1.0 + material.poisson)


def burmister(x: FloatArray, layer: Material, base: Material) -> FloatArray:
    """Return the deflection of a bonded layer on a half-space under pressure J0(k r), no shear.

    Parameters
    ----------
    x : wave number k times the thickness of the layer.

    Returns
    -------
    That over what a half-space of the layer's material does, (1 - nu) / (G k).
    """
    ratio = shear_modulus(layer) / shear_modulus(base)
    one, two = 3.0 - 4.0 * layer.poisson, 3.0 - 4.0 * base.poisson
    lam = 1.0 - (1.0 + one) / (1.0 + ratio * two)
    kappa = (ratio - 1.0) / (ratio + one)
    th = np.exp(-2.0 * x)
    above = 1.0 + 4.0 * kappa * x * th - lam * kappa * th**2
    return above / (1.0 - (lam + kappa + 4.0 * kappa * x**2) * th + lam * kappa * th**2)


def normal_mode(k: float, layers: Sequence[tuple[float, Material]]) -> FloatArray:
    """Return the field under pressure J0(k r) on bonded layers, the last held at its base.

    Parameters
    ----------
    k : 1/mm.
    layers : thickness and material, from the top downwards.

    Returns
    -------
    (layers + 1, 4): amplitudes of u_r and sigma_rz, times J1(k r), and of u_z and sigma_zz, times
    J0(k r), in the order u_r, u_z, sigma_rz, sigma_zz; at the top, the interfaces and the base.
    """
    through = [expm(h * mode_matrix(k, material)) for h, material in layers]
    up = [np.eye(4)]  # from the base to each level
    for step in reversed(through):
        up.insert(0, step @ up[0])
    base = np.zeros(4)
    base[2:] = np.linalg.solve(up[0][2:, 2:], [0.0, -1.0])
    return np.array([step @ base for step in up])


def mode_matrix(k: float, material: Material) -> FloatArray:
    """Return A of y' = A y along z, y being the four amplitudes of ``normal_mode``."""
    nu, shear = material.poisson, shear_modulus(material)
    lame = 2.0 * shear * nu / (1.0 - 2.0 * nu)
    whole = lame + 2.0 * shear
    return np.array(
        [
            [0.0, k, 1.0 / shear, 0.0],
            [-k * lame / whole, 0.0, 0.0, 1.0 / whole],
            [k * k * (whole - lame * lame / whole), 0.0, 0.0, k * lame / whole],
            [0.0, 0.0, -k, 0.0],
        ]
    )


def torsion_mode(k: float, layers: Sequence[tuple[float, Material]]) -> FloatArray:
    """Return the field under shear J1(k r) on bonded layers, the last held at its base.

    Parameters are those of ``normal_mode``.

    Returns
    -------
    (layers + 1, 2): amplitudes of u_theta and sigma_ztheta, times J1(k r), at the top, the
    interfaces and the base.
    """
    up = [np.array([0.0, 1.0])]
    for h, material in reversed(layers):
        shear = shear_modulus(material)
        u, t = up[0]
        grown, other = math.cosh(k * h), math.sinh(k * h)
        up.insert(0, np.array([grown * u + other / (k * shear) * t, k * shear * other * u
                               + grown * t]))  # fmt: skip
    return np.array(up) / up[0][1]


@dataclass(frozen=True)
class LayeredHalfSpace:
    """A half-space with one bonded layer, loaded without shear.

    Parameters
    ----------
    thickness : mm, of the layer.
    layer, base : materials.
    """

    thickness: float
    layer: Material
    base: Material

    def bathed_circle(self, r: FloatArray) -> FloatArray:
        """Return u_z (mm, downwards) at radii r <= 1 mm under pressure 1 on the circle r < 1."""
        k, weight = self._waves()
        more = (weight * j1(k) / k) @ j0(k[:, None] * r)
        return self._compliance * (2.0 / math.pi * ellipe(r**2) + more)

    @property
    def _compliance(self) -> float:
        """(1 - nu) / G of the layer."""
        return (1.0 - self.layer.poisson) / shear_modulus(self.layer)

    def _waves(self) -> tuple[FloatArray, FloatArray]:
        """Return wave numbers, and at each the weight of Burmister's function less one.

        They integrate products of it with waves and Bessel functions of two radii up to 1 mm.
        """
        last = _DEEP / self.thickness
        n = 64 + math.ceil(1.2 * last)
        x, w = np.polynomial.legendre.leggauss(64)
        panels = np.linspace(0.0, last, math.ceil(n / 64) + 1)
        half = 0.5 * np.diff(panels)
        k = (panels[:-1, None] + half[:, None] * (1.0 + x)).ravel()
        weight = (half[:, None] * w).ravel()
        return k, weight * (burmister(k * self.thickness, self.layer, self.base) - 1.0)

    def punch(self, r: FloatArray) -> tuple[float, FloatArray]:
        """Return the force of a rigid flat punch of radius 1 per approach, and its share within r.

        With the pressure's transform A(k) = Int_0^1 phi(t) cos(k t) dt, the dual integral equations
        become one of the second kind (Copson, 1961; Lebedev and Ufliand, 1958),

            phi(t) + (2/pi) Int_0^1 phi(s) Int_0^inf (F - 1) cos(k t) cos(k s) dk ds = (2/pi) delta,

        delta over (1 - nu) / G, which is solved at Gauss points (Nystrom).

        Parameters
        ----------
        r : mm, radii up to 1.
        """
        t, w = np.polynomial.legendre.leggauss(64 + math.ceil(8.0 / self.thickness))
        t, w = 0.5 * (1.0 + t), 0.5 * w
        k, weight = self._waves()
        waves = np.cos(k[:, None] * t)
        kernel = 2.0 / math.pi * waves.T @ (weight[:, None] * waves)
        unit = 2.0 / math.pi / self._compliance
        phi = np.linalg.solve(np.eye(len(t)) + kernel * w, np.full(len(t), unit))
        force = 2.0 * math.pi * w @ phi
        # phi at sqrt(r^2 + s^2), s being Gauss points up to where that is 1
        end = np.sqrt(1.0 - r**2)
        at = np.sqrt(r[:, None] ** 2 + (end[:, None] * t) ** 2)
        spectrum = weight * (waves @ (w * phi))
        # radius by radius: all at once are gigabytes of waves
        moments = [np.cos(points[:, None] * k) @ spectrum @ w for points in at]
        rest = unit * w.sum() - 2.0 / math.pi * np.array(moments)
        return float(force), 1.0 - 2.0 * math.pi / force * end * rest


def sleeve_pressure(
    radii: tuple[float, float, float], inner: float, outer: float, materials: Sequence[Material]
) -> float:
    """Return the pressure (MPa) between two bonded rings in plane strain under pressure.

    Parameters
    ----------
    radii : mm, of the bore, the interface and the outside.
    inner, outer : MPa, pressures there.
    materials : of the inner and the outer ring.
    """
    a, c, b = radii
    within, around = materials

    def apart(pressure: float) -> float:
        return float(
            reference.lame_displacement(np.array(c), c, b, pressure, outer, *_both(around))
            - reference.lame_displacement(np.array(c), a, c, inner, pressure, *_both(within))
        )

    return apart(0.0) / (apart(0.0) - apart(1.0))


def _both(material: Material) -> tuple[float, float]:
    return material.young, material.poisson
