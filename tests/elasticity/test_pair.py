"""Two bodies joined: what a pair is of, and what its moduli make of it."""

from dataclasses import replace

import numpy as np
import pytest

import ringwear_par as rw
from ringwear_par.elasticity.bem.body import Body
from ringwear_par.elasticity.bem.pair import assemble_pair, pair_key, symmetric
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
    line, twice = pair.line, pair.compliance((2.0, 4.0))
    once, lower = pair.compliance((1.0, 2.0)), pair.compliance((1.0, 1e300))
    assert np.abs(once.matrix - 2.0 * twice.matrix).max() <= 1e-15 * np.abs(once.matrix).max()
    assert once.twist == pytest.approx(2.0 * twice.twist, rel=1e-14)
    assert np.array_equal(once.matrix, once.matrix.T)
    assert lower.matrix == pytest.approx(symmetric(line, pair.normal[0]), rel=1e-13)
    weighted = line.area[:, None] * pair.normal[0]
    assert lower.symmetry_defect == pytest.approx(
        np.abs(weighted - weighted.T).max() / np.abs(weighted).max(), rel=1e-9
    )
    assert lower.symmetry_defect < 0.05


def test_a_compliance_that_is_not_positive_definite_is_refused(pair):
    wrong = replace(pair, normal=-pair.normal)
    with pytest.raises(rw.ComputationError, match="positive definite"):
        wrong.compliance((1.0, 1.0))
