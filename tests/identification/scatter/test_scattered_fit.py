"""Fits of specimens that differ: the material's value, each specimen's, what is refused."""

import copy
from dataclasses import replace

import numpy as np
import pytest
from laboratory import (
    CASE,
    FITTED,
    TRUTH,
    ZERO_AND_DRIFT,
    fit_tables,
    history,
    one_test,
    penetration,
    record,
    write_table,
)
from mpi4py import MPI
from parts import draw_values
from scipy.stats import norm

import ringwear_par as rw
from ringwear_par.identification.definition.fit_file import read_fit
from ringwear_par.identification.fitted_values import fitted_values

pytestmark = pytest.mark.slow

SPECIMENS, SCATTER = 5, 0.2
K, P0 = "wear.lower.k", "wear.lower.p0"


def write_specimens(folder, factors, seed=4):
    """Write a record of each specimen, whose k is that of TRUTH times a factor."""
    rng = np.random.default_rng(seed)
    experiments = []
    for number, factor in enumerate(factors, start=1):
        pressure = (45.0, 80.0)[number % 2]
        result = history(pressure, {**TRUTH, K: TRUTH[K] * factor})
        t, z = penetration(result, rng)
        data = record(folder / f"z{number}.csv", t, z, nuisance=copy.deepcopy(ZERO_AND_DRIFT))
        experiments.append(one_test(f"test {number}", pressure, data))
    return experiments


def with_scatter(tables, scatter="fit", key=K):
    """Return a fit file in which a key scatters."""
    changed = copy.deepcopy(tables)
    changed["fit"]["parameters"][key]["scatter"] = scatter
    return changed


def few(tables):
    """Return a fit file of three of its specimens, from one start."""
    return {**tables, "fit": {**tables["fit"]}, "experiment": tables["experiment"][:3]}


@pytest.fixture(scope="module")
def factors():
    return np.exp(SCATTER * np.random.default_rng(6).standard_normal(SPECIMENS))


@pytest.fixture(scope="module")
def tables(tmp_path_factory, factors):
    folder = tmp_path_factory.mktemp("specimens")
    (folder / "case.toml").write_text(CASE)
    return fit_tables(folder, write_specimens(folder, factors))


@pytest.fixture(scope="module")
def fit(tables):
    """The fit in which k scatters."""
    return rw.fit(with_scatter(tables), MPI.COMM_SELF)


def test_the_material_and_its_specimens(fit, factors, tmp_path):
    outcome = fit.to_dict()
    k = outcome["parameters"][K]
    assert (k["of"], k["interval_of"]) == ("material", "scatter integrated")
    low, high = k["interval"]
    assert low < TRUTH[K] < high
    # a sd of 0.2 of five specimens: the interval is some 35 % wide, where readings explain 1 %
    assert 0.15 < np.log(high / low) / 2 < 0.6
    size = k["scatter"]["specimen"]
    assert size["verdict"] == "identified"
    assert size["interval"][0] < np.std(np.log(factors), ddof=1) < size["interval"][1]
    assert k["next"][0] < low < high < k["next"][1]
    assert k["repeatability"]["r"] == pytest.approx(2.8 * size["estimate"])
    for factor, one in zip(factors, k["each"].values(), strict=True):
        assert one["interval"][0] < TRUTH[K] * factor < one["interval"][1]
        assert 0.0 <= one["shrinkage"] < 0.2
    assert outcome["p_value"] > 1e-3
    assert not [doubt for doubt in outcome["doubts"] if doubt["code"] == "tests-disagree"]
    assert "between 5 specimens" in fit.summary()
    fit.save(tmp_path / "fit")
    assert (tmp_path / "fit" / "specimens.png").exists()
    rw.report(tmp_path / "fit", tmp_path / "fit.html")
    page = (tmp_path / "fit.html").read_text()
    assert ", of specimens" in page


def test_a_posterior_that_bends_is_followed(tables, fit):
    """Its density along p0 is the likelihood of fits to which p0 is known; the doubt is told."""
    found = fit
    (place,) = [j for j, p in enumerate(found.parameters) if p.key == P0]
    at, known = np.array([14.0, 33.0]), []
    for value in at.tolist():
        one = with_scatter(tables)
        del one["fit"]["parameters"][P0]
        for test in one["experiment"]:
            test["set"] = {**test["set"], P0: value}
        known.append(rw.fit(one, MPI.COMM_SELF).material.mixed.posterior.log_mass)
    density = np.zeros(len(at))
    for piece in found.material.pieces:
        p0 = piece.posterior.unknown(place)
        each = norm.pdf(at[:, None], p0.means, np.sqrt(p0.variances))
        density += piece.weight * each @ p0.weights
    assert np.diff(np.log(density)) == pytest.approx(np.diff(known), abs=0.1)
    (doubt,) = [one for one in found.doubts if one.code == "nonlinear-interval" and P0 in one.keys]
    low, high = found.to_dict()["parameters"][P0]["interval"]
    assert doubt.values["low"] < low
    assert doubt.values["high"] < high  # histories bend most near the lower load
    assert " MPa where histories" in doubt.text
    # what is beyond the bounds of any key is left out, as predictions do
    bounds = (doubt.values["low"], 200.0)
    keys = tuple(replace(p, bounds=bounds) if p.key == P0 else p for p in found.material.parameters)
    bounded = replace(found.material, parameters=keys).warnings
    ends = {d.keys[0]: d.values for d in bounded if d.code == "nonlinear-interval"}
    values = replace(fitted_values(found), bounds=np.array([p.bounds for p in keys]))
    for of in ("material", "next specimen"):
        drawn, _ = draw_values(values, of, 50_000, np.random.default_rng(1))
        for key, at in ends.items():
            drawn_key = drawn[:, values.keys.index(key)]
            expected = at.get("next") if of == "next specimen" else (at["low"], at["high"])
            if expected is not None:
                within = pytest.approx(expected, abs=0.1 * drawn_key.std())
                assert np.quantile(drawn_key, (0.025, 0.975)) == within
    assert set(ends) == {K, P0}


def test_tests_that_disagree_are_a_doubt(tables):
    fit = rw.fit({**tables, "fit": {**tables["fit"]}}, MPI.COMM_SELF)
    (doubt,) = (d for d in fit.doubts if d.code == "tests-disagree" and d.keys == (K,))
    assert doubt.values["p"] < 1e-6
    assert 0.5 * SCATTER < doubt.values["scatter"] < 2.0 * SCATTER
    with pytest.raises(rw.InputError, match="scatter"):
        fit.plot_specimens()


def test_repeats_that_agree(tmp_path):

    (tmp_path / "case.toml").write_text(CASE)
    alike = fit_tables(tmp_path, write_specimens(tmp_path, np.ones(4)))
    plain = rw.fit(alike, MPI.COMM_SELF)
    assert not [doubt for doubt in plain.doubts if doubt.code == "tests-disagree"]
    one = rw.fit(with_scatter(alike), MPI.COMM_SELF).to_dict()["parameters"][K]
    size = one["scatter"]["specimen"]
    assert size["verdict"] == "at bound"
    assert size["interval"][0] == 0.0
    # with no scatter at all it is the common fit
    known = rw.fit(with_scatter(alike, 1e-6), MPI.COMM_SELF).to_dict()
    common = plain.to_dict()
    for key, estimate in known["parameters"].items():
        expected = common["parameters"][key]
        assert estimate["estimate"] == pytest.approx(expected["estimate"], rel=1e-3)
        assert estimate["sd"] == pytest.approx(expected["sd"], rel=0.02)
    assert known["aic"] == pytest.approx(common["aic"], abs=0.1)
    assert known["degrees_of_freedom"] == pytest.approx(common["degrees_of_freedom"], abs=0.01)


def test_noise_is_fitted_along(tables):
    guessed = few(with_scatter(tables))
    for experiment in guessed["experiment"]:
        experiment["data"][0]["sd"] = "fit"
    fit = rw.fit(guessed, MPI.COMM_SELF)
    fitted = [series["penetration"]["sd"] for series in fit.to_dict()["experiments"].values()]
    # 50 readings tell a standard deviation to a tenth
    assert fitted == pytest.approx([0.2] * 3, rel=0.35)


def test_a_plan_takes_sizes_as_they_start(tables):
    from ringwear_par.identification.fit import expected_result

    plan = with_scatter(tables, {"specimen": "fit", "start": 0.25})
    plan["fit"]["parameters"]["wear.lower.p0"]["prior"] = {"normal": [0.0, 0.2]}
    problem = read_fit(plan)
    expected = expected_result(problem, MPI.COMM_SELF).to_dict()["parameters"][K]
    assert expected["estimate"] == pytest.approx(FITTED[K]["start"])
    assert expected["scatter"]["specimen"]["known"] == 0.25
    ends = np.log(np.array(expected["interval"]) / FITTED[K]["start"])
    assert ends[1] == pytest.approx(-ends[0])
    # five specimens, whose own readings add little
    assert ends[1] == pytest.approx(1.96 * 0.25 / np.sqrt(SPECIMENS), rel=0.1)


def test_far_zeros_of_records_change_nothing(tables, tmp_path):
    """Zeros that are 40 um off, as of a sensor that nobody has set."""
    near = few(with_scatter(tables))
    near["fit"]["loss"] = "student"
    far = copy.deepcopy(near)
    for number, experiment in enumerate(far["experiment"], start=1):
        record = experiment["data"][0]
        t, z = np.loadtxt(record["file"], delimiter=",", skiprows=1, unpack=True)
        record["file"] = str(tmp_path / f"far{number}.csv")
        write_table(tmp_path / f"far{number}.csv", ("t_s", "z_um"), t, z + 40.0)
    here, there = (rw.fit(one, MPI.COMM_SELF).to_dict()["parameters"] for one in (near, far))
    for key in (K, "wear.lower.p0"):
        assert there[key]["estimate"] == pytest.approx(here[key]["estimate"], rel=1e-3)
        assert there[key]["sd"] == pytest.approx(here[key]["sd"], rel=1e-2)


def test_bounds_of_the_material(tables):
    """A key without scatter that would leave its bounds has a one-sided limit."""
    bounded = few(with_scatter(tables))
    bounded["fit"]["parameters"]["wear.lower.p0"] |= {"start": 60.0, "bounds": [50.0, 200.0]}
    p0 = rw.fit(bounded, MPI.COMM_SELF).to_dict()["parameters"]["wear.lower.p0"]
    assert (p0["estimate"], p0["verdict"]) == (50.0, "at bound")
    assert p0["interval"][0] is None
    assert p0["interval"][1] > 50.0


def test_groups_that_are_refused(tables):
    same = with_scatter(tables, {"specimen": "fit", "batch": "fit"})
    for experiment in same["experiment"]:
        experiment["batch"] = experiment["name"]
    with pytest.raises(rw.InputError, match="same groups"):
        read_fit(same)
    moved = with_scatter(tables)
    for experiment, batch in zip(moved["experiment"][:2], ("a", "b"), strict=True):
        experiment |= {"specimen": "S1", "batch": batch}
    with pytest.raises(rw.InputError, match="one batch"):
        read_fit(moved)
    one = with_scatter(tables)
    for experiment in one["experiment"]:
        experiment["specimen"] = "S1"
    with pytest.raises(rw.InputError, match="one specimen"):
        read_fit(one)


def test_the_scale_of_a_scatter_has_its_unit(tables):
    linear = with_scatter(tables, key="wear.lower.p0")
    linear["fit"]["parameters"]["wear.lower.p0"]["scatter"] = {
        "specimen": "fit", "prior": {"half_t": "5 MPa"},
    }  # fmt: skip
    scatter = read_fit(linear).parameters[1].scatter
    assert (scatter.scale, scatter.start) == (5.0, 2.5)
