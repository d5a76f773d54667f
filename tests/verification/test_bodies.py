"""Single bodies against exact fields: the kernels' closure, bar, Lame, torsion."""

import math

import numpy as np
import pytest
from convergence import check_errors
from exact_solutions import lame_displacement
from reference_cases import NU

from ringwear_par.elasticity._rings import kernels
from ringwear_par.elasticity.bem.body import boundary_conditions, compliance, solve_zones
from ringwear_par.elasticity.bem.boundary import zone_meshes
from ringwear_par.elasticity.bem.systems import BoundaryConditions, Zone
from ringwear_par.elasticity.mesh import Mesh, contact_line
from ringwear_par.elasticity.sections import Body, Material, Section

#: a hollow cylinder with its whole top as contact line
RADII, HEIGHT = (20.0, 40.0), 20.0


@pytest.mark.parametrize(("r", "z", "expected"), [(30, 10, -1), (50, 5, 0), (5, 8, 0)])
def test_rigid_modes_close(r, z, expected):
    """Int T ds = 0 or -1 for rigid u_z and u_theta = r, the source outside or inside a rectangle.

    It is far enough from the sides for 200-point Gauss rules.
    """
    corners = [(20.0, 0.0), (40.0, 0.0), (40.0, 20.0), (20.0, 20.0)]
    t, w = np.polynomial.legendre.leggauss(200)
    t, w = 0.5 * (t + 1.0), 0.5 * w
    axial = turning = 0.0
    for (r0, z0), (r1, z1) in zip(corners, corners[1:] + corners[:1], strict=True):
        length = math.hypot(r1 - r0, z1 - z0)
        normal = (z1 - z0) / length, -(r1 - r0) / length
        a, b = r0 + t * (r1 - r0) - r, z0 + t * (z1 - z0) - z
        values = kernels(np.array(np.broadcast_arrays(float(r), a, b, *normal)), NU)
        axial += length * w @ values[8]
        turning += length * w @ (values[9] * (r + a) / r)
    assert [axial, turning] == pytest.approx([expected] * 2, abs=1e-12)


def test_bar_with_free_sides(comm):
    """u_z on top of a bar with free sides under uniform pressure, but for quadrature."""
    line, mesh = contact_line(RADII, Mesh(16)), Mesh(16)
    body = compliance(Body(Section(RADII, HEIGHT), 1.0, NU, "platen"), line, mesh, comm)
    assert body.normal.sum(axis=1) == pytest.approx(np.full(16, HEIGHT), rel=1e-6)


def test_lame(comm):
    """u_r on the bore of a ring between two smooth planes under both pressures."""
    mesh, inner, outer = Mesh(64), 3.0, 1.0
    boundary = zone_meshes(Section(RADII, HEIGHT), contact_line(RADII, mesh), mesh)[0]
    k = len(boundary.elements)
    fixed = np.zeros((k, 3), dtype=bool)
    fixed[np.concatenate([boundary.fixed, boundary.contact]), 1] = True
    fixed[boundary.fixed, 2] = True
    load, traction = np.full((k, 3), -1), np.zeros((k, 3))
    for side, value in ((boundary.inner_side, inner), (boundary.outer_side, -outer)):
        load[side, 0], traction[side, 0] = 0, value
    conditions = BoundaryConditions(fixed, load, traction, 1)
    bore = boundary.elements[boundary.inner_side, 1]
    (response,), _ = solve_zones([Zone(boundary, conditions, Material(1.0, NU))], 1e-8, comm)
    exact = lame_displacement(np.array(20.0), *RADII, inner, outer, 1.0, NU)
    assert response.displacement[bore, 0, 0] == pytest.approx(exact, rel=1e-6)


@pytest.mark.parametrize("degrees", [0.0, 10.0])
def test_torsion(degrees, comm):
    """u_theta = twist r (z + h) on top of a hollow cylinder, or on a cone, is of second order.

    Its traction per true area is shear x twist x r cos alpha; the top rises by alpha outwards.
    """
    alpha, (a, b), shear = math.radians(degrees), RADII, 0.5 / (1.0 + NU)
    face = ((a, -(b - a) * math.tan(alpha)), (b, 0.0)) if degrees else ()

    def errors(n):
        line = contact_line(RADII, Mesh(n))
        boundary = zone_meshes(Section(RADII, HEIGHT, face), line, Mesh(n))[0]
        conditions = boundary_conditions(boundary, "clamped", np.full(n, math.tan(alpha)))
        middle = boundary.elements[boundary.contact, 1]
        (response,), _ = solve_zones([Zone(boundary, conditions, Material(1.0, NU))], 1e-8, comm)
        r, z = boundary.nodes[middle].T
        u = response.displacement[middle, 2] @ (shear * r * math.cos(alpha))
        return {"u_theta": np.abs(u / (r * (z + HEIGHT)) - 1.0).max()}

    check_errors(errors, {"u_theta": (1e-3, 1.8)})
