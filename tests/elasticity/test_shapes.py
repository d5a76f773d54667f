"""Chamfers, profiles and partial overlap: pressures, symmetry, contact that spreads with wear."""

from dataclasses import replace

import numpy as np
import pytest
from parts import Stepping
from paths import CASES
from reference_cases import paper_case
from tracing import first_contact, trace

import ringwear_par as rw
from ringwear_par.elasticity.mesh import Mesh
from ringwear_par.elasticity.sections import Section


def with_faces(case, lower=(), upper=()):
    return replace(
        case, lower=replace(case.lower, face=lower), upper=replace(case.upper, face=upper)
    )


def test_pressure_is_continuous_in_a_vanishing_chamfer():
    """On the flat part, and the force of given approach is within what the chamfer takes off."""
    case = paper_case(Mesh(96), pressure=50.0)
    approach = []
    for c in (0.0, 0.01, 0.05, 0.2):
        face = ((28.5, -c), (28.5 + c, 0.0), (31.5 - c, 0.0), (31.5, -c)) if c else ()
        approach.append(first_contact(with_faces(case, upper=face)).approach)
    softening = np.diff(approach)
    assert (softening > 0).all()
    assert softening[0] < 0.02 * approach[0]


def test_chamfers_come_into_contact_as_wear_proceeds():
    case = rw.read_case(CASES / "chamfer.toml", ["wear.lower.p0=0", "time.steps=100"])
    history = trace(case, tao=True)
    line, states = case.line, history.states
    reach = [line.edges[:-1][s.pressure > 0].min() for s in states]
    assert reach[0] > 28.6 - 1e-3  # nearly the flat part alone, but for its deformation
    assert reach[-1] < 28.6 - 5e-3
    assert (np.diff(reach) <= 0).all()
    worst = history.balances
    assert worst.force <= 1e-10
    assert 0 < worst.energy <= 1e-10
    assert max(worst.torque, worst.reaction) <= 1e-4
    gap = states[-1].gap
    assert gap.min() > -1e-9
    assert np.abs(gap[states[-1].pressure > 0]).max() < 1e-9


def test_partly_overlapping_rings():
    case = rw.read_case(CASES / "overlap.toml")
    assert case.contact == (38.0, 40.0)
    assert case.open_ends == (False, False)
    history = trace(case, tao=True)
    line, states = history.line, history.states
    assert history.worst.measures["asymmetry"][0, 0] < 1e-3
    # the inner edge digs in, at the free end of the lower ring the pressure is small and regular
    p = states[0].pressure
    assert p[0] > 10.0 * case.load.force / case.area
    outer = p[case.line.edges[-1] - line.r < 0.05]
    assert np.all((outer > 0.4 * 80.0) & (outer < 0.55 * 80.0))
    assert np.abs(np.diff(outer) / outer[1:]).max() < 0.12
    assert history.balances.force <= 1e-9
    assert history.balances.residual <= 1e-8
    assert max(history.balances.torque, history.balances.reaction) <= 1e-4


def test_a_sphere_wears_where_it_slides():
    case = rw.read_case(CASES / "sphere.toml", ["mesh.contact_elements=48", "time.steps=20"])
    assert case.open_ends == (False, True)
    modulus = 0.5 * 210e3 / (1 - 0.09)
    hertz = (0.75 * 200.0 * 20.0 / modulus) ** (1 / 3)
    history = trace(case, tao=True)
    line, states = case.line, history.states
    touching = line.edges[1:][states[0].pressure > 0].max()
    assert touching == pytest.approx(hertz, abs=line.width.max())
    wear = states[-1].wear[1]
    inside = states[-1].pressure > 0
    assert line.edges[1:][inside].max() > touching
    assert wear[0] < wear.max()
    assert not wear[~inside].any()
    assert history.balances.force <= 1e-9
    assert history.balances.residual <= 1e-8


def test_clearance_is_closed_before_there_is_pressure():
    case = paper_case(Mesh(32), pressure=50.0)
    touching = trace(replace(case, time=Stepping("implicit", 1.0, 2)), tao=True).states
    apart = replace(
        case,
        upper=replace(case.upper, z=(20.05, 40.05)),
        time=Stepping("implicit", 1.0, 2),
    )
    states = trace(apart, tao=True).states
    for one, other in zip(states, touching, strict=True):
        assert one.approach == pytest.approx(other.approach + 0.05, rel=1e-10)
        assert one.pressure == pytest.approx(other.pressure, rel=1e-8)


def sampled(f, r):
    z = f(r) - f(r).max()
    return Section((r[0], r[-1]), 50.0, tuple(zip(r.tolist(), z.tolist(), strict=True)))


def test_dense_samples_of_a_smooth_face_are_splined_and_kinks_stay():
    r, x = np.linspace(0.0, 3.0, 31), np.linspace(0.0, 3.0, 1001)
    ball = sampled(lambda r: np.sqrt(400.0 - r * r), r)
    exact = np.sqrt(400.0 - x * x) - 20.0
    assert np.abs(ball.depth(x) - exact).max() < 1e-8
    assert np.abs(np.interp(x, *ball.points.T) - exact).max() > 5e-5
    roof = sampled(lambda r: -0.02 * np.abs(r - 1.5), r)
    assert np.array_equal(roof.depth(x), np.interp(x, *roof.points.T))
    few = sampled(lambda r: np.sqrt(400.0 - r * r), np.linspace(0.0, 3.0, 6))
    assert np.array_equal(few.depth(x), np.interp(x, *few.points.T))
    half = sampled(lambda r: -0.05 * np.maximum(r - 1.5, 0.0) ** 2, r)  # flat, then a parabola
    assert np.abs(half.depth(x) + 0.05 * np.maximum(x - 1.5, 0.0) ** 2).max() < 1e-5
    assert (half.depth(x[x < 1.4]) == 0.0).all()
