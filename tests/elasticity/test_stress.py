"""Stress at points of a body: exact fields, the surface, edges, thin bodies, reference values."""

import numpy as np
import pytest

import ringwear_par as rw
from ringwear_par.elasticity._rings import integrate_rows
from ringwear_par.elasticity.bem.body import BoundaryResponse
from ringwear_par.elasticity.bem.boundary import zone_meshes
from ringwear_par.elasticity.bem.pair import assemble_pair
from ringwear_par.elasticity.bem.quadrature import quadrature
from ringwear_par.elasticity.mesh import Mesh, contact_line
from ringwear_par.elasticity.sections import Body, Material, Section
from ringwear_par.elasticity.stress.fields import max_shear, mises, principal
from ringwear_par.elasticity.stress.largest import Search, edges
from ringwear_par.elasticity.stress.recovery import BoundaryRecovery, StressPoints, StressRecovery
from ringwear_par.elasticity.stress.surface import faces
from ringwear_par.elasticity.stress.zone import ZoneStress, locate

NU = 0.3
RING = Section((20.0, 40.0), 20.0)
DISC = Section((0.0, 10.0), 8.0)
SHEET = Section((20.0, 40.0), 0.05)
INSIDE = {
    RING: [[30.0, -10.0], [21.0, -0.5], [30.0, -0.01], [20.003, -7.0], [39.9, -19.9]],
    DISC: [[0.0, -4.0], [0.0, -0.01], [1e-3, -2.0], [5.0, -4.0], [9.99, -7.99], [2.0, -1e-4]],
    SHEET: [[30.0, -0.02], [25.0, -0.001], [33.3, -0.049]],
}


def linear_fields(r, z):
    """Displacements of which quadratic elements have no error, and their stresses (4 of each)."""
    zero, lame, shear = 0 * r, NU / ((1 + NU) * (1 - 2 * NU)), 0.5 / (1 + NU)
    both = 2 * (lame + shear)
    displacement = [
        [-NU * r, z, zero],  # a bar
        [r, zero, zero],
        [zero, zero + 1, r],  # rigid
        [zero, zero, r * z],  # torsion
    ]
    stress = [
        [zero, zero, zero + 1, zero, zero, zero],
        [zero + both, zero + both, zero + 2 * lame, zero, zero, zero],
        [zero] * 6,
        [zero, zero, zero, zero, zero, shear * r],
    ]
    return np.array(displacement).T, np.array(stress).T  # (m, 3, 4), (m, 6, 4)


def exact_zone(section, n=16):
    line = contact_line(section.r, Mesh(n))
    boundary = zone_meshes(section, line, Mesh(n))[0]
    ends = boundary.nodes[boundary.elements]
    along = ends[:, 2] - ends[:, 0]
    normal = np.stack([along[:, 1], -along[:, 0]], 1) / np.hypot(*along.T)[:, None]
    displacement, _ = linear_fields(*boundary.nodes.T)
    _, s = linear_fields(*ends[:, 1].T)
    nr, nz = normal.T[:, :, None]
    traction = np.stack(
        [s[:, 0] * nr + s[:, 3] * nz, s[:, 3] * nr + s[:, 2] * nz, s[:, 4] * nr + s[:, 5] * nz], 1
    )
    return BoundaryResponse(boundary, displacement, traction, Material(1.0, NU))


def at_points(zone, points):
    return ZoneStress(zone).at(np.array(points))


@pytest.mark.parametrize("section", INSIDE)
def test_linear_fields_are_exact(section):
    points = np.array(INSIDE[section])
    got, (_, exact) = at_points(exact_zone(section), points), linear_fields(*points.T)
    assert got[..., :3] == pytest.approx(exact[..., :3], abs=3e-7)
    # tractions are constant on elements, that of torsion is not
    assert got[..., 3] == pytest.approx(exact[..., 3], abs=1e-2 * np.abs(exact).max())


def test_integrals_over_elements_need_arrays_that_fit():
    """And are no number where a source is on an element: parts would be too long."""
    boundary = exact_zone(RING).boundary
    k, node, rules = len(boundary.elements), np.array([-1]), quadrature(1e-8)
    columns, factors, matrix = np.zeros((k, 3, 4), int), np.ones((k, 3, 4)), np.zeros(1)
    place = np.append(0.3 * boundary.nodes[0] + 0.7 * boundary.nodes[1], 0.0)[None]

    def integrate(rows, columns):
        integrate_rows(place, node, boundary, 0.3, rules, columns, factors, rows, matrix)

    rows = np.zeros((6, 1), int)
    with pytest.raises(rw.ComputationError, match="too close"):
        integrate(rows, columns)
    for bad in ((rows + 1, columns), (rows, columns + 1), (rows, columns[:, :2].copy())):
        with pytest.raises(ValueError, match="arrays"):
            integrate(*bad)


def test_torsion_converges():
    points = np.array([[25.0, -5.0], [38.0, -12.0]])
    _, exact = linear_fields(*points.T)
    errors = [np.abs(at_points(exact_zone(RING, n), points) - exact).max() for n in (16, 64)]
    assert 0.5 * np.log2(errors[0] / errors[1]) > 1.5
    assert errors[1] < 1e-3


@pytest.mark.parametrize("section", INSIDE)
def test_the_surface_has_linear_fields_too(section):
    zone = exact_zone(section)
    middle = zone.boundary.nodes[zone.boundary.elements[:, 1]]
    _, exact = linear_fields(*middle.T)
    assert ZoneStress(zone).surface[..., :3] == pytest.approx(exact[..., :3], abs=1e-9)
    # between the mid-points, and on the bodies' corners
    points = zone.boundary.nodes[zone.boundary.elements[:, 0]]
    points = points[points[:, 0] > 0]
    got, (_, exact) = at_points(zone, points), linear_fields(*points.T)
    assert got[..., :3] == pytest.approx(exact[..., :3], abs=1e-9)


def test_points_outside_have_no_stress():
    got = at_points(exact_zone(RING), [[30.0, 0.5], [30.0, -10.0], [19.0, -5.0], [30.0, -20.5]])
    assert np.isnan(got[[0, 2, 3]]).all()
    assert np.isfinite(got[1]).all()


def test_powers_between_mid_points():
    """Stresses at edges are powers of the distance: the interpolation has to follow them."""
    boundary = zone_meshes(RING, contact_line((28.5, 31.5), Mesh(64)), Mesh(64))[0]
    found = faces(boundary)
    values = np.abs(boundary.nodes[boundary.elements[:, 1], 0] - 28.5) ** -0.45
    for e in boundary.contact[2:30]:
        for t in (0.0, 0.25, 0.8):
            chosen, weights = found.weights(int(e), t)
            first, _, last = boundary.nodes[boundary.elements[e], 0]
            exact = (first + t * (last - first) - 28.5) ** -0.45
            assert weights @ values[chosen] == pytest.approx(exact, rel=1e-2)


def test_measures():
    both = np.array([[0.0, 0.0, -3.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0, 0.0, 2.0]])
    assert mises(both) == pytest.approx([3.0, 2.0 * np.sqrt(3.0)])
    assert max_shear(both) == pytest.approx([1.5, 2.0])
    assert principal(both) == pytest.approx(np.array([[0.0, 0.0, -3.0], [2.0, 0.0, -2.0]]))
    assert np.isnan(principal(np.nan * both)).all()


def test_the_search_leaves_edges_out_and_finds_between_its_points():
    boundary = zone_meshes(RING, contact_line((28.5, 31.5), Mesh(32)), Mesh(32))[0]
    around = edges([boundary])
    assert sorted(map(tuple, around.round(9))) == [(28.5, 0), (31.5, 0)]
    search = Search([boundary], around, 0.1)
    for edge, reach in ((around, 0.1), (np.array([[20.0, -20.0], [40.0, -20.0]]), 5.0)):
        away = np.hypot(*np.moveaxis(search.points[:, None] - edge, -1, 0)).min()
        assert reach - 1e-9 < away < 1.5 * reach
    assert (locate(boundary, search.points).distance > -1e-6).all()
    peak = np.array([29.87, -1.234])
    values = 7.0 - ((search.points - peak) ** 2).sum(axis=1)
    found = search.largest(search.points, search.zones, values)
    assert found.mises == pytest.approx(7.0, abs=2e-3)
    assert (found.r, found.z) == pytest.approx(tuple(peak), abs=0.05)
    assert found.layer == 0
    nothing = search.largest(search.points, search.zones, np.full(len(values), np.nan))
    assert np.isnan(nothing.mises)
    assert nothing.layer == -1


PAPER = (Body(RING, 1e4, 0.3, "clamped"), Body(Section((28.5, 31.5), 20.0), 1e5, 0.3, "clamped"))


def paper_stresses(n, comm, points, exclude=0.1):
    case = rw.read_case("scripts/cases/paper.toml", {
        "load.pressure": 50, "mesh.contact_elements": n, "time.step": 1e-9, "time.steps": 1,
    })  # fmt: skip
    pressure = rw.simulate(case, comm).profiles["pressure"][0]
    both = tuple(StressPoints(np.array(at), np.zeros(len(at))) for at in points)
    of = BoundaryRecovery(PAPER, case.line, case.mesh, (20.0, 20.0), comm, fine=True)
    return StressRecovery(of, both, exclude).stresses(pressure, 0.1)


@pytest.mark.parametrize(("n", "tolerance"), [(64, 1e-3), (128, 1e-4)])
def test_the_papers_rings(n, tolerance, comm):
    """Converged finite elements: 50 MPa, mu = 0.1."""
    places = [[30.0, 19.95], [30.0, 19.8], [30.0, 20.0]], [[30.0, 25.0], [30.0, 20.0]]
    lower, upper = paper_stresses(n, comm, places)
    assert mises(lower.points[:2]) == pytest.approx([15.4735, 15.7083], rel=tolerance)
    assert max_shear(lower.points[:2]) == pytest.approx([8.7740, 9.0225], rel=tolerance)
    # tension positive, z upwards, lower dragged towards +theta
    assert lower.points[0, 2] < -30.0
    assert lower.points[0, 5] == pytest.approx(3.426, rel=1e-3)
    assert upper.points[0, 5] > 0.0
    assert lower.surface[:, 5] == pytest.approx(-0.1 * lower.surface[:, 2], rel=1e-9)
    for of in ("surface", "points"):  # what pressure and friction say is the same on both
        sides = (getattr(body, of)[-1, [2, 3, 5]] for body in (lower, upper))
        assert next(sides) == pytest.approx(next(sides), rel=1e-9, abs=1e-9)


def test_up_to_the_surface(comm):
    """Coarse against fine at depths from a thousandth of an element on, and on the surface."""
    r = np.concatenate([[28.6, 28.7], np.random.default_rng(1).uniform(28.6, 31.4, 30)])
    depths = np.array([0.0, 1e-4, 3e-3, 0.02, 0.04, 0.06, 0.1, 0.3])
    rings = [
        np.stack(np.broadcast_arrays(r, 20.0 + side * depths[:, None]), axis=-1).reshape(-1, 2)
        for side in (-1.0, 1.0)
    ]
    fine = paper_stresses(144, comm, rings)
    for n, tolerance in ((48, 0.03), (72, 0.015)):
        for body, exact in zip(paper_stresses(n, comm, rings), fine, strict=True):
            assert mises(body.points) == pytest.approx(mises(exact.points), rel=tolerance)


def coated_stresses(n, thickness, young, comm):
    """Stresses of the paper's lower ring under a layer, beside and on both sides of its bottom."""
    section = Section((20.0, 40.0), 20.0, (), (thickness,))
    bodies = Body(section, 1e4, 0.3, "clamped", (Material(young, 0.3),)), PAPER[1]
    line = contact_line((28.5, 31.5), Mesh(n))
    pair = assemble_pair(bodies, line, Mesh(n), comm)
    pressure = np.linalg.solve(pair.normal[0] / 1e4 + pair.normal[1] / 1e5, np.ones(n))
    pressure *= 50.0 * line.area.sum() / (line.area @ pressure)
    depth = np.array([0.0, 0.3, 0.8, 1.0, 1.0, 1.3, 2.0]) * thickness
    at = np.stack(np.meshgrid([28.7, 29.4, 30.0, 31.2], 20.0 - depth), axis=-1).reshape(-1, 2)
    sides = np.repeat([0.0, 0.0, 0.0, 1.0, -1.0, 0.0, 0.0], 4)
    points = StressPoints(at, sides), StressPoints(np.empty((0, 2)), np.empty(0))
    of = BoundaryRecovery(bodies, line, Mesh(n), (20.0, 20.0), comm, fine=True)
    lower, _ = StressRecovery(of, points, 0.1).stresses(pressure, 0.1)
    return lower.points.reshape(len(depth), 4, 6), lower.largest


@pytest.mark.parametrize("thickness", [0.005, 0.5])
def test_stress_in_a_layer_and_under_it(thickness, comm):
    coarse, fine = (coated_stresses(n, thickness, 1e5, comm) for n in (48, 96))
    assert mises(coarse[0]) == pytest.approx(mises(fine[0]), rel=1e-2)
    assert coarse[1].mises == pytest.approx(fine[1].mises, rel=2e-2)
    assert coarse[1].layer == fine[1].layer == 0  # the hard one bears more
    above, below = fine[0][3], fine[0][4]
    assert above[:, [2, 3, 5]] == pytest.approx(below[:, [2, 3, 5]], abs=1e-9)  # tractions
    assert (np.abs(above[:, 1] - below[:, 1]) > 2.0).all()  # not so the hoop stress
    # the same strains along the interface, at ten times the modulus
    strain = [(s[:, 1] - 0.3 * (s[:, 0] + s[:, 2])) / e for s, e in ((above, 1e5), (below, 1e4))]
    assert strain[0] == pytest.approx(strain[1], rel=1e-9)


@pytest.mark.parametrize(("thickness", "young"), [(0.005, 3.0), (0.001, 100.0)])
def test_stress_under_a_soft_film_is_that_of_the_body(thickness, young, comm):
    """Tangential strains times the stiff side's modulus are no noise of the film's."""
    coarse, fine = (coated_stresses(n, thickness, young, comm) for n in (48, 96))
    assert mises(coarse[0][4]) == pytest.approx(mises(fine[0][4]), rel=1e-2)


def test_a_layer_of_the_same_material_changes_nothing(comm):
    layered, _ = coated_stresses(64, 0.3, 1e4, comm)
    shallow, _ = coated_stresses(64, 0.003, 1e4, comm)
    assert mises(layered[3]) == pytest.approx(mises(layered[4]), rel=2e-3)
    assert mises(layered[0]) == pytest.approx(mises(shallow[0]), rel=3e-3)


def disc_stresses(n, comm, points, layers=()):
    """Stresses in a solid disc under another one that turns on it, and friction's shear."""
    case = rw.read_case("scripts/cases/paper.toml", {
        "lower.r": [0.0, 20.0], "lower.z": [0.0, 15.0], "upper.r": [0.0, 10.0],
        "upper.z": [15.0, 25.0], "lower.layers": list(layers), "contact.friction": 0.3,
        "mesh.contact_elements": n, "time.step": 1e-9, "time.steps": 1, "stress.points": points,
    })  # fmt: skip
    result = rw.simulate(case, comm)
    return result.stress["stress"][-1], 0.3 * result.profiles["pressure"][0][0]


@pytest.mark.parametrize("thickness", [None, 0.05])
def test_on_the_axis_stress_is_symmetric(thickness, comm):
    """On faces and interfaces, inside and in layers; beside it stress goes to the same."""
    layers = [{"thickness": thickness, "young": 1e5, "poisson": 0.3}] if thickness else []
    heights = [0.0, 0.1, 7.0, 14.5, 14.9, 14.97, 14.999, 15.001, 15.1, 15.5, 20.0, 25.0]
    on_axis = [[0.0, z] for z in heights] + [[0.0, 15.0, side] for side in ("below", "above")]
    if layers:
        on_axis += [[0.0, 15.0 - thickness, side] for side in ("above", "below")]
    found, friction = disc_stresses(24, comm, on_axis, layers)
    assert (found[:, 3:] == 0.0).all()
    np.testing.assert_array_equal(found[:, 0], found[:, 1])
    assert (found[:, 2] < 0.0).all()
    inside = [[r, z] for z in (7.0, 14.5, 14.9, 15.1, 15.5) for r in (0.0, 1e-4)]
    near = disc_stresses(24, comm, inside, layers)[0].reshape(-1, 2, 6)
    np.testing.assert_allclose(near[:, 1], near[:, 0], atol=2e-3 * friction)


def test_near_the_axis_stress_converges(comm):
    """Within the first element, which is 0.6 mm wide on the coarsest of the meshes."""
    layers = [{"thickness": 0.4, "young": 1e5, "poisson": 0.3}]
    heights = [14.9, 14.8, 14.7, 14.5, 14.0, 15.1, 15.3]
    points = [[r, z] for r in (0.0, 0.02, 0.05, 0.1, 0.2) for z in heights]
    coarse, middle, fine = (disc_stresses(n, comm, points, layers) for n in (32, 64, 128))
    errors = [np.abs(one[0] - fine[0]).max() / fine[1] for one in (coarse, middle)]
    assert errors[0] < 0.05
    assert errors[1] < errors[0] / 3.0  # of first order at least


def test_stresses_of_incompressible_bodies_are_as_accurate(comm):
    """The quadrature's error is not multiplied by 1 / (1 - 2 nu)."""
    points = [[30.0, 19.9], [29.0, 19.0], [30.0, 20.2]]
    found = []
    for poisson in (0.499999, 0.4999999999):
        changes = {
            "lower.poisson": poisson, "upper.poisson": poisson, "mesh.contact_elements": 16,
            "time.steps": 1, "stress.points": points,
        }  # fmt: skip
        case = rw.read_case("scripts/cases/paper.toml", changes)
        stress = rw.simulate(case, comm).stress
        names = ("stress", "max_mises_lower", "max_mises_upper")
        found.append([stress[name][-1] for name in names])
    (inside, *largest), (known, *exact) = found
    assert np.abs(inside - known).max() < 1e-4 * np.abs(known).max()
    assert largest == pytest.approx(exact, rel=1e-4)
