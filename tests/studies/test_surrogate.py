"""Surrogates: closed forms met, errors that fresh cases confirm, nothing extrapolated."""

import itertools
import sys

import numpy as np
import pytest
from known_sweeps import sample, write
from parts import draw_sweep

import ringwear_par as rw

KEYS = ("wear.lower.k", "load.pressure", "wear.lower.p0")


def scaled(u):
    """Keys at points of the unit square or cube: k, and p of the square, by their logarithms."""
    x = u.copy()
    x[:, 0] = 10.0 ** (2.0 * u[:, 0] - 8.0)
    x[:, 1] = 10.0 ** (2.0 * u[:, 1]) if u.shape[1] == 2 else 30.0 + 70.0 * u[:, 1]
    x[:, 2:] = 60.0 * u[:, 2:]
    return x


def power(x):
    return 1e3 * x[:, 0] * x[:, 1] ** 0.8


def threshold(x):
    """Nothing wears where the pressure does not pass p0."""
    return 1e3 * x[:, 0] * np.maximum(0.0, x[:, 1] - x[:, 2])


def through(x):
    """A body that wears by another factor once its layer is worn through."""
    h, slow, fast = x.T
    return np.where(3e7 * slow < h, 3e7 * slow, h + 3e7 * fast * (1.0 - h / (3e7 * slow)))


def written(folder, model, count=64, keys=2, **about):
    x = scaled(sample(KEYS[:keys], count))
    return write(folder, KEYS[:keys], x, model(x), "sobol", **about)


def inside(made, count):
    """Fresh values of the keys in their ranges, all of them spread by logarithms but p0."""
    u = np.random.default_rng(5).random((count, len(made.factors)))
    return {f.name: f.at(c) for f, c in zip(made.factors, u.T, strict=True)}


def rms(values):
    return float(np.sqrt(np.mean(values**2)))


def test_a_power_law_is_met(tmp_path):
    """A product of powers is linear in logarithms: so is the process of its logarithm, nearly."""
    x = scaled(sample(KEYS[:2], 64))
    written(tmp_path, power, lower=7.0 * power(x))
    made = rw.surrogate(tmp_path)
    fresh = inside(made, 500)
    exact = power(np.column_stack([*fresh.values()]))
    answers = made.predict(fresh)
    assert answers["worn_volume_lower"] == pytest.approx(7.0 * exact, rel=1e-3)
    assert answers["penetration"] == pytest.approx(exact, rel=1e-3)
    assert made.relative_error["penetration"] < 1e-3
    at = {"wear.lower.k": [[1e-7], [2e-7]], "load.pressure": [5.0, 6.0, 7.0]}
    assert made.predict(at)["penetration"].shape == (2, 3)
    assert made.predict({"wear.lower.k": 1e-7, "load.pressure": 5})["penetration"].shape == ()


@pytest.mark.parametrize(("count", "most"), [(64, 0.15), (700, 0.03)])
def test_measured_errors_and_deviations_are_those_of_fresh_cases(tmp_path, count, most):
    written(tmp_path, threshold, count, 3)
    made = rw.surrogate(tmp_path)
    fresh = inside(made, 2000)
    exact = threshold(np.column_stack([*fresh.values()]))
    depth = made.predict(fresh)["penetration"]
    assert (depth >= 0.0).all()
    error = rms(depth - exact)
    assert error / 3.0 < made.error["penetration"] < 3.0 * error
    assert made.relative_error["penetration"] < most
    width = made.predict(fresh, deviations=True)["penetration"]
    assert error / 3.0 < rms(width) < 3.0 * error


GRID = ("lower.layers[0].thickness", "lower.layers[0].wear.k", "wear.lower.k")


@pytest.mark.parametrize("counts", [(6, 3, 2), (8, 1, 2), (6, 4, 4)])
def test_between_the_values_of_a_grid(tmp_path, counts):
    """Nothing leaves the range of the cases; the error is not below that between the values."""
    ends = (2e-3, 0.1), (1e-10, 1e-9), (2e-9, 1e-8)
    values = [np.geomspace(*e, count) for e, count in zip(ends, counts, strict=True)]
    x = np.array(list(itertools.product(*values)))
    write(tmp_path, GRID, x, through(x))
    made = rw.surrogate(tmp_path)
    fresh = inside(made, 3000)
    depth = made.predict(fresh)["penetration"]
    width = np.ptp(through(x))
    assert through(x).min() - 0.25 * width < depth.min()
    assert depth.max() < through(x).max() + 0.25 * width
    full = np.column_stack([fresh.get(k, np.full(3000, x[0, i])) for i, k in enumerate(GRID)])
    assert rms(depth - through(full)) < 1.5 * made.error["penetration"]


def test_nothing_else_than_the_cases_is_answered_for(tmp_path):
    written(tmp_path, power)
    made = rw.surrogate(tmp_path)
    at = {"wear.lower.k": 1e-7, "load.pressure": 10.0}
    for value in (2e-6, [1e-7, 1e-9], np.nan):
        with pytest.raises(rw.InputError, match=r"wear\.lower\.k"):
            made.predict({**at, "wear.lower.k": value})
    with pytest.raises(rw.InputError, match=r"load\.omega"):
        made.predict({**at, "load.omega": 1.0})
    with pytest.raises(rw.InputError, match=r"load\.pressure"):
        made.predict({"wear.lower.k": 1e-7})
    with pytest.raises(rw.InputError, match="torque"):
        rw.surrogate(tmp_path, ["torque"])


def test_texts_are_answered_for(tmp_path):
    x = scaled(sample(KEYS[:2], 90))
    rows = [("archard" if i % 3 else "power", k, p) for i, (k, p) in enumerate(x)]
    depth = [p * 1e3 * k if law == "archard" else 7.0 * k for law, k, p in rows]
    write(tmp_path, ("wear.lower.law", *KEYS[:2]), rows, np.array(depth), "list")
    made = rw.surrogate(tmp_path)
    assert set(made.ranges["wear.lower.law"]) == {"archard", "power"}
    at = {"wear.lower.k": 1e-7, "load.pressure": 10.0}
    for law, expected in (("archard", 1e-3), ("power", 7e-7)):
        answer = made.predict({**at, "wear.lower.law": law})["penetration"]
        assert answer == pytest.approx(expected, rel=0.02)
    for texts in ({"wear.lower.law": "table"}, {}):
        with pytest.raises(rw.InputError, match=r"wear\.lower\.law"):
            made.predict({**at, **texts})
    law = dict(zip(made.ranges, made.sobol_indices("penetration")[1], strict=True))
    assert law["wear.lower.law"] > 0.1


@pytest.mark.parametrize(
    ("keys", "rows", "words"),
    [(KEYS[:2], scaled(sample(KEYS[:2], 11)), "11 cases"),
     (("load.pressure", "load.omega"), np.linspace([1.0, 2.0], [5.0, 10.0], 20), "together"),
     (("time.scheme",), [("implicit",)] * 20 + [("explicit",)], "a key that is a number"),
     (KEYS[:1], (1e-7 * np.repeat([1, 2, 3, 4], 3) + 1e-15 * np.arange(12))[:, None], "4 cases")],
)  # fmt: skip
def test_too_few_cases_or_keys_that_do_not_vary_by_themselves(tmp_path, keys, rows, words):
    write(tmp_path, keys, rows, np.arange(len(rows)) + 1.0, "list")
    with pytest.raises(rw.InputError, match=words):
        rw.surrogate(tmp_path)


def test_without_scikit_learn_a_sentence_says_how_to_install_it(tmp_path, monkeypatch):
    ensemble = written(tmp_path, power)
    monkeypatch.setitem(sys.modules, "sklearn", None)
    with pytest.raises(rw.InputError, match="pip install"):
        rw.surrogate(tmp_path)
    assert len(draw_sweep(ensemble).axes) == 1 + 2 * 2


def test_sobol_indices_of_the_function_of_ishigami(tmp_path):
    u = sample(KEYS, 400)
    x = np.pi * (2.0 * u - 1.0)
    depth = np.sin(x[:, 0]) * (1.0 + 0.1 * x[:, 2] ** 4) + 7.0 * np.sin(x[:, 1]) ** 2 + 11.0
    write(tmp_path, KEYS, 1.0 + u, depth, "sobol")
    first, total = rw.surrogate(tmp_path).sobol_indices("penetration")
    assert first == pytest.approx([0.3139, 0.4424, 0.0], abs=0.02)
    assert total == pytest.approx([0.5576, 0.4424, 0.2437], abs=0.02)


def test_it_is_drawn(tmp_path):
    ensemble = written(tmp_path, power, 128)
    figure = draw_sweep(ensemble)
    # histories, Sobol' indices, responses with the cases; volumes, which are all 0, below them
    assert len(figure.axes) == 1 + 1 + 2 * 2
    bars, along_k, _ = figure.axes[1:4]
    made = rw.surrogate(tmp_path)
    first, total = made.sobol_indices("penetration")
    assert [bar.get_width() for bar in bars.containers[0]] == pytest.approx(first)
    assert [bar.get_width() for bar in bars.containers[1]] == pytest.approx(total)
    mean, points = along_k.lines
    assert points.get_ydata() == pytest.approx(1e3 * ensemble.final["penetration"])
    k, depth = mean.get_data()
    low, high = made.ranges["load.pressure"]
    over_p = (high**0.8 - low**0.8) / (0.8 * np.log(high / low))
    assert depth == pytest.approx(1e6 * k * over_p, rel=0.02)  # of 256 points over p


def test_any_array_over_the_cases_is_a_response(tmp_path):
    """Profiles and times, too; of fresh cases."""
    ensemble = written(tmp_path, threshold, 128, 3)
    depth = ensemble.final["penetration"]
    profiles = depth[:, None, None] * np.arange(1.0, 7.0).reshape(2, 3)
    made = rw.surrogate(tmp_path / "results.h5", {"wear": profiles})
    fresh = inside(made, 200)
    exact = threshold(np.column_stack([*fresh.values()]))
    wear = made.predict(fresh)["wear"]
    assert wear.shape == (200, 2, 3)
    assert rms(wear[:, 1, 2] - 6.0 * exact) < 3.0 * 6.0 * made.error["wear"]
    with pytest.raises(rw.InputError, match=r"wear: .* \(128, ...\)"):
        rw.surrogate(tmp_path, {"wear": profiles[:5]})
