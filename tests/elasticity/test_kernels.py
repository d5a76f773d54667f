"""Ring kernels against their integrals over theta, with mpmath where digits are at stake."""

import mpmath
import numpy as np
import pytest

from ringwear_par.elasticity.bem.kernels import (
    TILE,
    TILE_ROWS,
    elliptic,
    fill_tile,
    moments,
    ring_kernels,
)

NU = 0.3
#: the kernels U and T; those of theta are differences of larger ones near the axis
GROUPS = ([0, 1, 2, 3, 4], [5, 6, 7, 8, 9])
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
    exact = [kernel[key] for kernel in (u, t) for key in ("rr", "rz", "zr", "zz", "tt")]
    scale = max(map(abs, exact)) or 1.0
    assert ring_kernels(r, a, b, nr, nz, NU) == pytest.approx(exact, abs=1e-12 * scale)
    # theta uncouples
    for key in ("rt", "tr", "zt", "tz"):
        assert abs(u[key]) + abs(t[key]) < 1e-12 * scale


@pytest.mark.parametrize("r", [30.0, 1.0, 0.3, 1e-3, 0.0])
@pytest.mark.parametrize("count", [1, 4, TILE - 1, TILE])
def test_a_tile_holds_the_kernels_of_each_of_its_points(r, count):
    """On both sides of the switch to quadrature, near the source, the axis and far from both."""
    rng = np.random.default_rng(count)
    distance, angle = 10 ** rng.uniform(-6, 1.5, TILE), rng.uniform(0.0, 2 * np.pi, TILE)
    a, b = distance * np.cos(angle), distance * np.sin(angle)
    a = np.maximum(a, -0.999 * r)
    turn = rng.uniform(0.0, 2 * np.pi)
    tile = np.zeros(TILE_ROWS * TILE)
    tile[: 3 * TILE] = np.concatenate([np.full(TILE, r), a, b])
    fill_tile(tile, count, np.cos(turn), np.sin(turn), NU)
    kernels = tile.reshape(TILE_ROWS, TILE)[3:]
    for i in range(count):
        alone = np.array(ring_kernels(r, a[i], b[i], np.cos(turn), np.sin(turn), NU))
        for group in GROUPS:
            scale = np.abs(alone[group]).max()
            assert np.abs(kernels[group, i] - alone[group]).max() <= 2e-13 * scale
    assert not kernels[:, count:].any()


@pytest.mark.parametrize("parameter", [0.9, 0.31, 0.3, 0.29, 0.05, 1e-4, 0.0])
def test_kernels_near_the_axis(parameter):
    """A source at r = 0.01 in a disc: 4 r r1 / S^2 from where recursions serve to the axis."""
    r, r1 = (0.01 if parameter else 0.0), (0.03 if parameter > 0.01 else 2.0)
    b = np.sqrt(max(0.0, 4.0 * r * r1 / parameter - (r + r1) ** 2)) if parameter else 0.0
    got = np.array(ring_kernels(r, r1 - r, b, 0.6, 0.8, NU))
    for group, kernel in zip(GROUPS, kelvin_over_the_ring(r, r1 - r, b, 0.6, 0.8), strict=True):
        exact = np.array([kernel[key] for key in ("rr", "rz", "zr", "zz", "tt")])
        assert np.abs(got[group] - exact).max() <= 1e-12 * np.abs(exact).max()
