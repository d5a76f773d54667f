"""Slopes of faces, the one that pressure acts along, and the elasticity of sloping pairs."""

import math

import numpy as np
import pytest
from parts import bodies, boundary_recovery
from paths import CASES
from reference_cases import SORTS, Rings, ring_case
from tracing import first_contact

import ringwear_par as rw
from ringwear_par.elasticity.bem.body import body_zones, solve_zones
from ringwear_par.elasticity.bem.pair import assemble_pair
from ringwear_par.elasticity.mesh import (
    Mesh,
    case_slopes,
    common_slope,
    contact_line,
    face_slope,
    obliquity,
)
from ringwear_par.elasticity.sections import Body, Section
from ringwear_par.elasticity.stress.fields import FACES

CONTACT = (28.5, 31.5)
TAN = math.tan(math.radians(10.0))


def cone(tangent, r=CONTACT, height=20.0):
    """A ring whose face rises outwards by a tangent, in its own frame."""
    rise = tangent * (r[1] - r[0])
    return Section(r, height, ((r[0], min(-rise, 0.0)), (r[1], min(rise, 0.0))))


# -- faces -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("tangent", [TAN, -TAN, 1.0])
def test_cones_slope_alike_on_all_elements(tangent):
    line = contact_line(CONTACT, Mesh(24, grading=3.0))
    assert face_slope(cone(tangent), line, Mesh(24), np.zeros(24)) == pytest.approx(
        np.full(24, tangent), rel=1e-8
    )
    assert not face_slope(Section(CONTACT, 20.0), line, Mesh(24), np.zeros(24)).any()
    assert obliquity(np.array([0.0, 1.0])) == pytest.approx([1.0, math.sqrt(2.0)])


def test_a_sphere_slopes_as_one_and_not_in_steps_of_its_samples():
    case = rw.read_case(CASES / "sphere.toml", {"mesh.contact_elements": 48})
    lower, upper = case_slopes(case.sections, case.line, case.mesh, np.zeros((2, case.line.n)))
    r, steep = case.line.r, case.line.r > 0.1
    exact = r / np.sqrt(20.0**2 - r**2)  # rises outwards in the frame of the case
    assert not lower.any()
    assert upper[steep] == pytest.approx(exact[steep], rel=3e-4)  # samples of 7 decimals
    assert upper == pytest.approx(exact, abs=1e-5)


def test_a_linear_wear_depth_adds_its_slope_up_to_the_ends():
    mesh = Mesh(32, grading=3.5, geometry="updated", geometry_tolerance=0.005)
    line = contact_line(CONTACT, mesh)
    worn = 0.05 + 0.02 * (line.r - 30.0)
    assert line.width.min() < 0.2 * mesh.geometry_tolerance < line.width.max()
    for tangent in (0.0, TAN):
        found = face_slope(cone(tangent) if tangent else Section(CONTACT, 20.0), line, mesh, worn)
        assert found == pytest.approx(np.full(32, tangent - 0.02), rel=1e-8)
    # the same depths worn off the upper body, whose frame stands upside down
    sections = Section(CONTACT, 20.0), Section(CONTACT, 20.0)
    both = case_slopes(sections, line, mesh, np.stack([worn, worn]))
    assert both[0] == pytest.approx(np.full(32, -0.02), rel=1e-8)
    assert both[1] == pytest.approx(np.full(32, 0.02), rel=1e-8)


def test_round_off_of_depths_is_no_slope():
    """Elements of 1e-6 mm and depths that are wrong by 1e-9 mm: a slope of 1e-3, if looked at."""
    mesh = Mesh(128, grading=4.0, geometry="updated", geometry_tolerance=0.005)
    line = contact_line(CONTACT, mesh)
    assert line.width.min() < 2e-6
    noise = 1e-9 * np.where(np.arange(128) % 2, 1.0, -1.0)
    assert np.abs(np.diff(noise) / np.diff(line.r)).max() > 1e-4
    smooth = 0.02 + 1e-3 * (line.r - 30.0) ** 2
    flat = Section(CONTACT, 20.0)
    clean, found = (face_slope(flat, line, mesh, smooth + more) for more in (0.0, noise))
    assert np.abs(found - clean).max() < 1e-6
    assert clean == pytest.approx(-2e-3 * (line.r - 30.0), abs=1e-5)


def test_pressure_acts_along_the_flatter_face_or_the_axis():
    table = [  # lower, upper, common
        (0.1, 0.2, 0.1), (-0.1, -0.2, -0.1), (-0.3, -0.2, -0.2), (0.1, 0.1, 0.1),
        (0.1, -0.1, 0.0), (-0.1, 0.2, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 0.0),
    ]  # fmt: skip
    lower, upper, common = np.array(table).T
    assert np.array_equal(common_slope(np.stack([lower, upper])), common)


# -- pairs -----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def cones(comm):
    """Matched cones of 10 degrees on two meshes, with their pairs."""
    cases = [ring_case(SORTS["cones of 10 degrees"], Mesh(n)) for n in (16, 32)]
    return [(case, rw.assemble(case, comm)) for case in cases]


def test_a_pair_upside_down_is_the_same_pair(comm):
    """Unlike bodies on unlike cones, exchanged, as if the whole rig had been turned over."""
    mesh = Mesh(16)
    lower = Body(Section((27.0, 33.0), 15.0, ((27.0, -1.5), (33.0, 0.0))), 1e4, 0.3, "clamped")
    upper = Body(cone(-TAN), 5e4, 0.2, "platen")
    line = contact_line(CONTACT, mesh)
    one, other = (
        assemble_pair(both, line, mesh, comm) for both in ((lower, upper), (upper, lower))
    )
    # lower rises outwards by 0.25, upper by TAN: in the frame of the case its own sign is turned
    assert one.slope == pytest.approx(np.full(16, TAN), rel=1e-8)
    assert other.slope == pytest.approx(-one.slope, rel=1e-8)
    for name in ("normal", "twist", "force_reaction", "torque_reaction"):
        a, b = getattr(one, name), getattr(other, name)[::-1]
        assert np.abs(a - b).max() <= 1e-12 * np.abs(a).max(), name


def asymmetry(line, normal):
    """Largest ``|m C - (m C)'|`` over the largest ``|m C|`` of the middle half of the elements."""
    inside = slice(line.n // 4, -line.n // 4)
    weighted = (line.area[:, None] * normal)[inside, inside]
    return np.abs(weighted - weighted.T).max() / np.abs(weighted).max()


def test_cones_are_reciprocal_and_balance(cones, comm):
    """Pressure along the normal, and what gives way along it; along the axis would not do.

    Reactions are projected area for the force, true area for the torque.
    """
    defects, axial, reactions, oblique = [], [], [], 1.0 / math.cos(math.radians(10.0))
    for case, pair in cones:
        body, mesh, line = bodies(case)[0], case.mesh, pair.line
        assert pair.slope == pytest.approx(np.full(line.n, TAN), rel=1e-8)
        assert obliquity(pair.slope) == pytest.approx(oblique)
        both = pair.normal[0] / case.lower.young + pair.normal[1] / case.upper.young
        defects.append([asymmetry(line, normal) for normal in (both, pair.normal[0])])
        zones = body_zones(body, line, mesh, slope=pair.slope)
        (response,), _ = solve_zones(zones, mesh.quadrature_tolerance, comm)
        middle = response.boundary.elements[response.boundary.contact, 1]
        axial.append(asymmetry(line, -response.displacement[middle, 1]))
        force = np.abs(pair.force_reaction / line.area - 1.0).max()
        torque = np.abs(pair.torque_reaction / (line.area * line.arm * oblique) - 1.0).max()
        reactions.append(max(force, torque))
    for one, other in zip(*defects, strict=True):
        assert other < 0.5 * one < 0.01
    assert min(axial) > 0.01
    assert reactions[1] < 0.7 * reactions[0] < 0.01


# -- fields ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("degrees", [0.0, 5.0, -10.0])
def test_displaced_faces_meet_along_the_common_normal(degrees, comm):
    """And their tractions are p along it, and mu p around the axis, per true area."""
    case = ring_case(Rings(CONTACT, (1e4, 1e5), degrees), Mesh(32))
    t, cos = math.tan(math.radians(degrees)), math.cos(math.radians(degrees))
    contact = first_contact(case)
    p, touching = contact.pressure, contact.pressure > 0.0
    recovery = boundary_recovery(case, comm)
    both = recovery.fields(p, contact.approach, case.friction, np.zeros((2, 32)))
    moved, normals = [], np.array([-t, 1.0]) * cos  # of the lower face, outwards
    for sign, body in zip((1.0, -1.0), both, strict=True):
        elements = np.flatnonzero(body.face == FACES.index("contact"))
        middle = body.elements[elements, 1]
        order = np.argsort(body.nodes[middle, 0])
        elements, middle = elements[order], middle[order]
        moved.append(body.nodes[middle] + body.displacement[middle, :2])
        traction = body.traction[elements]
        assert traction[:, :2] == pytest.approx(-sign * p[:, None] * normals, rel=1e-9, abs=1e-12)
        assert np.hypot(*traction[:, :2].T) == pytest.approx(p, rel=1e-9)
        assert traction[:, 2] == pytest.approx(sign * case.friction * p, rel=1e-9)
    apart = ((moved[1] - moved[0]) @ normals)[touching]
    sheared = ((moved[1] - moved[0]) @ np.array([normals[1], -normals[0]]))[touching]
    assert np.abs(apart).max() < 1e-4 * contact.approach
    if degrees:  # they slide along each other, and along the axis there is a gap or an overlap
        along = (moved[1] - moved[0])[touching, 1]
        assert np.abs(sheared).max() > 0.005 * contact.approach
        assert np.abs(along).max() > 20.0 * np.abs(apart).max()
