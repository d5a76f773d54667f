"""Quadrature rules: accurate to their tolerance, wherever the source is."""

import numpy as np
import pytest
from scipy.integrate import quad

from ringwear_par.elasticity.bem.body import body_zones, compliance
from ringwear_par.elasticity.bem.quadrature import MAX_POINTS, quadrature
from ringwear_par.elasticity.bem.systems import assemble, number_dofs
from ringwear_par.elasticity.mesh import Mesh, contact_line
from ringwear_par.elasticity.sections import Body, Section


@pytest.mark.parametrize("power", range(5))
def test_singular_rule_for_polynomials_and_logarithms(power):
    rules = quadrature(1e-8)
    t, w = rules.points[0], rules.weights[0]
    assert w @ t**power == pytest.approx(1 / (power + 1), rel=1e-10)
    assert w @ (t**power * np.log(t)) == pytest.approx(-1 / (power + 1) ** 2, rel=1e-10)


@pytest.mark.parametrize("tolerance", [1e-4, 1e-8, 1e-12])
@pytest.mark.parametrize("source", [1.5 + 0j, 2.0 + 0j, 0.5 + 0.5j, 0.3 + 2j, -3 + 4j, 40 + 0j])
def test_gauss_order_meets_its_tolerance(tolerance, source):
    rules = quadrature(tolerance)
    ratio = abs(source) + abs(source - 1.0)
    fits = np.flatnonzero(rules.reach <= ratio)
    if len(fits) == 0:  # such an element is halved
        assert ratio < rules.reach[MAX_POINTS]
        return
    n = fits[0]

    def kernel(t):
        return (1.0 / (t - source) ** 2).real

    exact = (1.0 / (source - 1.0) - 1.0 / source).real
    got = rules.weights[n, :n] @ kernel(rules.points[n, :n])
    size = quad(lambda t: abs(kernel(t)), 0, 1)[0]
    assert abs(got - exact) <= tolerance * size


@pytest.mark.parametrize("bore", [0.01, 0.3, 10.0])
def test_bars_with_small_bores_stay_exact(bore, comm):
    """u_z = s z, u_r = -nu s r is in the discrete space: what is left is quadrature."""
    section = Section((bore, 20.0), 20.0)
    for tolerance in (1e-4, 1e-7):
        mesh = Mesh(16, quadrature_tolerance=tolerance)
        body = compliance(
            Body(section, 1.0, 0.3, "platen"), contact_line(section.r, mesh), mesh, comm
        )
        assert np.abs(body.normal.sum(axis=1) / 20.0 - 1).max() < 10 * tolerance


def test_assembled_rows_follow_the_tolerance(comm):
    body = Body(Section((20.0, 40.0), 20.0), 1.0, 0.3, "clamped")
    zones = body_zones(body, contact_line((28.5, 31.5), Mesh(16)), Mesh(16))

    def rows(tolerance):
        systems = assemble(zones, number_dofs(zones), quadrature(tolerance), comm)
        return [array for rows in systems for array in (rows.matrix, rows.loads)]

    exact, defects = rows(1e-13), []
    for tolerance in (1e-4, 1e-6, 1e-8, 1e-9):
        found = rows(tolerance)
        off = [np.abs(x - y).max() / np.abs(y).max() for x, y in zip(found, exact, strict=True)]
        assert max(off) < tolerance
        defects.append(max(off))
    assert defects == sorted(defects, reverse=True)
