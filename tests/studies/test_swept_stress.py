"""Sweeps of coated rings and of cases with [stress]: what is stored is that of single runs."""

import numpy as np
import pytest
from mpi4py import MPI
from swept import CASE, table, write_study

import ringwear_par as rw
from ringwear_par.studies.analysis.surrogate import surrogate

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


def check_stresses(row, mine, own):
    """Stored stresses and those of the table, at the times that the case has them."""
    at = np.searchsorted(own.time.values, own.stress_time.values)
    count = int(mine.steps_stored)
    asked = np.zeros(count, dtype=bool)
    asked[at] = True
    for name in (*ROWS, "max_mises_lower_layers", "mises", "max_shear"):
        stored, last = mine[name].values[:count], own[name].values[-1]
        np.testing.assert_allclose(stored[at], own[name].values, rtol=1e-8)
        assert np.isnan(stored[~asked]).all()
        np.testing.assert_allclose(mine[f"final_{name}"].values, last, rtol=1e-8)
        for i, value in enumerate(np.atleast_1d(last)):
            entry = "body" if "layers" in name and i == 1 else i
            column = name if name in ROWS else f"{name}[{entry}]"
            assert float(row[column] or "nan") == pytest.approx(value, rel=1e-8, nan_ok=True)
    np.testing.assert_array_equal(mine.point_z, own.point_z)
    assert mine.point_side.values.tolist() == own.point_side.values.tolist() == ["", "", "above"]
    layers = own.max_mises_lower_layers
    np.testing.assert_array_equal(layers.max("layer"), own.max_mises_lower)


def check_layers(row, mine, own, result):
    """Volumes of the layers, and what is worn through."""
    np.testing.assert_allclose(
        mine.worn_volume_lower_layers[: len(own.time)], own.worn_volume_lower_layers, rtol=1e-8
    )
    volumes = [float(row[f"worn_volume_lower_layers[{i}]"]) for i in (0, "body")]
    assert sum(volumes) == pytest.approx(float(row["worn_volume_lower"]), rel=1e-12)
    share = float(own.share_through_lower[-1])
    assert float(row["share_through_lower"]) == pytest.approx(share, rel=1e-12)
    least = float(row["least_layer_left_lower"])
    assert least == pytest.approx(float(own.layer_left_lower[-1].min()), abs=1e-12)
    time = result.attributes["time_through_lower"]
    assert float(row["time_through_lower"] or "nan") == pytest.approx(time, nan_ok=True)
    return bool(np.isfinite(time))


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    """The folder of a sweep of 24 cases over thickness and pressure."""
    folder = tmp_path_factory.mktemp("swept")
    rw.sweep(write_study(folder, MPI.COMM_SELF, STUDY, COATED), folder / "out", MPI.COMM_SELF)
    return folder / "out"


def test_stresses_and_layers_are_those_of_single_runs(swept):
    """Points in what is worn away are blank."""
    through, blank = set(), set()
    for row, mine, own, result in singles(swept, stride=5):
        check_stresses(row, mine, own)
        through.add(check_layers(row, mine, own, result))
        gone = bool(own.layer_left_lower[-1, result.line.element_at(np.array(30.0))] == 0.0)
        assert (row["mises[0]"] == "") == bool(np.isnan(own.mises[-1, 0])) == gone
        assert ("worn_points" in row["flags"]) == (not gone)
        blank.add(gone)
    assert through == blank == {True, False}


def test_stresses_at_some_times_are_those_of_single_runs(comm, tmp_path):
    study = STUDY.replace("count = 4", "count = 2").replace("count = 6", "count = 2")
    case = COATED + "times = [0.0, 5.0]\n"
    rw.sweep(write_study(tmp_path, comm, study, case), tmp_path / "out", comm)
    for row, mine, own, _ in singles(tmp_path / "out"):
        check_stresses(row, mine, own)


LISTS = """
[vary]
"lower.layers" = { values = [[], [%(thin)s], [%(thin)s, %(soft)s]%(more)s] }
"load.pressure" = { values = [80] }
[design]
method = "grid"
"""
ENTRIES = {
    "thin": "{ thickness = 0.004, young = 5e4, poisson = 0.3 }",
    "soft": "{ thickness = 0.01, young = 2e4, poisson = 0.3, "
    "wear = { law = 'archard', k = 4e-6 } }",
}


def test_cases_may_have_different_numbers_of_layers(comm, tmp_path):
    """The body has a place of its own."""
    case = CASE.replace("steps = 20", "steps = 8") + (
        '[stress]\npoints = [[30.0, 20.0, "below"], [30.0, 20.0, "above"]]\n'
    )
    thicker = ENTRIES | {"more": ", [{thin}, {soft}, {soft}]".format(**ENTRIES)}
    for entries, most in ((ENTRIES | {"more": ""}, 2), (thicker, 3)):
        folder = tmp_path / f"out_{most}"
        summary = rw.sweep(write_study(tmp_path, comm, LISTS % entries, case), folder, comm)
        assert summary.failed == 0
        counts = []
        for row, mine, own, _ in singles(folder):
            assert mine.point_side.values.tolist() == ["below", "above"]
            assert mine.sizes["layer"] == most + 1
            layers = own.sizes.get("layer", 1) - 1
            counts.append(layers)
            for name in ("worn_volume_lower_layers", "max_mises_lower_layers"):
                stored = mine[f"final_{name}"].values
                exact = own[name].values[-1] if layers else np.array([np.nan])
                np.testing.assert_allclose(stored[:layers], exact[:-1], rtol=1e-8)
                np.testing.assert_allclose(stored[-1], exact[-1], rtol=1e-8)
                assert np.isnan(stored[layers:-1]).all()
                columns = [f"{name}[{entry}]" for entry in (*range(most), "body")]
                in_table = [float(row[column] or "nan") for column in columns]
                np.testing.assert_array_equal(in_table, stored)
                assert f"{name}[{most}]" not in row
        assert sorted(counts) == [*range(most + 1)]


def test_surrogates_answer_for_stresses(swept):
    """But for what jumps from place to place, or what not all cases have."""
    made = surrogate(swept)
    assert {"max_mises", "mises[1]", "worn_volume_lower_layers[body]"} <= set(made.names)
    assert not {"max_mises_z", "time_through_lower", "mises[0]"} & set(made.names)
    with rw.open_ensemble(swept) as data:
        at = {name: data[name].values for name in ("lower.layers[0].thickness", "load.pressure")}
        np.testing.assert_allclose(made.predict(at)["mises[1]"], data.final_mises[:, 1], rtol=1e-6)
    # without its state of stress at all steps
    early = surrogate(swept, times=[5.0]).names
    assert "max_mises" not in early
    assert "share_through_lower" in early


@pytest.mark.usefixtures("few_resamples")
def test_figures_and_pages_show_them(swept, tmp_path):
    labels = [" ".join(axes.get_ylabel().split()) for axes in rw.plot(swept).axes]
    assert "largest von Mises stress (MPa)" in labels
    assert not any("point" in label or "body" in label or "layer 0" in label for label in labels)
    rw.report(swept, tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text()
    assert "largest von Mises stress (MPa)" in page
    assert "worn through from, lower (s)" in page
