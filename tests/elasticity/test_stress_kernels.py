"""Stress kernels against their integrals over theta."""

import numpy as np
import pytest

from ringwear_par.elasticity._rings import stress_kernels

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
    got = stress_kernels(np.array([[r], [a], [b], [nr], [nz]]), NU)[:, 0]
    for part, exact in zip(
        np.split(got, 2), somigliana_over_the_ring(r, a, b, nr, nz), strict=True
    ):
        assert part == pytest.approx(exact, rel=1e-11, abs=1e-12 * np.abs(exact).max())
