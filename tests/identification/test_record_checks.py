"""Signs of readings that cannot be, keys to which nothing responds, parts that oppose the model."""

import copy

import numpy as np
import pytest
from laboratory import PEN, PROF, changed, write_table

import ringwear_par as rw
from ringwear_par.identification.definition.fit_file import read_fit
from ringwear_par.identification.estimation.misfit import Misfit
from ringwear_par.identification.estimation.record_checks import refuse_reversed
from ringwear_par.identification.fit import expected_result, fit
from ringwear_par.identification.model.histories import Histories


@pytest.mark.parametrize("entry", [PEN, PROF])
def test_wrong_signs(entry, good, tmp_path, comm):
    data = good["experiment"][0]["data"][entry[-1]]
    names = tuple(data["columns"].values())
    x, y = np.genfromtxt(data["file"], delimiter=",", skip_header=1).T
    write_table(tmp_path / "a.csv", names, x, -y)
    with pytest.raises(rw.InputError, match="wrong sign"):
        fit(changed(good, (*entry, "file"), str(tmp_path / "a.csv")), comm)


def test_a_key_to_which_nothing_responds(good, comm):
    """But for the pressure at the edges, which exceeds every threshold a little."""
    tables = copy.deepcopy(good)
    tables["experiment"] = tables["experiment"][:1]
    tables["experiment"][0]["set"]["wear.lower.p0"] = 300.0
    del tables["fit"]["parameters"]["wear.lower.p0"]
    with pytest.raises(rw.InputError, match=r"respond to wear.lower.k"):
        fit(tables, comm)
    tables["experiment"][0]["set"]["wear.lower.p0"] = 25.0
    start = {"start": 1e-11, "bounds": [1e-12, 1e-5], "scale": "log"}
    tables["fit"]["parameters"]["wear.lower.k"] = start
    found = expected_result(read_fit(tables), comm)  # hardly at the start, but elsewhere
    assert found.parameters[0].sd > 0


def test_a_drift_that_outweighs_the_wear_is_no_wrong_sign(good, tmp_path, comm):
    data = good["experiment"][0]["data"][0]
    t, z = np.genfromtxt(data["file"], delimiter=",", skip_header=1).T
    write_table(tmp_path / "z.csv", tuple(data["columns"].values()), t, z - 4.0 * z.max() * t / 100)
    tables = changed(good, (*PEN, "file"), str(tmp_path / "z.csv"))
    prior = {"prior": {"normal": [-4.0 * z.max(), z.max()]}}
    tables["experiment"][0]["data"][0]["nuisance"]["drift"] = prior
    for known in (prior, {}):
        tables["experiment"][0]["data"][0]["nuisance"]["drift"] = known
        problem = read_fit(tables)
        misfit = Misfit(problem, Histories(problem, comm))
        refuse_reversed(misfit, misfit.with_best_nuisances(list(problem.start.values())))


def test_a_part_that_opposes_the_model_is_a_doubt(good, tmp_path, comm):
    """Rings that grow warm: beside a drift, a fall at first is most of what is left of a rise."""
    data = good["experiment"][0]["data"][0]
    t, z = np.genfromtxt(data["file"], delimiter=",", skip_header=1).T
    write_table(tmp_path / "z.csv", tuple(data["columns"].values()), t, z + 4.0 * np.exp(-t / 4.0))
    tables = changed(good, (*PEN, "file"), str(tmp_path / "z.csv"))
    table = tables["experiment"][0]["data"][0]
    table["nuisance"] = {"offset": {}, "drift": {}}
    found = fit(tables, comm)
    (doubt,) = (one for one in found.doubts if one.code == "readings-oppose")
    first, last = doubt.values["exclude"]
    assert first == 0.0
    assert 4.0 <= last <= 30.0
    assert doubt.experiments == ("test 1",)
    table["exclude"] = [[first, last]]
    assert not any(one.code == "readings-oppose" for one in fit(tables, comm).doubts)


def test_a_torque_that_falls_is_no_wrong_sign(good, tmp_path, comm):
    t = np.linspace(1.0, 100.0, 50)
    write_table(tmp_path / "m.csv", ("time", "value"), t, -10.0 - np.sin(t))
    tables = copy.deepcopy(good)
    tables["experiment"][0]["data"].append(
        {
            "quantity": "torque",
            "file": str(tmp_path / "m.csv"),
            "units": {"value": "N m"},
            "sd": 0.1,
        }
    )
    problem = read_fit(tables)
    misfit = Misfit(problem, Histories(problem, comm))
    refuse_reversed(misfit, misfit.with_best_nuisances(list(problem.start.values())))
