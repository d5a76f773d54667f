"""Compliances that differ a little from a reference: they share its bases."""

from dataclasses import replace

import numpy as np
import pytest
from reference_cases import paper_case

from ringwear_par.elasticity.bem.compliance_family import family_number, family_of
from ringwear_par.elasticity.mesh import Mesh
from ringwear_par.history.elastic.compliances import Compliances
from ringwear_par.history.elastic.pairs import assemble


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
