"""Two bodies joined: what a pair is of, and what its moduli make of it."""

from dataclasses import replace

import numpy as np
import pytest
from parts import Compliance, Line

from ringwear_par.elasticity.bem.body import Body
from ringwear_par.elasticity.bem.pair import assemble_pair, pair_key
from ringwear_par.elasticity.mesh import Mesh, contact_line
from ringwear_par.elasticity.sections import Section

CONTACT, MESH = (28.5, 31.5), Mesh(16)
LOWER = Body(Section((20.0, 40.0), 20.0), 210e3, 0.3, "clamped")
UPPER = Body(Section(CONTACT, 20.0), 70e3, 0.35, "platen")


@pytest.fixture(scope="module")
def pair(comm):
    return assemble_pair((LOWER, UPPER), contact_line(CONTACT, MESH), MESH, comm)


def test_one_pair_serves_every_modulus(pair, comm):
    harder = (replace(LOWER, young=1.0), replace(UPPER, young=2.0))
    again = assemble_pair(harder, pair.line, MESH, comm)
    assert np.array_equal(again.normal, pair.normal)
    assert again.key == pair.key == pair_key(harder, CONTACT, MESH)


def test_the_key_tells_what_a_pair_depends_on(pair):
    others = [
        ((replace(LOWER, poisson=0.2), UPPER), CONTACT, MESH),
        ((LOWER, replace(UPPER, grip="clamped")), CONTACT, MESH),
        ((UPPER, LOWER), CONTACT, MESH),
        ((LOWER, UPPER), (28.5, 31.0), MESH),
        ((LOWER, UPPER), CONTACT, Mesh(17)),
        ((replace(LOWER, section=Section((20.0, 40.0), 21.0)), UPPER), CONTACT, MESH),
    ]
    keys = {pair.key, *(pair_key(*other) for other in others)}
    assert len(keys) == 1 + len(others)
    following = Mesh(16, geometry="updated", geometry_tolerance=0.1)
    assert pair_key((LOWER, UPPER), CONTACT, following) == pair.key


def test_compliances_of_both_bodies_add_up(pair):
    """C1 / E1 + C2 / E2, symmetric but for the mesh."""
    moduli = np.array([[1.0, 2.0], [2.0, 4.0], [1.0, 1e300]])
    both = Compliance.of(Line.of([pair]), np.zeros(3, int), 1.0 / moduli)
    once, twice, lower = (both.matrix(row) for row in range(3))
    assert once == pytest.approx(pair.normal[0] + 0.5 * pair.normal[1], rel=1e-14)
    assert once == pytest.approx(2.0 * twice, rel=1e-14)
    assert np.array_equal(lower, pair.normal[0])
    assert both.diagonal[0] == pytest.approx(np.diagonal(once), rel=1e-14)
    p = np.cos(np.arange(48.0)).reshape(3, 16)
    assert both.deflection(p)[1] == pytest.approx(twice @ p[1], rel=1e-12)
    weighted = pair.line.area[:, None] * lower
    defect = np.abs(weighted - weighted.T).max() / np.abs(weighted).max()
    assert both.asymmetry[2] == pytest.approx(defect, rel=1e-12)
    assert defect < 0.05
