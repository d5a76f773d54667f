"""Readings that a fit file names: columns and units, times, times of day."""

import numpy as np
import pytest
from laboratory import PEN, changed, write_table

from ringwear_par.identification.definition.fit_file import read_fit


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


@pytest.mark.parametrize(
    ("hour", "minute", "end", "first", "suspicion"),
    [
        (0, 0, 100.0, 0.0, ""),
        (0, 2, 100.0, 0.0, "after the end"),
        (8, 0, 36e3, 28800.0, ""),
    ],
)  # fmt: skip
def test_times_of_day(hour, minute, end, first, suspicion, good, tmp_path):
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
    assert [suspicion in one for one in series.suspicions] == [True] * bool(suspicion)


def test_a_unit_that_is_assumed_is_named(good, tmp_path):
    data = good["experiment"][0]["data"][0]
    x, y = np.genfromtxt(data["file"], delimiter=",", skip_header=1).T

    def assumptions(t, z, scale=1.0, **units):
        write_table(tmp_path / "z.csv", (t, z), scale * x, 1e-3 * y)
        tables = changed(good, (*PEN, "file"), str(tmp_path / "z.csv"))
        columns = {"columns": {"time": t, "value": z}, "units": units}
        tables["experiment"][0]["data"][0] |= columns
        problem = read_fit(tables)
        assert problem.experiments[0].series[0].x == pytest.approx(x)
        return problem.experiments[0].series[0].assumptions

    of_time, of_depth = assumptions("t", "z")
    assert "column t" in of_time
    assert "s is taken" in of_time
    assert "mm is taken" in of_depth
    assert assumptions("t_s", "z_mm") == ()
    assert assumptions("t / min", "z / mm", 1.0 / 60.0) == ()
    assert assumptions("t", "z", 1.0 / 60.0, time="min") == (of_depth,)
    assert assumptions("t", "z", time="s", value="mm") == ()
