"""Colours of lines and points on white: a contrast of 3 to 1 at least, as WCAG 1.4.11 asks."""

import numpy as np
import pytest
from matplotlib.colors import to_rgb

from ringwear_par.pictures.panel import GREY
from ringwear_par.pictures.style import COLOURS, stage_colour


def luminance(colour):
    share = np.array(to_rgb(colour))
    linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    return linear @ [0.2126, 0.7152, 0.0722]


@pytest.mark.parametrize("colour", [*COLOURS, GREY, *map(stage_colour, (0.0, 0.3, 0.6, 1.0))])
def test_lines_are_seen_on_white(colour):
    assert 1.05 / (luminance(colour) + 0.05) >= 3.0


def test_later_stages_are_darker():
    values = [luminance(stage_colour(share)) for share in np.linspace(0.0, 1.0, 9)]
    assert np.all(np.diff(values) < 0.0)
