"""Stress kernels against their integrals over theta, with mpmath where digits are at stake."""

import mpmath
import numpy as np
import pytest

from ringwear_par.elasticity.bem.kernels import TILE
from ringwear_par.elasticity.stress.kernels import (
    N_KERNELS,
    STRESS_TILE_ROWS,
    fill_stress_tile,
    seventh_moments,
)

NU = 0.3
PLACES = [
    (30.0, 5.0, 3.0),
    (30.0, 0.06, -0.08),
    (30.0, -29.99, 4.0),  # field point near the axis
    (0.01, 20.0, 20.0),  # source near the axis
    (0.0, 2.0, 1.0),  # on it
    (1.0, 3.0, 2.0),  # both sides of the switch from recursion to quadrature
    (1.0, 4.0, 6.5),
]


@pytest.mark.parametrize(("r", "a", "b"), [*PLACES, (30.0, 1e-4, -2e-4)])
def test_seventh_moments_to_eleven_digits(r, a, b):
    near2, span2 = mpmath.mpf(a) ** 2 + mpmath.mpf(b) ** 2, 4 * mpmath.mpf(r) * (r + mpmath.mpf(a))
    reach = mpmath.sqrt(near2 / span2) if span2 else 1
    cuts = [0, *sorted({min(reach * 10**k, mpmath.pi / 2) for k in range(7)}), mpmath.pi / 2]
    with mpmath.workdps(30):
        for q, value in enumerate(seventh_moments(r, a, b)):

            def integrand(phi, q=q):
                s2 = mpmath.sin(phi) ** 2
                return s2**q / (near2 + span2 * s2) ** mpmath.mpf(3.5)

            exact = 4 * mpmath.quad(integrand, sorted(set(cuts)))
            assert value == pytest.approx(float(exact), rel=1e-11)


def somigliana_over_the_ring(r, a, b, nr, nz, n=200_000):
    """Integrate the tensors D and S over theta by the trapezoidal rule, as they are printed."""
    r1, shear = r + a, 0.5 / (1 + NU)
    theta = 2 * np.pi * (np.arange(n) + 0.5) / n
    zero, c, s = np.zeros(n), np.cos(theta), np.sin(theta)
    away = np.array([a - 2 * r1 * np.sin(0.5 * theta) ** 2, r1 * s, b + zero])
    distance = np.linalg.norm(away, axis=0)
    away /= distance
    normal = np.array([nr * c, nr * s, nz + zero])
    rn = (away * normal).sum(0)
    along = {"r": [c, s, zero], "z": [zero, zero, zero + 1], "t": [-s, c, zero]}
    index = {"rr": (0, 0), "tt": (1, 1), "zz": (2, 2), "rz": (0, 2), "rt": (0, 1), "tz": (1, 2)}
    pairs = [("r", "rr tt zz rz"), ("z", "rr tt zz rz"), ("t", "rt tz")]
    d, big_s = [], []
    for k, components in pairs:
        e = np.array(along[k])
        re, ne = (away * e).sum(0), (normal * e).sum(0)
        for name in components.split():
            i, j = index[name]
            delta, rij = float(i == j), away[i] * away[j]
            d.append((1 - 2 * NU) * (e[i] * away[j] + e[j] * away[i] - delta * re) + 3 * rij * re)
            big_s.append(
                3 * rn * ((1 - 2 * NU) * delta * re + NU * (e[i] * away[j] + e[j] * away[i]))
                - 15 * rn * rij * re
                + 3 * NU * (normal[i] * away[j] + normal[j] * away[i]) * re
                + (1 - 2 * NU) * (3 * ne * rij + normal[j] * e[i] + normal[i] * e[j])
                - (1 - 4 * NU) * ne * delta
            )
    ring = 2 * np.pi * r1
    return (
        ring * (np.array(d) / distance**2).mean(1) / (8 * np.pi * (1 - NU)),
        ring * (np.array(big_s) / distance**3).mean(1) * shear / (4 * np.pi * (1 - NU)),
    )


@pytest.mark.parametrize(("r", "a", "b"), PLACES)
def test_kernels_are_the_printed_tensors(r, a, b):
    nr, nz = np.cos(0.7), np.sin(0.7)
    tile = np.zeros(STRESS_TILE_ROWS * TILE)
    for row, value in enumerate((a, b, nr, nz)):
        tile[row * TILE : row * TILE + 3] = value
    fill_stress_tile(tile, 3, r, NU)
    for i in (0, 2):
        got = tile[4 * TILE + i :: TILE]
        for part, exact in zip(
            (got[:N_KERNELS], got[N_KERNELS:]),
            somigliana_over_the_ring(r, a, b, nr, nz),
            strict=True,
        ):
            assert part == pytest.approx(exact, rel=1e-11, abs=1e-12 * np.abs(exact).max())
