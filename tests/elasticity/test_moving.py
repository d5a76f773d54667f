"""Elements that follow the wear: updates against fresh assemblies, and what they save."""

from dataclasses import replace

import numpy as np
import pytest
from paths import CASES

from ringwear_par.cases.files.reading import read_case
from ringwear_par.elasticity.bem.body import compliance
from ringwear_par.elasticity.bem.boundary import node_wear
from ringwear_par.elasticity.mesh import Mesh, case_slopes, common_slope, contact_line
from ringwear_par.errors import ComputationError
from ringwear_par.history.elastic.bodies import bodies
from ringwear_par.history.elastic.pairs import assemble, updated_geometry
from ringwear_par.verification.fine import SORTS, ring_case
from ringwear_par.verification.histories import paper_case
from ringwear_par.wear.laws.threshold import ThresholdLaw

pytestmark = pytest.mark.serial


def agree(one, other, tolerance=1e-12):
    for name in ("normal", "twist", "force_reaction", "torque_reaction"):
        a, b = getattr(one, name), getattr(other, name)
        assert np.abs(a - b).max() <= tolerance * np.abs(b).max(), name


def fresh(case, worn, comm):
    """Normal compliance of both bodies from ordinary assemblies of the worn contours."""
    slope = common_slope(case_slopes(case.sections, case.line, case.mesh, worn))
    return [
        compliance(body, case.line, case.mesh, comm, node_wear(case.line, depth), own)
        for body, depth, own in zip(bodies(case), worn, (slope, -slope), strict=True)
    ]


@pytest.fixture(scope="module")
def cases():
    both = paper_case(Mesh(32), p0=(0.0, 0.0))
    chamfered = read_case(CASES / "chamfer.toml", ["mesh.contact_elements=32"])
    sphere = read_case(CASES / "sphere.toml", ["mesh.contact_elements=32"])
    cones = ring_case(SORTS["cones of 5 degrees"], Mesh(32), k=(1e-7, 1e-7))
    return both, chamfered, sphere, replace(cones, mesh=Mesh(32, geometry="updated"))


@pytest.mark.parametrize(
    "which",
    [pytest.param(0, marks=pytest.mark.ranks), 1, 2, pytest.param(3, marks=pytest.mark.ranks)],
)
def test_an_update_is_a_fresh_assembly(cases, which, comm):
    case = cases[which]
    moving = updated_geometry(case, comm)
    n = case.line.n
    unworn = moving.update(np.zeros((2, n)))
    agree(unworn, assemble(case, comm))
    assert unworn.key == assemble(case, comm).key
    x = np.linspace(0.0, 1.0, n)
    worn = np.stack([0.03 + 0.02 * np.cos(5 * x), 0.01 + 0.02 * x**2])
    worn[[law is None for law in case.laws]] = 0.0
    pair = moving.update(worn)
    assert pair.cost.kernel_evaluations > 0
    assert pair.key != unworn.key
    for i, body in enumerate(fresh(case, worn, comm)):
        assert np.abs(pair.normal[i] - body.normal).max() <= 1e-12 * np.abs(body.normal).max()
        twist = case.line.area @ body.torsion
        assert np.abs(pair.twist[i] - twist).max() <= 1e-12 * np.abs(twist).max()
        for name in ("force_reaction", "torque_reaction"):
            a, b = getattr(pair, name)[i], getattr(body, name)
            assert np.abs(a - b).max() <= 1e-12 * np.abs(b).max()
    change = np.abs(pair.normal - unworn.normal).max() / np.abs(unworn.normal).max()
    assert 1e-4 < change < 0.2
    # no memory of what came before, and the same again to the last bit
    agree(moving.update(np.zeros((2, n))), unworn, 0.0)
    agree(moving.update(worn), pair, 0.0)


def test_updates_cost_less_than_assemblies(cases, comm):
    case = replace(cases[0], wear_upper=None)
    full = assemble(case, comm).cost.kernel_evaluations
    moving = updated_geometry(case, comm)
    zero = np.zeros((2, case.line.n))
    first = moving.update(zero).cost.kernel_evaluations
    again = moving.update(zero).cost.kernel_evaluations
    assert first == full
    assert again < 0.5 * full


def test_the_bodies_without_wear_law_do_not_move(cases, comm):
    case = replace(cases[0], wear_lower=None, wear_upper=None)
    moving = updated_geometry(case, comm)
    ones = np.full((2, case.line.n), 0.1)
    pair = moving.update(ones)
    agree(pair, assemble(case, comm))
    assert moving.update(ones).cost.kernel_evaluations == 0


def test_uniform_wear_is_a_lower_ring(comm):
    """Worn all over by h, the upper ring is one that is h shorter."""
    case = paper_case(Mesh(48), p0=(None, 0.0))
    h = 0.5
    moving = updated_geometry(case, comm)
    pair = moving.update(np.full((2, case.line.n), h))
    shorter = replace(case, upper=replace(case.upper, z=(20.0, 40.0 - h)))
    exact = assemble(shorter, comm)
    softer = np.abs(exact.normal[1] - assemble(case, comm).normal[1]).max()
    assert np.abs(pair.normal[1] - exact.normal[1]).max() < 2e-3 * softer


def test_wear_at_the_nodes():
    line = contact_line((28.5, 31.5), Mesh(16))
    x, r = line.gap_point, line.edges
    assert node_wear(line, 0.2 + 0.1 * (x - 28.5)) == pytest.approx(
        np.maximum(0.2 + 0.1 * (r - 28.5), 0.2 + 0.1 * (x[0] - 28.5)), rel=1e-12
    )
    peak = np.zeros(16)
    peak[0] = 0.1
    nodes = node_wear(line, peak)
    assert nodes[0] > 0.1
    assert (nodes[2:] == 0.0).all()
    assert not node_wear(line, np.zeros(16)).any()


@pytest.mark.ranks
def test_wear_through_half_a_body_is_an_error(comm):
    case = replace(paper_case(Mesh(16)), wear_lower=ThresholdLaw(1e-7))
    moving = updated_geometry(case, comm)
    with pytest.raises(ComputationError, match="half of the height"):
        moving.update(np.full((2, 16), 10.5))
