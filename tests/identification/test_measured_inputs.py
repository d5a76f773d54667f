"""Fits of tests whose friction, load or speed the rig has measured."""

import copy

import numpy as np
import pytest
from laboratory import (
    END,
    FITTED,
    TRUTH,
    fit_tables,
    history,
    write_table,
    write_tests,
)
from mpi4py import MPI

import ringwear_par as rw
from ringwear_par.identification.definition.fit_file import read_fit

K, MU = "wear.lower.k", "contact.friction"
FRICTION = [[0.0, 0.06], [20.0, 0.1], [50.0, 0.12], [END, 0.12]]
INPUT = {"key": MU, "quantity": "torque", "columns": {"time": "t_s", "value": "m_Nm"}}


def write_measured(folder, truth, pressures):
    """Return the fit file, as a dict, of tests without noise whose torques are measured."""
    experiments = write_tests(folder, pressures, None, truth=truth, **{MU: FRICTION})
    for number, experiment in enumerate(experiments, start=1):
        result = history(experiment["set"]["load.pressure"], truth, **{MU: FRICTION})
        t = np.linspace(0.0, END, 400)
        torque = np.interp(t, result.histories["time"], result.histories["torque"])
        write_table(folder / f"m{number}.csv", ("t_s", "m_Nm"), t, 1e-3 * torque)
        experiment["input"] = [{**INPUT, "file": str(folder / f"m{number}.csv"), "smooth": "none"}]
        experiment["set"]["wear.lower.p0"] = truth["wear.lower.p0"]
        experiment["data"][0]["nuisance"]["drift"] = {"prior": {"normal": [0.3, 0.1]}}
        del experiment["data"][1]
    tables = fit_tables(folder, experiments)
    tables["fit"]["parameters"] = {K: FITTED[K]}
    return tables


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """A folder, and the fit file of two tests."""
    folder = tmp_path_factory.mktemp("measured")
    return folder, write_measured(folder, TRUTH, (40.0, 85.0))


@pytest.fixture
def tables(written):
    """Their fit file as a dict."""
    return copy.deepcopy(written[1])


def test_a_torque_that_is_no_friction_is_doubted(tables, written, caplog):
    """Of readings in kN m."""
    t, rng = np.linspace(0.0, END, 300), np.random.default_rng(2)
    noisy = (10.0 - 4.0 * np.exp(-t / 20.0)) * (1.0 + 0.02 * rng.standard_normal(300))
    torque = tables["experiment"][0]["input"][0]
    torque["file"] = str(written[0] / "noisy.csv")
    for unit, sentences in ((1.0, 0), (1e-3, 1)):
        write_table(written[0] / "noisy.csv", ("t_s", "m_Nm"), t, unit * noisy)
        read_fit(tables)
        assert ["a friction of" in sentence for sentence in caplog.messages] == [True] * sentences


@pytest.mark.slow
def test_friction_is_that_of_the_torque_at_the_radius_of_the_history(tables):
    """Without noise it is the true one; at the nominal mean radius it is a thousandth off."""
    t = np.linspace(0.0, END, 50)
    true = np.interp(t, *np.transpose(FRICTION))
    nominal = read_fit(tables).experiments[0].case.friction(t)
    assert 3e-4 < np.abs(nominal / true - 1.0).max() < 2e-2
    found = rw.fit(tables, MPI.COMM_SELF)
    k = found.parameters[K]
    assert abs(k["estimate"] - TRUTH[K]) < 0.15 * k["sd"]
    for inputs in found.to_dict()["inputs"].values():
        time, value = (np.array(inputs[MU][name]) for name in ("time", "value"))
        np.testing.assert_allclose(np.interp(t, time, value), true, rtol=1e-4)


@pytest.mark.slow
def test_a_calibration_widens_the_interval_by_its_own_uncertainty(tmp_path):
    """Without threshold k mu counts: the variance of log k gains that of log mu."""
    plain = write_measured(tmp_path, {**TRUTH, "wear.lower.p0": 0.0}, (85.0,))
    scaled = copy.deepcopy(plain)
    scaled["experiment"][0]["input"][0]["scale"] = {"prior": {"normal": [1.1, 0.03]}}
    exact, found = (rw.fit(tables, MPI.COMM_SELF) for tables in (plain, scaled))
    before, after = exact.parameters[K], found.parameters[K]
    relative = [k["sd"] / k["estimate"] for k in (before, after)]
    assert relative[1] == pytest.approx(np.hypot(relative[0], 0.03 / 1.1), rel=0.06)
    scale = found.to_dict()["inputs"]["test 1"][MU]["scale"]
    assert scale["sd"] == pytest.approx(0.03, rel=0.1)
    assert scale["estimate"] == pytest.approx(1.1, abs=0.01)
    # a calibration that is known to be off is taken so
    assert after["estimate"] / before["estimate"] == pytest.approx(1.0 / 1.1, rel=5e-3)


def test_measured_loads_and_speeds_are_those_of_the_case(tables, written):
    folder, _ = written
    t = np.linspace(0.0, END, 60)
    write_table(folder / "f.csv", ("t_s", "p_bar"), t, 10.0 * np.full(60, 85.0))
    write_table(folder / "w.csv", ("t_min", "n_rpm"), t / 60.0, np.full(60, 30.0))
    tables["experiment"][1]["set"] = {"time.end": END, "wear.lower.p0": 25.0}
    tables["experiment"][1]["input"] += [
        {"key": "load.pressure", "file": str(folder / "f.csv"),
         "columns": {"time": "t_s", "value": "p_bar"}},
        {"key": "load.omega", "file": str(folder / "w.csv"),
         "columns": {"time": "t_min", "value": "n_rpm"}},
    ]  # fmt: skip
    case = read_fit(tables).experiments[1].case
    assert case.load.force(50.0) == pytest.approx(85.0 * case.area)
    assert case.load.omega(50.0) == pytest.approx(np.pi)
    assert case.friction(60.0) == pytest.approx(0.12, rel=5e-3)
