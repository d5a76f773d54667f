"""The symmetric compliance: what is exact of it, and what the symmetric part alone does instead."""

import active_set
import numpy as np
import pytest

from ringwear_par.elasticity.bem.pair import assemble_pair
from ringwear_par.elasticity.mesh import Mesh, contact_line
from ringwear_par.elasticity.sections import Body, Section

CONTACT, FORCE = (28.5, 31.5), 28274.334
WIDE, NARROW = Section((20.0, 40.0), 20.0), Section(CONTACT, 20.0)
#: lower and upper, and the radii of their contact
BODIES = {
    "stiff on soft": (WIDE, 1e4, NARROW, 1e5),
    "soft on stiff": (WIDE, 1e5, NARROW, 1e4),
    "flush": (NARROW, 5e4, NARROW, 1e4),
    "discs": (Section((0.0, 15.0), 10.0), 1e4, Section((0.0, 4.0), 6.0), 1e5),
}
SIZES = (16, 32)


def flat_pressure(matrix, area):
    """Pressures under a rigid flat face that bears FORCE, of an area-weighted compliance."""
    p = np.linalg.solve(matrix, area)
    return p * FORCE / (area @ p)


def faces(line):
    """A rigid flat and a rigid bowed face, (n, 2), as the correction has them."""
    m, r = line.area, line.r
    return np.stack([np.ones_like(r), r**2 - m @ r**2 / m.sum()], axis=1)


@pytest.fixture(scope="module")
def compliances(comm):
    """Of all bodies on both meshes."""
    found = {}
    for name, (lower, soft, upper, hard) in BODIES.items():
        a, b = max(lower.r[0], upper.r[0]), min(lower.r[1], upper.r[1])
        both = Body(lower, soft, 0.3, "clamped"), Body(upper, hard, 0.3, "clamped")
        for n in SIZES:
            pair = assemble_pair(both, contact_line((a, b), Mesh(n)), Mesh(n), comm)
            found[name, n] = pair.compliance((soft, hard))
    return found


@pytest.mark.parametrize("name", BODIES)
def test_it_is_symmetric_to_the_last_bit_and_positive_definite(compliances, name):
    for n in SIZES:
        matrix = compliances[name, n].matrix
        assert np.array_equal(matrix, matrix.T)
        assert np.linalg.eigvalsh(matrix).min() > 0.0


@pytest.mark.parametrize("name", BODIES)
def test_pressures_under_rigid_faces_are_those_of_the_collocated_equations(compliances, name):
    """K P lies in the span of Y = diag(m) C P: exactly.

    It is Y where Y'P is symmetric, as reciprocity has it; no symmetric K can do better. What this
    leaves falls with the mesh.
    """
    left, pressures = [], []
    for n in SIZES:
        compliance = compliances[name, n]
        m, normal, face = compliance.line.area, compliance.collocated, faces(compliance.line)
        face /= np.abs(face).max(axis=0)
        p = np.linalg.solve(normal, face)
        y = m[:, None] * face
        found = compliance.matrix @ p
        share = np.linalg.lstsq(y, found, rcond=None)[0]
        assert np.abs(found - y @ share).max() < 1e-10 * np.abs(y).max()
        middle = y.T @ p
        exact = np.linalg.solve(0.5 * (middle + middle.T), middle)
        assert share == pytest.approx(exact, rel=1e-8, abs=1e-10)
        left.append(np.abs(share - np.eye(2)).max())
        exact_p, new_p = (flat_pressure(a, m) for a in (m[:, None] * normal, compliance.matrix))
        pressures.append(np.abs(new_p / exact_p - 1.0).max())
    assert left[1] < 0.3 * left[0] < 2e-3
    assert pressures[1] < 0.3 * pressures[0] < 2e-3


def test_contact_at_the_axis_alone_is_right_too(comm):
    """Rigid faces bear at the edge of discs, a sphere does not: what the diagonal is for.

    On a uniform mesh, whose elements at the axis are wide against their radius.
    """
    (lower, soft, upper, hard), mesh = BODIES["discs"], Mesh(32, grading=1.0)
    both = Body(lower, soft, 0.3, "clamped"), Body(upper, hard, 0.3, "clamped")
    pair = assemble_pair(both, contact_line((0.0, 4.0), mesh), mesh, comm)
    compliance = pair.compliance((soft, hard))
    line, normal = compliance.line, compliance.collocated
    gap = line.r**2 / 40.0
    exact, _ = active_set.solve(line.area[:, None] * normal, line.area, gap, force=2000.0)
    assert exact[0] > 0.0 == exact[-1]
    p, _ = active_set.solve(compliance.matrix, line.area, gap, force=2000.0)
    assert p[0] == pytest.approx(exact[0], rel=0.02)
