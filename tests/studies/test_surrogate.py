"""Surrogates: closed forms met, errors told that fresh cases confirm, nothing extrapolated."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from known_sweeps import sample, write
from swept import CASE

import ringwear_par as rw
from ringwear_par.studies.analysis import sensitivity
from ringwear_par.studies.pictures.figures import draw_sweep_and_surrogate

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


def written(folder, model, count=64, keys=2, seed=3, **about):
    x = scaled(sample(KEYS[:keys], count, seed))
    return write(folder, KEYS[:keys], x, model(x), "sobol", **about)


def within(made, x):
    """The rows that a surrogate answers for."""
    low, high = (np.array(ends) for ends in zip(*made.ranges.values(), strict=True))
    return x[((x >= low) & (x <= high)).all(axis=1)]


def values(x):
    return dict(zip(KEYS, x.T, strict=False))


def test_a_power_law_is_met_exactly(tmp_path):
    """Worn volume of Archard's law: a product of powers is linear in logarithms."""
    written(tmp_path, power, lower=power(scaled(sample(KEYS[:2], 64))) * 7.0)
    made = rw.surrogate(tmp_path)
    assert made.relative_error["worn_volume_lower"] < 1e-9
    fresh = within(made, scaled(sample(KEYS[:2], 50, seed=8)))
    assert len(fresh) > 40
    found = made.predict(values(fresh))
    assert found["worn_volume_lower"] == pytest.approx(7.0 * power(fresh), rel=1e-9)
    assert found["penetration"] == pytest.approx(power(fresh), rel=1e-9)


@pytest.mark.parametrize("count", [64, 256])
def test_the_error_told_is_that_of_fresh_cases(tmp_path, count):
    written(tmp_path, threshold, count, 3)
    made = rw.surrogate(tmp_path)
    fresh = within(made, scaled(np.random.default_rng(5).random((2000, 3))))
    found = made.predict(values(fresh))["penetration"]
    assert (found >= 0.0).all()
    error = float(np.sqrt(np.mean((found - threshold(fresh)) ** 2)))
    assert error / 3.0 < made.error["penetration"] < 3.0 * error
    assert made.relative_error["penetration"] < (0.3 if count == 64 else 0.1)


GRID = ("lower.layers[0].thickness", "lower.layers[0].wear.k", "wear.lower.k")


def through(x):
    """A body that wears by another factor once its layer is worn through."""
    h, slow, fast = x.T
    return np.where(3e7 * slow < h, 3e7 * slow, h + 3e7 * fast * (1.0 - h / (3e7 * slow)))


def spike(x):
    """Stress in the layer that is nearly worn through: far above that of all other cases."""
    return np.where(np.arange(len(x)) == 0, 110.0, 44.0 - 80.0 * x[:, 0])


def grid_of_layers(folder, counts, model=through):
    values = [
        np.geomspace(*ends, count)
        for ends, count in zip(((2e-3, 0.1), (1e-10, 1e-9), (2e-9, 1e-8)), counts, strict=True)
    ]
    x = np.array(list(itertools.product(*values)))
    return write(folder, GRID, x, model(x))


@pytest.mark.parametrize("model", [through, spike])
@pytest.mark.parametrize("counts", [(6, 3, 2), (8, 1, 2), (6, 4, 4)])
def test_between_the_values_of_a_grid_nothing_leaves_the_range_of_its_cases(
    tmp_path, counts, model
):
    """Cases left out by lot were met best by stretches that let it swing between few values."""
    values = grid_of_layers(tmp_path, counts, model).final["penetration"]
    (part,) = rw.surrogate(tmp_path).parts
    u = np.random.default_rng(7).random((3000, len(part.keys)))
    found = part.at(u, ["penetration"])["penetration"]
    width = np.ptp(values)
    assert found.min() > values.min() - 0.25 * width
    assert found.max() < values.max() + 0.25 * width


def test_shares_are_from_0_to_1(tmp_path):
    """Between cases in which all or nothing is worn through."""
    ensemble = written(tmp_path, power)
    share = np.clip(0.5 + 2.0 * np.log10(ensemble.final["penetration"] / 1e-3), 0.0, 1.0)
    assert {0.0, 1.0} < set(share)
    final = {**ensemble.final, "share_through_lower": share, "max_mises": share}
    made = rw.surrogate(replace(ensemble, final=final))
    (part,) = made.parts
    u = np.random.default_rng(7).random((3000, 2))
    found = part.at(u, ["share_through_lower", "max_mises"])
    assert found["max_mises"].max() > 1.0  # the same numbers, of what may be more
    assert found["share_through_lower"].min() == 0.0
    assert found["share_through_lower"].max() == 1.0
    assert made.error["share_through_lower"] < made.error["max_mises"]


def test_the_error_of_a_grid_is_not_below_that_between_its_values(tmp_path):
    grid_of_layers(tmp_path, (6, 3, 3))
    made = rw.surrogate(tmp_path)
    u = np.random.default_rng(5).random((3000, 3))
    ends = np.log([made.ranges[key] for key in GRID])
    fresh = np.exp(ends[:, 0] + u * (ends[:, 1] - ends[:, 0]))
    inside = np.clip(fresh, *np.transpose([made.ranges[key] for key in GRID]))
    found = made.predict(dict(zip(GRID, inside.T, strict=True)))["penetration"]
    error = float(np.sqrt(np.mean((found - through(fresh)) ** 2)))
    assert error / 1.5 < made.error["penetration"] < 4.0 * error


def test_a_coarse_surrogate_is_not_drawn(tmp_path):
    ensemble = grid_of_layers(tmp_path, (6, 3, 2))
    made = rw.surrogate(tmp_path)
    assert made.relative_error["penetration"] > 0.2
    figure = draw_sweep_and_surrogate(ensemble)
    assert len(figure.axes) == 1 + 2 * 3  # histories, penetrations and volumes against the keys


@pytest.mark.parametrize(
    "changed",
    [{"wear.lower.k": 2e-6}, {"wear.lower.k": [1e-7, 1e-9]}, {"wear.lower.k": np.nan},
     {"wear.lower.k": "steel"}, {"load.omega": 1.0}, {"load.pressure": None}],
)  # fmt: skip
def test_nothing_else_than_the_cases_is_answered_for(tmp_path, changed):
    written(tmp_path, power)
    made = rw.surrogate(tmp_path)
    at = {"wear.lower.k": 1e-7, "load.pressure": 10.0, **changed}
    with pytest.raises(rw.InputError, match=next(iter(changed))):
        made.predict({key: value for key, value in at.items() if value is not None})
    with pytest.raises(rw.InputError, match="torque"):
        made.predict({"wear.lower.k": 1e-7, "load.pressure": 10.0}, ["torque"])


def test_keys_are_broadcast(tmp_path):
    written(tmp_path, power)
    made = rw.surrogate(tmp_path)
    asked = {"wear.lower.k": [[1e-7], [2e-7]], "load.pressure": [5.0, 6.0, 7.0]}
    found = made.predict(asked, ["penetration"])["penetration"]
    assert found == pytest.approx(1e3 * np.array([[1e-7], [2e-7]]) * np.array([5, 6, 7]) ** 0.8)
    assert made.predict({"wear.lower.k": 1e-7, "load.pressure": 5})["penetration"].shape == ()


def test_the_design_tells_scales_and_ends(tmp_path):
    """Spans of less than 20 look linear; the ends of a range are in reach of its cases."""
    u = sample(KEYS[:2], 32)
    x = np.column_stack([1e-7 * 10.0 ** u[:, 0], 50.0 + 50.0 * u[:, 1]])
    ensemble = write(tmp_path, KEYS[:2], x, x[:, 0] ** 3, "sobol")
    study = (
        '[vary]\n"wear.lower.k" = { log = [1e-7, 1e-6] }\n"load.pressure" = { linear = [50, 200] }'
        '\n[design]\nmethod = "sobol"\ncount = 32\n'
    )
    made = rw.surrogate(replace(ensemble, attributes={"method": "sobol", "study": study}))
    assert list(made.parts[0].logarithmic) == [True, False]
    assert made.ranges["wear.lower.k"] == (1e-7, 1e-6)
    # no case is above 100
    assert made.ranges["load.pressure"] == (50.0, x[:, 1].max())
    unknown = rw.surrogate(tmp_path)
    assert list(unknown.parts[0].logarithmic) == [False, False]
    assert unknown.ranges["wear.lower.k"] == (x[:, 0].min(), x[:, 0].max())


def test_responses_at_times(tmp_path):
    written(tmp_path, lambda x: 2.0 * power(x))
    at = {"wear.lower.k": 1e-7, "load.pressure": 10.0}
    expected = 2e3 * 1e-7 * 10.0**0.8
    early = rw.surrogate(tmp_path, times=[5.0, 10.0]).predict(at)["penetration"]
    assert early == pytest.approx(expected * np.array([0.25, 0.5]))
    assert rw.surrogate(tmp_path).predict(at)["penetration"] == pytest.approx(expected)


def test_texts_have_a_surrogate_each(tmp_path):
    x = scaled(sample(KEYS[:2], 90))
    rows = [("archard" if i % 3 else "power", k, p) for i, (k, p) in enumerate(x)]
    rows += [("table", 1e-7, 10.0 + i) for i in range(3)]
    depth = [p * 1e3 * k if law == "archard" else 7.0 * k for law, k, p in rows]
    write(tmp_path, ("wear.lower.law", *KEYS[:2]), rows, np.array(depth), "list")
    made = rw.surrogate(tmp_path)
    assert made.ranges["wear.lower.law"] == ("archard", "power")
    assert (made.used, made.cases) == (90, 93)
    at = {"wear.lower.k": 1e-7, "load.pressure": 10.0}
    for law, expected in (("archard", 1e-3), ("power", 7e-7)):
        found = made.predict({**at, "wear.lower.law": law})["penetration"]
        assert found == pytest.approx(expected, rel=1e-6)
    with pytest.raises(rw.InputError, match="archard"):
        made.predict({**at, "wear.lower.law": "table"})
    with pytest.raises(rw.InputError, match="archard"):
        made.predict(at)


@pytest.mark.parametrize(
    ("keys", "rows", "words"),
    [(KEYS[:2], scaled(sample(KEYS[:2], 11)), "11 cases"),
     (("load.pressure", "load.omega"), np.linspace([1.0, 2.0], [5.0, 10.0], 20), "together"),
     (("time.scheme",), [("implicit",)] * 2 + [("explicit",)], "2 cases"),
     (KEYS[:1], (1e-7 * np.repeat([1, 2, 3, 4], 3) + 1e-15 * np.arange(12))[:, None], "4 cases")],
)  # fmt: skip
def test_too_few_cases_or_keys_that_do_not_vary_by_themselves(tmp_path, keys, rows, words):
    write(tmp_path, keys, rows, np.arange(len(rows)) + 1.0, "list")
    with pytest.raises(rw.InputError, match=words):
        rw.surrogate(tmp_path)


def test_sobol_indices_of_a_product(tmp_path, monkeypatch):
    monkeypatch.setattr(sensitivity, "EVALUATIONS", 1e5)
    written(tmp_path, power, 128)
    (part,) = rw.surrogate(tmp_path).parts
    (found,) = sensitivity.surrogate_indices(part, ["penetration"])
    factors = []
    for key, exponent in ((0, 1.0), (1, 0.8)):  # of values whose logarithm is uniform
        low, high = part.low[key], part.high[key]
        first, second = (
            (high ** (n * exponent) - low ** (n * exponent)) / (n * exponent * np.log(high / low))
            for n in (1, 2)
        )
        factors.append(second / first**2)
    one, other = factors
    whole = one * other - 1.0
    assert found.first == pytest.approx([(one - 1.0) / whole, (other - 1.0) / whole], abs=0.01)
    assert found.influence == pytest.approx(
        [(one - 1.0) * other / whole, (other - 1.0) * one / whole], abs=0.01
    )


@pytest.mark.usefixtures("few_resamples")
def test_it_is_drawn(tmp_path):
    ensemble = written(tmp_path, power, 128)
    figure = draw_sweep_and_surrogate(ensemble)
    # histories, Sobol' indices, responses with the cases; volumes, which are all 0, below them
    assert len(figure.axes) == 1 + 1 + 2 * 2
    indices, along_k, _ = figure.axes[1:4]
    part = rw.surrogate(tmp_path).parts[0]
    (found,) = sensitivity.surrogate_indices(part, ["penetration"])
    assert [bar.get_width() for bar in indices.containers[0]] == pytest.approx(found.first)
    assert [bar.get_width() for bar in indices.containers[1]] == pytest.approx(found.influence)
    mean, points = along_k.lines
    assert points.get_ydata() == pytest.approx(1e3 * ensemble.final["penetration"])
    k, depth = mean.get_data()
    low, high = part.low[1], part.high[1]
    over_p = (high**0.8 - low**0.8) / (0.8 * np.log(high / low))
    assert depth == pytest.approx(1e6 * k * over_p, rel=0.02)  # of 256 points over p


@pytest.mark.usefixtures("few_resamples")
def test_a_sweep_is_answered_for(tmp_path):
    """Profiles and times, too, from the data set that users open; of fresh cases."""
    (tmp_path / "case.toml").write_text(
        CASE.replace("steps = 20", "steps = 10").replace("p0 = 40", "p0 = 20")
    )
    ranges = {"wear.lower.k": (1e-8, 1e-6), "load.pressure": (50.0, 80.0)}
    scales = zip(("log", "linear"), ranges.items(), strict=True)
    vary = {key: {scale: list(ends)} for scale, (key, ends) in scales}
    for name, seed, count in (("a", 1, 64), ("b", 2, 24)):
        design = {"method": "sobol", "count": count, "seed": seed}
        study = {"case": tmp_path / "case.toml", "vary": vary, "design": design}
        rw.sweep(rw.read_study(study), tmp_path / name)
    with rw.open_ensemble(tmp_path / "a") as data:
        made = rw.surrogate(data)
        early = rw.surrogate(tmp_path / "a" / "results.h5", times=[3.5, 10.0])
        with pytest.raises(rw.InputError, match="selected"):
            rw.surrogate(data.isel(case=slice(0, 30)))
    assert {"penetration", "worn_volume_lower", "wear_lower", "wear_upper"} <= set(made.names)
    assert made.ranges == ranges
    with rw.open_ensemble(tmp_path / "b" / "results.h5") as data:
        at = {key: data[key].to_numpy() for key in made.ranges}
        wear, depth = data.wear_lower.to_numpy(), data.penetration.to_numpy()
    found, then = made.predict(at), early.predict(at)
    assert found["wear_lower"].shape == (24, 16)
    assert then["wear_lower"].shape == (24, 2, 16)
    for name, expected in (
        ("penetration", depth[:, -1]),
        ("wear_lower", wear[:, -1]),
        ("largest_wear_lower", wear[:, -1].max(axis=1)),
    ):
        error = float(np.sqrt(np.mean((found[name] - expected) ** 2)))
        assert error < 3.0 * made.error[name]
        assert made.relative_error[name] < 0.02
    middle = 0.5 * (depth[:, 3] + depth[:, 4])  # at 3.5 s, between two steps
    error = np.sqrt(np.mean((then["penetration"] - np.stack([middle, depth[:, -1]], 1)) ** 2))
    assert error < 3.0 * early.error["penetration"]
    assert rw.plot(tmp_path / "a").axes
