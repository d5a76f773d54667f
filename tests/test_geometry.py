"""Contours: closed, counter-clockwise, graded, exact in area."""

import numpy as np
import pytest

from ringwear_par.errors import InputError
from ringwear_par.geometry import Mesh, Section, contact_line, contour, count_elements, graded

SECTIONS = [
    Section((20.0, 40.0), 20.0, (28.5, 31.5)),
    Section((28.5, 31.5), 20.0, (28.5, 31.5)),
    Section((20.0, 30.0), 5.0, (25.0, 30.0)),
    Section((0.0, 10.0), 8.0, (0.0, 3.0)),
    Section((0.0, 10.0), 8.0, (2.0, 3.0)),
    Section((0.0, 3.0), 8.0, (0.0, 3.0)),
]


@pytest.mark.parametrize("section", SECTIONS)
@pytest.mark.parametrize("n", [4, 17, 64])
def test_contour_encloses_the_section(section, n):
    body = contour(section, Mesh(n))
    assert len(body.elements) == count_elements(section, Mesh(n))
    first, middle, last = (body.nodes[body.elements[:, i]] for i in range(3))
    step = last - first
    # Green: area by the trapezoidal rule, exact for straight elements, positive counter-clockwise
    area = 0.5 * np.sum(first[:, 0] * last[:, 1] - last[:, 0] * first[:, 1])
    assert area == pytest.approx((section.r[1] - section.r[0]) * section.height, rel=1e-13)
    assert middle == pytest.approx(0.5 * (first + last), rel=1e-15)
    assert np.hypot(*step.T).min() > 0.0
    line = contact_line(section.contact, Mesh(n))
    assert np.array_equal(body.nodes[body.elements[body.contact, 0], 0], line.edges[1:])
    assert np.array_equal(body.nodes[body.elements[body.contact, 2], 0], line.edges[:-1])
    assert body.nodes[body.elements[body.held].ravel(), 1] == pytest.approx(-section.height)
    if section.r[0] > 0:
        assert np.array_equal(body.elements[:, 2], np.roll(body.elements[:, 0], -1))


def test_contact_line_measures():
    line = contact_line((28.5, 31.5), Mesh(64))
    assert line.area.sum() == pytest.approx(np.pi * (31.5**2 - 28.5**2), rel=1e-14)
    assert line.area @ line.arm == pytest.approx(2 * np.pi / 3 * (31.5**3 - 28.5**3), rel=1e-14)
    assert np.allclose(line.width, line.width[::-1], rtol=1e-9)
    assert line.width[0] < line.width[32] / 20


def test_grading_one_is_uniform_and_doubling_halves():
    assert graded(2.0, 5.0, 6, 1.0, 1.0) == pytest.approx(np.linspace(2, 5, 7), rel=1e-14)
    assert graded(0, 1, 20, 3.0, 2.0)[::2] == pytest.approx(graded(0, 1, 10, 3.0, 2.0), abs=1e-15)


@pytest.mark.parametrize(
    "bad",
    [
        ((3.0, 2.0), 1.0, (2.0, 3.0)),
        ((1.0, 2.0), 0.0, (1.0, 2.0)),
        ((1.0, 2.0), 1.0, (0.5, 2.0)),
        ((1.0, 2.0), 1.0, (1.5, 1.5)),
    ],
)
def test_impossible_sections_are_refused(bad):
    with pytest.raises(InputError, match="section"):
        Section(*bad)
