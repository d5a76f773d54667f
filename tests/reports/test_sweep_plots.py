"""The figure of a sweep: what is drawn is what is stored, or the surrogate of it."""

import itertools

import numpy as np
import pytest
from figure_texts import check_texts
from known_sweeps import sample, write
from parts import choose, plot_stored

import ringwear_par as rw
from ringwear_par.reports.plot import draw_sweep

KEYS = ("load.pressure", "load.omega", "upper.r[1]")


def test_a_surrogate_that_is_not_good_is_not_drawn(tmp_path):
    """Of a response that is noise there is no mean, and no index."""
    u = sample(KEYS, 128)
    noise = 2.0 + np.random.default_rng(1).random(128)
    figure = draw_sweep(write(tmp_path, KEYS, u, noise, "sobol"))
    check_texts(figure)
    assert len(figure.axes) == 1 + 2 * 3
    (points,) = figure.axes[1].lines
    assert points.get_ydata() == pytest.approx(1e3 * noise)
    assert "not drawn" in figure.get_suptitle()


def test_cases_that_are_not_done_and_texts_are_drawn_as_what_they_are(tmp_path):
    u = sample(KEYS, 120)
    bad = np.arange(120) % 4 == 0
    depth = np.where(bad, 1e3, 1.0 + u[:, 0])
    rows = [(p, "implicit" if o < 0.5 else "explicit", 30.0) for p, o, _ in u]
    ensemble = write(
        tmp_path, ("load.pressure", "time.scheme", "upper.r[1]"), rows, depth, "random",
        status=["failed" if b else "done" for b in bad],
    )  # fmt: skip
    choice = choose(ensemble)
    assert "30 failed" in choice.counts
    assert [key.name for key in choice.keys] == ["load.pressure", "time.scheme"]
    assert choice.indices["penetration"][0] == pytest.approx([1.0, 0.0], abs=0.02)
    figure = draw_sweep(ensemble)
    check_texts(figure)
    against_scheme = figure.axes[3]
    assert {text.get_text() for text in figure.axes[-1].get_xticklabels()} == {
        "implicit", "explicit"
    }  # fmt: skip
    mean = next(line for line in against_scheme.lines if len(line.get_xdata()) == 2)
    assert mean.get_ydata() == pytest.approx([1.5e3, 1.5e3], rel=0.02)


def test_curves_of_a_grid(tmp_path):
    pressures, factors = [20.0, 40.0, 80.0], [1e-9, 1e-8, 1e-7]
    rows = list(itertools.product(pressures, factors))
    p, k = np.array(rows).T
    names = ("load.pressure", "wear.lower.k")
    figure = draw_sweep(write(tmp_path, names, rows, 1e-3 * p + 1e5 * k, lower=p * k))
    check_texts(figure)
    fan, against_p, against_k, volume_p, volume_k = figure.axes
    assert len(fan.lines) == 9
    assert fan.lines[4].get_ydata() == pytest.approx(
        1e3 * (0.04 + 1e-3) * np.arange(11) / 10, rel=1e-9
    )
    assert [line.get_label() for line in against_p.lines] == ["1e-9", "1e-8", "1e-7"]
    for line, factor in zip(against_p.lines, factors, strict=True):
        assert list(line.get_xdata()) == pressures
        assert line.get_ydata() == pytest.approx(np.array(pressures) + 1e8 * factor)
    for line, pressure in zip(volume_k.lines, pressures, strict=True):
        assert list(line.get_xdata()) == factors
        assert line.get_ydata() == pytest.approx(pressure * np.array(factors))
    assert "(\N{MICRO SIGN}m)" in against_p.get_ylabel()
    assert "(mm\N{SUPERSCRIPT THREE})" in volume_p.get_ylabel()
    assert "(MPa)" in volume_p.get_xlabel()
    assert "(1/MPa)" in volume_k.get_xlabel()
    assert (against_p.get_xscale(), against_k.get_xscale()) == ("linear", "log")
    assert (against_p.get_yscale(), volume_p.get_yscale()) == ("linear", "log")


def test_a_sweep_without_a_case_that_is_done_is_refused(tmp_path):
    write(tmp_path / "b", KEYS[:1], [(1.0,), (2.0,)], [1.0, 1.0], status=["failed", "failed"])
    with pytest.raises(rw.InputError, match="no case"):
        plot_stored([tmp_path / "b"], tmp_path / "a.png")
    assert not (tmp_path / "a.png").exists()


def test_fan_of_histories_with_different_steps(tmp_path):
    count = 101
    steps = [10 + n % 5 for n in range(count)]
    depth = 1e-3 * np.arange(1.0, count + 1)
    ensemble = write(
        tmp_path, ("load.omega",), [(n,) for n in range(count)], depth, "list", steps=steps,
        step=[60.0 / n for n in steps],
    )  # fmt: skip
    fan = draw_sweep(ensemble).axes[0]
    time, median = fan.lines[-1].get_data()
    assert fan.lines[-1].get_label() == "median"
    assert time[-1] == pytest.approx(60.0)
    assert median == pytest.approx(51.0 * time / 60.0)
    for band, ends in zip(fan.collections, ((6.0, 96.0), (26.0, 76.0)), strict=True):
        x, y = band.get_paths()[0].vertices.T
        last = y[np.isclose(x, 60.0)]
        assert (last.min(), last.max()) == pytest.approx(ends)
