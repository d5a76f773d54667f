"""Signs of readings that cannot be, and parts that oppose the model."""

import numpy as np
import pytest
from laboratory import write_table
from mpi4py import MPI
from parts import StopSignals

from ringwear_par.identification.definition.fit_file import read_fit
from ringwear_par.identification.histories import Readings
from ringwear_par.identification.record_checks import refuse_unfit, trend


def test_a_drift_that_outweighs_the_wear_is_no_wrong_sign(tables, tmp_path):
    given = tables()
    data = given["experiment"][0]["data"][0]
    t, z = np.genfromtxt(data["file"], delimiter=",", skip_header=1).T
    write_table(tmp_path / "z.csv", tuple(data["columns"].values()), t, z - 4.0 * z.max() * t / 100)
    data["file"] = str(tmp_path / "z.csv")
    prior = {"prior": {"normal": [-4.0 * z.max(), z.max()]}}
    for known in (prior, {}):
        data["nuisance"]["drift"] = known
        refuse_unfit(Readings(read_fit(given), MPI.COMM_SELF, StopSignals()))


def test_trends_are_no_noise():
    random, x = np.random.default_rng(1), np.linspace(0.0, 1.0, 200)
    alarms = np.mean([trend(random.standard_normal(200)) < 0.05 for _ in range(1000)])
    assert alarms == pytest.approx(0.05, abs=0.025)
    assert trend(random.standard_normal(200) + 2.0 * x) < 1e-4
    assert trend(0.01 * x) < 1e-4
    assert trend(0.01 * x, least=1.0) == pytest.approx(1.0)
    assert trend(5.0 * x[:20]) == 1.0  # too few to tell
