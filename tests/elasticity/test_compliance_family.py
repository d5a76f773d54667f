"""Compliances that differ a little from a reference: they share its bases."""

from dataclasses import replace

import numpy as np
import pytest
from parts import Compliances
from reference_cases import paper_case

import ringwear_par as rw
from ringwear_par.elasticity.mesh import Mesh


def test_members_are_the_compliances_of_their_moduli(comm):
    """At both ends of a family and within; the collocated ones exactly."""
    case = paper_case(Mesh(24))
    pair = rw.assemble(case, comm)
    moduli = [(1e3 * 2.0 ** (0.5 * (3 + by)), 1e3) for by in (-0.499, 0.2, 0.499)]
    cases = [
        replace(case, lower=replace(case.lower, young=a), upper=replace(case.upper, young=b))
        for a, b in moduli
    ]
    found = Compliances.of([pair] * 3, cases)
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
