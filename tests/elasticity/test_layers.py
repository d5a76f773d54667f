"""Bodies with bonded layers: systems, ranks, balances, limits, elements that follow the wear."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from ringwear_par.elasticity.bem.body import body_zones, compliance, solve_zones
from ringwear_par.elasticity.bem.pair import UpdatedGeometry, assemble_pair
from ringwear_par.elasticity.bem.systems import number_dofs
from ringwear_par.elasticity.mesh import Mesh, contact_line
from ringwear_par.elasticity.sections import Body, Material, Section

CONTACT = (28.5, 31.5)
HARD, SOFT = Material(1e5, 0.25), Material(2e3, 0.4)
LOWER = Body(Section((20.0, 40.0), 20.0), 1e4, 0.3, "clamped")
UPPER = Body(Section(CONTACT, 20.0), 1e5, 0.3, "clamped")


def layered(body, *layers):
    thicknesses = tuple(thickness for thickness, _ in layers)
    section = replace(body.section, layers=thicknesses)
    return replace(body, section=section, layers=tuple(material for _, material in layers))


COATED = layered(LOWER, (0.05, HARD), (0.5, SOFT))
DISC = Body(Section((0.0, 10.0), 8.0, (), (0.3, 1.0)), 1e4, 0.3, "platen", (HARD, SOFT))
CHAMFERED = replace(
    layered(UPPER, (0.2, SOFT)),
    section=Section(CONTACT, 20.0, ((28.5, -0.1), (28.6, 0.0), (31.4, 0.0), (31.5, -0.1)), (0.2,)),
)
FILM = layered(LOWER, (0.003, Material(1e2, 0.4)), (0.02, HARD))
BODIES = [(COATED, CONTACT), (layered(UPPER, (0.3, SOFT)), CONTACT), (DISC, (0.0, 3.0)),
          (DISC, (2.0, 3.0)), (CHAMFERED, CONTACT), (FILM, CONTACT)]  # fmt: skip
#: soft films far thinner than elements are long
THIN = [(thickness, Material(young, poisson)) for young, poisson, thickness in
        [(1e3, 0.3, 0.003), (1e2, 0.3, 0.001), (1e1, 0.3, 0.01), (1e1, 0.4999, 0.003)]]  # fmt: skip


def condensed(body, mesh, comm, contact=CONTACT):
    line = contact_line(contact, mesh, body.section)
    return compliance(body, line, mesh, comm)


def approach(pair, line, more=0.0):
    """Under 50 MPa, all in contact; more on the diagonal of the compliance."""
    normal = pair.normal[0] / 1e4 + pair.normal[1] / 1e5 + more * np.eye(line.n)
    p = np.linalg.solve(normal, np.ones(line.n))
    return 50.0 * line.area.sum() / float(line.area @ p)


@pytest.mark.parametrize(("body", "contact"), BODIES)
def test_as_many_equations_as_unknowns(body, contact):
    mesh = Mesh(16)
    zones = body_zones(body, contact_line(contact, mesh, body.section), mesh)
    dofs = number_dofs(zones)
    for block in (slice(0, 2), slice(2, 3)):
        rows = np.concatenate([of.equation[:, block].ravel() for of in dofs])
        columns = [of[:, block].ravel() for own in dofs for of in (own.displacement, own.traction)]
        rows, found = rows[rows >= 0], np.concatenate(columns)
        n = len(rows)
        assert np.array_equal(np.sort(rows), np.arange(n))  # each equation once
        assert np.array_equal(np.unique(found[found >= 0]), np.arange(n))
    for zone, own in zip(zones, dofs, strict=True):
        assert (own.sign < 0.0).nonzero()[0].tolist() == sorted(zone.boundary.below)


@pytest.mark.parametrize(("body", "contact"), BODIES)
def test_zones_share_their_interfaces_and_balance(body, contact, comm):
    """Displacements are the same, tractions opposite; each zone hands the whole load on."""
    mesh = Mesh(32)
    line = contact_line(contact, mesh, body.section)
    responses, _ = solve_zones(body_zones(body, line, mesh), mesh.quadrature_tolerance, comm)
    load = np.stack([line.area, line.area * line.arm])
    for upper, lower in itertools.pairwise(responses):
        one = upper.boundary.elements[upper.boundary.below]
        other = lower.boundary.elements[lower.boundary.above, ::-1]
        assert np.array_equal(upper.displacement[one], lower.displacement[other])
        t = upper.traction[upper.boundary.below]
        assert np.array_equal(-t, lower.traction[lower.boundary.above])
        inner, outer = lower.boundary.nodes[other[:, 0], 0], lower.boundary.nodes[other[:, 2], 0]
        area = np.pi * np.abs(outer**2 - inner**2)
        moment = 2.0 / 3.0 * np.pi * np.abs(outer**3 - inner**3)
        force, torque = area @ t[:, 1], -moment @ t[:, 2]
        assert force.sum() == pytest.approx(load[0].sum(), rel=1e-3)
        assert torque.sum() == pytest.approx(load[1].sum(), rel=1e-3)
    top, base = responses[0], responses[-1]
    assert not base.displacement[base.boundary.elements[base.boundary.fixed].ravel(), 1:].any()
    middle = top.boundary.elements[top.boundary.contact, 1]
    assert np.array_equal(-top.displacement[middle, 1], condensed(body, mesh, comm, contact).normal)


@pytest.mark.parametrize("layers", [(0.001,), (0.05,), (0.5,), (2.0, 3.0)])
@pytest.mark.parametrize("which", [0, 1])
def test_layers_of_the_same_material_change_nothing(layers, which, comm):
    mesh, both = Mesh(48), [LOWER, UPPER]
    line = contact_line(CONTACT, mesh)
    plain = approach(assemble_pair(tuple(both), line, mesh, comm), line)
    own = Material(both[which].young, both[which].poisson)
    both[which] = layered(both[which], *((thickness, own) for thickness in layers))
    found = approach(assemble_pair(tuple(both), line, mesh, comm), line)
    assert found == pytest.approx(plain, rel=1e-4)


@pytest.mark.parametrize("film", THIN)
def test_thin_soft_films_are_resolved(film, comm):
    """Interfaces are collocated for the stiffer side: otherwise no compliance came out of it."""
    line = contact_line(CONTACT, Mesh(64))
    for bodies in ((layered(LOWER, film), UPPER), (LOWER, layered(UPPER, film))):
        pair = assemble_pair(bodies, line, Mesh(64), comm)
        weighted = line.area[:, None] * (pair.normal[0] / 1e4 + pair.normal[1] / 1e5)
        assert np.linalg.eigvalsh(weighted + weighted.T).min() > 0.0
        assert np.abs(weighted - weighted.T).max() < 0.01 * np.abs(weighted).max()


def test_a_very_thin_film_is_a_winkler_foundation(comm):
    """Its constrained modulus is all that is left of it (Johnson, Contact Mechanics, 5.8)."""
    mesh, poisson, young = Mesh(64), 0.3, 1e2
    line = contact_line(CONTACT, mesh)
    modulus = young * (1.0 - poisson) / ((1.0 + poisson) * (1.0 - 2.0 * poisson))
    bare, off = assemble_pair((LOWER, UPPER), line, mesh, comm), []
    for h in (0.001, 0.002, 0.004):
        body = layered(LOWER, (h, Material(young, poisson)))
        pair = assemble_pair((body, UPPER), line, mesh, comm)
        off.append(approach(pair, line) / approach(bare, line, h / modulus) - 1.0)
    # and the rest goes with its thickness
    assert np.abs(off).max() < 1e-3
    assert np.divide(off, off[0]) == pytest.approx([1.0, 2.0, 4.0], rel=0.25)


# elements that follow the wear


def after_wear(both, worn, mesh, comm):
    """The contact line, and the pair after the upper body has worn by so many mm all over."""
    line = contact_line(CONTACT, mesh)
    geometry = UpdatedGeometry(both, line, mesh, comm)
    return line, geometry.update(np.outer([0.0, worn], np.ones(line.n)))


def test_uniform_wear_within_a_layer_is_a_thinner_layer(comm):
    """The whole face of the upper ring worn: one that is lower by as much, its layer too."""
    mesh, h = Mesh(48), 0.2
    thick = LOWER, layered(UPPER, (0.5, SOFT))
    line, pair = after_wear(thick, h, mesh, comm)
    found = approach(pair, line)
    section = Section(CONTACT, 20.0 - h, (), (0.5 - h,))
    thin = LOWER, replace(thick[1], section=section)
    exact, before = (approach(assemble_pair(both, line, mesh, comm), line)
                     for both in (thin, thick))  # fmt: skip
    assert abs(found - exact) < 1e-4 * abs(exact - before)


@pytest.mark.parametrize("coating", [HARD, SOFT])
def test_a_residual_film_is_about_the_substrate(coating, comm):
    """The upper ring worn through its layer: a lower ring without, but for a film of 1 um."""
    mesh, h = Mesh(48), 0.3
    line, pair = after_wear((LOWER, layered(UPPER, (0.05, coating))), h, mesh, comm)
    bare = LOWER, replace(UPPER, section=Section(CONTACT, 20.0 - h))
    exact = approach(assemble_pair(bare, line, mesh, comm), line)
    film = 1e-3 * 50.0 / coating.young
    assert approach(pair, line) == pytest.approx(exact, abs=max(film, 2e-5 * exact))
