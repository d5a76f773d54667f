"""The figure of a sweep: what is drawn is what is stored, and indices of models that have them."""

import itertools

import numpy as np
import pytest
from figure_texts import check_texts
from known_sweeps import sample, write
from parts import plot_stored

import ringwear_par as rw
from ringwear_par.studies.analysis.sensitivity import sensitivity_indices
from ringwear_par.studies.pictures.figures import draw_sweep

KEYS = ("load.pressure", "load.omega", "upper.r[1]")


def sensitivity(ensemble):
    """Indices of all outputs that are drawn, of the sample itself."""
    return sensitivity_indices(ensemble, None)


def ishigami(u):
    x = np.pi * (2.0 * u - 1.0)
    first = np.sin(x[:, 0])
    return first + 7.0 * np.sin(x[:, 1]) ** 2 + 0.1 * x[:, 2] ** 4 * first + 5.0


def linear(u):
    return u @ [1.0, 2.0, 3.0]


@pytest.mark.parametrize(
    ("model", "exact"),
    [(ishigami, (0.3139, 0.4424, 0.0)), (linear, np.array([1.0, 4.0, 9.0]) / 14.0)],
)
def test_first_order_indices_of_known_models(tmp_path, model, exact):
    u = sample(KEYS, 2048)
    (depth,) = sensitivity(write(tmp_path, KEYS, u, model(u), "sobol"))
    assert depth.output == "penetration"
    assert depth.keys == KEYS
    # classes of the key, and a resample of the cases, add less than 0.01
    assert (np.abs(depth.first - exact) <= depth.first_width + 0.01).all()
    assert (depth.first_width < 0.05).all()


def test_moment_independent_index_of_a_sum(tmp_path, few_resamples):
    """Of x + y, both uniform, it is 1/3: half the mean area between a square and a triangle."""
    u = sample(KEYS[:2], 2048)
    (found,) = sensitivity(write(tmp_path, KEYS[:2], u, u.sum(axis=1), "sobol"))
    assert found.influence == pytest.approx([1 / 3, 1 / 3], abs=0.07)
    assert found.first == pytest.approx([0.5, 0.5], abs=0.03)


def test_indices_do_not_depend_on_units_nor_touch_the_random_state(tmp_path, few_resamples):
    u = sample(KEYS, 256)
    small = write(tmp_path / "a", KEYS, u, 1e-9 * linear(u), "sobol")
    large = write(tmp_path / "b", KEYS, u, 1e9 * linear(u), "sobol")
    np.random.seed(7)
    expected = np.random.random()
    np.random.seed(7)
    (one,), (other,), (again,) = map(sensitivity, (small, large, small))
    assert np.random.random() == expected
    for name in ("influence", "influence_width", "first", "first_width"):
        assert getattr(one, name) == pytest.approx(getattr(other, name), rel=1e-6)
        assert (getattr(one, name) == getattr(again, name)).all()


def test_indices_follow_from_done_cases_and_numbers_only(tmp_path, few_resamples):
    u = sample(KEYS, 512)
    bad = np.arange(512) % 4 == 0
    depth = np.where(bad, 1e3, u[:, 0])
    rows = [(p, "implicit" if o < 0.5 else "explicit", 30.0) for p, o, _ in u]
    ensemble = write(
        tmp_path, ("load.pressure", "time.scheme", "upper.r[1]"), rows, depth, "random",
        status=["failed" if b else "done" for b in bad],
    )  # fmt: skip
    (found,) = sensitivity(ensemble)
    assert found.keys == ("load.pressure",)
    assert "384 cases" in found.source
    assert found.first[0] == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize(
    ("count", "depth"),
    [(99, lambda u: u[:, 0]), (128, lambda u: 1.0 + 1e-14 * u[:, 0]),
     (128, lambda u: np.arange(len(u)) % 9 == 5.0)],
    ids=["few cases", "round-off", "few other values"],
)  # fmt: skip
def test_indices_that_cannot_be_known_are_not_there(tmp_path, count, depth):
    u = sample(KEYS, count)
    ensemble = write(tmp_path, KEYS, u, depth(u), "sobol")
    assert sensitivity(ensemble) == ()
    assert len(draw_sweep(ensemble).axes) == 1 + 2 * 3


def test_indices_are_drawn(tmp_path, few_resamples):
    u = sample(KEYS, 128)
    ensemble = write(tmp_path, KEYS, u, linear(u), "latin-hypercube", lower=u[:, 1])
    depth, _ = sensitivity(ensemble)
    figure = draw_sweep(ensemble)
    check_texts(figure)
    panel = figure.axes[1]
    bars = {each.get_label(): each for each in panel.containers if len(each.get_label()) > 0}
    (first,), (delta,) = ([b for n, b in bars.items() if word in n] for word in ("first", "\u03b4"))
    assert [bar.get_width() for bar in delta] == pytest.approx(depth.influence)
    assert [bar.get_width() for bar in first] == pytest.approx(depth.first)


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


def test_other_cases_than_done_ones_are_counted_not_drawn(tmp_path):
    rows = [(float(n),) for n in range(1, 8)]
    status = ["done", "failed", "done", "failed", "done", "failed", "failed"]
    ensemble = write(tmp_path / "a", KEYS[:1], rows, np.arange(7.0) + 1.0, status=status)
    figure = draw_sweep(ensemble)
    assert all(words in figure.get_suptitle() for words in ("7 cases", "4 failed"))
    fan, depth, _ = figure.axes
    assert [line.get_label() for line in fan.lines] == ["1", "3", "5"]
    assert list(depth.lines[0].get_xdata()) == [1.0, 3.0, 5.0]
    assert depth.lines[0].get_ydata() == pytest.approx([1e3, 3e3, 5e3])
    write(tmp_path / "b", KEYS[:1], rows[:2], [1.0, 1.0], status=["failed", "failed"])
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


def test_many_cases_are_drawn_from_a_part_of_their_histories(tmp_path):
    u = sample(KEYS, 2500)
    fan = draw_sweep(write(tmp_path, KEYS, u, linear(u), "list")).axes[0]
    assert "2000 of 2500 cases" in fan.get_legend().get_title().get_text()
    median = fan.lines[-1].get_ydata()[-1]
    assert median == pytest.approx(1e3 * np.median(linear(u)), rel=0.03)


def test_round_off_looks_like_no_effect(tmp_path):
    """Values that differ by it lie on a level line; 2 % are seen as ever."""
    u = np.array(list(itertools.product(np.linspace(0.1, 1.0, 4), repeat=2)))
    noise = 4.79307 * (1.0 + 1e-6 * np.random.default_rng(2).random(len(u)))
    seen = 4.0 + 0.02 * u[:, 0]
    ensemble = write(tmp_path, KEYS[:2], u, u[:, 0], "grid", lower=noise, upper=seen)
    figure = draw_sweep(ensemble)
    check_texts(figure)
    spans = {
        body: [np.ptp(axes.get_ylim()) for axes in figure.axes if body in axes.get_ylabel()]
        for body in ("lower", "upper")
    }
    assert min(spans["lower"]) >= 1e-3 * 4.79
    assert 0.015 < max(spans["upper"]) < 0.03
