"""Fits of records of rigs that warm up."""

import copy

import numpy as np
import pytest
from laboratory import (
    CASE,
    PAPER,
    SD_PENETRATION,
    TRUTH,
    fit_tables,
    history,
    one_test,
    penetration,
    record,
)  # fmt: skip
from linear_histories import LinearHistories
from mpi4py import MPI

import ringwear_par as rw
from ringwear_par.identification.definition.fit_file import read_fit
from ringwear_par.identification.definition.problem import Nuisance
from ringwear_par.identification.estimation.intervals import estimates
from ringwear_par.identification.estimation.minimise import minimise
from ringwear_par.identification.estimation.misfit import Misfit
from ringwear_par.identification.estimation.record_checks import refuse_reversed
from ringwear_par.identification.model.histories import STEPS, Histories
from ringwear_par.identification.model.readings import growth

K = "wear.lower.k"
#: s, um; and the record's end and number of readings
TIME, GROWTH = 1500.0, -3.0
END, READINGS = 7200.0, 120
OMEGA = 3.5 * 100.0 / END
THERMAL = {"time": {"start": "20 min", "bounds": ["2 min", "3 h"],
                    "prior": {"normal": ["25 min", "8 min"]}}}  # fmt: skip


@pytest.fixture(scope="module")
def records():
    """Times (s) and penetrations (um) of two loads, without growth and noise."""
    times = np.linspace(END / READINGS, END, READINGS)
    return {
        pressure: penetration(
            history(pressure, end=END, **{"load.omega": OMEGA}), None, times, 1e-3, 0.0
        )
        for pressure in (40.0, 85.0)
    }


@pytest.fixture(scope="module")
def warm(records, tmp_path_factory):
    """Function that makes a fit file of tests on a warm rig, with some nuisances."""

    def made(nuisance, growth=GROWTH, seed=3, **fit):
        tmp_path = tmp_path_factory.mktemp("warm")
        rng = np.random.default_rng(seed)
        experiments = []
        for pressure, (t, z) in records.items():
            name = f"{pressure:g} MPa"
            noise = 1e3 * SD_PENETRATION * rng.standard_normal(len(t))
            grown = z + 1e-3 * (growth * -np.expm1(-t / TIME) + noise)
            data = record(tmp_path / f"{name}.csv", t, grown, nuisance=copy.deepcopy(nuisance))
            more = {"load.omega": OMEGA, "time.end": END}
            experiments.append(one_test(name, pressure, data, **more))
        (tmp_path / "case.toml").write_text(CASE)
        return copy.deepcopy(fit_tables(tmp_path, experiments, **fit))

    return made


def test_derivatives(warm):
    """Those of all unknowns but the keys are differences of residuals."""
    problem = read_fit(warm({"offset": {}, "thermal": THERMAL}))
    misfit = Misfit(problem, Histories(problem, MPI.COMM_SELF))
    x = misfit.with_best_nuisances(list(problem.start.values()))
    amplitude, time = misfit.names.index(("40 MPa", "penetration", "thermal")), 4
    assert x[time] == 1200.0
    assert x[amplitude] != 0.0
    x[time] = 1700.0
    jacobian = misfit.evaluate(x).jacobian
    for j in range(2, len(x)):
        step = np.zeros(len(x))
        step[j] = 1e-4 * abs(x[j])
        change = misfit.evaluate(x + step).residuals - misfit.evaluate(x - step).residuals
        assert change / (2.0 * step[j]) == pytest.approx(jacobian[:, j], rel=1e-6, abs=1e-9)


@pytest.fixture(scope="module")
def found(warm):
    """The fit of a warm rig."""
    return rw.fit(warm({"offset": {}, "thermal": THERMAL}), MPI.COMM_SELF)


def test_growth_is_no_wear(warm, found):
    cold = rw.fit(warm({"offset": {}}), MPI.COMM_SELF)
    k = {one.key: one for one in cold.parameters}[K]
    assert abs(k.estimate - TRUTH[K]) > 3.0 * k.sd
    assert cold.p_value < 1e-6
    assert found.p_value > 0.01
    for one in found.parameters:
        assert abs(one.estimate - TRUTH[one.key]) < 2.0 * one.sd
    for of_test in found.to_dict()["nuisance"].values():
        growth = of_test["penetration"]["thermal"]
        assert abs(growth["estimate"] - GROWTH) < 3.0 * growth["sd"]
        assert abs(growth["time"]["estimate"] - TIME) < 3.0 * growth["time"]["sd"]
        assert growth["time"]["sd"] < 450.0  # of the prior: 480


def test_coverage(warm):
    """40 tests whose time constants are of the prior, of readings that are linear in the keys."""
    tables = warm({"offset": {}, "thermal": THERMAL})
    for key, truth in TRUTH.items():
        tables["fit"]["parameters"][key]["start"] = truth
    problem = read_fit(tables)
    histories = Histories(problem, MPI.COMM_SELF)
    (response,) = histories.responses(np.array([list(TRUTH.values())]), STEPS)
    misfit, rng = Misfit(problem, LinearHistories(problem, response)), np.random.default_rng(5)
    truth = misfit.with_best_nuisances(list(TRUTH.values()))
    errors = []
    for _ in range(40):
        truth[2:] = [1.0, GROWTH, rng.normal(1500.0, 480.0)] * 2
        truth[2:] = np.clip(truth, misfit.lower, misfit.upper)[2:]
        misfit.data = response[:, 0] + misfit.nuisance_readings(truth)
        misfit.data = misfit.data + misfit.sd * rng.standard_normal(misfit.n)
        best = minimise(misfit, misfit.with_best_nuisances(list(problem.start.values())))
        assert best.converged
        covariance = estimates(misfit, best.x, best.evaluation)[1]
        errors.append((best.x - truth) / np.sqrt(np.diag(covariance)))
    of_keys = np.array(errors)[:, :2]  # 95 and 94 % of 400; amplitudes and times 90 to 93 %
    assert ((np.abs(of_keys) < 1.96).mean(axis=0) >= 0.9).all()
    assert of_keys.std(axis=0) == pytest.approx(1.0, abs=0.2)


@pytest.mark.parametrize("noise", ["scatter", "process"])
def test_growth_and_other_noise(warm, found, noise):
    """Estimates are those of the plain fit where scatter and the noise of wear are next to none."""
    tables = warm({"offset": {}, "thermal": THERMAL})
    plain = found.to_dict()
    if noise == "scatter":
        tables["fit"]["parameters"][K] |= {"scatter": 1e-4}
    else:
        tables["fit"]["process"] = {"wear.lower": {"size": 1e-9}}
    other = rw.fit(tables, MPI.COMM_SELF).to_dict()
    for key, one in plain["parameters"].items():
        assert abs(other["parameters"][key]["estimate"] - one["estimate"]) < 0.1 * one["sd"]
    for test, one in plain["nuisance"].items():
        growth, same = (of["penetration"]["thermal"] for of in (one, other["nuisance"][test]))
        for entry, again in ((growth, same), (growth["time"], same["time"])):
            assert abs(again["estimate"] - entry["estimate"]) < 0.1 * entry["sd"]
            assert again["sd"] == pytest.approx(entry["sd"], rel=0.1)


def test_a_drift_is_much_like_growth(warm):
    tables = warm({"offset": {}, "drift": {}, "thermal": {"time": THERMAL["time"]}})
    for experiment in tables["experiment"]:
        experiment["data"][0]["exclude"] = [[3000.0, END]]
    (doubt, _) = (d for d in rw.fit(tables, MPI.COMM_SELF).doubts if d.code == "drift-or-growth")
    assert "2940 s" in doubt.text


def test_growth_with_friction_power_is_a_sum_over_steps():
    """Steps of load and speed: 40, 80 and 20 of at most 80, and derivatives by the time."""
    loads, speeds = [[3000.0, 40.0], [3000.001, 80.0]], [[5000.0, 1.0], [5000.001, 0.25]]
    case = rw.read_case(PAPER, {"load.pressure": loads, "load.omega": speeds})
    t, nuisance = np.linspace(0.0, END, 97), Nuisance("thermal", power=True)
    expected = sum(
        share * -np.expm1(-np.maximum(t - start, 0.0) / TIME)
        for share, start in ((0.5, 0.0), (0.5, 3000.0), (-0.75, 5000.0))
    )
    (_, by_time), (here, _), low, high = (
        growth(nuisance, case, t, TIME + d) for d in (0.0, 0.0, -1.0, 1.0)
    )
    assert here == pytest.approx(expected, abs=1e-6)
    assert by_time == pytest.approx((high[0] - low[0]) / 2.0, rel=1e-5, abs=2e-9)


def test_growth_with_friction_power_is_recovered(tmp_path):
    """A load that is doubled half way: a rig that is cold but once does not explain it."""
    loads = [[3600.0, 40.0], [3610.0, 80.0]]
    times = np.linspace(END / READINGS, END, READINGS)
    run = history(loads, end=END, **{"load.omega": OMEGA})
    t, z = penetration(run, np.random.default_rng(3), times, 1e-3, 0.0)
    grown = sum(0.5 * -np.expm1(-np.maximum(t - s, 0.0) / TIME) for s in (0.0, 3605.0))
    (tmp_path / "case.toml").write_text(CASE)
    thermal = {**THERMAL, "power": True}
    data = record(
        tmp_path / "z.csv", t, z - 6e-3 * grown, nuisance={"offset": {}, "thermal": thermal}
    )
    more = {"load.omega": OMEGA, "time.end": END, "wear.lower.p0": TRUTH["wear.lower.p0"]}
    tables = fit_tables(tmp_path, [one_test("a", loads, data, **more)])
    del tables["fit"]["parameters"]["wear.lower.p0"]
    found = rw.fit(tables, MPI.COMM_SELF)
    assert found.p_value > 0.01
    (k,) = found.parameters
    assert abs(k.estimate - TRUTH[K]) < 2.0 * k.sd < 0.3 * TRUTH[K]
    of_rig = found.to_dict()["nuisance"]["a"]["penetration"]["thermal"]
    assert abs(of_rig["estimate"] + 6.0) < 2.0 * of_rig["sd"] < 2.0
    thermal["power"] = False
    assert rw.fit(tables, MPI.COMM_SELF).chi2 > found.chi2 + 10.0


@pytest.mark.parametrize("nuisance", ["thermal", "offset"])
def test_growth_that_outweighs_the_wear_is_no_wrong_sign(warm, nuisance):
    known = {"offset": {}} | (
        {"thermal": {"time": THERMAL["time"]}} if nuisance == "thermal" else {}
    )
    problem = read_fit(warm(known, growth=-60.0))
    misfit = Misfit(problem, Histories(problem, MPI.COMM_SELF))
    start = misfit.with_best_nuisances(list(problem.start.values()))
    if nuisance == "offset":
        with pytest.raises(rw.InputError, match=r"40 MPa.*wrong sign"):
            refuse_reversed(misfit, start)
        for experiment in problem.experiments:  # in total they rise
            experiment.series[0].value[-1] = 1.0
    refuse_reversed(misfit, start)
