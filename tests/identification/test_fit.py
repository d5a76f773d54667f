"""Fits: the truth is found, and what the readings do not tell is said."""

import re
from pathlib import Path

import numpy as np
import pytest
from laboratory import (
    CASE,
    END,
    FITTED,
    SD_PROFILE,
    TRUTH,
    fit_tables,
    history,
    one_test,
    penetration,
    profile,
    record,
    write_table,
    write_tests,
)
from parts import parse_toml

import ringwear_par as rw
from ringwear_par.identification.definition.fit_file import read_fit
from ringwear_par.identification.fit import expected_result, fit, fit_problem

pytestmark = pytest.mark.slow

SCRIPTS = Path(__file__).parents[2] / "scripts"


def near(found, truth=TRUTH, most=3.0):
    """Tell whether estimates are within some standard deviations of the truth."""
    return all(abs(p.estimate - truth[p.key]) < most * p.sd for p in found.parameters)


def test_a_laboratory_found_the_law(comm):
    """Files of an independent model with noise, in the repository as a worked example."""
    problem = read_fit(SCRIPTS / "fit/fit.toml")
    found = fit_problem(problem, comm, compare=False)
    assert near(found)
    assert not found.flagged
    assert [p.verdict for p in found.parameters] == ["identified"] * 2
    assert found.histories <= 2 * 20


def test_likelihood_profiles_are_parabolas_where_much_is_known(tables, comm):
    found = fit(tables(level=0.9), comm)
    assert set(found.profiles) == set(TRUTH)
    for one in found.parameters:
        low, high = one.interval
        assert (high - low) / (2 * 1.645 * one.sd) == pytest.approx(1.0, abs=0.05)
        value, growth = found.profiles[one.key]
        assert (np.diff(value) > 0).all()
        assert np.interp(low, value, growth) == pytest.approx(1.645**2, rel=0.05)
        assert np.interp(high, value, growth) == pytest.approx(1.645**2, rel=0.05)


def test_criteria_count_what_priors_object(tables, comm):
    """A prior that is far off costs what it costs the objective."""
    given = tables()
    known = expected_result(read_fit(given), comm)
    key = known.parameters[0].key
    prior = {"normal": [known.parameters[0].estimate * 3, known.parameters[0].estimate]}
    given["fit"]["parameters"][key] = {**FITTED[key], "prior": prior}
    doubted = expected_result(read_fit(given), comm)
    assert doubted.aic - known.aic == pytest.approx(4.0, rel=1e-6)
    assert doubted.bic - known.bic == pytest.approx(4.0, rel=1e-6)
    growth = doubted.evaluation.objective - known.evaluation.objective
    assert growth == pytest.approx(2.0, rel=1e-6)


def test_noise_is_fitted(tables, comm):
    given = tables()
    for experiment in given["experiment"]:
        experiment["data"][1]["sd"] = "fit"
    found = fit(given, comm)
    assert near(found)
    assert found.p_value is not None  # of the penetrations, whose noise is given
    assert found.p_value > 1e-3
    squared, freedom = found.tested_chi2
    assert squared == pytest.approx(
        sum(series["penetration"]["chi2"] for series in found.experiments.values())
        + found.total - found.chi2
    )  # fmt: skip
    assert 0.9 * 100 < freedom <= 102
    for series in found.experiments.values():
        noise = series[f"profile.lower at {END:g} s"]
        assert 1e-3 * noise["sd"] == pytest.approx(SD_PROFILE, rel=0.25)
        assert noise["chi2"] == pytest.approx(noise["n"], rel=0.1)


def test_outliers_do_not_count(tables, comm, tmp_path):
    given = tables()
    for number, experiment in enumerate(given["experiment"]):
        data = experiment["data"][0]
        t, z = np.genfromtxt(data["file"], delimiter=",", skip_header=1).T
        z[3::9] += 4.0
        data["file"] = str(tmp_path / f"{number}.csv")
        write_table(tmp_path / f"{number}.csv", ("t_s", "z_um"), t, z)
        data["nuisance"] = {"offset": {}}
    plain = fit(given, comm)
    given["fit"]["loss"] = "student"
    robust = fit(given, comm)
    assert plain.flagged

    def offset(found):
        return found.nuisances["test 1"]["penetration"]["offset"]["estimate"]

    assert abs(offset(plain) - 1.15) > 0.3  # offset, and half of the drift
    assert abs(offset(robust) - 1.15) < 0.15
    assert near(robust)
    assert robust.p_value is None
    assert not robust.flagged


def test_friction_and_coefficient_are_one_number_without_torque(tables, comm):
    given = tables()
    given["fit"]["parameters"] = {
        **FITTED, "contact.friction": {"start": 0.2, "bounds": [0.01, 1.0], "scale": "log"},
    }  # fmt: skip
    found = fit(given, comm)
    by_key = {p.key: p for p in found.parameters}
    for key in ("contact.friction", "wear.lower.k"):
        assert by_key[key].verdict == "not identified"
        assert by_key[key].interval == (None, None)
        assert by_key[key].direction == "only contact.friction x wear.lower.k"
    assert by_key["wear.lower.p0"].verdict == "identified"
    product = by_key["contact.friction"].estimate * by_key["wear.lower.k"].estimate
    assert product == pytest.approx(0.1 * TRUTH["wear.lower.k"], rel=0.02)


@pytest.mark.parametrize("share", [0.0, 0.2])
def test_residuals_that_trend_are_a_doubt(share, tables, comm, tmp_path):
    """A torque that settles, of which the model has a constant one only; and noise."""
    given = tables()
    friction = {"start": 0.2, "bounds": [0.01, 1.0], "scale": "log"}
    given["fit"]["parameters"] = {**FITTED, "contact.friction": friction}
    t, noise = np.linspace(1.0, END, 100), np.random.default_rng(2).standard_normal(100)
    torque = 1e-3 * history(40.0).histories["torque"][-1]
    values = torque * (1.0 + share * np.exp(-t / 20.0)) + 0.02 * noise
    write_table(tmp_path / "m.csv", ("t_s", "torque_Nm"), t, values)
    given["experiment"][0]["data"].append(
        {"quantity": "torque", "file": str(tmp_path / "m.csv"), "sd": "fit",
         "columns": {"time": "t_s", "value": "torque_Nm"}}
    )  # fmt: skip
    found = fit(given, comm)
    doubts = [one for one in found.to_dict()["doubts"] if one["code"] == "residuals-trend"]
    assert len(doubts) == (1 if share else 0)
    (mu,) = (p for p in found.parameters if p.key == "contact.friction")  # which torques tell
    assert mu.verdict == "identified"
    assert mu.estimate == pytest.approx(0.1, rel=0.1 if share else 0.01)
    assert all(doubt["experiments"] == ("test 1",) for doubt in doubts)


def test_a_threshold_hides_behind_the_drift(tables, comm):
    given = tables()
    (one, _), given["experiment"] = given["experiment"], given["experiment"][:1]
    del one["data"][1]
    one["data"][0]["nuisance"]["drift"] = {}
    found = fit(given, comm)
    by_key = {p.key: p for p in found.parameters}
    assert by_key["wear.lower.p0"].verdict == "not identified"
    assert "drift of penetration (test 1)" in by_key["wear.lower.p0"].direction


def test_what_is_one_with_an_unknown_is_unknown(tables, comm):
    """A coefficient and a threshold at one load: bounds of the one alone do not tell the other."""
    given = tables()
    (_, one), given["experiment"] = given["experiment"], given["experiment"][1:]
    del one["data"][1], one["data"][0]["nuisance"]
    one["data"][0]["sd"] = 0.4
    given["fit"]["parameters"] = {
        "wear.lower.k": {"start": 1.3e-7, "bounds": [1.1e-7, 1.5e-7]},
        "wear.lower.p0": {"start": 25.0, "bounds": [0.0, 200.0]},
    }
    found = expected_result(read_fit(given), comm)
    (_, _, correlation), *_ = found.correlations()
    assert abs(correlation) > 0.999
    assert 4 * found.parameters[1].sd < 200.0
    assert [p.verdict for p in found.parameters] == ["not identified"] * 2
    assert "wear.lower.k" in found.parameters[1].direction


def test_a_threshold_at_its_bound_has_an_upper_limit(comm, tmp_path):
    truth = {"wear.lower.k": 1.3e-7, "wear.lower.p0": 0.0}
    written = write_tests(tmp_path, truth=truth)  # whose noise leads below 0
    found = fit(fit_tables(tmp_path, written), comm)
    threshold = found.parameters[1]
    assert threshold.verdict == "at bound"
    assert threshold.estimate == 0.0
    assert threshold.interval[0] is None
    assert 0.0 < threshold.interval[1] < 1.0
    assert abs(found.parameters[0].estimate - 1.3e-7) < 3 * found.parameters[0].sd


def test_both_bodies_wear_and_records_have_gaps(comm, tmp_path):
    truth = {"wear.lower.k": 1.3e-7, "wear.upper.k": 4e-8}
    law = {"wear.lower.law": "archard", "wear.upper.law": "archard"}
    result = history(60.0, truth={**law, **truth})
    rng = np.random.default_rng(4)
    t, z = penetration(result, rng)
    keep = (t < 30) | (t > 60)
    data = [record(tmp_path / "z.csv", t[keep], z[keep], nuisance={"offset": {}})]
    for body in ("lower", "upper"):
        r, d = profile(result, rng, body=body)
        keep = (r > 28.5) & (r < 31.5) if body == "upper" else r > 0
        write_table(tmp_path / f"{body}.csv", ("r_mm", "d_um"), r[keep], 1e3 * d[keep])
        data.append(
            {"quantity": f"profile.{body}", "file": str(tmp_path / f"{body}.csv"), "sd": 0.08,
             "columns": {"r": "r_mm", "value": "d_um"}, "nuisance": {"level": {}, "tilt": {}}}
        )  # fmt: skip
    (tmp_path / "case.toml").write_text(CASE)
    sought = {"start": 1e-7, "bounds": [1e-9, 1e-5], "scale": "log"}
    given = fit_tables(
        tmp_path, [one_test("both", 60.0, *data, **law)], parameters=dict.fromkeys(truth, sought)
    )
    found = fit(given, comm)
    assert near(found, truth)
    assert not found.flagged


def test_another_law_does_not_fit(tables, comm):
    given = tables()
    given["compare"] = {
        "archard": {
            "set": {"wear.lower.law": "archard"},
            "parameters": {"wear.lower.k": FITTED["wear.lower.k"]},
        }
    }
    found = fit(given, comm, compare=True)
    other = found.alternatives["archard"]
    assert other.flagged
    assert other.aic > found.aic + 10
    assert other.bic > found.bic + 10
    stored = found.to_dict()["alternatives"]["archard"]
    assert stored["flagged"] is True
    assert list(stored["parameters"]) == ["wear.lower.k"]
    (line,) = (line for line in found.summary().splitlines() if line.startswith("  archard: "))
    assert f"{other.parameters[0].estimate:.5g} 1/MPa" in line


def test_outliers_are_named(tables, comm, tmp_path):
    """A weighing in another unit, and one point of a profile at the edge."""
    given = tables()
    _, face = given["experiment"][0]["data"]
    r, depth = np.genfromtxt(face["file"], delimiter=",", skip_header=1).T
    depth[39] += 40.0
    write_table(tmp_path / "d.csv", ("r_mm", "d_um"), r, depth)
    face["file"] = str(tmp_path / "d.csv")
    weighing = {"quantity": "mass.lower", "value": 90.0, "unit": "mg", "sd": 5.0, "density": 0.0019}
    given["experiment"][0]["data"].append(weighing)
    text = "\n".join(doubt.text for doubt in fit(given, comm).doubts)
    assert "the model does not fit" in text
    assert re.search("mass.lower .*unit", text)
    assert re.search(f"profile.lower .*at r = .*{r[39]:.6g}.* mm", text)


def test_a_law_of_ones_own_is_found(comm, tmp_path):
    truth = {"wear.lower.parameters.k": 3e-7, "wear.lower.parameters.p1": 50.0}
    start = {"wear.lower.parameters.k": 1e-7, "wear.lower.parameters.p1": 30.0}
    rng, experiments = np.random.default_rng(1), []
    path = SCRIPTS / "cases/user_law.toml"
    for pressure in (40.0, 100.0):
        settings = {"load.pressure": pressure, "time.end": END, "mesh.contact_elements": 12}
        result = rw.simulate(rw.read_case(path, {**settings, **truth}), comm)
        t, z = penetration(result, rng, np.linspace(4.0, END, 25), offset=0.0, drift=0.0)
        data = [record(tmp_path / f"{pressure}.csv", t, z)]
        experiments.append({"name": f"{pressure} MPa", "set": settings, "data": data})
    keys = {
        key: {"start": value, "bounds": [0.01 * value, 100.0 * value], "scale": "log"}
        for key, value in start.items()
    }
    tables = {
        "case": str(path), "fit": {"parameters": keys}, "experiment": experiments,
    }  # fmt: skip
    found = fit(tables, comm)
    assert near(found, truth)
    assert {p.verdict for p in found.parameters} == {"identified"}
    assert found.parameters[0].estimate == pytest.approx(3e-7, rel=0.1)
    assert not found.flagged


def test_steps_resolve_how_a_layer_is_worn_through(tmp_path, comm):
    """Long steps there made k of the layer and of the body under it wrong by several sd."""
    truth = {"lower.layers[0].wear.k": 4e-8, "wear.lower.k": 4e-7}
    layer = {"thickness": 6e-3, "young": 1e5, "poisson": 0.3, "wear": {"law": "archard"}}
    case = {**parse_toml(CASE, "case"), "wear": {"lower": {"law": "archard"}}}
    case["lower"]["layers"] = [layer]
    layer["wear"]["k"], case["wear"]["lower"]["k"] = truth.values()
    case["time"] = {"scheme": "adaptive", "end": END, "tolerance": 1e-7}
    t, z = penetration(
        rw.simulate(rw.read_case(case), comm), np.random.default_rng(1), offset=0.0, drift=0.0
    )
    data = record(tmp_path / "z.csv", t, z)
    keys = {
        key: {"start": 0.7 * k, "bounds": [0.1 * k, 10.0 * k], "scale": "log"}
        for key, k in truth.items()
    }
    tables = {
        "case": case, "fit": {"parameters": keys},
        "experiment": [{"name": "A", "data": [data]}],
    }  # fmt: skip
    found = fit(tables, comm)
    assert near(found, truth)
    assert not found.flagged
    assert all(abs(moved) < 0.2 for moved in found.discretisation_shift_sd.values())


def test_trials_that_a_law_does_not_allow_end_no_fit(tmp_path, comm):
    """Running-in from k_start = k: with this noise, the best k_start would be below it."""
    law = {
        "wear.lower.law": "running-in", "wear.lower.distance": 1000.0, "wear.lower.p0": 0.0,
        "wear.lower.k": 1e-7, "wear.lower.k_start": 1e-7,
    }  # fmt: skip
    rng = np.random.default_rng(4)
    t, z = penetration(history(60.0, {}, **law), rng, offset=0.0, drift=0.0)
    (tmp_path / "case.toml").write_text(CASE)
    keys = [key for key in law if key.endswith(("k", "k_start"))]
    sought = {"start": 1e-7, "bounds": [1e-9, 1e-5], "scale": "log"}
    known = {key: value for key, value in law.items() if key not in keys}
    test = one_test("A", 60.0, record(tmp_path / "z.csv", t, z), **known)
    given = fit_tables(tmp_path, [test], parameters=dict.fromkeys(keys, sought))
    found = fit(given, comm)
    k, k_start = found.parameters
    assert near(found, dict.fromkeys(keys, 1e-7))
    assert k.estimate <= k_start.estimate
    assert k.interval[1] is None or k.interval[1] > k.estimate
    assert not any(start.error for start in found.starts)
    # searches go along the rule, not against it: each meets the gradient there
    assert all(start.converged and start.histories < 40 for start in found.starts)
