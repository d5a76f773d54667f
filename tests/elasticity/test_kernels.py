"""Ring kernels against their integrals over theta, with mpmath where digits are at stake."""

import time

import mpmath
import numpy as np
import pytest
from scipy.special import ellipe, ellipkm1

from ringwear_par.elasticity._rings import kernels, moments

NU = 0.3
#: radius of the source, offsets of the field point, mm
PLACES = [
    (30.0, 5.0, 3.0),
    (30.0, 0.06, -0.08),
    (30.0, -29.99, 4.0),  # field point near the axis
    (0.01, 20.0, 20.0),  # source near the axis
    (0.0, 2.0, 1.0),  # on it
    (1.0, 3.0, 2.0),  # both sides of the switch from recursion to quadrature
    (1.0, 4.0, 6.5),
]
#: component of the force, then of the displacement or traction on the element
PAIRS = ("rr", "zr", "rz", "zz", "tt")
#: the kernels U and T; those of theta are differences of larger ones near the axis
GROUPS = ([0, 1, 2, 3, 4], [5, 6, 7, 8, 9])
#: of the moments and their relative error
MOMENTS = [(p, q, 1e-12) for p, end in ((1, 2), (3, 3), (5, 4)) for q in range(end)]
MOMENTS += [(7, q, 1e-11) for q in range(5)]


def kernels_at(*numbers):
    """Return the ring kernels at one point, (10,)."""
    return kernels(np.array(numbers, float)[:, None], NU)[:, 0]


@pytest.mark.parametrize(("r", "a", "b"), [*PLACES, (30.0, 0.006, -0.008), (30.0, 1e-6, 1e-6)])
def test_moments_keep_their_digits(r, a, b):
    got = moments(r, a, b)
    near2, span2 = mpmath.mpf(a) ** 2 + mpmath.mpf(b) ** 2, 4 * mpmath.mpf(r) * (r + mpmath.mpf(a))
    reach = mpmath.sqrt(near2 / span2) if span2 else 1
    cuts = [0, *sorted({min(reach * 10**k, mpmath.pi / 2) for k in range(9)}), mpmath.pi / 2]
    with mpmath.workdps(30):
        for value, (p, q, error) in zip(got, MOMENTS, strict=True):

            def integrand(phi, p=p, q=q):
                s2 = mpmath.sin(phi) ** 2
                return s2**q / (near2 + span2 * s2) ** (mpmath.mpf(p) / 2)

            exact = 4 * mpmath.quad(integrand, sorted(set(cuts)))
            assert value == pytest.approx(float(exact), rel=error)


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
    exact = [kernel[key] for kernel in (u, t) for key in PAIRS]
    scale = max(map(abs, exact)) or 1.0
    assert kernels_at(r, a, b, nr, nz) == pytest.approx(exact, abs=1e-12 * scale)
    # theta uncouples
    for key in ("rt", "tr", "zt", "tz"):
        assert abs(u[key]) + abs(t[key]) < 1e-12 * scale


def random_points(count, r):
    """Return points near a source, the axis and far from both, (5, count)."""
    rng = np.random.default_rng(count)
    distance = 10 ** rng.uniform(-6, 1.5, count)
    angle, turn = rng.uniform(0.0, 2.0 * np.pi, (2, count))
    a, b = np.maximum(distance * np.cos(angle), -0.999 * r), distance * np.sin(angle)
    return np.array([np.full(count, r), a, b, np.cos(turn), np.sin(turn)])


@pytest.mark.parametrize("stress", [False, True])
@pytest.mark.parametrize("r", [30.0, 0.3, 0.0])
@pytest.mark.parametrize("count", [4, 300])
def test_kernels_of_points_do_not_depend_on_their_company(stress, r, count):
    points = random_points(count, r)
    alone = [kernels(points[:, [i]].copy(), NU, stress)[:, 0] for i in range(count)]
    assert np.array_equal(kernels(points, NU, stress), np.transpose(alone))


def test_kernels_are_computed_by_vector_instructions():
    """Without, they would take five times as long as two elliptic integrals alone in SciPy."""
    points = random_points(20_000, 30.0)
    m1 = np.random.default_rng(1).uniform(0.0, 1.0, points.shape[1])

    def seconds(compute):
        times = []
        for _ in range(7):
            started = time.process_time()
            compute()
            times.append(time.process_time() - started)
        return min(times)

    both = seconds(lambda: (kernels(points, NU), kernels(points, NU, True)))
    assert both < 3.3 * seconds(lambda: (ellipkm1(m1), ellipe(1.0 - m1)))


def test_points_of_another_shape_are_refused():
    with pytest.raises(ValueError, match="five"):
        kernels(np.ones((4, 3)), NU)
    with pytest.raises(ValueError, match="contiguous"):
        kernels(np.ones((3, 5)).T, NU)


@pytest.mark.parametrize("parameter", [0.9, 0.31, 0.3, 0.29, 0.05, 1e-4, 0.0])
def test_kernels_near_the_axis(parameter):
    """A source at r = 0.01 in a disc: 4 r r1 / S^2 from where recursions serve to the axis."""
    r, r1 = (0.01 if parameter else 0.0), (0.03 if parameter > 0.01 else 2.0)
    b = np.sqrt(max(0.0, 4.0 * r * r1 / parameter - (r + r1) ** 2)) if parameter else 0.0
    got = kernels_at(r, r1 - r, b, 0.6, 0.8)
    for group, kernel in zip(GROUPS, kelvin_over_the_ring(r, r1 - r, b, 0.6, 0.8), strict=True):
        exact = np.array([kernel[key] for key in PAIRS])
        assert np.abs(got[group] - exact).max() <= 1e-12 * np.abs(exact).max()


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
def test_stress_kernels_are_the_integrated_tensors(r, a, b):
    nr, nz = np.cos(0.7), np.sin(0.7)
    got = kernels(np.array([[r], [a], [b], [nr], [nz]]), NU, True)[:, 0]
    for part, exact in zip(
        np.split(got, 2), somigliana_over_the_ring(r, a, b, nr, nz), strict=True
    ):
        assert part == pytest.approx(exact, rel=1e-11, abs=1e-12 * np.abs(exact).max())
