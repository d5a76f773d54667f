"""Fits of tests whose wear is itself random: k, the size, what is smoothed, what is refused."""

import copy
import json

import h5py
import numpy as np
import pytest
from laboratory import (
    CASE,
    END,
    TRUTH,
    ZERO_AND_DRIFT,
    fit_tables,
    history,
    one_test,
    record,
)
from mpi4py import MPI

import ringwear_par as rw
from ringwear_par.identification.definition.fit_file import read_fit
from ringwear_par.identification.definition.problem import ProcessNoise
from ringwear_par.identification.estimation.misfit import Misfit
from ringwear_par.identification.model.histories import Histories

TESTS, SHARE, BODY = 3, 0.05, "wear.lower"


@pytest.fixture(scope="module")
def tables(tmp_path_factory):
    """Records and weighings of repeats whose clocks run at random."""
    folder = tmp_path_factory.mktemp("random")
    (folder / "case.toml").write_text(CASE)
    experiments = write_experiments(folder)
    return fit_tables(folder, experiments, process={BODY: "fit"})


def write_experiments(folder):
    rng, experiments = np.random.default_rng(12), []
    result = history(80.0, end=1.5 * END)
    there, worn = (result.histories[name] for name in ("time", "worn_volume_lower"))
    area = np.pi * (31.5**2 - 28.5**2)
    depth = np.interp(END, there, worn) / area
    for number in range(1, TESTS + 1):
        size, times = SHARE**2 * depth, np.linspace(2.0, END, 80)
        clock = np.cumsum(rng.gamma(depth / 80 / size, size, 80))  # at each reading
        ran = np.interp(clock, worn / area, there)
        z = np.interp(ran, there, result.histories["penetration"])
        z += 1e-3 * (0.3 * number + 0.2 * rng.standard_normal(80))
        mass = 7.8e-3 * float(np.interp(ran[-1], there, worn))
        data = record(folder / f"z{number}.csv", times, z, nuisance=copy.deepcopy(ZERO_AND_DRIFT))
        weighing = {
            "quantity": "mass.lower", "value": 1e3 * mass, "unit": "mg", "density": 7.8e-3,
            "sd": 0.1,
        }  # fmt: skip
        known = {"wear.lower.p0": 25.0}
        experiments.append(one_test(f"test {number}", 80.0, data, weighing, **known))
    return experiments


def of_k(tables, process="fit", tests=TESTS):
    """Return a fit file of k alone, with another process and fewer tests."""
    changed = copy.deepcopy(tables)
    del changed["fit"]["parameters"]["wear.lower.p0"]
    changed["fit"]["process"] = {BODY: process}
    changed["experiment"] = changed["experiment"][:tests]
    return changed


def test_k_and_the_size_of_wear_s_noise(tables, tmp_path, comm):
    fit = rw.fit(of_k(tables), comm)
    outcome = fit.to_dict()
    k, process = outcome["parameters"]["wear.lower.k"], outcome["process"][BODY]
    assert (k["of"], k["interval_of"]) == ("specimens", "process integrated")
    low, high = k["interval"]
    assert low < TRUTH["wear.lower.k"] < high
    # three shares of 5 % average to 2.9 %; readings alone tell 0.5 %
    assert 0.03 < np.log(high / low) / 2 < 0.09
    assert process["verdict"] == "identified"
    assert process["share"]["interval"][0] < SHARE < process["share"]["interval"][1]
    sizes = np.array([process["size"]["estimate"], *process["size"]["interval"]])
    shares = np.array([process["share"]["estimate"], *process["share"]["interval"]])
    assert sizes == pytest.approx(shares**2 * process["depth"])
    # the random part is in the model's readings, so that none of these doubts are
    assert outcome["doubts"] == []
    assert outcome["p_value"] > 1e-3
    assert len(set(comm.allgather(json.dumps(outcome["parameters"])))) == 1
    fit.save(tmp_path / "fit")
    assert not (tmp_path / "fit" / "specimens.png").exists()
    with h5py.File(tmp_path / "fit" / "results.h5") as file:
        excess, sd = (file["1_penetration"][f"excess_lower{end}"][()] for end in ("", "_sd"))
    assert np.abs(excess).max() > 3e-5
    assert (sd < 0.1 * SHARE).all()
    assert "wear of lower fluctuates: sd " in fit.summary()


def test_a_size_that_is_known_and_one_test(tables):
    one = rw.fit(of_k(tables, {"share": SHARE}, tests=1), MPI.COMM_SELF).to_dict()
    k = one["parameters"]["wear.lower.k"]
    assert np.log(k["interval"][1] / k["interval"][0]) == pytest.approx(4 * SHARE, rel=0.2)
    size = one["process"][BODY]["size"]["known"]
    again = rw.fit(of_k(tables, {"size": f"{1e6 * size} nm"}, tests=1), MPI.COMM_SELF).to_dict()
    assert again["parameters"]["wear.lower.k"]["sd"] == pytest.approx(k["sd"], rel=1e-6)
    # next to none: the fit of the sensors' noise
    none = of_k(tables, {"share": 1e-6})
    plain = of_k(tables)
    del plain["fit"]["process"]
    known, common = (rw.fit(each, MPI.COMM_SELF).to_dict() for each in (none, plain))
    for key in ("estimate", "sd"):
        assert known["parameters"]["wear.lower.k"][key] == pytest.approx(
            common["parameters"]["wear.lower.k"][key], rel=1e-4
        )
    assert known["chi2"] == pytest.approx(common["chi2"], rel=1e-5)
    assert known["degrees_of_freedom"] == pytest.approx(common["degrees_of_freedom"], abs=1e-3)
    assert known["aic"] == pytest.approx(common["aic"], abs=0.05)
    assert "tests-disagree" in [doubt["code"] for doubt in common["doubts"]]


def test_noise_of_sensors_is_fitted_beside_it(tables):
    guessed = of_k(tables)
    for experiment in guessed["experiment"]:
        experiment["data"][0]["sd"] = "fit"
    outcome = rw.fit(guessed, MPI.COMM_SELF).to_dict()
    fitted = [series["penetration"]["sd"] for series in outcome["experiments"].values()]
    assert fitted == pytest.approx([0.2] * TESTS, rel=0.3)
    share = outcome["process"][BODY]["share"]["interval"]
    assert share[0] < SHARE < share[1]


def test_a_free_drift_hides_k(tables):
    hidden = of_k(tables, tests=2)
    experiment, torque = hidden["experiment"]
    torque["data"] = [{"quantity": "torque", "value": 300.0, "unit": "N m", "sd": 300.0, "at": 9}]
    del experiment["data"][1]
    experiment["data"][0]["nuisance"]["drift"] = {}
    k = rw.fit(hidden, MPI.COMM_SELF).to_dict()["parameters"]["wear.lower.k"]
    assert (k["verdict"], k["interval"]) == ("not identified", [None, None])
    assert k["direction"] == "wear.lower.k against drift of penetration (test 1)"


@pytest.mark.parametrize(
    "law",
    [
        {"law": "archard", "k": 1e-8},
        {"law": "power", "k": 1e-9, "m": 1.4},
        {"law": "non-local", "k": 1e-8, "length": 0.5},
        {"law": "running-in", "k": 1e-8, "k_start": 3e-8, "distance": 3000.0},
    ],
    ids=lambda law: law["law"],
)  # fmt: skip
def test_answers_to_a_factor_on_all_rates(tables, law):
    """They are those to all factors of a law together, also where both bodies wear."""
    rates = [name for name in law if name.startswith("k")]
    both = of_k(tables, tests=1)
    both["experiment"][0]["set"] = {
        "load.pressure": 80.0, "load.omega": 3.5, "time.end": END,
        **{f"wear.{body}.{name}": v for body in ("lower", "upper") for name, v in law.items()
           if name not in rates},
    }  # fmt: skip
    keys = [f"wear.{body}.{name}" for body in ("upper", "lower") for name in rates]
    both["fit"]["parameters"] = {
        key: {"start": law[key.rpartition(".")[2]], "bounds": [1e-12, 1e-5]} for key in keys
    }
    both["fit"]["process"] = {"wear.upper": "fit", "wear.lower": {"share": 0.1}}
    both["experiment"][0]["data"][1]["quantity"] = "mass.upper"
    problem = read_fit(both)
    assert problem.settings.process["wear.lower"] == ProcessNoise(share=0.1)
    misfit = Misfit(problem, Histories(problem, MPI.COMM_SELF))
    x = problem.unknowns(list(problem.start.values()))
    answers, depths = misfit.clocks(x)
    values = misfit.values(x)
    by_key = misfit.columns(x)[:, : len(keys)] * values
    for body, name in enumerate(problem.settings.process):
        of_body = [j for j, key in enumerate(keys) if key.startswith(f"{name}.")]
        assert answers[:, body] * depths[:, body] == pytest.approx(
            by_key[:, of_body].sum(axis=1), rel=1e-9
        )
    mass = misfit.model_readings(x)[-1]
    area = np.pi * (31.5**2 - 28.5**2)
    assert depths[-1, list(problem.settings.process).index("wear.upper")] == pytest.approx(
        mass / 7.8e-3 / area
    )


def test_readings_that_cannot_tell_it_are_refused(tables):
    slow = of_k(tables)
    slow["experiment"][0]["data"][0]["correlation_time"] = 20.0
    with pytest.raises(rw.InputError, match="noise"):
        read_fit(slow)
    limit = of_k(tables, tests=1)
    limit["experiment"][0]["data"][1]["censored"] = "below"
    with pytest.raises(rw.InputError, match="censored"):
        read_fit(limit)
    torque = of_k(tables, tests=1)
    torque["experiment"][0]["data"] = [
        {"quantity": "torque", "value": 1.0, "unit": "N m", "sd": 0.1, "at": at} for at in (1, 2)
    ]
    with pytest.raises(rw.InputError, match="no reading"):
        read_fit(torque)
