"""The drawing of the rig: true to the case, and legible for any proportions."""

import itertools

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from paths import ROOT

import ringwear_par as rw

CASES = [
    path
    for path in sorted((ROOT / "scripts/cases").glob("*.toml"))
    if path.stem not in ("study", "wear_law")
]
FLAT = {"lower.r": [0, 300], "lower.z": [18, 20], "upper.r": [290, 300], "upper.z": [20, 21]}
TALL = {"lower.r": [10, 12], "lower.z": [-70, 20], "upper.r": [9, 11], "upper.z": [20, 60]}


def texts(figure):
    """Return the boxes in pixels of the words of a figure that are seen, by their text."""
    renderer = FigureCanvasAgg(figure).get_renderer()
    figure.draw(renderer)
    (axes,) = figure.axes
    words = [*axes.texts, *axes.get_xticklabels(), *axes.get_yticklabels(), axes.xaxis.label]
    return {text.get_text(): text.get_window_extent(renderer) for text in words if text.get_text()}


@pytest.mark.parametrize("path", CASES, ids=lambda path: path.stem)
def test_words_are_inside_and_apart(path):
    boxes = texts(figure := rw.plot(rw.read_case(path)))
    width, height = figure.canvas.get_width_height()
    for name, box in boxes.items():
        assert (np.clip(box.get_points(), 0, (width, height)) == box.get_points()).all(), name
    for (name, box), (other, second) in itertools.combinations(boxes.items(), 2):
        assert not box.padded(-1.0).overlaps(second.padded(-1.0)), (name, other)


@pytest.mark.parametrize("changes", [FLAT, TALL])
def test_words_of_flat_and_tall_rigs_are_apart(changes):
    case = rw.read_case(ROOT / "scripts/cases/archard.toml", changes)
    boxes = texts(rw.plot(case))
    assert "not to scale: heights" in boxes
    for box, second in itertools.combinations(boxes.values(), 2):
        assert not box.padded(-1.0).overlaps(second.padded(-1.0))


def test_outlines_are_those_of_the_case():
    case = rw.read_case(ROOT / "scripts/cases/crown.toml")
    patches = rw.plot(case).axes[0].patches
    filled = [patch.get_xy() for patch in patches if not patch.get_hatch()]
    for outline, ring in ((filled[0], case.lower), (filled[2], case.upper)):
        assert outline.min(axis=0) == pytest.approx((ring.r[0], ring.z[0]))
        assert outline.max(axis=0) == pytest.approx((ring.r[1], ring.z[1]))
