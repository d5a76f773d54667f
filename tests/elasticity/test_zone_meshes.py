"""Boundaries of bodies with layers: closed, bonded element by element, following the wear."""

import itertools

import numpy as np
import pytest

import ringwear_par as rw
from ringwear_par.elasticity.bem.boundary import count_elements, zone_meshes
from ringwear_par.elasticity.mesh import Mesh, contact_line
from ringwear_par.elasticity.sections import Body, Material, Section

CHAMFER = ((28.5, -0.1), (28.6, 0.0), (31.4, 0.0), (31.5, -0.1))
RIDGE = ((20.0, -0.3), (29.0, 0.0), (40.0, -0.4))
DOME = tuple((float(r), float(-(r**2) / 40.0)) for r in np.linspace(0.0, 10.0, 101))
#: each with its contact line
SECTIONS = [
    (Section((20.0, 40.0), 20.0, (), (0.05,)), (28.5, 31.5)),
    (Section((20.0, 40.0), 20.0, (), (0.001, 2.0, 0.02)), (28.5, 31.5)),
    (Section((20.0, 40.0), 20.0, RIDGE, (0.5, 1.0)), (28.5, 31.5)),
    (Section((28.5, 31.5), 20.0, (), (0.05, 0.5)), (28.5, 31.5)),
    (Section((28.5, 31.5), 20.0, CHAMFER, (0.2,)), (28.5, 31.5)),
    (Section((20.0, 30.0), 5.0, (), (4.9,)), (25.0, 30.0)),
    (Section((0.0, 10.0), 8.0, (), (0.3, 1.0)), (0.0, 3.0)),
    (Section((0.0, 10.0), 8.0, DOME, (2.6,)), (2.0, 3.0)),
    (Section((0.0, 3.0), 8.0, (), (0.3,)), (0.0, 3.0)),
]
N = 32


def meshes(section, contact, worn=None):
    line = contact_line(contact, Mesh(N), section)
    depth = None if worn is None else worn(line.edges)
    return line, zone_meshes(section, line, Mesh(N), depth)


def polygon(zone):
    """The zone's area, positive if its elements go round it counter-clockwise."""
    first, last = zone.nodes[zone.elements[:, 0]], zone.nodes[zone.elements[:, 2]]
    return 0.5 * np.sum(first[:, 0] * last[:, 1] - last[:, 0] * first[:, 1])


def top_and_bottom(zone):
    """Ends of the elements of a zone's upper and lower face, by radius: (2, k, 2) each."""
    n, sides = len(zone.below), len(zone.outer_side)
    upper = zone.elements[n + sides : n + sides + n][::-1, ::-1]
    return zone.nodes[upper][:, ::2], zone.nodes[zone.elements[zone.below]][:, ::2]


def check_bonded(zones):
    """Boundaries are closed, and have the same nodes on both sides of every interface."""
    for zone in zones:
        first, middle, last = (zone.nodes[zone.elements[:, i]] for i in range(3))
        assert middle == pytest.approx(0.5 * (first + last), rel=1e-15, abs=1e-300)
        assert np.hypot(*(last - first).T).min() > 0.0
        after = np.roll(zone.elements[:, 0], -1)
        if zone.nodes[0, 0] == 0.0:  # from axis to axis
            assert zone.nodes[-1, 0] == 0.0
            assert np.array_equal(zone.elements[:-1, 2], after[:-1])
        else:
            assert np.array_equal(zone.elements[:, 2], after)
    for upper, lower in itertools.pairwise(zones):
        one, other = upper.elements[upper.below], lower.elements[lower.above, ::-1]
        assert np.array_equal(upper.nodes[one], lower.nodes[other])
        assert (np.diff(upper.nodes[one[:, 1], 0]) > 0.0).all()


@pytest.mark.parametrize(("section", "contact"), SECTIONS)
def test_zones_are_bonded_and_fill_the_section(section, contact):
    line, zones = meshes(section, contact)
    check_bonded(zones)
    assert len(zones) == len(section.layers) + 1
    assert sum(len(zone.elements) for zone in zones) == count_elements(section, contact, Mesh(N))
    levels = [0.0, *(-np.cumsum(section.layers)), -section.height]
    width = section.r[1] - section.r[0]
    face, _ = top_and_bottom(zones[0])
    cut = float(face[..., 1].mean(axis=1) @ np.diff(face[..., 0])[:, 0])
    for k, zone in enumerate(zones):
        full = width * (levels[k] - levels[k + 1])
        assert polygon(zone) == pytest.approx(full + (cut if k == 0 else 0.0), rel=1e-9)
        below = zone.elements[zone.fixed if k == len(zones) - 1 else zone.below]
        assert (zone.nodes[below, 1] == levels[k + 1]).all()
        assert [len(of) > 0 for of in (zone.contact, zone.above)] == [k == 0, k > 0]
        assert (len(zone.inner_side) > 0) == (section.r[0] > 0.0)
    contact_ends = zones[0].nodes[zones[0].elements[zones[0].contact]]
    assert np.array_equal(contact_ends[:, 0, 0], line.edges[1:])
    assert contact_ends[:, 2, 1] == pytest.approx(section.depth(line.edges[:-1]), abs=1e-15)


@pytest.mark.parametrize(("section", "contact"), SECTIONS)
@pytest.mark.parametrize("share", [0.0, 0.5, 0.999, 1.3])
def test_interfaces_give_way_where_layers_are_worn_through(section, contact, share):
    """A film of 1 um, or of half a thinner layer, stays; nothing turns over."""

    def worn(r):
        return share * section.layers[0] * (0.7 + 0.3 * np.cos(3.0 * (r - r[0])))

    if share * section.layers[0] >= 0.5 * section.height:
        with pytest.raises(rw.ComputationError, match="half of the height"):
            meshes(section, contact, worn)
        return
    (_, before), (_, after) = meshes(section, contact), meshes(section, contact, worn)
    check_bonded(after)
    assert min(polygon(zone) for zone in after) > 0.0
    films = np.minimum(1e-3, 0.5 * np.array(section.layers))
    for zone, unworn, film in zip(after, before, films, strict=False):
        assert np.array_equal(zone.elements, unworn.elements)
        (high, low), (high_0, low_0) = top_and_bottom(zone), top_and_bottom(unworn)
        assert np.array_equal(high[..., 0], low[..., 0])
        film = np.minimum(film, (high_0 - low_0)[..., 1])
        exact = np.minimum(low_0[..., 1], high[..., 1] - film)
        assert low[..., 1] == pytest.approx(exact, rel=0.0, abs=1e-14)
    if share == 1.3:
        assert not np.array_equal(*(top_and_bottom(zones[0])[1] for zones in (before, after)))
    if share == 0.0:
        assert all(np.array_equal(a.nodes, b.nodes) for a, b in zip(before, after, strict=True))


@pytest.mark.parametrize(("face", "layers"), [((), (12.0, 8.0)), (CHAMFER, (0.1,))])
def test_impossible_layers_are_refused(face, layers):
    with pytest.raises(rw.InputError, match="thicker"):
        Section((28.5, 31.5), 20.0, face, layers)


def test_every_layer_has_a_material():
    section = Section((28.5, 31.5), 20.0, (), (0.1, 0.2))
    with pytest.raises(rw.InputError, match="2 layers"):
        Body(section, 1e4, 0.3, "clamped", (Material(1e5, 0.3),))
    two = Material(1e5, 0.25), Material(5e3, 0.4)
    relative = Body(section, 1e4, 0.3, "clamped", two).relative
    assert relative == (Material(10.0, 0.25), Material(0.5, 0.4), Material(1.0, 0.3))
