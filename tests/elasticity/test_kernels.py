"""Ring kernels against their integrals over theta, with mpmath where digits are at stake."""

import mpmath
import numpy as np
import pytest

from ringwear_par.elasticity.kernels import elliptic, moments, ring_kernels

NU = 0.3
POWERS = [(1, 0), (1, 1), (3, 0), (3, 1), (3, 2), (5, 0), (5, 1), (5, 2), (5, 3)]


@pytest.mark.parametrize("m1", [1.0, 0.7, 0.1, 1e-3, 1e-8, 1e-15])
def test_elliptic_integrals_keep_their_digits(m1):
    with mpmath.workdps(40):
        exact = mpmath.ellipk(1 - mpmath.mpf(m1)), mpmath.ellipe(1 - mpmath.mpf(m1))
    assert elliptic(m1) == pytest.approx([float(v) for v in exact], rel=3e-15)


@pytest.mark.parametrize(
    ("r", "a", "b"),
    [
        (30.0, 5.0, 3.0),
        (30.0, 0.006, -0.008),  # 0.01 mm from the ring
        (30.0, 1e-6, 1e-6),
        (30.0, -29.99, 4.0),  # field point near the axis
        (0.01, 20.0, 20.0),  # source near the axis
        (0.0, 2.0, 1.0),  # on it
        (1.0, 3.0, 2.0),  # both sides of the switch from recursion to quadrature
        (1.0, 4.0, 6.5),
    ],
)
def test_moments_to_twelve_digits(r, a, b):
    got = moments(r, a, b)
    near2, span2 = mpmath.mpf(a) ** 2 + mpmath.mpf(b) ** 2, 4 * mpmath.mpf(r) * (r + mpmath.mpf(a))
    reach = mpmath.sqrt(near2 / span2) if span2 else 1
    cuts = [0, *sorted({min(reach * 10**k, mpmath.pi / 2) for k in range(9)}), mpmath.pi / 2]
    with mpmath.workdps(30):
        for value, (p, q) in zip(got, POWERS, strict=True):

            def integrand(phi, p=p, q=q):
                s2 = mpmath.sin(phi) ** 2
                return s2**q / (near2 + span2 * s2) ** (mpmath.mpf(p) / 2)

            exact = 4 * mpmath.quad(integrand, sorted(set(cuts)))
            assert value == pytest.approx(float(exact), rel=1e-12)


def kelvin_over_the_ring(r, a, b, nr, nz, n=200_000):
    """Integrate the Kelvin tensors over theta by the trapezoidal rule, as they are printed."""
    r1, shear = r + a, 0.5 / (1 + NU)
    theta = 2 * np.pi * (np.arange(n) + 0.5) / n
    zero, one = np.zeros(n), np.ones(n)
    at_y = {
        "r": np.array([np.cos(theta), np.sin(theta), zero]),
        "z": np.array([zero, zero, one]),
        "t": np.array([-np.sin(theta), np.cos(theta), zero]),
    }
    at_x = {key: np.array(v)[:, None] * one for key, v in
            {"r": [1, 0, 0], "z": [0, 0, 1], "t": [0, 1, 0]}.items()}  # fmt: skip
    y = np.array([r1 * np.cos(theta), r1 * np.sin(theta), b + zero])
    d = y - np.array([[r], [0.0], [0.0]])
    dist = np.linalg.norm(d, axis=0)
    normal = nr * at_y["r"] + nz * at_y["z"]
    u, t = {}, {}
    for k in "rzt":
        for i in "rzt":
            ek, ei = at_x[k], at_y[i]
            dk, di, dn = (d * ek).sum(0) / dist, (d * ei).sum(0) / dist, (d * normal).sum(0) / dist
            delta = (ek * ei).sum(0)
            u_ki = ((3 - 4 * NU) * delta + dk * di) / (16 * np.pi * shear * (1 - NU) * dist)
            nk, ni = (normal * ek).sum(0), (normal * ei).sum(0)
            t_ki = -(dn * ((1 - 2 * NU) * delta + 3 * dk * di) - (1 - 2 * NU) * (dk * ni - di * nk))
            t_ki /= 8 * np.pi * (1 - NU) * dist**2
            u[k + i], t[k + i] = (2 * np.pi * r1 * v.mean() for v in (u_ki, t_ki))
    return u, t


@pytest.mark.parametrize(
    ("r", "a", "b", "nr", "nz"),
    [
        (30.0, 0.5, 0.3, 0.6, 0.8),
        (30.0, -2.0, 5.0, 0.0, 1.0),
        (3.0, 0.01, 0.02, 1.0, 0.0),
        (0.5, 30.0, 10.0, 0.6, -0.8),
        (0.0, 3.0, 1.0, 0.6, 0.8),
        (30.0, -30.0, 3.0, 0.0, 1.0),  # field point on the axis: no surface there
    ],
)
def test_ring_kernels_are_the_integrated_kelvin_solution(r, a, b, nr, nz):
    u, t = kelvin_over_the_ring(r, a, b, nr, nz)
    exact = [
        u["rr"],
        u["rz"],
        u["zr"],
        u["zz"],
        t["rr"],
        t["rz"],
        t["zr"],
        t["zz"],
        u["tt"],
        t["tt"],
    ]
    got = ring_kernels(r, a, b, nr, nz, NU)
    scale = max(map(abs, exact)) or 1.0
    assert got == pytest.approx(exact, abs=1e-12 * scale)
    # theta uncouples
    for key in ("rt", "tr", "zt", "tz"):
        assert abs(u[key]) + abs(t[key]) < 1e-12 * scale
