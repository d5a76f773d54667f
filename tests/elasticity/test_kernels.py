"""Ring kernels against their integrals over theta."""

import time

import numpy as np
import pytest
from scipy.special import ellipe, ellipkm1

from ringwear_par.elasticity._rings import kernels

NU = 0.3
#: radius of the source, offsets of the field point, mm
PLACES = [
    (30.0, 5.0, 3.0),
    (30.0, 0.06, -0.08),
    (30.0, 0.006, -0.008),
    (30.0, 1e-6, 1e-6),
    (30.0, -29.99, 4.0),  # field point near the axis
    (0.01, 20.0, 20.0),  # source near the axis
    (0.0, 2.0, 1.0),  # on it
    (1.0, 3.0, 2.0),  # both sides of the switch from recursion to quadrature
    (1.0, 4.0, 6.5),
]
#: component of the force or stress at the source, then the direction on the element
PAIRS = ("rr", "zr", "rz", "zz", "tt")
STRESS_PAIRS = ("rrr", "ttr", "zzr", "rzr", "rrz", "ttz", "zzz", "rzz", "rtt", "tzt")


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


def tensors_over_the_ring(r, a, b, nr, nz, stress, n=200_000):
    """Integrate Kelvin's U and T, or D and S, over theta, as printed.

    By the trapezoidal rule in u, tan(theta/2) = k tan(u/2): dense where the ring is near.
    """
    r1, shear = r + a, 0.5 / (1 + NU)
    k = (np.hypot(a, b) / np.hypot(r + r1, b)) ** 0.5
    t = k * np.tan(np.pi * ((np.arange(n) + 0.5) / n - 0.5))
    zero, c, s = np.zeros(n), (1 - t**2) / (1 + t**2), 2 * t / (1 + t**2)
    away = np.array([a - 2 * r1 * t**2 / (1 + t**2), r1 * s, b + zero])
    distance = np.linalg.norm(away, axis=0)
    away /= distance
    normal = np.array([nr * c, nr * s, nz + zero])
    rn = (away * normal).sum(0)
    along = {"r": [c, s, zero], "z": [zero, zero, zero + 1], "t": [-s, c, zero]}
    at_x = {"r": 0, "t": 1, "z": 2}
    first, second = [], []
    for pair in STRESS_PAIRS if stress else PAIRS:
        e = np.array(along[pair[-1]])
        re, ne = (away * e).sum(0), (normal * e).sum(0)
        i, j = at_x[pair[0]], at_x[pair[1]]
        delta, rij = float(i == j), away[i] * away[j]
        if stress:
            both = e[i] * away[j] + e[j] * away[i]
            first.append((1 - 2 * NU) * (both - delta * re) + 3 * rij * re)
            second.append(
                3 * rn * ((1 - 2 * NU) * delta * re + NU * both)
                - 15 * rn * rij * re
                + 3 * NU * (normal[i] * away[j] + normal[j] * away[i]) * re
                + (1 - 2 * NU) * (3 * ne * rij + normal[j] * e[i] + normal[i] * e[j])
                - (1 - 4 * NU) * ne * delta
            )
        else:
            first.append(((3 - 4 * NU) * e[i] + away[i] * re) / (2 * shear) * distance)
            bend = (1 - 2 * NU) * (away[i] * ne - re * normal[i])
            second.append((bend - rn * ((1 - 2 * NU) * e[i] + 3 * away[i] * re)) * distance)
    ring = 2 * np.pi * r1 / (8 * np.pi * (1 - NU)) * (k + t**2 / k) / (1 + t**2)
    return (
        (ring * np.array(first) / distance**2).mean(1),
        (ring * np.array(second) / distance**3).mean(1) * (2 * shear if stress else 1.0),
    )


@pytest.mark.parametrize("stress", [False, True])
@pytest.mark.parametrize(("r", "a", "b"), PLACES)
def test_kernels_are_the_integrated_tensors(r, a, b, stress):
    nr, nz = np.cos(0.7), np.sin(0.7)
    got = kernels(np.array([[r], [a], [b], [nr], [nz]]), NU, stress)[:, 0]
    exact = tensors_over_the_ring(r, a, b, nr, nz, stress)
    for part, known in zip(np.split(got, 2), exact, strict=True):
        assert part == pytest.approx(known, rel=1e-11, abs=2e-12 * np.abs(known).max())


@pytest.mark.parametrize("parameter", [0.9, 0.31, 0.3, 0.29, 0.05, 1e-4, 0.0])
def test_kernels_near_the_axis(parameter):
    """A source at r = 0.01 in a disc: 4 r r1 / S^2 from where recursions serve to the axis."""
    r, r1 = (0.01 if parameter else 0.0), (0.03 if parameter > 0.01 else 2.0)
    b = np.sqrt(max(0.0, 4.0 * r * r1 / parameter - (r + r1) ** 2)) if parameter else 0.0
    got = kernels(np.array([[r], [r1 - r], [b], [0.6], [0.8]]), NU)[:, 0]
    exact = tensors_over_the_ring(r, r1 - r, b, 0.6, 0.8, False)
    for part, known in zip(np.split(got, 2), exact, strict=True):
        assert np.abs(part - known).max() <= 1e-12 * np.abs(known).max()
