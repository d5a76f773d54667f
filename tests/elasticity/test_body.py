"""Bodies: exact fields, orders of convergence, symmetry, the factorisations, the ranks."""

import os
from dataclasses import replace

import numpy as np
import pytest
from contact_problems import spring
from parts import TaoContact

import ringwear_par as rw
from ringwear_par.elasticity.bem.body import (
    body_zones,
    boundary_conditions,
    compliance,
    in_case_frame,
    solve_zones,
)
from ringwear_par.elasticity.bem.boundary import zone_meshes
from ringwear_par.elasticity.bem.systems import Zone
from ringwear_par.elasticity.mesh import Mesh, contact_line
from ringwear_par.elasticity.sections import Body, Material, Section

LOWER = Section((20.0, 40.0), 20.0)
UPPER = Section((28.5, 31.5), 20.0)
CHAMFERED = Section((28.5, 31.5), 20.0, ((28.5, -0.1), (28.6, 0.0), (31.4, 0.0), (31.5, -0.1)))
CONTACT = (28.5, 31.5)


def condensed(section, mesh, comm, grip="clamped"):
    line = contact_line(CONTACT, mesh, section)
    layers = LAYERS if section.layers else ()
    return compliance(Body(section, 1.0, 0.3, grip, layers), line, mesh, comm)


def test_a_node_on_another_element_is_an_error_on_all_ranks(comm):
    """Not integrals over parts that are too long, whose error nobody would see."""
    boundary = zone_meshes(UPPER, contact_line(CONTACT, Mesh(16), UPPER), Mesh(16))[0]
    conditions, nodes = boundary_conditions(boundary, "clamped"), boundary.nodes.copy()
    start, middle, _ = boundary.elements[boundary.outer_side[3]]
    nodes[boundary.elements[boundary.contact[0], 1]] = 0.3 * nodes[start] + 0.7 * nodes[middle]
    zone = Zone(boundary._replace(nodes=nodes), conditions, Material(1.0, 0.3))
    with pytest.raises(rw.ComputationError, match="too close"):
        solve_zones([zone], 1e-8, comm)


@pytest.mark.parametrize("poisson", [0.0, 0.3, 0.4999, 0.499999999])
def test_the_quadrature_is_as_accurate_of_incompressible_bodies(poisson, comm):
    """Its error is not multiplied by 1 / (1 - 2 nu)."""
    found = []
    for tolerance in (1e-7, 1e-10):
        mesh = Mesh(16, quadrature_tolerance=tolerance)
        body = Body(LOWER, 1.0, poisson, "clamped")
        found.append(compliance(body, contact_line(CONTACT, mesh, LOWER), mesh, comm).normal)
    assert np.abs(found[0] - found[1]).max() < 1e-6 * np.abs(found[1]).max()


COATED = replace(LOWER, layers=(0.05, 0.5))
LAYERS = (Material(10.0, 0.25), Material(0.2, 0.4))


@pytest.mark.parametrize(("section", "coarse"), [(LOWER, 16), (COATED, 16), (CHAMFERED, 32)])
def test_defects_vanish_with_the_mesh(section, coarse, comm):
    """Of reciprocity, and of equilibrium under any pressure and shear."""
    symmetry, force, torque = [], [], []
    for n in (coarse, 2 * coarse, 4 * coarse):
        body = condensed(section, Mesh(n), comm)
        line = contact_line(CONTACT, Mesh(n), section)
        weighted = line.area[:, None] * body.normal
        symmetry.append(np.abs(weighted - weighted.T).max() / np.abs(weighted).max())
        force.append(np.abs(body.force_reaction / line.area - 1).max())
        torque.append(np.abs(body.torque_reaction / (line.area * line.arm) - 1).max())
    for defects in (symmetry, force, torque):
        assert defects[0] > 1.5**2 * defects[2]
    assert max(symmetry[2], force[2], torque[2]) < 2e-3


def test_alternating_pressure_has_compliance(comm):
    """No checkerboard mode: the smallest eigenvalue falls like 1/n, as it does for exact C."""
    smallest = []
    for n in (32, 64):
        mesh = Mesh(n, grading=1.0)
        body = condensed(LOWER, mesh, comm)
        sign = (-1.0) ** np.arange(n)
        smallest.append((sign @ body.normal @ sign) / n)
        spectrum = np.linalg.eigvals(body.normal).real
        assert spectrum.min() > 0.9 * 0.7424 * 0.91 * 3.0 / n  # 0.7424 h/E* on a half-plane
    assert smallest[0] / smallest[1] == pytest.approx(2.0, rel=0.05)


def resident_megabytes():
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def test_memory_stays_flat(comm):
    """Over 60 solves and contact solvers; a TAO that is not freed is 160 to 280 kB."""
    zero, force = np.zeros((1, 32)), np.ones(1)

    def once():
        compliance = spring(1.0, 1, condensed(LOWER, Mesh(32), comm).normal)
        with TaoContact(compliance, by_force=True) as solver:
            assert not solver.solve(zero, force, None, zero, force).failed.any()

    for _ in range(15):
        once()
    before = resident_megabytes()
    for _ in range(60):
        once()
    assert resident_megabytes() - before < 4.0


@pytest.mark.parametrize("section", [LOWER, UPPER])
def test_the_whole_boundary_in_both_frames(section, comm):
    mesh = Mesh(24)
    line = contact_line(CONTACT, mesh)
    zones = body_zones(Body(section, 1.0, 0.3, "clamped"), line, mesh)
    (response,), _ = solve_zones(zones, mesh.quadrature_tolerance, comm)
    body = response.boundary
    condensed_body = condensed(section, mesh, comm)
    middle = body.elements[body.contact, 1]
    assert np.array_equal(-response.displacement[middle, 1], condensed_body.normal)
    assert np.array_equal(response.displacement[middle, 2], condensed_body.torsion)
    assert not response.displacement[body.elements[body.fixed].ravel()].any()
    assert np.array_equal(response.traction[body.contact, 1], -np.eye(24))
    assert np.array_equal(response.traction[body.contact, 2], np.eye(24))
    free = np.setdiff1d(np.arange(len(body.elements)), [*body.contact, *body.fixed])
    assert not response.traction[free].any()
    # equilibrium along z and about the axis, by area and moment of every element
    first, last = body.nodes[body.elements[:, 0]], body.nodes[body.elements[:, 2]]
    length = np.hypot(*(last - first).T)
    area = np.pi * (first[:, 0] + last[:, 0]) * length
    assert np.abs(area @ response.traction[:, 1] / line.area).max() < 5e-3
    lower = in_case_frame(response, "lower", 20.0)
    upper = in_case_frame(response, "upper", 20.0)
    assert np.array_equal(lower.displacement, response.displacement)
    assert np.array_equal(lower.boundary.nodes[:, 1] + upper.boundary.nodes[:, 1], np.full(
        len(body.nodes), 40.0))  # fmt: skip
    assert np.array_equal(upper.displacement[:, 0], response.displacement[:, 0])
    assert np.array_equal(upper.displacement[:, 1], -response.displacement[:, 1])
    assert np.array_equal(upper.traction[upper.boundary.contact, 1], np.eye(24))  # pushed up
    assert np.array_equal(upper.traction[upper.boundary.contact, 2], -np.eye(24))  # held back
    # outward normals to the right: of the contact, up, down
    for shown in (lower.boundary, upper.boundary):
        along = np.diff(shown.nodes[shown.elements[shown.contact]][:, [0, 2], 0], axis=1)
        assert (along < 0).all() == (shown is lower.boundary)
