"""Sweeps of coated rings and of cases with [stress]: what is stored is that of single runs."""

import numpy as np
import pytest
from mpi4py import MPI
from swept import CASE, table, write_study

import ringwear_par as rw

LAYER = """
[[lower.layers]]
thickness = 0.004
young = 50e3
poisson = 0.3
wear = { law = "threshold", k = 4e-6 }

[stress]
points = [[30.0, 19.999], [30.0, 19.95], [29.0, 20.0, "above"]]
grid = { body = "lower", r = [29.0, 31.0], z = [19.8, 19.95], n = [3, 2] }
"""
COATED = CASE.replace("steps = 20", "steps = 8").replace("p0 = 40.0", "p0 = 4.0") + LAYER
STUDY = """
[vary]
"lower.layers[0].thickness" = { log = [0.002, 0.04], count = 4 }
"load.pressure" = { linear = [40, 80], count = 6 }
[design]
method = "grid"
"""
ROWS = ("max_mises", "max_mises_r", "max_mises_z", "max_mises_layer")


def singles(folder, stride=1):
    """Rows of a sweep's table and of its file, and each case of its study, computed alone."""
    rows, study = table(folder), rw.read_study(folder.parent / "study.toml")
    with rw.open_ensemble(folder) as data:
        for i in range(0, len(rows), stride):
            result = rw.simulate(study.case(i), MPI.COMM_SELF)
            yield rows[i], data.isel(case=i), result.to_xarray(), result


def assert_close(found, exact):
    """To the accuracy of contact within blocks."""
    most = 5e-4 * np.nanmax(np.abs(exact), initial=0.0)
    np.testing.assert_allclose(found, exact, rtol=5e-4, atol=most)


def check(row, mine, own):
    """Compare what is stored of a case, at the times that have it, and its row of the table."""
    count, at = int(mine.steps_stored), np.searchsorted(own.time, own.stress_time)
    for name in (*ROWS, "max_mises_lower_layers", "mises", "max_shear"):
        stored = mine[name].values[:count]
        assert_close(stored[at], own[name].values)
        assert np.isnan(np.delete(stored, at, axis=0)).all()
    layers = own.worn_volume_lower_layers.values
    assert_close(mine.worn_volume_lower_layers[:count], layers)
    ends = {name: own[name].values[-1] for name in (*ROWS, "share_through_lower")}
    ends |= {f"mises[{i}]": end for i, end in enumerate(own.mises.values[-1])}
    names = (f"worn_volume_lower_layers[{entry}]" for entry in (0, "body"))
    ends |= dict(zip(names, layers[-1], strict=True))
    ends |= {"least_layer_left_lower": own.layer_left_lower.values[-1].min()}
    ends |= {"time_through_lower": own.attrs["time_through_lower"]}
    for column, end in ends.items():
        assert float(row[column] or "nan") == pytest.approx(end, rel=1e-3, abs=1e-6, nan_ok=True)
    assert mine.point_side.values.tolist() == own.point_side.values.tolist() == ["", "", "above"]
    return bool(np.isfinite(ends["time_through_lower"]))


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    """The folder of a sweep of 24 cases over thickness and pressure."""
    folder = tmp_path_factory.mktemp("swept")
    rw.sweep(write_study(folder, MPI.COMM_SELF, STUDY, COATED), folder / "out", MPI.COMM_SELF)
    return folder / "out"


def test_stresses_and_layers_are_those_of_single_runs(swept):
    """Points in what is worn away are blank."""
    through = set()
    for row, mine, own, result in singles(swept, stride=5):
        through.add(check(row, mine, own))
        gone = bool(own.layer_left_lower[-1, result.line.element_at(np.array(30.0))] == 0.0)
        assert (row["mises[0]"] == "") == gone
    assert through == {True, False}


def test_stresses_at_some_times_are_those_of_single_runs(comm, tmp_path):
    study = STUDY.replace("count = 4", "count = 2").replace("count = 6", "count = 2")
    case = COATED + "times = [0.0, 5.0]\n"
    rw.sweep(write_study(tmp_path, comm, study, case), tmp_path / "out", comm)
    for row, mine, own, _ in singles(tmp_path / "out"):
        check(row, mine, own)


THIN = "{ thickness = 0.004, young = 5e4, poisson = 0.3 }"
SOFT = "{ thickness = 0.01, young = 2e4, poisson = 0.3, wear = { law = 'archard', k = 4e-6 } }"


def test_cases_may_have_different_numbers_of_layers(comm, tmp_path):
    """The body has a place of its own."""
    case = CASE.replace("steps = 20", "steps = 8") + "[stress]\npoints = [[30.0, 19.0]]\n"
    study = f'[vary]\n"lower.layers".values = [[], [{THIN}], [{THIN}, {SOFT}, {SOFT}]]\n'
    rw.sweep(write_study(tmp_path, comm, study, case), tmp_path / "out", comm)
    for layers, (row, mine, own, _) in zip((0, 1, 3), singles(tmp_path / "out"), strict=True):
        for name in ("worn_volume_lower_layers", "max_mises_lower_layers"):
            stored = mine[f"final_{name}"].values
            exact = own[name].values[-1] if layers else np.array([np.nan])
            assert_close(stored[[*range(layers), -1]], exact)
            assert np.isnan(stored[layers:-1]).all()
            in_table = [float(row[f"{name}[{n}]"] or "nan") for n in (0, 1, 2, "body")]
            np.testing.assert_array_equal(in_table, stored)


def test_surrogates_answer_for_stresses(swept):
    """But for what jumps from place to place, or what not all cases have."""
    made = rw.surrogate(swept)
    assert {"max_mises", "mises[1]", "worn_volume_lower_layers[body]"} <= made.responses.keys()
    assert not {"max_mises_z", "time_through_lower", "mises[0]"} & made.responses.keys()
    with rw.open_ensemble(swept) as data:
        at = {name: data[name].values for name in ("lower.layers[0].thickness", "load.pressure")}
        np.testing.assert_allclose(made.predict(at)["mises[1]"], data.final_mises[:, 1], rtol=1e-3)
