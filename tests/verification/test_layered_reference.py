"""Exact solutions with layers: against fields solved otherwise, and against what they become."""

import math

import numpy as np
import pytest
from exact_solutions import (
    LayeredHalfSpace,
    burmister,
    contact_modulus,
    flat_cylinder_force,
    mode_matrix,
    normal_mode,
    shear_modulus,
    sleeve_pressure,
    torsion_mode,
)
from scipy.integrate import solve_ivp

from ringwear_par.elasticity.sections import Material

BASE = Material(1.0, 0.3)
LAYERS = Material(10.0, 0.2), Material(0.1, 0.45)


def given_way(k, thickness, layer, base):
    """What the surface gives way under pressure J0(k r), by integration from the base upwards.

    Of the base's fields those that decay downwards, all like exp(k z) or z exp(k z).
    """
    decaying = np.linalg.svd(np.linalg.matrix_power(mode_matrix(k, base) - k * np.eye(4), 2))[2][2:]
    top = np.stack(
        [
            solve_ivp(lambda _, y: mode_matrix(k, layer) @ y, (0.0, thickness), start,
                      method="DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
            for start in decaying
        ],
        axis=1,
    )  # fmt: skip
    return -(top[:2] @ np.linalg.solve(top[2:], [0.0, -1.0]))[1]


@pytest.mark.parametrize("layer", LAYERS)
@pytest.mark.parametrize("k", [0.02, 0.7, 2.0, 8.0])
def test_burmister_is_a_layer_on_a_half_space(layer, k):
    own = (1.0 - layer.poisson) / (shear_modulus(layer) * k)
    exact = burmister(np.array(0.5 * k), layer, BASE) * own
    assert given_way(k, 0.5, layer, BASE) == pytest.approx(exact, rel=1e-9)


def test_mode_matrix_has_the_half_spaces_own_surface():
    """Of one material: (1 - nu) / (G k), whatever the thickness."""
    exact = (1.0 - 0.3) / (shear_modulus(BASE) * 3.0)
    assert given_way(3.0, 0.4, BASE, BASE) == pytest.approx(exact, rel=1e-10)
    assert np.array_equal(burmister(np.linspace(0.0, 9.0, 7), BASE, BASE), np.ones(7))


@pytest.mark.parametrize("layer", LAYERS)
def test_modes_on_a_deep_stack_are_those_of_a_half_space(layer):
    k, h = 2.0, 0.3
    found = normal_mode(k, [(h, layer), (8.0, BASE)])
    assert found.shape == (3, 4)
    assert found[0, 2:] == pytest.approx([0.0, -1.0], abs=1e-9)
    assert not found[-1, :2].any()
    exact = burmister(np.array(k * h), layer, BASE) * (1.0 - layer.poisson)
    assert -found[0, 1] == pytest.approx(exact / (shear_modulus(layer) * k), rel=1e-9)


def test_torsion_modes_of_a_deep_stack():
    """Of the base u = t / (G k), and continuity through the layer."""
    k, h, (layer, _) = 1.5, 0.3, LAYERS
    (u0, t0), (u1, t1), (u2, _) = torsion_mode(k, [(h, layer), (20.0, BASE)])
    assert (t0, u2) == (1.0, 0.0)
    assert u1 == pytest.approx(t1 / (shear_modulus(BASE) * k), rel=1e-12)
    stiff = k * shear_modulus(layer)
    assert u0 == pytest.approx(u1 * math.cosh(k * h) + t1 / stiff * math.sinh(k * h), rel=1e-12)


def test_a_half_space_of_one_material():
    """Boussinesq's displacements under uniform pressure and his punch."""
    found = LayeredHalfSpace(0.2, BASE, BASE)
    modulus = contact_modulus((BASE.young, BASE.poisson))
    on_axis, at_edge = found.bathed_circle(np.array([0.0, 1.0]))
    assert on_axis == pytest.approx(2.0 / modulus, rel=1e-14)
    assert at_edge == pytest.approx(4.0 / (math.pi * modulus), rel=1e-14)
    force, share = found.punch(r := np.linspace(0.0, 1.0, 9))
    assert force == pytest.approx(flat_cylinder_force(modulus, 1.0, 1.0), rel=1e-13)
    assert share == pytest.approx(1.0 - np.sqrt(1.0 - r**2), abs=1e-13)


@pytest.mark.parametrize("layer", LAYERS)
@pytest.mark.parametrize("thickness", [1e-3, 100.0])
def test_very_thin_and_very_thick_layers(layer, thickness):
    """The base alone but for the thin layer's own compression, or the layer alone."""
    found = LayeredHalfSpace(thickness, layer, BASE)
    of = BASE if thickness < 1.0 else layer
    exact = 2.0 / contact_modulus((of.young, of.poisson))
    u = found.bathed_circle(np.array([0.0]))[0]
    assert u == pytest.approx(exact, rel=0.05)
    assert u != pytest.approx(exact, rel=1e-5)


@pytest.mark.parametrize("layer", LAYERS)
@pytest.mark.parametrize("thickness", [0.02, 0.5])
def test_punch_and_uniform_pressure_do_the_same_work_on_each_other(layer, thickness):
    found = LayeredHalfSpace(thickness, layer, BASE)
    edges = np.sin(np.linspace(0.0, 0.5 * math.pi, 301))
    force, share = found.punch(edges)
    work = force * np.diff(share) @ found.bathed_circle(0.5 * (edges[1:] + edges[:-1]))
    assert work == pytest.approx(math.pi, rel=1e-5)


def test_sleeves():
    """Of one material the whole ring's own pressure; the softer outer one gives way."""
    one = sleeve_pressure((20.0, 30.0, 40.0), 3.0, 1.0, (BASE, BASE))
    a2, c2, b2 = 400.0, 900.0, 1600.0
    assert one == pytest.approx(3.0 - 2.0 * (1.0 - a2 / c2) * b2 / (b2 - a2), rel=1e-14)
    soft = sleeve_pressure((20.0, 30.0, 40.0), 3.0, 0.0, (BASE, Material(1e-6, 0.3)))
    assert 0.0 < soft < 1e-5
