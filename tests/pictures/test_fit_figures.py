"""Figures of fits show what they say: signs, gaps, units, and no curves of what is not known."""

from dataclasses import replace

import numpy as np
import pytest
from figure_texts import check_texts
from laboratory import FITTED, fit_tables, write_tests
from mpi4py import MPI

import ringwear_par as rw
from ringwear_par.pictures import fit_panels, key_panels
from ringwear_par.pictures.matplotlib import panel_figure


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    """The fit of one test with a penetration, a profile and a mass."""
    folder = tmp_path_factory.mktemp("figures")
    experiments = write_tests(folder, (60.0,))
    mass = {"quantity": "mass.lower", "value": 5.0, "unit": "mg", "sd": 0.1, "density": 0.0019}
    experiments[0]["data"].append(mass)
    sought = {**FITTED, "wear.lower.p0": {"start": 25.0, "bounds": [0.0, 200.0]}}
    tables = fit_tables(folder, experiments, parameters=sought)
    return rw.fit(tables, MPI.COMM_WORLD)


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
        assert [one.x.tolist() for one in points] == [[1.0], [2.0, 4.0], [3.0]]


def test_a_profile_is_broken_at_edges_and_gaps():
    radii = [28.3, 28.4, 28.5, 28.6, 28.7, 28.8, 29.4, 29.5]
    for order in (radii, radii[::-1]):
        series = series_at(order, (28.5, 31.5))
        assert series.breaks().tolist() == [2, 6]
        (model,) = fit_panels.readings(series).curves
        assert np.flatnonzero(np.isnan(model.x)).tolist() == [2, 7]
        assert model.x[np.isfinite(model.x)].tolist() == radii


def test_residuals_are_data_less_model(found):
    chart = found.plot()
    check_texts(chart)
    panels = [axes for axes in chart.axes if axes.get_ylabel() == "residual / sd"]
    assert len(panels) == 2
    for axes, one in zip(panels, found.series, strict=False):
        expected = (one.drawn.data - one.drawn.model) / one.drawn.sd
        (drawn,) = (line.get_ydata() for line in axes.lines)
        assert drawn == pytest.approx(expected)


def test_densities_and_pairs_are_those_of_the_draws(found):
    """With the interval's ends, one where there is one limit, and the verdict."""
    draws, outcome = (
        dict(zip(found.draws.keys, found.draws.material.T, strict=True)),
        found.to_dict(),
    )
    rows = key_panels.fitted_keys(outcome, draws)
    check_texts(panel_figure(rows, (7.2, 7.0)))
    ((alone,), (pair, _)) = rows
    low, high = outcome["parameters"]["wear.lower.k"]["interval"]
    assert [curve.x[0] for curve in alone.curves][:2] == pytest.approx([low, high])
    assert alone.labels == []
    for axis, column in zip(("x", "y"), found.draws.material.T, strict=True):
        shown = getattr(pair.points[0], axis)
        assert len(shown) == 1000
        assert np.median(shown) == pytest.approx(np.median(column), 0.02)
    outcome["parameters"]["wear.lower.k"] |= {"verdict": "at bound", "interval": [None, high]}
    ((limited,), _) = key_panels.fitted_keys(outcome, draws)
    assert len(limited.curves) == 2
    assert [label.words for label in limited.labels] == ["at bound"]


def test_long_tests_are_drawn_in_hours(found):
    """As results are; the numbers are those of the file, in s."""
    series = found.series[0].drawn
    assert not series.profile
    long = replace(series, x=series.x * (2e4 / series.x.max()))
    for one, seconds, label in ((long, 3600.0, "time (h)"), (series, 1.0, "time (s)")):
        x, axis = one.along()
        assert x == pytest.approx(one.x / seconds)
        assert axis.label == label
