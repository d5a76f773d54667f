"""Sweeps: the numbers of single runs, one assembly for many cases, extension and resumption."""

import shutil
import tomllib
from functools import partial

import h5py
import numpy as np
import pytest
from parts import HISTORIES, PROFILES, ThresholdLaw, parse_case, run_case
from swept import CASE, STUDY, assert_same_sweeps, table, variables, write_study

import ringwear_par as rw
from ringwear_par import version
from ringwear_par.studies.execution import pairs, plan, sweep, team_store
from ringwear_par.studies.storage import case_table, case_variables, results_writer
from ringwear_par.studies.ensemble import open_ensemble, read_ensemble

#: three cases of one operator, and six of two
COEFFICIENTS = '[vary]\n"wear.lower.k" = { log = [1e-8, 1e-6], count = 3 }\n'
SHAPES = COEFFICIENTS + '"upper.r" = { values = [[28.5, 31.5], [28, 32]] }\n'
THRESHOLDS = '[vary]\n"wear.lower.p0" = {{ values = [{}] }}\n'


@pytest.fixture
def write(tmp_path, comm):
    return partial(write_study, tmp_path, comm)


@pytest.fixture(scope="module")
def known(tmp_path_factory, comm):
    """The folder of a sweep of STUDY, beside the study itself; nobody writes to it."""
    folder = tmp_path_factory.mktemp("known")
    rw.sweep(write_study(folder, comm, STUDY), folder / "out", comm)
    return folder / "out"


@pytest.fixture
def copied(known, tmp_path):
    """A copy of it."""
    return shutil.copytree(known, tmp_path / "out")


def test_equals_single_runs(known, tmp_path, comm):
    """To 1e-12: assembly on all ranks and on one sum in another order, histories do not."""
    found, rows = variables(known), table(known)
    run = tmp_path / "run.h5"
    assert [row["status"] for row in rows] == ["done"] * 12
    for i in (0, 5, 10):
        (text,) = [t.decode() for t in found["case_toml"][[i]]]
        (tmp_path / "one.toml").write_text(text)
        run_case(tmp_path / "one.toml", run, [], comm=comm)
        with h5py.File(run) as file:
            for name in (*HISTORIES, *PROFILES, "r", "width"):
                if name == "contact_iterations":
                    continue
                values = file[name][()]
                gap = 1e-12 * max(np.abs(values).max(), 1e-3 if name == "gap" else 0.0)
                assert found[name][i] == pytest.approx(values, rel=1e-12, abs=gap), name
        assert float(rows[i]["penetration"]) == found["penetration"][i, -1]


def test_edge_elements_are_those_of_single_runs(write, tmp_path, comm):
    """NaN where a contact line has no element: no edge of contact either."""
    changes = {"upper.chamfer": 0.2, "time.steps": 2}
    study = write(
        '[vary]\n"mesh.contact_elements" = { values = [24, 32] }\n',
        case=parse_case(CASE, "case").replace(changes).text,
    )
    rw.sweep(study, tmp_path / "out", comm)
    with open_ensemble(tmp_path / "out") as data:
        for i, n in enumerate((24, 32)):
            alone = rw.simulate(parse_case(data.case_toml[i].item(), "case"), comm)
            marked = data.edge_element[i].values
            assert np.array_equal(marked[:, :n], alone.to_xarray().edge_element.values)
            assert np.isnan(marked[:, n:]).all()
            assert (np.nansum(marked, axis=1) == 4).all()


def test_opens_in_xarray_with_coordinates(known):
    with open_ensemble(known) as data:
        assert data.pressure.dims == ("case", "step", "element")
        assert {"wear.lower.k", "upper.young", "upper.r"} <= set(data.pressure.coords)
        first = data.isel(case=0)
        assert float(first["wear.lower.k"]) == 1e-8
        assert data.sel(case=str(first.case.values)).penetration[-1] == first.penetration[-1]
        assert data.pressure.attrs["units"] == "MPa"
        assert list(data.step.values) == list(range(21))


def test_five_geometries_cost_five_assemblies(write, tmp_path, comm):
    study = write(
        '[vary]\n"upper.r[1]" = { linear = [30.5, 32.5], count = 5 }\n'
        '"wear.lower.p0" = { linear = [0, 60], count = 4 }\n'
        '"time.steps" = { values = [2] }\n'
    )
    summary = rw.sweep(study, tmp_path / "out", comm)
    assert (summary.done, summary.operators) == (20, 5)


def test_different_sizes_are_padded(write, tmp_path, comm):
    study = write(
        '[vary]\n"mesh.contact_elements" = { values = [8, 16] }\n'
        '"time.steps" = { values = [3, 7] }\n"output.profiles" = { values = ["last"] }\n'
    )
    rw.sweep(study, tmp_path / "out", comm)
    found = variables(tmp_path / "out")
    assert found["pressure"].shape == (4, 16)
    assert list(found["elements"]) == [8, 8, 16, 16]
    assert list(found["steps_stored"]) == [4, 8, 4, 8]
    for i, (rows, n) in enumerate(zip(found["steps_stored"], found["elements"], strict=True)):
        assert np.isfinite(found["penetration"][i, :rows]).all()
        assert np.isnan(found["penetration"][i, rows:]).all()
        assert np.isfinite(found["pressure"][i, :n]).all()
        assert np.isnan(found["pressure"][i, n:]).all()
        assert found["final_penetration"][i] == found["penetration"][i, rows - 1]


def test_again_recomputes_nothing_and_changes_nothing(write, copied, known, comm):
    """Of the file, or of its tables."""
    path = write(STUDY)
    tables = tomllib.loads(path.read_text()) | {"case": tomllib.loads(CASE)}
    for study in (path, tables):
        summary = rw.sweep(study, copied, comm)
        assert (summary.total, summary.done, summary.failed, summary.computed) == (12, 12, 0, 0)
        assert_same_sweeps(copied, known)
    attributes = read_ensemble(copied).attributes
    assert tomllib.loads(attributes["study"])["vary"] == tables["vary"]


def test_changed_study_keeps_what_is_the_same(write, copied, comm):
    before = {row["case"]: row for row in table(copied)}
    changed = write(STUDY.replace("[5e4, 1e5]", "[1e5, 2e5]"))
    assert rw.sweep(changed, copied, comm).computed == 6
    after = table(copied)
    assert [row["in_study"] for row in after] == ["yes"] * 12 + ["no"] * 6
    kept = [row for row in after if row["case"] in before]
    assert len(kept) == 12
    for row in kept:
        vanished = row["upper.young"] == "50000.0"
        assert row == {**before[row["case"]], "in_study": "no" if vanished else "yes"}
    assert read_ensemble(copied).in_study.sum() == 12


def test_files_do_not_depend_on_windows(write, known, tmp_path, comm, monkeypatch):
    """Neither written from blocks, nor, once more, from earlier results."""
    for module in (results_writer, case_table, case_variables):
        monkeypatch.setattr(module, "WINDOW", 4)
    for _ in range(2):
        rw.sweep(write(STUDY), tmp_path / "out", comm)
        assert_same_sweeps(known, tmp_path / "out")


def test_slices_and_merging_equal_the_whole(write, known, tmp_path, comm):
    study = write(STUDY)
    for part in ((3, 3), (1, 3), (2, 3)):
        rw.sweep(study, tmp_path / "sliced", comm, part=part)
        assert not (tmp_path / "sliced" / "results.h5").exists()
    assert rw.sweep(study, tmp_path / "sliced", comm).computed == 0
    assert_same_sweeps(known, tmp_path / "sliced")


def test_a_failed_case_is_a_row_and_the_others_go_on(write, tmp_path, comm, monkeypatch):
    original, study, folder = ThresholdLaw.line, write(COEFFICIENTS), tmp_path / "out"

    def line(self, local):
        if abs(self.k - 1e-7) < 1e-12:
            raise RuntimeError("this law blows up")
        return original(self, local)

    monkeypatch.setattr(ThresholdLaw, "line", line)
    with pytest.raises(rw.ComputationError, match="1 of 3"):
        rw.sweep(study, folder, comm)
    rows = table(folder)
    assert [row["status"] for row in rows] == ["done", "failed", "done"]
    assert "this law blows up" in rows[1]["error"]
    monkeypatch.setattr(ThresholdLaw, "line", original)
    with pytest.raises(rw.ComputationError, match="1 of 3"):
        rw.sweep(study, folder, comm)  # failures are results as well
    summary = rw.sweep(study, folder, comm, retry_failed=True)
    assert (summary.done, summary.computed) == (3, 1)
    assert all(row["status"] == "done" for row in table(folder))


def test_an_operator_that_fails_fails_its_cases_only(write, tmp_path, comm, monkeypatch):
    original = pairs.assemble

    def assemble(case, team):
        if case.upper.r[0] == 28.0:
            raise rw.ComputationError("the factorisation failed")
        return original(case, team)

    monkeypatch.setattr(pairs, "assemble", assemble)
    with pytest.raises(rw.ComputationError, match="3 of 6"):
        rw.sweep(write(SHAPES), tmp_path / "out", comm)
    failed = [row for row in table(tmp_path / "out") if row["status"] == "failed"]
    assert {row["upper.r"] for row in failed} == {"[28, 32]"}
    assert {row["error"] for row in failed} == {"the factorisation failed"}


def test_a_dry_run_counts_and_writes_nothing(write, tmp_path, comm, capsys):
    sweep.run_sweep(write(STUDY), tmp_path / "out", comm, dry_run=True)
    assert not (tmp_path / "out").exists()
    output = capsys.readouterr().out
    assert "12 cases" in output
    assert "2 distinct contact pair" in output


def test_a_sweep_without_memory_for_it_is_refused(write, tmp_path, comm, with_memory):
    with_memory(1e9)
    study = write(COEFFICIENTS + '"mesh.contact_elements" = { values = [6000] }\n')
    with pytest.raises(rw.InputError, match="memory"):
        rw.sweep(study, tmp_path / "out", comm)


def test_another_version_does_not_mix_with_the_first(write, tmp_path, comm, monkeypatch):
    mine, folder = rw.__version__, tmp_path / "out"
    rw.sweep(write(THRESHOLDS.format("0, 20")), folder, comm)
    for module in (rw, version, plan, team_store):
        monkeypatch.setattr(module, "__version__", "99.0")
    assert rw.sweep(write(THRESHOLDS.format("0, 20")), folder, comm).computed == 0
    with pytest.raises(rw.InputError, match=f"2 by {mine}"):
        rw.sweep(write(THRESHOLDS.format("0, 20, 40")), folder, comm)
    # the others are no longer of the study
    assert rw.sweep(write(THRESHOLDS.format("40")), folder, comm).computed == 1
    versions = dict.fromkeys(["0", "20"], mine) | {"40": "99.0"}
    assert {row["wear.lower.p0"]: row["version"] for row in table(folder)} == versions


def test_warnings_are_flags_of_a_sweep(write, tmp_path, comm):
    """And in its summary, once more when nothing is computed."""
    explicit = {"time.scheme": "explicit", "time.step": 40.0, "load.omega": 35.0}
    case = parse_case(CASE, "case").replace(explicit).text
    for _ in range(2):
        summary = rw.sweep(write(THRESHOLDS.format("0, 79.9"), case), tmp_path / "out", comm)
        assert "unstable explicit step" in str(summary)
    rows = table(tmp_path / "out")
    assert "unstable_explicit_step" in rows[0]["flags"]
    with open_ensemble(tmp_path / "out") as data:
        assert [str(v) for v in data.flags.values] == [row["flags"] for row in rows]
