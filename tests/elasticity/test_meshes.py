"""Boundaries of bodies and of their layers: closed, bonded, graded, following the wear."""

import itertools

import numpy as np
import pytest

import ringwear_par as rw
from ringwear_par.elasticity.bem.boundary import count_elements, zone_meshes
from ringwear_par.elasticity.mesh import Mesh, contact_line, graded
from ringwear_par.elasticity.sections import Body, Material, Section, corners

CHAMFER = ((28.5, -0.1), (28.6, 0.0), (31.4, 0.0), (31.5, -0.1))
RIDGE, STEEP = (((20.0, -d), (29.0, 0.0), (40.0, -3.0 * d)) for d in (0.1, 1.0))
DOME = tuple((float(r), float(-(r**2) / 40.0)) for r in np.linspace(0.0, 10.0, 201))
#: each with its contact line; faces: chamfers, a ridge with a corner, a smooth dome
BARE = [
    (Section((20.0, 40.0), 20.0), (28.5, 31.5)),
    (Section((28.5, 31.5), 20.0), (28.5, 31.5)),
    (Section((20.0, 30.0), 5.0), (25.0, 30.0)),
    (Section((0.0, 10.0), 8.0), (2.0, 3.0)),
    (Section((0.0, 3.0), 8.0), (0.0, 3.0)),
    (Section((28.5, 31.5), 20.0, CHAMFER), (28.5, 31.5)),
    (Section((20.0, 40.0), 20.0, STEEP), (30.0, 31.5)),
    (Section((0.0, 10.0), 8.0, DOME), (0.0, 3.0)),
]
LAYERED = [
    (Section((20.0, 40.0), 20.0, (), (0.05,)), (28.5, 31.5)),
    (Section((20.0, 40.0), 20.0, (), (0.001, 2.0, 0.02)), (28.5, 31.5)),
    (Section((20.0, 40.0), 20.0, RIDGE, (0.5, 1.0)), (28.5, 31.5)),
    (Section((28.5, 31.5), 20.0, CHAMFER, (0.2,)), (28.5, 31.5)),
    (Section((20.0, 30.0), 5.0, (), (4.9,)), (25.0, 30.0)),
    (Section((0.0, 10.0), 8.0, (), (0.3, 1.0)), (0.0, 3.0)),
    (Section((0.0, 10.0), 8.0, DOME, (2.6,)), (2.0, 3.0)),
]


def meshes(section, contact, worn=None, n=32):
    line = contact_line(contact, Mesh(n), section)
    return line, zone_meshes(section, line, Mesh(n), None if worn is None else worn(line.edges))


def enclosed(zone):
    """Area by Green's theorem, exact for straight elements, positive counter-clockwise."""
    first, last = zone.nodes[zone.elements[:, 0]], zone.nodes[zone.elements[:, 2]]
    return 0.5 * np.sum(first[:, 0] * last[:, 1] - last[:, 0] * first[:, 1])


def top_and_bottom(zone):
    """Ends of the elements of a layer's upper and lower face, by radius: (2, k, 2) each."""
    n, sides = len(zone.below), len(zone.outer_side)
    upper = zone.elements[n + sides : n + sides + n][::-1, ::-1]
    return zone.nodes[upper][:, ::2], zone.nodes[zone.elements[zone.below]][:, ::2]


def check_bonded(zones, line):
    """Boundaries are closed, and have the same nodes on both sides of every interface."""
    for zone in zones:
        first, middle, last = (zone.nodes[zone.elements[:, i]] for i in range(3))
        assert middle == pytest.approx(0.5 * (first + last), rel=1e-15, abs=1e-300)
        assert np.hypot(*(last - first).T).min() > 0.0
        closed = slice(None, -1 if zone.nodes[0, 0] == 0.0 else None)  # or from axis to axis
        assert np.array_equal(zone.elements[closed, 2], np.roll(zone.elements[:, 0], -1)[closed])
    for upper, lower in itertools.pairwise(zones):
        one, other = upper.elements[upper.below], lower.elements[lower.above, ::-1]
        assert np.array_equal(upper.nodes[one], lower.nodes[other])
        assert (np.diff(upper.nodes[one[:, 1], 0]) > 0.0).all()
    contact = zones[0].nodes[zones[0].elements[zones[0].contact]]
    assert np.array_equal(contact[:, 0, 0], line.edges[1:])
    assert np.array_equal(contact[:, 2, 0], line.edges[:-1])


@pytest.mark.parametrize(("section", "contact"), [*BARE, *LAYERED])
@pytest.mark.parametrize("n", [17, 32])
def test_zones_are_bonded_and_fill_the_section(section, contact, n):
    line, zones = meshes(section, contact, n=n)
    check_bonded(zones, line)
    assert len(zones) == len(section.layers) + 1
    assert sum(len(zone.elements) for zone in zones) == count_elements(section, contact, Mesh(n))
    levels = [0.0, *(-np.cumsum(section.layers)), -section.height]
    r, z = section.points.T
    cut = [0.5 * (z[1:] + z[:-1]) @ np.diff(r), *(0.0 for _ in section.layers)]
    for k, zone in enumerate(zones):
        full = (r[-1] - r[0]) * (levels[k] - levels[k + 1]) + cut[k]
        smooth = len(r) > 2 and not corners(section)  # its elements are chords
        assert enclosed(zone) == pytest.approx(full, rel=5e-3 if smooth else 1e-9)
        below = zone.elements[zone.fixed if k == len(zones) - 1 else zone.below]
        assert (zone.nodes[below, 1] == levels[k + 1]).all()
        assert [len(of) > 0 for of in (zone.contact, zone.above)] == [k == 0, k > 0]
        assert (len(zone.inner_side) > 0) == (section.r[0] > 0.0)
    heights = zones[0].nodes[zones[0].elements[zones[0].contact, 2], 1]
    assert heights == pytest.approx(section.depth(line.edges[:-1]), abs=1e-15)


@pytest.mark.parametrize(("section", "contact"), BARE)
def test_a_worn_contour_loses_what_is_worn(section, contact):
    def worn(r):
        return 0.03 * (2.0 + np.cos(7.0 * r))

    (line, (fresh,)), (_, (body,)) = meshes(section, contact), meshes(section, contact, worn)
    check_bonded([body], line)
    depth = worn(line.edges)
    lost = 0.5 * (depth[1:] + depth[:-1]) @ line.width
    for end, neighbour in ((0, body.contact[0] + 1), (-1, body.contact[-1] - 1)):
        if line.edges[end] not in section.r:  # the wall of the track
            wall = body.nodes[body.elements[neighbour]]
            lost += 0.5 * abs(wall[0, 0] - wall[2, 0]) * depth[end]
    assert enclosed(fresh) - enclosed(body) == pytest.approx(lost, rel=1e-10)
    moved = np.abs(fresh.nodes - body.nodes).max(axis=1) > 0
    assert not moved[fresh.elements[fresh.fixed].ravel()].any()


@pytest.mark.parametrize(("section", "contact"), LAYERED)
@pytest.mark.parametrize("share", [0.0, 0.5, 1.3])
def test_interfaces_give_way_where_layers_are_worn_through(section, contact, share):
    """A film of 1 um, or of half a thinner layer, stays; nothing turns over."""

    def worn(r):
        return share * section.layers[0] * (0.7 + 0.3 * np.cos(3.0 * (r - r[0])))

    if share * section.layers[0] >= 0.5 * section.height:
        with pytest.raises(rw.ComputationError, match="half of the height"):
            meshes(section, contact, worn)
        return
    (line, before), (_, after) = meshes(section, contact), meshes(section, contact, worn)
    check_bonded(after, line)
    assert min(map(enclosed, after)) > 0.0
    films = np.minimum(1e-3, 0.5 * np.array(section.layers))
    for zone, unworn, film in zip(after, before, films, strict=False):
        (high, low), (high_0, low_0) = top_and_bottom(zone), top_and_bottom(unworn)
        assert np.array_equal(high[..., 0], low[..., 0])
        film = np.minimum(film, (high_0 - low_0)[..., 1])
        exact = np.minimum(low_0[..., 1], high[..., 1] - film)
        assert low[..., 1] == pytest.approx(exact, rel=0.0, abs=1e-14)
    same = [np.array_equal(a.nodes, b.nodes) for a, b in zip(before, after, strict=True)]
    assert all(same) == (share == 0.0)


def test_the_line_is_cut_at_corners_and_shares_its_elements_out():
    chamfered, ridge = Section((28.5, 31.5), 20.0, CHAMFER), Section((20.0, 40.0), 20.0, STEEP)
    assert corners(chamfered) == [28.6, 31.4]
    assert corners(Section((0.0, 10.0), 8.0, DOME)) == []
    line = contact_line((28.5, 31.5), Mesh(64), chamfered, ridge)
    cuts = np.flatnonzero(np.isin(line.edges, [28.6, 29.0, 31.4]))
    lengths = np.sqrt([0.1, 0.4, 2.4, 0.1])
    assert np.abs(np.diff([0, *cuts, 64]) - 64 * lengths / lengths.sum()).max() < 1.0
    alone = contact_line((28.5, 31.5), Mesh(64), Section((20.0, 40.0), 20.0))
    assert np.array_equal(alone.edges, graded(31.5, 28.5, 64, 2.5, 2.5)[::-1])
    with pytest.raises(rw.InputError, match=r"15.* 4 pieces .*16"):
        contact_line((28.5, 31.5), Mesh(15), chamfered, ridge)


def test_contact_line_measures():
    line = contact_line((28.5, 31.5), Mesh(64))
    assert line.area.sum() == pytest.approx(np.pi * (31.5**2 - 28.5**2), rel=1e-14)
    assert (line.area / line.arm).sum() == pytest.approx(2 * np.pi * 3.0, rel=1e-14)
    exact = 2 * np.pi / 3 * (31.5**3 - 28.5**3)
    assert line.area @ line.uniform_arm == pytest.approx(exact, rel=1e-14)
    assert graded(2.0, 5.0, 6, 1.0, 1.0) == pytest.approx(np.linspace(2, 5, 7), rel=1e-14)
    assert graded(0, 1, 20, 3.0, 2.0)[::2] == pytest.approx(graded(0, 1, 10, 3.0, 2.0), abs=1e-15)


def test_the_fixed_face_is_fine_under_thin_bodies_only():
    """Under the contact: 16 distances, or its width, over the number of contact elements."""
    contact, mesh = (10.0, 20.0), Mesh(64)
    for height, more in ((0.1, True), (1.5, True), (20.0, False)):
        section = Section((0.0, 30.0), height)
        body = zone_meshes(section, contact_line(contact, mesh), mesh)[0]
        r = body.nodes[body.elements[body.fixed], 0]
        middle, length = r[:, 1], np.abs(r[:, 2] - r[:, 0])
        assert (len(middle) > 32) == more
        under = (middle > contact[0]) & (middle < contact[1])
        if more:
            assert (length[under] <= max(16.0 * height, 10.0) / 64 * (1.0 + 1e-9)).all()


@pytest.mark.parametrize(
    "bad",
    [
        ((3.0, 2.0), 1.0),
        ((1.0, 2.0), 1.0, ((1.0, 0.0), (1.5, 0.1), (2.0, 0.0))),
        ((1.0, 2.0), 1.0, ((1.0, 0.0), (1.5, 0.0), (1.5, -0.1), (2.0, 0.0))),
        ((28.5, 31.5), 20.0, (), (12.0, 8.0)),
        ((28.5, 31.5), 20.0, CHAMFER, (0.1,)),
    ],
)
def test_impossible_sections_are_refused(bad):
    with pytest.raises(rw.InputError, match="no section"):
        Section(*bad)


def test_materials_relative_to_the_body():
    two = Material(1e5, 0.25), Material(5e3, 0.4)
    section = Section((28.5, 31.5), 20.0, (), (0.1, 0.2))
    relative = Body(section, 1e4, 0.3, "clamped", two).relative
    assert relative == (Material(10.0, 0.25), Material(0.5, 0.4), Material(1.0, 0.3))
