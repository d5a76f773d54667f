"""Elements that follow the wear: updates are assemblies of the worn bodies."""

from dataclasses import replace

import numpy as np
import pytest
from parts import ThresholdLaw, UpdatedGeometry, bodies
from paths import CASES
from reference_cases import paper_case

import ringwear_par as rw
from ringwear_par.elasticity.bem.body import compliance
from ringwear_par.elasticity.bem.boundary import node_wear
from ringwear_par.elasticity.mesh import Mesh, contact_line, pair_slope


@pytest.mark.parametrize("name", ["chamfer", "sphere", "wear_through"])
def test_an_update_is_a_fresh_assembly(name, comm):
    """Whatever updates came before, to the last bit."""
    case = rw.read_case(CASES / f"{name}.toml", ["mesh.contact_elements=32"])
    geometry, n = UpdatedGeometry(bodies(case), case.line, case.mesh, comm), case.line.n
    unworn, exact = geometry.update(np.zeros((2, n))), rw.assemble(case, comm)
    assert unworn.key == exact.key
    assert np.array_equal(unworn.normal, exact.normal)
    x = np.linspace(0.0, 1.0, n)
    worn = np.stack([0.03 + 0.02 * np.cos(5 * x), 0.01 + 0.02 * x**2])
    worn[[not laws for laws in case.laws]] = 0.0
    geometry.update(0.5 * worn)
    pair = geometry.update(worn)
    assert pair.key != unworn.key
    slope = pair_slope(case.sections, case.line, case.mesh, worn)
    for i, (body, depth, own) in enumerate(zip(bodies(case), worn, (slope, -slope), strict=True)):
        fresh = compliance(body, case.line, case.mesh, comm, node_wear(case.line, depth), own)
        assert np.array_equal(pair.normal[i], fresh.normal)
        assert np.array_equal(pair.twist[i], case.line.area @ fresh.torsion)
        assert np.array_equal(pair.torque_reaction[i], fresh.torque_reaction)
    change = np.abs(pair.normal - unworn.normal).max() / np.abs(unworn.normal).max()
    assert 1e-4 < change < 0.2


def test_a_body_that_does_not_wear_is_assembled_once(comm):
    case, ones = paper_case(Mesh(16)), np.ones(16)
    geometry = UpdatedGeometry(bodies(case), case.line, case.mesh, comm)
    first, again = (geometry.update(np.outer([depth, 0.0], ones)) for depth in (0.1, 0.2))
    assert np.array_equal(first.normal[1], again.normal[1])
    assert not np.array_equal(first.normal[0], again.normal[0])


def test_uniform_wear_is_a_lower_ring(comm):
    """Worn all over by h, the upper ring is one that is h shorter."""
    case, h = paper_case(Mesh(48)), 0.5
    worn = np.outer([0.0, h], np.ones(case.line.n))
    pair = UpdatedGeometry(bodies(case), case.line, case.mesh, comm).update(worn)
    shorter = replace(case, upper=replace(case.upper, z=(20.0, 40.0 - h)))
    exact = rw.assemble(shorter, comm)
    softer = np.abs(exact.normal[1] - rw.assemble(case, comm).normal[1]).max()
    assert np.abs(pair.normal[1] - exact.normal[1]).max() < 2e-3 * softer


def test_wear_at_the_nodes():
    line = contact_line((28.5, 31.5), Mesh(16))
    x, r = line.r, line.edges
    assert node_wear(line, 0.2 + 0.1 * (x - 28.5)) == pytest.approx(
        np.maximum(0.2 + 0.1 * (r - 28.5), 0.2 + 0.1 * (x[0] - 28.5)), rel=1e-12
    )
    peak = np.zeros(16)
    peak[0] = 0.1
    nodes = node_wear(line, peak)
    assert nodes[0] > 0.1
    assert (nodes[2:] == 0.0).all()
    assert not node_wear(line, np.zeros(16)).any()


def test_wear_through_half_a_body_is_an_error(comm):
    case = replace(paper_case(Mesh(16)), wear_lower=ThresholdLaw(1e-7))
    moving = UpdatedGeometry(bodies(case), case.line, case.mesh, comm)
    with pytest.raises(rw.ComputationError, match="half of the height"):
        moving.update(np.full((2, 16), 10.5))
