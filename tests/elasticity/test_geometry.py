"""Contours: closed, counter-clockwise, graded, exact in area."""

import numpy as np
import pytest

import ringwear_par as rw
from ringwear_par.elasticity.bem.boundary import boundary_mesh, count_elements
from ringwear_par.elasticity.mesh import Mesh, contact_line, graded
from ringwear_par.elasticity.sections import Section, corners

# each with its contact line; faces: chamfers, a ridge with a corner, a smooth dome, a steep rim
DOME = tuple((float(r), float(-(r**2) / 40.0)) for r in np.linspace(0.0, 10.0, 201))
SECTIONS = [
    (Section((20.0, 40.0), 20.0), (28.5, 31.5)),
    (Section((28.5, 31.5), 20.0), (28.5, 31.5)),
    (Section((20.0, 30.0), 5.0), (25.0, 30.0)),
    (Section((0.0, 10.0), 8.0), (0.0, 3.0)),
    (Section((0.0, 10.0), 8.0), (2.0, 3.0)),
    (Section((0.0, 3.0), 8.0), (0.0, 3.0)),
    (Section((28.5, 31.5), 20.0, ((28.5, -0.1), (28.6, 0.0), (31.4, 0.0), (31.5, -0.1))),
     (28.5, 31.5)),
    (Section((20.0, 40.0), 20.0, ((20.0, -1.0), (29.0, 0.0), (40.0, -3.0))), (28.5, 31.5)),
    (Section((20.0, 40.0), 20.0, ((20.0, -1.0), (29.0, 0.0), (40.0, -3.0))), (30.0, 31.5)),
    (Section((0.0, 10.0), 8.0, DOME), (0.0, 3.0)),
    (Section((0.0, 10.0), 8.0, DOME), (2.0, 3.0)),
]  # fmt: skip


def enclosed(body):
    """Area by Green's theorem, exact for straight elements, positive counter-clockwise."""
    first, last = body.nodes[body.elements[:, 0]], body.nodes[body.elements[:, 2]]
    return 0.5 * np.sum(first[:, 0] * last[:, 1] - last[:, 0] * first[:, 1])


def integral(y, x):
    return 0.5 * (y[1:] + y[:-1]) @ np.diff(x)


def check_contour(body, section, line):
    first, middle, last = (body.nodes[body.elements[:, i]] for i in range(3))
    assert middle == pytest.approx(0.5 * (first + last), rel=1e-15, abs=1e-300)
    assert np.hypot(*(last - first).T).min() > 0.0
    assert np.array_equal(first[body.contact, 0], line.edges[1:])
    assert np.array_equal(last[body.contact, 0], line.edges[:-1])
    assert body.nodes[body.elements[body.fixed].ravel(), 1] == pytest.approx(-section.height)
    following = np.roll(body.elements[:, 0], -1)
    if section.r[0] > 0:
        assert np.array_equal(body.elements[:, 2], following)
    else:
        assert np.array_equal(body.elements[:-1, 2], following[:-1])
        assert body.nodes[[0, -1], 0].tolist() == [0.0, 0.0]


@pytest.mark.parametrize(("section", "contact"), SECTIONS)
@pytest.mark.parametrize("n", [16, 17, 64])
def test_contour_encloses_the_section(section, contact, n):
    line = contact_line(contact, Mesh(n), section)
    body = boundary_mesh(section, line, Mesh(n))
    assert line.n == n
    assert len(body.elements) == count_elements(section, contact, Mesh(n))
    check_contour(body, section, line)
    r, z = section.points.T
    exact = (r[-1] - r[0]) * section.height + integral(z, r)
    smooth = len(r) > 10  # its elements are chords
    assert enclosed(body) == pytest.approx(exact, rel=5e-3 if smooth else 1e-13)
    heights = body.nodes[body.elements[body.contact, 2], 1]
    assert heights == pytest.approx(section.depth(line.edges[:-1]), abs=1e-15)


@pytest.mark.parametrize(("section", "contact"), SECTIONS)
def test_a_worn_contour_loses_what_is_worn(section, contact):
    mesh = Mesh(32)
    line = contact_line(contact, mesh, section)
    worn = 0.03 * (2.0 + np.cos(7.0 * line.edges))
    fresh, body = (boundary_mesh(section, line, mesh, w) for w in (None, worn))
    check_contour(body, section, line)
    lost = integral(worn, line.edges)
    for end, neighbour in ((0, body.contact[0] + 1), (-1, body.contact[-1] - 1)):
        if line.edges[end] not in section.r:  # the wall of the track
            wall = body.nodes[body.elements[neighbour]]
            lost += 0.5 * abs(wall[0, 0] - wall[2, 0]) * worn[end]
    assert enclosed(fresh) - enclosed(body) == pytest.approx(lost, rel=1e-10)
    moved = np.abs(fresh.nodes - body.nodes).max(axis=1) > 0
    assert not moved[fresh.elements[fresh.fixed].ravel()].any()
    assert np.array_equal(boundary_mesh(section, line, mesh, 0.0 * worn).nodes, fresh.nodes)


def test_the_line_is_cut_at_corners_and_shares_its_elements_out():
    chamfered, ridge = SECTIONS[6][0], SECTIONS[7][0]
    assert corners(chamfered) == [28.6, 31.4]
    assert corners(SECTIONS[9][0]) == []
    line = contact_line((28.5, 31.5), Mesh(64), chamfered, ridge)
    cuts = np.flatnonzero(np.isin(line.edges, [28.6, 29.0, 31.4]))
    counts = np.diff([0, *cuts, 64])
    assert len(cuts) == 3
    assert counts.sum() == 64
    ideal = 64 * np.sqrt([0.1, 0.4, 2.4, 0.1]) / np.sqrt([0.1, 0.4, 2.4, 0.1]).sum()
    assert np.abs(counts - ideal).max() < 1.0
    alone = contact_line((28.5, 31.5), Mesh(64))
    assert np.array_equal(contact_line((28.5, 31.5), Mesh(64), *SECTIONS[0][:1]).edges, alone.edges)
    assert np.array_equal(alone.edges, graded(31.5, 28.5, 64, 2.5, 2.5)[::-1])
    assert contact_line((28.5, 31.5), Mesh(16), chamfered, ridge).n == 16
    with pytest.raises(rw.InputError, match=r"15.* 4 pieces .*16"):
        contact_line((28.5, 31.5), Mesh(15), chamfered, ridge)


def test_contact_line_measures():
    line = contact_line((28.5, 31.5), Mesh(64))
    assert line.area.sum() == pytest.approx(np.pi * (31.5**2 - 28.5**2), rel=1e-14)
    assert (line.area / line.arm).sum() == pytest.approx(2 * np.pi * 3.0, rel=1e-14)
    exact = 2 * np.pi / 3 * (31.5**3 - 28.5**3)
    assert line.area @ line.uniform_arm == pytest.approx(exact, rel=1e-14)
    assert np.allclose(line.width, line.width[::-1], rtol=1e-9)
    assert line.width[0] < line.width[32] / 20


def test_the_fixed_face_is_fine_under_thin_bodies_only():
    """Under the contact: 16 distances, or its width, over the number of contact elements."""
    contact, mesh = (10.0, 20.0), Mesh(64)
    for height, more in ((0.1, True), (1.5, True), (20.0, False)):
        section = Section((0.0, 30.0), height)
        body = boundary_mesh(section, contact_line(contact, mesh), mesh)
        r = body.nodes[body.elements[body.fixed], 0]
        middle, length = r[:, 1], np.abs(r[:, 2] - r[:, 0])
        assert (len(middle) > 32) == more
        under = (middle > contact[0]) & (middle < contact[1])
        assert under.any()
        if more:
            assert (length[under] <= max(16.0 * height, 10.0) / 64 * (1.0 + 1e-9)).all()


def test_grading_one_is_uniform_and_doubling_halves():
    assert graded(2.0, 5.0, 6, 1.0, 1.0) == pytest.approx(np.linspace(2, 5, 7), rel=1e-14)
    assert graded(0, 1, 20, 3.0, 2.0)[::2] == pytest.approx(graded(0, 1, 10, 3.0, 2.0), abs=1e-15)


@pytest.mark.parametrize(
    "bad",
    [
        ((3.0, 2.0), 1.0),
        ((1.0, 2.0), 1.0, ((1.0, 0.0), (1.5, 0.1), (2.0, 0.0))),
        ((1.0, 2.0), 1.0, ((1.0, 0.0), (1.5, 0.0), (1.5, -0.1), (2.0, 0.0))),
    ],
)
def test_impossible_sections_are_refused(bad):
    with pytest.raises(rw.InputError, match="section"):
        Section(*bad)
