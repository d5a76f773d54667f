"""Bodies with bonded layers against exact solutions, a coated ring of the paper, thin discs.

Half-spaces are stood in for by two discs, as in ``test_half_space``, but larger: where a layer is
stiff, what the truncation adds falls off more slowly.
"""

from dataclasses import replace

import exact_solutions as exact
import numpy as np
import pytest
from convergence import check_errors
from fine_solutions import pressure_at
from parts import RingLayer
from reference_cases import NU, collocated, paper_case
from scipy.special import j0, j1, jn_zeros
from tracing import first_contact

from ringwear_par.elasticity.bem.body import body_zones, solve_zones
from ringwear_par.elasticity.bem.pair import assemble_pair
from ringwear_par.elasticity.bem.systems import BoundaryConditions
from ringwear_par.elasticity.mesh import Mesh, contact_line
from ringwear_par.elasticity.sections import Body, Material, Section

BASE = Material(1.0, NU)


def test_bar_of_two_materials(comm):
    """With one nu / E, under uniform pressure: u_z on top, tractions of the interface."""
    h, layer, base, mesh = 4.0, Material(2.0, 0.4), Material(1.0, 0.2), Mesh(16)
    section = Section((20.0, 40.0), 20.0, (), (h,))
    body = Body(section, base.young, base.poisson, "platen", (layer,))
    zones = body_zones(body, contact_line(section.r, mesh), mesh)
    (top, below), _ = solve_zones(zones, mesh.quadrature_tolerance, comm)
    u = top.displacement[top.boundary.elements[top.boundary.contact, 1], 1].sum(axis=1)
    t = below.traction[below.boundary.above, :2].sum(axis=2)
    exactly = -h / layer.young - (section.height - h) / base.young
    assert u == pytest.approx(np.full_like(u, exactly), rel=1e-6)
    assert np.abs(t - [0.0, -1.0]).max() < 1e-6


def test_bessel_modes(comm):
    """A disc with two layers under J0 pressure between smooth sides, and J1 shear with free ones.

    Root mean squares: of the face's displacement over its amplitude, and of the interfaces'
    tractions over that of the load. The base is clamped.
    """
    big_r = 10.0
    stack = [(0.5, Material(5.0, 0.2)), (1.0, Material(0.5, 0.45)), (6.5, BASE)]
    thicknesses, materials = zip(*stack, strict=True)
    section = Section((0.0, big_r), sum(thicknesses), (), thicknesses[:-1])
    body = Body(section, BASE.young, BASE.poisson, "clamped", materials[:-1])
    squeezed, turned = (float(jn_zeros(order, 2)[1]) / big_r for order in (1, 2))
    normal = exact.normal_mode(squeezed, stack)[:-1, None].reshape(-1, 2, 1, 2)
    torsion = exact.torsion_mode(turned, stack)[:-1]

    def errors(n):
        mesh = Mesh(n)
        line, zones = contact_line(section.r, mesh), []
        pattern = np.stack([j1(squeezed * line.r), j0(squeezed * line.r)], axis=1)
        angular = j1(turned * line.r)
        for zone in body_zones(body, line, mesh):
            boundary, (fixed, load, traction, _) = zone.boundary, zone.conditions
            fixed[boundary.outer_side, 0] = True
            load[boundary.contact] = 0
            if len(boundary.contact):
                traction[boundary.contact, 1] = -pattern[:, 1]
                traction[boundary.contact, 2] = angular
            conditions = BoundaryConditions(fixed, load, traction, 1)
            zones.append(replace(zone, conditions=conditions))
        (top, *below), _ = solve_zones(zones, 1e-8, comm)
        u = top.displacement[top.boundary.elements[top.boundary.contact, 1], :, 0]
        t = np.array([zone.traction[zone.boundary.above, :, 0] for zone in below])
        exact_shear = np.multiply.outer(torsion[1:, 1], angular)[..., None]

        def off(difference):
            return np.sqrt((line.area @ difference**2 / line.area.sum()).max())

        return {
            "u under pressure": off(u[:, :2] - normal[0, 0] * pattern) / np.abs(normal[0, 0]).max(),
            "interfaces under pressure": off(t[:, :, :2] - normal[1:, 1] * pattern),
            "u under shear": off(u[:, 2:] - torsion[0, 0] * angular[:, None]) / torsion[0, 0],
            "interfaces under shear": off(t[:, :, 2:] - exact_shear),
        }

    check_errors(errors, dict.fromkeys(
        ("u under pressure", "interfaces under pressure", "u under shear",
         "interfaces under shear"), (1e-3, 1.8),
    ))  # fmt: skip


@pytest.mark.parametrize("thickness", [0.5, 0.05])
@pytest.mark.parametrize("layer", [Material(10.0, 0.2), Material(0.1, 0.4)], ids=["hard", "soft"])
def test_layer_on_a_half_space(layer, thickness, comm):
    """Under a uniform pressure on r < 1: u_z on the axis, at elements and at the end of it."""

    def errors(n):
        mesh, found = Mesh(n, grading=3.0), []
        line = contact_line((0.0, 1.0), mesh)
        for big_r in (200.0, 400.0):
            section = Section((0.0, big_r), big_r, (), (thickness,))
            disc = Body(section, BASE.young, NU, "clamped", (layer,))
            (top, _), _ = solve_zones(body_zones(disc, line, mesh), 1e-7, comm)
            contact = top.boundary.elements[top.boundary.contact]
            nodes = np.array([contact[0, 2], *contact[:, 1], contact[-1, 0]])
            found.append(-top.displacement[nodes, 1].sum(axis=1))
        known = exact.bathed_circle(np.array([0.0, *line.r, 1.0]), thickness, layer, BASE)
        axis, *inside, edge = np.abs((2.0 * found[1] - found[0]) / known - 1.0)
        return {"axis": axis, "inside": np.array(inside)[line.r < 0.9].max(), "edge": edge}

    limits = {"axis": (2e-4, 2.2), "inside": (5e-4, 2.2), "edge": (1e-3, 2.2)}
    check_errors(errors, limits, (16, 32, 64))


def test_hard_coating_of_the_paper(comm):
    """100 GPa, 0.05 mm, at 50 MPa without wear: independent finite elements."""

    def errors(n):
        case = paper_case(Mesh(n), pressure=50.0)
        coated = replace(case.lower, layers=(RingLayer(0.05, 100e3, NU),))
        case = replace(case, lower=coated)
        contact = first_contact(case, comm)
        return {
            "approach": contact.approach / exact.COATED_APPROACH - 1.0,
            **{
                f"p({r:g})": pressure_at(case.line, contact.pressure, r) / value - 1.0
                for r, value in exact.COATED_PRESSURE.items()
            },
        }

    found = check_errors(errors, {
        "approach": (1e-5, 2.2, 1.4e-6), "p(30)": (3e-4, None),
        "p(28.6)": (2e-3, 1.6, 1e-5), "p(31.4)": (2e-3, 1.6, 1e-5),
    })  # fmt: skip
    default = {"approach": 5e-5, "p(30)": 3e-4, "p(28.6)": 1e-2, "p(31.4)": 1e-2}
    assert all(found[1][name] <= most for name, most in default.items())


@pytest.mark.parametrize(("height", "poisson"), [(2.0, 0.4), (1.5, 0.499)])
def test_thin_soft_disc_under_a_narrower_ring(height, poisson, comm):
    """Clamped; against the same disc as a layer on a rigid body, no elements of a held face near.

    Of the approach, and of pressures 0.7 mm inside both edges and in the middle.
    """
    narrower, radii = (10.0, 20.0), (10.7, 15.0, 19.3)
    soft, rigid = Material(500.0, poisson), Material(1e12, NU)
    disc = Body(Section((0.0, 30.0), height), soft.young, soft.poisson, "clamped")
    layer = Body(Section((0.0, 30.0), 20.0 + height, (), (height,)), rigid.young, rigid.poisson,
                 "clamped", (soft,))  # fmt: skip
    ring = Body(Section(narrower, 10.0), 200e3, NU, "clamped")

    def solution(lower, n):
        line = contact_line(narrower, Mesh(n))
        pair = assemble_pair((lower, ring), line, Mesh(n), comm)
        unit = np.linalg.solve(collocated(pair, (lower.young, ring.young)), np.ones(n))
        approach = 1.0 / (line.area @ unit)
        return np.array([approach, *(pressure_at(line, approach * unit, r) for r in radii)])

    errors = np.abs(solution(disc, 64) / solution(layer, 128) - 1.0)
    assert errors[0] < 3e-4
    assert errors[1:].max() < 1e-3
