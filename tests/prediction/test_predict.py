"""Predictions of a case that was not tested, from draws that are known, and from their folder."""

import json
import re

import numpy as np
import pytest
from drawn import P0, SD, TAU, K, draws_of, fit_of, save_fit
from laboratory import CASE
from mpi4py import MPI
from parts import TimeTo, draw_paces, main
from scipy.stats import norm

import ringwear_par as rw

ALONE = MPI.COMM_SELF
#: standard errors that a moment may be off
OFF = 4.0
ARCHARD = {"wear.lower.law": "archard", "wear.lower.p0": None}
ADAPTIVE = {"time.scheme": "adaptive", "time.step": None, "time.steps": None, "time.end": 150.0}


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("case") / "case.toml"
    path.write_text(CASE)
    return path


@pytest.fixture(scope="module")
def threshold(file):
    return rw.read_case(file, ADAPTIVE)


@pytest.fixture(scope="module")
def archard(threshold):
    return threshold.replace(ARCHARD)


def predicted(known, case, **how):
    return rw.predict(fit_of(known), case, comm=ALONE, **how)


def test_the_band_of_the_depth_is_at_quantiles_of_k(archard):
    """Depth grows with k, and is one function of k t."""
    found = predicted(draws_of(archard), archard, draws=200, of="material")
    shares = (0.025, 0.5, 0.975)
    ends = np.exp(np.log(1e-7) + SD * norm.ppf(shares))
    exact = [
        rw.simulate(archard.replace({K: k, "time.tolerance": 1e-6}), ALONE).histories["penetration"]
        for k in ends
    ]
    assert found.quantiles("penetration", shares)[:, -1] == pytest.approx(
        [depth[-1] for depth in exact], rel=0.01
    )
    life = found.time_to(0.8 * exact[1][-1])
    assert life.reached == pytest.approx(norm.cdf(np.log(1.25) / SD), abs=0.02)
    assert found.to_xarray().penetration.dims == ("draw", "step")
    assert [doubt.code for doubt in found.doubts] == ["no-scatter"]


def test_whom_a_prediction_is_of(archard):
    draws = draws_of(archard, tau=TAU, size=1e-5)
    at = {of: predicted(draws, archard, draws=200, of=of)
          for of in ("next specimen", "material", "S2")}  # fmt: skip
    logs = {of: np.log(one.values[:, 0]) for of, one in at.items()}
    assert logs["material"].std() == pytest.approx(SD, rel=0.03)
    assert logs["next specimen"].std() == pytest.approx(np.hypot(SD, TAU), rel=0.2)
    assert at["S2"].values == pytest.approx(1.5e-7)
    assert at["S2"].histories["penetration"][:, -1].std() > 0.0  # wears at random
    near = draws_of(archard, k=9e-6, tau=TAU)
    short = predicted(near, archard.replace({"time.end": 1.5}), draws=20)
    assert (short.values < 1e-5).all()  # reflected
    with pytest.raises(rw.ComputationError, match="of 20 draws have no history"):
        predicted(near, archard, draws=20)


def test_a_depth_is_reached_by_some_draws_only():
    """Draw i wears i um/s, linearly between unequal steps."""
    time, speeds = np.array([0.0, 1.0, 4.0, 10.0]), np.arange(1, 101)
    depths = 1e-3 * np.outer(speeds, time)
    alone = [TimeTo.of(time, depths[i : i + 1], 0.1).median for i in range(100)]
    assert alone == [None] * 9 + [pytest.approx(100.0 / speed) for speed in speeds[9:]]
    reached = TimeTo.of(time, depths, 0.1)
    assert (reached.median, reached.reached) == pytest.approx((100.0 / 51, 0.91))
    assert reached.interval == (pytest.approx(100.0 / 98), None)


def test_a_key_at_its_bound_is_predicted_from(threshold):
    p0 = np.maximum(np.random.default_rng(1).normal(0.0, 20.0, 200), 0.0)
    found = predicted(draws_of(threshold, p0=p0), threshold, draws=100, of="material")
    assert 0.4 < (found.values[:, 1] == 0.0).mean() < 0.6
    assert np.isfinite(found.quantiles()).all()
    assert found.failed == 0


def test_doubts(archard):
    elsewhere = archard.replace({"load.pressure": 150.0, "time.end": 1.5})
    found = predicted(draws_of(archard), elsewhere, draws=2)
    codes = [(doubt.code, doubt.values.get("condition")) for doubt in found.doubts]
    assert codes == [  # not the distance: a part of a test
        ("no-scatter", None), ("extrapolates", "p"), ("extrapolates", "pV")
    ]  # fmt: skip
    assert "the specimens tested" in found.summary()


def test_worn_depth_is_a_gamma_process():
    """Mean S and variance size S at every S, whatever the steps; none without noise."""
    count, size, depth = 40_000, 1e-5, np.cumsum([1e-6, 0.0, 3e-6, 6e-6, 40e-6])
    depths = np.tile(depth, (count, 2, 1))
    paces = draw_paces(depths, np.tile([size, 0.0], (count, 1)), np.random.default_rng(3))
    worn = np.cumsum(paces * np.diff(depths, prepend=0.0), axis=-1)
    assert (paces[:, 1] == 1.0).all()
    sd = np.sqrt(size * depth)
    assert np.abs((worn[:, 0].mean(axis=0) - depth) / sd).max() < OFF / np.sqrt(count)
    kurtosis = 3.0 + 6.0 * size / depth
    off = np.abs(worn[:, 0].var(axis=0) / sd**2 - 1.0)
    assert (off < OFF * np.sqrt((kurtosis - 1.0) / count)).all()


def test_random_wear_spreads_a_prediction(archard):
    """Variance of worn depth: size times depth, where k is known."""
    size = 2e-5
    noisy, plain = (
        predicted(draws_of(archard, size=s), archard, of="S2", draws=n)
        for s, n in ((size, 500), (0.0, 1))
    )
    steps = [20, 40, -1]
    worn, mean = (one.histories["worn_volume_lower"][:, steps] / archard.area
                  for one in (noisy, plain))  # fmt: skip
    assert worn.mean(axis=0) == pytest.approx(mean[0], rel=0.04)
    assert worn.var(axis=0) == pytest.approx(size * mean[0], rel=0.27)


def test_the_folder_is_predicted_from_like_the_fit(archard, tmp_path):
    fit = fit_of(draws_of(archard, tau=TAU))
    folder = save_fit(tmp_path / "fit", fit)
    one, same = (rw.predict(f, archard, draws=8, seed=3, comm=ALONE) for f in (fit, folder))
    assert same.values == pytest.approx(one.values, rel=1e-12)
    assert same.quantiles() == pytest.approx(one.quantiles(), rel=1e-9)
    assert same.doubts == one.doubts


def test_what_is_refused(archard, threshold, tmp_path):
    fit = fit_of(draws_of(archard))
    broken = save_fit(tmp_path / "fit", fit)
    (broken / "draws.nc").write_text("{}")
    without = fit_of(draws_of(threshold, p0=np.zeros(200)))
    for source, case, options, said in (
        (tmp_path, archard, {}, "draws.nc"), (broken, archard, {}, "draws of ringwear fit"),
        (fit, tmp_path / "no.toml", {}, "no.toml"), (fit, threshold, {}, 'law "archard"'),
        (fit, archard, {"of": "S9"}, '"S1", "S2"'),
        (without, archard, {}, f'must have {K} of the law "threshold", {P0} of the law "thre'),
        (broken / "fit.json", archard, {}, "fit.json: is a file; must be the folder of a fit"),
        (fit, archard, {"draws": 0}, "draws"), (fit, archard, {"seed": -1}, "seed"),
    ):  # fmt: skip
        with pytest.raises(rw.InputError, match=re.escape(said)):
            rw.predict(source, case, comm=ALONE, **options)
    found = predicted(draws_of(archard), archard, draws=2)
    with pytest.raises(rw.InputError, match="penetration"):
        found.quantiles("depth")


def test_the_command(file, threshold, archard, tmp_path, capsys):
    folder = save_fit(tmp_path / "fit", fit_of(draws_of(threshold, p0=np.zeros(200), tau=TAU)))
    out = tmp_path / "out"
    words = ["predict", str(folder), str(file), "--draws", "4", "--set", "load.pressure=60", "-o"]
    assert main([*words, str(out), "--depth", "1 um"]) == 0
    output = capsys.readouterr().out
    assert {path.name for path in out.iterdir()} == {
        "prediction.json", "prediction.h5", "prediction.png"
    }  # fmt: skip
    stored = json.loads((out / "prediction.json").read_text())
    assert stored["draws"] == 4
    (line,) = [line for line in stored["summary"] if line.startswith("1 um of penetration: ")]
    assert line in output
    assert stored["depth"]["reached"] == 1.0
    assert np.shape(stored["quantiles"]["penetration"]["values"]) == (len(stored["time"]), 5)
    assert "Prediction, 1 figure" in rw.report(out, tmp_path / "page.html")
    assert main([*words, str(folder)]) == 2
    assert "fit.json" in capsys.readouterr().err
    words[1] = str(save_fit(tmp_path / "archard", fit_of(draws_of(archard))))
    assert main([*words, str(out)]) == 2
    assert f"{file}: must have {K} of" in capsys.readouterr().err
