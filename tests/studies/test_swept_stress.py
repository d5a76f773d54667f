"""Sweeps of coated rings and of cases with [stress]: what is stored is that of single runs."""

import signal

import numpy as np
import pytest
from mpi4py import MPI
from swept import CASE, table, variables, write_study

import ringwear_par as rw
from ringwear_par.elasticity.stress.recovery import StressRecovery
from ringwear_par.errors import ComputationError
from ringwear_par.studies.analysis.surrogate import surrogate
from ringwear_par.studies.execution.sweep import sweep
from ringwear_par.studies.execution.teams import Team
from ringwear_par.studies.storage.end_values import figure_columns
from ringwear_par.studies.storage.ensemble import read_ensemble
from ringwear_par.studies.storage.folder import SweepFolder

pytestmark = pytest.mark.slow

LAYER = """
[[lower.layers]]
thickness = 0.004
young = 50e3
poisson = 0.3
wear = { law = "threshold", k = 4e-6 }

[stress]
points = [[30.0, 19.95], [29.0, 20.0, "above"]]
grid = { body = "lower", r = [29.0, 31.0], z = [19.8, 19.95], n = [3, 2] }
"""
COATED = CASE.replace("steps = 20", "steps = 8").replace("p0 = 40.0", "p0 = 4.0") + LAYER
STUDY = """
[vary]
"lower.layers[0].thickness" = { values = [0.002, 0.03] }
"load.pressure" = { values = [60, 80] }
[design]
method = "grid"
"""
ROWS = ("max_mises", "max_mises_r", "max_mises_z", "max_mises_layer")


def singles(folder, stride=1):
    """Rows of a sweep's table and of its file, and each case by its text, computed alone."""
    rows = table(folder)
    with rw.open_ensemble(folder) as data:
        for i in range(0, len(rows), stride):
            (folder / "one.toml").write_text(str(data.case_toml.values[i]))
            result = rw.simulate(rw.read_case(folder / "one.toml"), MPI.COMM_SELF)
            yield rows[i], data.isel(case=i), result.to_xarray(), result


@pytest.mark.parametrize("times", ["last", "[0.0, 5.0]"])
def test_stresses_and_layers_are_those_of_single_runs(times, comm, tmp_path):
    case = COATED + f"times = {times if times[0] == '[' else repr(times)}\n"
    sweep(write_study(tmp_path, comm, STUDY, case), tmp_path / "out", comm)
    through = set()
    for row, mine, own, result in singles(tmp_path / "out"):
        at = np.searchsorted(own.time.values, own.stress_time.values)
        count = int(mine.steps_stored)
        asked = np.zeros(count, dtype=bool)
        asked[at] = True
        for name in (*ROWS, "max_mises_lower_layers", "mises", "max_shear"):
            stored = mine[name].values[:count]
            np.testing.assert_allclose(stored[at], own[name].values, rtol=1e-8)
            assert np.isnan(stored[~asked]).all()
            last = own[name].values[-1]
            np.testing.assert_allclose(mine[f"final_{name}"].values, last, rtol=1e-8)
            for i, value in enumerate(np.atleast_1d(last)):
                entry = "body" if "layers" in name and i == 1 else i
                column = name if name in ROWS else f"{name}[{entry}]"
                assert float(row[column]) == pytest.approx(value, rel=1e-8)
        np.testing.assert_array_equal(mine.point_z, own.point_z)
        assert mine.point_side.values.tolist() == own.point_side.values.tolist() == ["", "above"]
        layers = own.max_mises_lower_layers
        np.testing.assert_array_equal(layers.max("layer"), own.max_mises_lower)
        np.testing.assert_allclose(
            mine.worn_volume_lower_layers[:count], own.worn_volume_lower_layers, rtol=1e-8
        )
        volumes = [float(row[f"worn_volume_lower_layers[{i}]"]) for i in (0, "body")]
        assert sum(volumes) == pytest.approx(float(row["worn_volume_lower"]), rel=1e-12)
        share = float(own.share_through_lower[-1])
        assert float(row["share_through_lower"]) == pytest.approx(share, rel=1e-12)
        least = float(row["least_layer_left_lower"])
        assert least == pytest.approx(float(own.layer_left_lower[-1].min()), abs=1e-12)
        time = result.attributes["time_through_lower"]
        assert float(row["time_through_lower"] or "nan") == pytest.approx(time, nan_ok=True)
        through.add(bool(np.isfinite(time)))
    assert through == {True, False}


OVER_THICKNESS = """
[vary]
"lower.layers[0].thickness" = { log = [0.002, 0.04], count = 4 }
"load.pressure" = { linear = [40, 80], count = 6 }
[design]
method = "grid"
"""


@pytest.mark.usefixtures("few_resamples")
def test_points_of_layers_that_are_worn_through_are_blank(comm, tmp_path):
    """In some cases of a sweep; whatever takes maxima or fits goes on without them."""
    case = COATED.replace("[[30.0, 19.95], ", "[[30.0, 19.999], [30.0, 19.95], ") + 'times = "all"'
    sweep(write_study(tmp_path, comm, OVER_THICKNESS, case), tmp_path / "out", comm)
    blank = set()
    for row, mine, own, result in singles(tmp_path / "out", stride=5):
        np.testing.assert_allclose(mine.mises[: len(own.mises)], own.mises, rtol=1e-8)
        gone = bool(own.layer_left_lower[-1, result.line.element_at(np.array(30.0))] == 0.0)
        assert (row["mises[0]"] == "") == bool(np.isnan(own.mises[-1, 0])) == gone
        assert float(row["mises[1]"]) == pytest.approx(float(own.mises[-1, 1]), rel=1e-8)
        assert ("worn_points" in row["flags"]) == (not gone)
        assert np.isfinite(float(row["max_mises"]))
        blank.add(gone)
    assert blank == {True, False}
    made = surrogate(tmp_path / "out")
    assert "mises[0]" not in made.names
    assert {"mises[1]", "max_mises"} <= set(made.names)
    assert rw.plot(tmp_path / "out").axes
    rw.report(tmp_path / "out", tmp_path / "page.html")


LISTS = """
[vary]
"lower.layers" = { values = [[], [%(thin)s], [%(thin)s, %(soft)s]%(more)s] }
"load.pressure" = { values = [60, 90] }
[design]
method = "grid"
"""
ENTRIES = {
    "thin": "{ thickness = 0.004, young = 5e4, poisson = 0.3 }",
    "soft": "{ thickness = 0.01, young = 2e4, poisson = 0.3, "
    "wear = { law = 'archard', k = 4e-6 } }",
}


def test_cases_may_have_different_numbers_of_layers(comm, tmp_path):
    """The body has a place of its own, in a study that goes on with more layers, too."""
    case = CASE.replace("steps = 20", "steps = 8") + (
        '[stress]\npoints = [[30.0, 20.0, "below"], [30.0, 20.0, "above"]]\n'
    )
    thicker = ENTRIES | {"more": ", [{thin}, {soft}, {soft}]".format(**ENTRIES)}
    for entries, most in ((ENTRIES | {"more": ""}, 2), (thicker, 3)):
        told = sweep(write_study(tmp_path, comm, LISTS % entries, case), tmp_path / "out", comm)
        assert told.failed == 0
        counts = []
        for row, mine, own, _ in singles(tmp_path / "out"):
            assert mine.point_side.values.tolist() == ["below", "above"]
            assert mine.sizes["layer"] == most + 1
            layers = own.sizes.get("layer", 1) - 1
            counts.append(layers)
            for name in ("worn_volume_lower_layers", "max_mises_lower_layers"):
                stored = mine[f"final_{name}"].values
                known = own[name].values[-1] if layers else np.array([np.nan])
                np.testing.assert_allclose(stored[:layers], known[:-1], rtol=1e-8)
                np.testing.assert_allclose(stored[-1], known[-1], rtol=1e-8)
                assert np.isnan(stored[layers:-1]).all()
                columns = [*range(most), "body"]
                told = [float(row[f"{name}[{entry}]"] or "nan") for entry in columns]
                np.testing.assert_array_equal(told, stored)
                assert f"{name}[{most}]" not in row
        assert sorted(counts) == sorted([*range(most + 1)] * 2)


def test_the_same_bits_on_all_ranks(comm, tmp_path):
    """Whatever is drawn by which team; each team integrates once for all cases of a thickness."""
    study = write_study(tmp_path, comm, STUDY, COATED)
    made, integrated = [], StressRecovery._integrated
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(StressRecovery, "_integrated", lambda *a: made.append(1) or integrated(*a))
        sweep(study, tmp_path / "all", comm)
    assert len(made) <= 2
    sweep(study, tmp_path / "one", MPI.COMM_SELF)
    one, every = variables(tmp_path / "one"), variables(tmp_path / "all")
    assert one.keys() == every.keys()
    for name, values in one.items():
        assert np.array_equal(values, every[name], equal_nan=values.dtype.kind == "f"), name


def test_an_interrupted_case_keeps_its_stresses(comm, tmp_path, monkeypatch):
    """Alone, with a checkpoint: its stresses so far are in the incomplete file and in the whole."""
    case = COATED.replace("contact_elements = 16", 'contact_elements = 16\ngeometry = "updated"')
    two = STUDY.replace("[60, 80]", "[60]")
    study = write_study(tmp_path, comm, two, case + 'times = "all"\n')
    sweep(study, tmp_path / "whole", comm)
    step, made = Team._observe, []

    def interrupting(self, snapshot=None):
        if snapshot is not None:
            made.append(1)
            if len(made) == 13:
                signal.raise_signal(signal.SIGTERM)
        return step(self, snapshot)

    with monkeypatch.context() as patch:
        patch.setattr(Team, "_observe", interrupting)
        with pytest.raises(ComputationError, match="stopped by SIGTERM"):
            sweep(study, tmp_path / "parts", comm)
    with rw.open_ensemble(tmp_path / "parts") as data:
        (going,) = np.flatnonzero(data.status == "incomplete")[:1]
        assert len(SweepFolder(tmp_path / "parts", "").checkpoints()) == 1
        begun = data.isel(case=int(going))
        assert np.isfinite(begun.max_mises[: int(begun.steps_stored)]).any()
    sweep(study, tmp_path / "parts", comm)
    whole, parts = variables(tmp_path / "whole"), variables(tmp_path / "parts")
    for name, values in whole.items():
        assert np.array_equal(values, parts[name], equal_nan=values.dtype.kind == "f"), name


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    """The folder of a sweep of 24 cases over thickness and pressure."""
    folder = tmp_path_factory.mktemp("swept")
    sweep(write_study(folder, MPI.COMM_SELF, OVER_THICKNESS, COATED), folder / "out", MPI.COMM_SELF)
    return folder / "out"


def test_surrogates_answer_for_stresses(swept):
    made = surrogate(swept)
    assert {"max_mises", "mises[0]", "worn_volume_lower_layers[body]"} <= set(made.names)
    assert "max_mises_z" not in made.names  # which jumps from place to place
    assert "time_through_lower" not in made.names  # which not all cases have
    with rw.open_ensemble(swept) as data:
        at = {name: data[name].values for name in ("lower.layers[0].thickness", "load.pressure")}
        np.testing.assert_allclose(made.predict(at)["mises[0]"], data.final_mises[:, 0], rtol=1e-6)
    # without its state of stress at all steps
    assert "max_mises" not in surrogate(swept, times=[5.0]).names
    assert "share_through_lower" in surrogate(swept, times=[5.0]).names


@pytest.mark.usefixtures("few_resamples")
def test_figures_and_pages_show_them(swept, tmp_path):
    ensemble = read_ensemble(swept)
    done = np.ones(len(ensemble.ids), dtype=bool)
    assert figure_columns(ensemble.final, done) == [
        "penetration", "worn_volume_lower", "share_through_lower", "max_mises",
    ]  # fmt: skip
    labels = [" ".join(axes.get_ylabel().split()) for axes in rw.plot(swept).axes]
    assert "largest von Mises stress (MPa)" in labels
    assert not any("point" in label or "body" in label or "layer 0" in label for label in labels)
    rw.report(swept, tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text()
    for words in (
        "largest von Mises stress (MPa)",
        "worn through from, lower (s)",
        "; the body itself",
    ):
        assert words in page
