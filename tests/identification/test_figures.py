"""Figures of fits show what they say: signs, gaps, words, and no curves of what is not known."""

from dataclasses import replace

import numpy as np
import pytest
from figure_texts import check_texts
from laboratory import FITTED, fit_tables, write_tests
from mpi4py import MPI

from ringwear_par.identification.definition.fit_file import read_fit
from ringwear_par.identification.figures import drawn_series
from ringwear_par.identification.fit import expected_result
from ringwear_par.pictures import fit_panels, key_panels


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    """What is known before a fit of one test with a penetration, a profile and a mass."""
    folder = tmp_path_factory.mktemp("figures")
    experiments = write_tests(folder, (60.0,))
    mass = {"quantity": "mass.lower", "value": 5.0, "unit": "mg", "sd": 0.1, "density": 0.0019}
    experiments[0]["data"].append(mass)
    sought = {**FITTED, "wear.lower.p0": {"start": 25.0, "bounds": [0.0, 200.0]}}
    tables = fit_tables(folder, experiments, parameters=sought)
    return expected_result(read_fit(tables), MPI.COMM_WORLD)


def series_at(radii, edges, quantity="profile.lower", unit="um"):
    x = np.array(radii)
    columns = dict.fromkeys(("data", "model", "sd", "band", "residuals"), 0.0 * x)
    return fit_panels.Series(
        "test", "profile", quantity, unit, x, **columns, level=0.95, edges=edges,
        censored=np.zeros(len(x), dtype=int),
    )  # fmt: skip


def test_limits_are_arrows_to_where_the_truth_is():
    """Depths grow downwards."""
    for quantity, markers in (
        ("penetration", ["dot", "up", "down"]), ("profile.lower", ["dot", "down", "up"]),
    ):  # fmt: skip
        series = replace(series_at([1.0, 2, 3, 4], (), quantity), censored=np.array([0, 1, -1, 1]))
        points = fit_panels.readings(series).points
        assert [one.marker for one in points] == markers
        assert [one.name for one in points] == ["data", "2 limits, at least", "1 limit, at most"]
        assert [one.x.tolist() for one in points] == [[1.0], [2.0, 4.0], [3.0]]


def test_limits_are_as_far_from_the_model_as_they_are():
    """Those that the model keeps do not stretch the axis."""
    limits = np.array([0, 1, -1, 1])
    at = replace(series_at([1.0, 2, 3, 4], ()), residuals=np.array([1, -2, 50, 6]), censored=limits)
    panel = fit_panels.residuals(at)
    data, low, kept = (one.y for one in panel.points)
    assert data.tolist() == [1.0]
    assert low.tolist() == [-2.0, 6.0]  # the last is a misfit
    assert panel.y.ends[1] == pytest.approx(6.6)
    assert 6.0 < kept[0] < 6.6


def test_bars_of_specimens_are_their_intervals():
    each = {
        "1": {"estimate": 2.0, "sd": 0.5, "interval": [1.2, 3.4], "alone": None},
        "2": {"estimate": 2.0, "sd": 0.5, "interval": [1.2, 3.4],
              "alone": {"estimate": 2.0, "sd": 0.1}},
    }  # fmt: skip
    entry = {"estimate": 2.0, "interval": [1.5, 2.6], "next": [1.0, 4.0], "unit": "MPa"}
    alone, by_all = key_panels.specimens("wear.lower.p0", {**entry, "each": each}, 0.95).points
    assert np.array(by_all.ends) == pytest.approx(np.array([[1.2, 1.2], [3.4, 3.4]]))
    assert [ends[1] for ends in alone.ends] == pytest.approx([2.0 - 0.196, 2.0 + 0.196], abs=1e-4)


def test_a_profile_is_broken_at_edges_and_gaps():
    radii = [28.3, 28.4, 28.5, 28.6, 28.7, 28.8, 29.4, 29.5]
    for order in (radii, radii[::-1]):
        series = series_at(order, (28.5, 31.5))
        assert series.breaks().tolist() == [2, 6]
        (model,) = fit_panels.readings(series).curves
        assert np.flatnonzero(np.isnan(model.x)).tolist() == [2, 7]
        assert model.x[np.isfinite(model.x)].tolist() == radii
    assert series_at([31.4, 31.5, 31.6], (28.5, 31.5)).breaks().tolist() == [2]
    assert series_at(radii, ()).breaks().tolist() == [6]  # where edges are not known


@pytest.mark.parametrize(
    ("quantity", "unit", "said"),
    [
        ("profile.lower", "\N{MICRO SIGN}m", "worn depth of lower (\N{MICRO SIGN}m)"),
        ("penetration", "\N{GREEK SMALL LETTER MU}m", "penetration (\N{MICRO SIGN}m)"),
        ("penetration", "um", "penetration (\N{MICRO SIGN}m)"),
        ("penetration", "2 vacuums", "penetration (2 vacuums)"),
        ("volume", "um^3", "volume loss (\N{MICRO SIGN}m\N{SUPERSCRIPT THREE})"),
        ("mass.upper", "mg", "mass loss of upper (mg)"),
    ],
)
def test_axes_are_in_words(quantity, unit, said):
    assert series_at([1.0], (), quantity, unit).label == said


def test_residuals_are_data_less_model(found):
    chart = found.plot()
    check_texts(chart)
    panels = [axes for axes in chart.axes if axes.get_ylabel() == "residual / sd"]
    assert len(panels) == 2
    for axes, (_, series, part) in zip(panels, found.misfit.records, strict=False):
        expected = (series.value - found.evaluation.model[part]) / series.sd
        (drawn,) = (line.get_ydata() for line in axes.lines)
        assert drawn == pytest.approx(expected)


def test_single_readings_share_a_strip(found):
    """A line each, below the curves, with both numbers in words."""
    chart = found.plot()
    check_texts(chart)
    chart.draw_without_rendering()
    *curves, strip = chart.axes
    (words,) = (tick.get_text() for tick in strip.get_yticklabels())
    assert words.startswith("test 1: mass loss of lower\n5 mg from 4.804 to 5.196\nmodel ")
    assert strip.get_xlabel() == "(data - model) / sd"
    (data,) = (line for line in strip.lines if line.get_label() == "data")
    assert data.get_xdata() == pytest.approx([-found.evaluation.noise[-1]])
    boxes = [axes.get_window_extent() for axes in (*curves, strip)]
    assert all(boxes[-1].y1 < box.y0 for box in boxes[:-1])
    assert boxes[-1].height < 0.15 * chart.bbox.height


def test_what_is_not_identified_has_neither_curve_nor_ellipse(found):
    def labels(chart):
        check_texts(chart)
        return [[*filter(None, axes.get_legend_handles_labels()[1])] for axes in chart.axes]

    first, pair, second = labels(found.plot_parameters())
    assert "linear" in first
    assert "linear" in second
    assert pair == ["68 % ellipse", "95 % ellipse"]
    lost = replace(found.parameters[1], verdict="not identified", sd=None, interval=(None, None))
    chart = replace(found, parameters=(found.parameters[0], lost)).plot_parameters()
    first, pair, second = labels(chart)
    assert "linear" in first
    assert pair == []
    assert second == ["best fit"]
    assert "not identified" in [text.get_text() for axes in chart.axes for text in axes.texts]


def test_long_tests_are_drawn_in_hours(found):
    """As results are; the numbers are those of the file, in s."""
    (test,) = found.misfit.problem.experiments
    series = test.series[0]
    assert not series.profile
    long = replace(series, x=series.x * (2e4 / series.x.max()))
    for one, seconds, words in ((long, 3600.0, "time (h)"), (series, 1.0, "time (s)")):
        x, axis = drawn_series(found, test, one, found.misfit.records[0].rows).along()
        assert x == pytest.approx(one.x / seconds)
        assert axis.label == words
    _, axis = drawn_series(found, test, test.series[1], found.misfit.records[1].rows).along()
    assert axis.label == "radius (mm)"
