"""The symmetric compliance: positive definite, and right under rigid faces."""

import numpy as np
import pytest

from ringwear_par.elasticity.bem.pair import assemble_pair
from ringwear_par.elasticity.mesh import Mesh, contact_line
from ringwear_par.elasticity.sections import Body, Section

WIDE, NARROW = Section((20.0, 40.0), 20.0), Section((28.5, 31.5), 20.0)
#: lower and upper, and the radii of their contact
BODIES = {
    "stiff on soft": (WIDE, 1e4, NARROW, 1e5),
    "soft on stiff": (WIDE, 1e5, NARROW, 1e4),
    "flush": (NARROW, 5e4, NARROW, 1e4),
    "discs": (Section((0.0, 15.0), 10.0), 1e4, Section((0.0, 4.0), 6.0), 1e5),
}


@pytest.mark.parametrize("name", BODIES)
def test_pressures_under_a_rigid_face_are_those_of_the_collocated_equations(name, comm):
    """By less than the mesh's error, of K that is symmetric to the last bit."""
    lower, soft, upper, hard = BODIES[name]
    a, b = max(lower.r[0], upper.r[0]), min(lower.r[1], upper.r[1])
    both = Body(lower, soft, 0.3, "clamped"), Body(upper, hard, 0.3, "clamped")
    off = []
    for n in (16, 32):
        pair = assemble_pair(both, contact_line((a, b), Mesh(n)), Mesh(n), comm)
        found = pair.compliance((soft, hard))
        assert np.array_equal(found.matrix, found.matrix.T)
        assert np.linalg.eigvalsh(found.matrix).min() > 0.0
        exact = np.linalg.solve(found.collocated, np.ones(n))
        p = np.linalg.solve(found.matrix, pair.line.area)
        off.append(np.abs(p / exact * (pair.line.area @ exact) / (pair.line.area @ p) - 1.0).max())
    assert off[1] < 0.3 * off[0] < 2e-3
