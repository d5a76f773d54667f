"""Compliances that differ a little from a reference: they share its bases."""

from dataclasses import replace

import numpy as np
import pytest
from reference_cases import paper_case

from ringwear_par.contact.hessians import Hessians
from ringwear_par.elasticity.bem.compliance_family import family_number, family_of
from ringwear_par.elasticity.mesh import Mesh
from ringwear_par.history.elastic.bodies import shares_reference
from ringwear_par.history.elastic.compliances import Compliances
from ringwear_par.history.elastic.pairs import assemble

pytestmark = pytest.mark.serial


@pytest.fixture(scope="module")
def case():
    return paper_case(Mesh(24))


def with_moduli(case, lower, upper):
    rings = {"lower": lower, "upper": upper}
    return replace(case, **{k: replace(getattr(case, k), young=e) for k, e in rings.items()})


def test_members_are_the_compliances_of_their_moduli(case, comm):
    """At both ends of a family and within; the collocated ones exactly."""
    pair = assemble(case, comm)
    ends = [2.0 ** (0.5 * (3 + by)) for by in (-0.499, 0.2, 0.499)]
    moduli = [(1e3 * ratio, 1e3) for ratio in ends]
    assert {family_number(young) for young in moduli} == {3}
    found = Compliances.of([pair] * 3, [with_moduli(case, *young) for young in moduli], {})
    scaled, area = found.scaled(), pair.line.area
    assert len(found.every) == 1
    products = scaled.products(np.arange(3))
    p = np.random.default_rng(1).uniform(1.0, 2.0, (3, pair.line.n))
    for i, young in enumerate(moduli):
        exact, scale = pair.compliance(young), scaled.scale[i]
        matrix = scaled.matrix(i) * scale[:, None] * scale
        assert np.abs(matrix - exact.matrix).max() <= 1e-5 * np.abs(exact.matrix).max()
        product = scale * products.symmetric(scaled.scale * p)[i]
        assert product == pytest.approx(matrix @ p[i], rel=1e-12)
        collocated = product / area - products.gap_of_excess(p)[i]
        assert collocated == pytest.approx(exact.collocated @ p[i], rel=1e-12)
        assert found.diagonal[i] == pytest.approx(np.diag(matrix) / area, rel=1e-12)
        assert found.stiffness[i] == pytest.approx(area.sum() / matrix.sum())
        assert found.twist[i] == pytest.approx(exact.twist, rel=1e-13)
        assert found.symmetry_defect[i] == pytest.approx(exact.symmetry_defect, rel=1e-13)
        # conjugate gradients end soon
        change = np.linalg.solve(pair.compliance((ends[1], 1.0)).matrix, matrix)
        spread = np.linalg.eigvals(change).real
        assert spread.max() < 1.2 * spread.min()


@pytest.mark.parametrize("shape", ["speed", "any"])
def test_inverses_are_those_of_the_members(case, shape, comm):
    """On the elements in contact, beside a compliance that is a reference itself."""
    moduli = [(2830.1234, 1e3), (1e4, 1e5), (3.3e3 / 1.1111, 1.1e3)]
    found = Compliances.of(
        [assemble(case, comm)] * 3, [with_moduli(case, *young) for young in moduli], {}
    )
    scaled, rng = found.scaled(), np.random.default_rng(2)
    n = len(scaled.area)
    hessians, free = Hessians(scaled, found.which), rng.uniform(size=(3, n)) < 0.8
    slope = 3.0 * scaled.speed[scaled.reference[found.which]]
    if shape == "any":
        slope *= rng.uniform(0.5, 1.5, (3, n))
    per_depth = (scaled.weights / scaled.scale)[found.which]
    hessians.set_slopes(np.arange(3), slope / per_depth, None)
    hessians.refresh(np.arange(3), free)
    right = rng.normal(size=(2, 3, n))
    solved = hessians.solve(np.arange(3), right)
    # of derivatives of some histories, rows do not follow each other in memory
    scattered = right.transpose(1, 0, 2).copy().transpose(1, 0, 2)
    assert np.array_equal(solved, hessians.solve(np.arange(3), scattered))
    for i, on in enumerate(free):
        block = (scaled.matrix(int(found.which[i])) + np.diag(slope[i]))[np.ix_(on, on)]
        exact = np.linalg.solve(block, right[:, i, on].T).T
        assert solved[:, i, on] == pytest.approx(exact, rel=1e-9, abs=1e-9 * np.abs(exact).max())
        assert not solved[:, i, ~on].any()


def test_derivatives_by_moduli_are_those_of_the_members(case, comm):
    """K is nearly linear in both compliances, so that differences are wide."""
    young, pair = (10001.3, 99e3), assemble(case, comm)
    family = family_of(pair, family_number(young))

    def matrix(moduli):
        member = family.members([moduli])
        return member.share * (family.reference.matrix + member.deviation * family.derivative)

    for body in range(2):
        low, high = (
            matrix(tuple(np.multiply(young, 1.0 + by * (np.arange(2) == body))))
            for by in (-1e-4, 1e-4)
        )
        difference = (high - low) / (2e-4 * young[body])
        found = family.derivative_by_modulus(young, body)
        assert np.abs(found - difference).max() < 1e-7 * np.abs(found).max()


def test_moduli_that_are_written_have_references_of_their_own(case, comm):
    """So that the many histories of one pair of moduli need no iterations; and so have layers."""
    own = [(210e3, 70e3), (206.8e3, 3.0), (1e-3, 9.99e11)]
    shared = [(210000.1, 70e3), (1e4, 1e5 / 3.0)]
    assert not any(shares_reference(with_moduli(case, *young)) for young in own)
    assert all(shares_reference(with_moduli(case, *young)) for young in shared)
