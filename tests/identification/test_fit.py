"""Fits of histories: the truth is found, and what the readings do not tell is said."""

import functools

import numpy as np
import pytest
from laboratory import (
    CASE,
    END,
    FITTED,
    SD_PROFILE,
    SHARE,
    TRUTH,
    fit_tables,
    history,
    one_test,
    penetration,
    record,
    write_table,
    write_tests,
)
from parts import StopSignals, parse_toml

import ringwear_par as rw
from ringwear_par.identification.definition.fit_file import read_fit
from ringwear_par.identification.histories import Readings
from ringwear_par.identification.solution import solve

pytestmark = pytest.mark.slow

K, P0, MU = "wear.lower.k", "wear.lower.p0", "contact.friction"
FRICTION = {"start": 0.2, "bounds": [0.01, 1.0], "scale": "log"}


def near(found):
    """Tell whether estimates are within three standard deviations of the truth."""
    return all(abs(p["estimate"] - TRUTH[key]) < 3 * p["sd"] for key, p in found.parameters.items())


def codes(found):
    return [doubt.code for doubt in found.doubts]


def test_two_tests_tell_both_numbers(found):
    assert near(found)
    assert [p["verdict"] for p in found.parameters.values()] == ["identified"] * 2
    outcome = found.to_dict()
    other = outcome["alternatives"]["archard"]
    assert (outcome["flagged"], other["flagged"]) == (False, True)
    assert codes(found) == []
    assert all(check["pass"] for check in outcome["checks"])
    assert outcome["evidence"] > other["evidence"] + 10
    lines = found.summary().splitlines()
    (line,) = (line for line in lines if line.startswith("  archard: "))
    assert line.endswith("does not fit")
    fitted = outcome["experiments"]["test 2"][f"profile.lower at {END:g} s"]
    assert 1e-3 * fitted["sd"] == pytest.approx(SD_PROFILE, rel=0.25)
    assert fitted["chi2"] == pytest.approx(fitted["n"], rel=0.1)


@pytest.fixture(scope="module")
def one_load(tmp_path_factory):
    """One test at one load, of few and noisy readings."""
    folder = tmp_path_factory.mktemp("one")
    (folder / "case.toml").write_text(CASE)
    t, z = penetration(
        history(60.0), np.random.default_rng(3), np.linspace(10.0, END, 10), 0.0, 0.0
    )
    parameters = {
        K: {**FITTED[K], "bounds": [2e-8, 1e-6]},
        P0: {"start": 0.0, "bounds": [0.0, 60.0]},
    }
    test = one_test("A", 60.0, record(folder / "z.csv", t, z))
    return read_fit(fit_tables(folder, [test], parameters=parameters))


@pytest.fixture(scope="module")
def ends(one_load, comm):
    """Function that returns quantiles of the draws of a seed, from so many steps; and steps."""

    def ends(seed, steps=40):
        readings = Readings(one_load, comm, StopSignals())
        readings.steps = steps
        found = readings.lead(lambda: solve(readings, seed))
        return np.quantile(found.theta, [0.025, 0.5, 0.975], axis=0), found

    return functools.cache(ends)


def test_one_load_against_quadrature_over_true_histories(one_load, ends, comm):
    """K against p0: a bent ridge, found from outside in, whatever the seed."""
    (test,) = one_load.experiments
    low, high = one_load.unknown_bounds
    p0 = np.linspace(low[1], high[1], 41)
    # at equal depths, so that the grid follows the ridge
    readings = Readings(one_load, comm, StopSignals())
    depths = readings([(0, np.column_stack([np.full(41, np.log(1.3e-7)), p0]))])[0][:, -1]
    shift = np.linspace(-0.25, 0.25, 25)
    k = np.log(1.3e-7 * test.series[0].value[-1] / depths)[:, None] + shift
    points = np.stack([k, np.broadcast_to(p0[:, None], k.shape)], axis=-1)
    y = readings([(0, points.reshape(-1, 2))])[0].reshape(*k.shape, -1)
    squares = np.square((y - test.series[0].value) / test.series[0].sd).sum(axis=-1)
    density = np.exp(-0.5 * (squares - squares.min())) * ((k > low[0]) & (k < high[0]))
    share = np.cumsum(density.sum(axis=1)) / density.sum()
    middle = np.append(0.5 * (p0[1:] + p0[:-1]), high[1])  # each point stands for its surroundings
    exact = np.interp([0.025, 0.5, 0.975], share, middle)
    sd = np.sqrt(np.cov(p0, aweights=density.sum(axis=1)))
    first, second = ends(0)[0], ends(1)[0]
    assert first[:, 1] == pytest.approx(exact, abs=0.2 * sd)
    of_seeds = np.abs(first - second) / (0.25 * (first[2] - first[0]))
    assert of_seeds.max() < 0.15


def test_steps_are_halved_until_they_do_not_matter(ends):
    exact, crude = ends(0)[0], ends(0, 3)
    assert crude[1].steps > 3
    assert crude[1].step_error < 0.15
    assert np.abs((crude[0] - exact) / (0.25 * (exact[2] - exact[0]))).max() < 0.4


def test_friction_and_coefficient_are_one_number_without_torque(tables, comm):
    given = tables()
    given["fit"]["parameters"] = {**FITTED, K: {**FITTED[K], "bounds": [1e-8, 1e-6]}, MU: FRICTION}
    found = rw.fit(given, comm)
    by_key = found.parameters
    for key in (MU, K):
        assert by_key[key]["verdict"] == "not identified"
        assert by_key[key]["direction"] == "only contact.friction x wear.lower.k is known"
    assert by_key[P0]["verdict"] == "identified"
    k, _, mu = found.draws.material.T
    assert np.median(k * mu) == pytest.approx(0.1 * TRUTH[K], rel=0.02)
    assert codes(found) == ["not-identified"]


def test_wear_hides_behind_a_drift(tables, comm):
    given = tables()
    (one, _), given["experiment"] = given["experiment"], given["experiment"][:1]
    one["set"] |= {P0: 25.0}
    del one["data"][1]
    one["data"][0] |= {"sd": 0.2, "nuisance": {"offset": {}, "drift": {}}}
    given["fit"]["parameters"] = {K: {"start": 1.3e-7, "bounds": [5e-8, 2.1e-7]}}
    (k,) = rw.fit(given, comm).parameters.values()
    assert k["verdict"] == "not identified"
    assert k["direction"] == "wear.lower.k against drift of penetration (test 1)"


def test_a_threshold_at_its_bound_has_an_upper_limit(comm, tmp_path):
    truth = {K: 1.3e-7, P0: 0.0}
    found = rw.fit(fit_tables(tmp_path, write_tests(tmp_path, truth=truth)), comm)
    k, threshold = found.parameters.values()
    assert threshold["verdict"] == "at bound"
    assert threshold["interval"][0] is None
    assert 0.0 < threshold["interval"][1] < 1.0
    assert k["estimate"] == pytest.approx(1.3e-7, rel=0.015)  # readings lie between straight lines
    assert "less than" in next(line for line in found.summary().splitlines() if P0 in line)


def test_outliers_and_trends_are_named(tables, comm, tmp_path):
    """A torque that settles, a point at an edge, a weighing in another unit."""
    given = tables()
    given["fit"]["parameters"] = {**FITTED, MU: FRICTION}
    t, noise = np.linspace(1.0, END, 100), np.random.default_rng(2).standard_normal(100)
    torque = 1e-3 * history(40.0).histories["torque"][-1]
    values = torque * (1.0 + 0.2 * np.exp(-t / 20.0)) + 0.02 * noise
    write_table(tmp_path / "m.csv", ("t_s", "torque_Nm"), t, values)
    first, _ = given["experiment"]
    weighing = {"quantity": "mass.lower", "value": 90.0, "unit": "mg", "sd": 5.0, "density": 0.0019}
    columns = {"time": "t_s", "value": "torque_Nm"}
    first["data"] += [weighing, {"quantity": "torque", "file": str(tmp_path / "m.csv"),
                                 "sd": "fit", "columns": columns}]  # fmt: skip
    face = first["data"][1]
    r, depth = np.genfromtxt(face["file"], delimiter=",", skip_header=1).T
    depth[39] += 40.0
    write_table(tmp_path / "d.csv", ("r_mm", "d_um"), r, depth)
    face["file"] = str(tmp_path / "d.csv")
    found = rw.fit(given, comm)
    doubts = {doubt.code: doubt for doubt in found.doubts}
    assert {"does-not-fit", "outliers", "residuals-trend"} <= {*doubts}
    assert f"r = {r[39]:.6g} mm" in doubts["outliers"].text
    assert any("mass.lower" in name for name in doubts["outliers"].values)
    assert [*doubts["residuals-trend"].values] == ["torque (test 1)"]


def test_outliers_do_not_count(tables, comm, tmp_path):
    given = tables(loss="student")
    for number, experiment in enumerate(given["experiment"]):
        data = experiment["data"][0]
        t, z = np.genfromtxt(data["file"], delimiter=",", skip_header=1).T
        z[3::9] += 4.0
        data["file"] = str(tmp_path / f"{number}.csv")
        write_table(tmp_path / f"{number}.csv", ("t_s", "z_um"), t, z)
        data["nuisance"] = {"offset": {}}
    robust = rw.fit(given, comm)
    offset = robust.to_dict()["nuisance"]["test 1"]["penetration"]["offset"]["estimate"]
    assert offset == pytest.approx(1.15, abs=0.15)  # and half of the drift
    assert near(robust)
    assert (robust.content["p_value"], robust.content["flagged"]) == (None, False)


def test_the_material_and_its_specimens(specimens):
    """Of three that differ, whose wear is random."""
    outcome = specimens.to_dict()
    k, process = outcome["parameters"][K], outcome["process"]["wear.lower"]
    low, high = k["interval"]
    assert k["of"] == "material"
    assert low < TRUTH[K] < high
    assert k["next"][0] < low < high < k["next"][1]
    for factor, one in zip((0.85, 1.0, 1.2), k["each"].values(), strict=True):
        assert one["interval"][0] < TRUTH[K] * factor < one["interval"][1]
        assert np.log(one["interval"][1] / one["interval"][0]) < np.log(high / low)
    size = k["scatter"]["specimen"]
    assert size["interval"][0] < np.std(np.log([0.85, 1.0, 1.2]), ddof=1) < size["interval"][1]
    # of the median of its square
    assert k["repeatability"]["s_r"] == pytest.approx(size["estimate"], rel=1e-3)
    assert k["repeatability"]["r"] == pytest.approx(2.8 * k["repeatability"]["s_r"])
    assert k["mean"] > k["estimate"]
    assert k["specimens_for_10_percent"] > 3
    assert process["size"]["known"] == pytest.approx(SHARE**2 * process["depth"])
    assert outcome["p_value"] > 1e-3
    words = specimens.summary()
    assert "between 3 specimens" in words
    assert "wear of lower fluctuates" in words
    assert "repeatability r = " in words
    assert "tests-disagree" not in codes(specimens)


def test_one_coefficient_for_specimens_that_differ_is_a_doubt(specimens, comm):
    tables = parse_toml(specimens.problem.text, "fit")
    tables["fit"]["parameters"][K].pop("scatter")
    tables["fit"].pop("process")
    found = rw.fit(tables, comm)
    (doubt,) = (doubt for doubt in found.doubts if doubt.code == "tests-disagree")
    assert doubt.keys == (K,)
    assert 0.08 < doubt.values["scatter"] < 0.35


def test_a_specimen_whose_wear_is_random(specimens, comm):
    """By itself it tells k less well than its readings seem to, and how random its wear is."""
    tables = parse_toml(specimens.problem.text, "fit")
    tables["fit"]["parameters"][K].pop("scatter")
    tables["fit"]["process"] = {"wear.lower": "fit"}
    del tables["experiment"][1:]
    found = rw.fit(tables, comm)
    (k,), process = found.parameters.values(), found.to_dict()["process"]["wear.lower"]
    low, share, high = (process["share"]["interval"][0], process["share"]["estimate"],
                        process["share"]["interval"][1])  # fmt: skip
    assert low < SHARE < high
    assert process["size"]["estimate"] == pytest.approx(share**2 * process["depth"])
    assert k["interval"][0] < 0.85 * TRUTH[K] < k["interval"][1]
    assert k["sd"] / k["estimate"] > 0.5 * share
    ahead = (
        found.series[-1].columns["excess_lower"][0][-1] / process["depth"]
    )  # of the law, as far as readings tell
    assert abs(ahead) < 3.0 * share


def test_a_law_that_the_tests_bring_and_values_that_it_does_not_allow(tmp_path, comm):
    """Running-in from k_start = k: with this noise, the best k_start would be below it."""
    law = {"wear.lower.law": "running-in", "wear.lower.distance": 1000.0, P0: 0.0,
           K: 1e-7, "wear.lower.k_start": 1e-7}  # fmt: skip
    t, z = penetration(history(60.0, {}, **law), np.random.default_rng(4), None, 0.0, 0.0)
    (tmp_path / "case.toml").write_text(CASE)
    keys = [K, "wear.lower.k_start"]
    sought = {"start": 1e-7, "bounds": [1e-9, 1e-5], "scale": "log"}
    known = {key: value for key, value in law.items() if key not in keys}
    test = one_test("A", 60.0, record(tmp_path / "z.csv", t, z), **known)
    found = rw.fit(fit_tables(tmp_path, [test], parameters=dict.fromkeys(keys, sought)), comm)
    assert [p["estimate"] for p in found.parameters.values()] == pytest.approx(
        [1e-7, 1e-7], rel=0.3
    )
    k, k_start = found.draws.material.T
    assert (k <= k_start + 1e-9).all()
    assert 0 < found.solution.failed < found.solution.histories
    assert "histories-failed" in codes(found)
    assert "k_start" in found.solution.reason


def test_limits_of_a_record(comm, tmp_path):
    """A sensor that ends at 2 um: later readings say that the depth is more."""
    (tmp_path / "case.toml").write_text(CASE)
    t, z = penetration(history(80.0), np.random.default_rng(7), offset=0.0, drift=0.0)
    z *= 1e3
    rows = zip(t, np.minimum(z, 2.0), np.where(z > 2.0, "above", ""), strict=True)
    lines = ["t_s,z_um,limit", *(f"{a:.9g},{b:.9g},{c}" for a, b, c in rows)]
    (tmp_path / "z.csv").write_text("\n".join(lines) + "\n")
    depth = {"quantity": "penetration", "file": str(tmp_path / "z.csv"), "sd": 0.2,
             "censored": "limit", "columns": {"time": "t_s", "value": "z_um"}}  # fmt: skip
    tables = fit_tables(tmp_path, [one_test("a", 80.0, depth, **{P0: 25.0})])
    del tables["fit"]["parameters"][P0]
    found = rw.fit(tables, comm)
    of_record = found.to_dict()["experiments"]["a"]["penetration"]
    assert 20 < of_record["censored"] < of_record["n"] == 50
    freedom = found.to_dict()["degrees_of_freedom"]
    assert freedom == pytest.approx(50 - of_record["censored"] - 1, abs=0.3)
    assert near(found)
    weighing = {"quantity": "mass.lower", "value": 0.1, "unit": "mg", "sd": 0.05, "density": 7.8e-3,
                "censored": "below"}  # fmt: skip
    tables["experiment"][0]["data"] = [weighing]
    (k,) = rw.fit(tables, comm).parameters.values()
    assert (k["verdict"], k["interval"][0]) == ("at bound", None)
