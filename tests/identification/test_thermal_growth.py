"""Fits of records of rigs that warm up."""

import copy

import numpy as np
import pytest
from laboratory import (
    CASE,
    SD_PENETRATION,
    TRUTH,
    fit_tables,
    history,
    one_test,
    penetration,
    record,
)
from mpi4py import MPI
from parts import StopSignals

import ringwear_par as rw
from ringwear_par.identification.definition.fit_file import read_fit
from ringwear_par.identification.histories import Readings
from ringwear_par.identification.record_checks import refuse_unfit

K, P0 = "wear.lower.k", "wear.lower.p0"
#: s, um; and the record's end and number of readings
TIME, GROWTH = 1500.0, -6.0
END, READINGS = 7200.0, 80
OMEGA = 3.5 * 100.0 / END
THERMAL = {"time": {"start": "20 min", "bounds": ["2 min", "3 h"],
                    "prior": {"normal": ["25 min", "8 min"]}}}  # fmt: skip
#: a load that is doubled half way, and the times at which the rig is heated
LOADS, HEATED = [[3600.0, 40.0], [3610.0, 80.0]], (0.0, 3605.0)


@pytest.fixture(scope="module")
def wear():
    """Times (s) and penetrations (mm) without growth and noise."""
    times = np.linspace(END / READINGS, END, READINGS)
    return penetration(history(LOADS, end=END, **{"load.omega": OMEGA}), None, times, 1e-3, 0.0)


@pytest.fixture(scope="module")
def warm(wear, tmp_path_factory):
    """Function that makes a fit file of k of a test on a warm rig, with some nuisances."""
    folder = tmp_path_factory.mktemp("warm")
    (folder / "case.toml").write_text(CASE)

    def made(nuisance, size=GROWTH):
        t, z = wear
        grown = sum(0.5 * -np.expm1(-np.maximum(t - s, 0.0) / TIME) for s in HEATED)
        noise = SD_PENETRATION * np.random.default_rng(3).standard_normal(len(t))
        path = folder / f"{size:g}.csv"
        data = record(path, t, z + 1e-3 * size * grown + noise, nuisance=copy.deepcopy(nuisance))
        known = {"load.omega": OMEGA, "time.end": END, P0: TRUTH[P0]}
        tables = fit_tables(folder, [one_test("a", LOADS, data, **known)])
        del tables["fit"]["parameters"][P0]
        return tables

    return made


@pytest.mark.slow
def test_growth_with_friction_power_is_no_wear(warm):
    thermal = {"offset": {}, "thermal": {**THERMAL, "power": True}}
    found = rw.fit(warm(thermal), MPI.COMM_SELF)
    k = found.parameters[K]
    assert abs(k["estimate"] - TRUTH[K]) < 2.5 * k["sd"] < 0.3 * TRUTH[K]
    assert found.content["p_value"] > 0.01
    of_rig = found.to_dict()["nuisance"]["a"]["penetration"]["thermal"]
    assert abs(of_rig["estimate"] - GROWTH) < 3.0 * of_rig["sd"] < 3.0
    assert abs(of_rig["time"]["estimate"] - TIME) < 3.0 * of_rig["time"]["sd"]
    assert of_rig["time"]["sd"] < 450.0  # of the prior: 480


@pytest.mark.slow
def test_a_drift_is_much_like_growth(warm):
    tables = warm({"offset": {}, "drift": {}, "thermal": {"time": THERMAL["time"]}})
    tables["experiment"][0]["data"][0]["exclude"] = [[3000.0, END]]
    (doubt,) = (d for d in rw.fit(tables, MPI.COMM_SELF).doubts if d.code == "drift-or-growth")
    assert "drift" in doubt.text


@pytest.mark.parametrize("nuisance", ["thermal", "offset"])
def test_growth_that_outweighs_the_wear_is_no_wrong_sign(warm, nuisance):
    known = {"offset": {}} | ({"thermal": THERMAL} if nuisance == "thermal" else {})
    problem = read_fit(warm(known, -150.0))
    with StopSignals() as signals:
        readings = Readings(problem, MPI.COMM_SELF, signals)
        if nuisance == "offset":
            with pytest.raises(rw.InputError, match=r"wrong sign"):
                refuse_unfit(readings)
            problem.experiments[0].series[0].value[-1] = 1.0  # in total it rises
        refuse_unfit(readings)
