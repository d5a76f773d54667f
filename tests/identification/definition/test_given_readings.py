"""Readings that a fit file names: columns and units, times, noise, and signs that cannot be."""

import copy

import numpy as np
import pytest
from laboratory import PEN, PROF, changed, write_table

from ringwear_par.errors import InputError
from ringwear_par.identification.definition.fit_file import read_fit
from ringwear_par.identification.estimation.misfit import Misfit
from ringwear_par.identification.estimation.record_checks import refuse_reversed
from ringwear_par.identification.fit import expected_result, fit
from ringwear_par.identification.model.histories import Histories
from ringwear_par.identification.summary import prediction


def test_times_that_end_long_before_the_test(good, tmp_path):
    """Minutes that are read as seconds: a warning of the dry run and of the fit."""
    times = np.linspace(0.1, 5.0 / 3.0, 50)
    write_table(tmp_path / "z.csv", ("t", "z_um"), times, times)
    tables = changed(good, (*PEN, "file"), str(tmp_path / "z.csv"))
    tables["experiment"][0]["data"][0]["columns"] = {"time": "t", "value": "z_um"}
    (sentence,) = read_fit(tables).experiments[0].series[0].suspicions
    assert "1.667 s" in sentence
    tables["experiment"][0]["data"][0]["units"] = {"time": "min"}
    series = read_fit(tables).experiments[0].series[0]
    assert series.assumptions == series.suspicions == ()


def test_the_same_readings_twice(good):
    tables = copy.deepcopy(good)
    data = tables["experiment"][0]["data"]
    with pytest.raises(InputError, match="readings of"):
        read_fit(changed(good, ("experiment", 1, "data", 0, "file"), data[0]["file"]))
    data.append({**data[0], "sd": 0.3, "exclude": [[0, 50]]})
    with pytest.raises(InputError, match="twice"):
        read_fit(tables)
    data[0]["exclude"] = [[50, 100]]
    assert len(read_fit(tables).experiments[0].series) == 3  # parts of one record


@pytest.mark.parametrize(
    ("hour", "minute", "end", "first", "said"),
    [
        (0, 0, 100.0, 0.0, ""),
        (0, 2, 100.0, 0.0, "0:02:00, after the end"),
        (8, 0, 36e3, 28800.0, "8:00:00, taken as elapsed"),
    ],
)  # fmt: skip
def test_times_of_day_are_told(hour, minute, end, first, said, good, tmp_path):
    """Clock times that begin after the end of the test; others have elapsed."""
    rows = [f"{hour}:{minute + i // 60:02d}:{i % 60:02d};{0.1 * i}" for i in range(0, 100, 2)]
    path = tmp_path / "z.csv"
    path.write_text("\n".join(["t;z_um", *rows, "OVL;OVL"]))
    tables = changed(good, (*PEN, "file"), str(path))
    tables["experiment"][0]["data"][0] |= {
        "columns": {"time": "t", "value": "z_um"}, "drop": ["OVL"],
    }  # fmt: skip
    tables["experiment"][0]["set"]["time.end"] = end
    series = read_fit(tables).experiments[0].series[0]
    assert series.x[[0, -1]] == pytest.approx([first, first + 98.0])
    assert [said in sentence for sentence in series.suspicions] == [True] * bool(said)


def test_what_is_taken_for_a_unit_is_told(good, tmp_path, comm):
    data = good["experiment"][0]["data"][0]
    x, y = np.genfromtxt(data["file"], delimiter=",", skip_header=1).T

    def assumptions(t, z, scale=1.0, **units):
        write_table(tmp_path / "z.csv", (t, z), scale * x, 1e-3 * y)
        tables = changed(good, (*PEN, "file"), str(tmp_path / "z.csv"))
        columns = {"columns": {"time": t, "value": z}, "units": units}
        tables["experiment"][0]["data"][0] |= columns
        problem = read_fit(tables)
        assert problem.experiments[0].series[0].x == pytest.approx(x)
        return tables, problem.experiments[0].series[0].assumptions

    said = ("the column t names no unit; s is taken", "the column z names no unit; mm is taken")
    assert assumptions("t", "z")[1] == said
    assert assumptions("t_s", "z_mm")[1] == ()
    assert assumptions("t / min", "z / mm", 1.0 / 60.0)[1] == ()
    assert assumptions("t", "z", 1.0 / 60.0, time="min")[1] == said[1:]
    assert assumptions("t", "z", time="s", value="mm")[1] == ()
    tables, _ = assumptions("t", "z_mm")
    found = fit(tables, comm)
    sentence = f"penetration (test 1): {said[0]}"
    assert sentence in [doubt["text"] for doubt in found.to_dict()["doubts"]]
    assert f"warning: {sentence}" in found.summary()
    assert f"warning: {sentence}" in prediction(expected_result(read_fit(tables), comm))
    with pytest.raises(InputError, match="in min"):
        assumptions("t / min", "z / mm", time="s")


@pytest.mark.parametrize("entry", [PEN, PROF])
def test_wrong_signs(entry, good, tmp_path, comm):
    data = good["experiment"][0]["data"][entry[-1]]
    names = tuple(data["columns"].values())
    x, y = np.genfromtxt(data["file"], delimiter=",", skip_header=1).T
    write_table(tmp_path / "a.csv", names, x, -y)
    with pytest.raises(InputError, match="wrong sign"):
        fit(changed(good, (*entry, "file"), str(tmp_path / "a.csv")), comm)


def test_a_key_to_which_nothing_responds(good, comm):
    """But for the pressure at the edges, which exceeds every threshold a little."""
    tables = copy.deepcopy(good)
    tables["experiment"] = tables["experiment"][:1]
    tables["experiment"][0]["set"]["wear.lower.p0"] = 300.0
    del tables["fit"]["parameters"]["wear.lower.p0"]
    with pytest.raises(InputError, match=r"respond to wear.lower.k"):
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


def test_a_part_that_opposes_the_model_is_told(good, tmp_path, comm):
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
    assert f"exclude = [[0, {last:g}]]" in doubt.text
    table["exclude"] = [[first, last]]
    assert not any(one.code == "readings-oppose" for one in fit(tables, comm).doubts)


def test_readings_that_are_left_out_are_not_counted(good):
    tables = copy.deepcopy(good)
    tables["experiment"][0]["data"][0] |= {"sd": "fit", "exclude": [[0.0, 85.0]]}
    with pytest.raises(InputError, match="9 readings"):
        read_fit(tables)
    tables["experiment"][0]["data"][0]["exclude"] = [[0.0, 81.0]]
    assert read_fit(tables).experiments[0].series[0].n == 10


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
