"""Sweeps: the numbers of single runs, one assembly for many cases, extension and resumption."""

import re
import shutil
import tomllib
from functools import partial

import h5py
import numpy as np
import pytest
from swept import CASE, STUDY, table, variables, write_study

import ringwear_par as rw
from ringwear_par.cases.files.reading import parse_case
from ringwear_par.errors import ComputationError, InputError
from ringwear_par.results.execution.run import run_case
from ringwear_par.results.storage.result_files import open_result
from ringwear_par.results.variables import HISTORIES, PROFILES
from ringwear_par.studies.definition.study import read_study
from ringwear_par.studies.execution import estimate, pairs, single_cases, sweep
from ringwear_par.studies.storage import (
    case_table,
    case_variables,
    results_file,
    results_writer,
)
from ringwear_par.studies.storage.ensemble import open_ensemble, read_ensemble

#: three cases of one operator, and six of two
COEFFICIENTS = '[vary]\n"wear.lower.k" = { log = [1e-8, 1e-6], count = 3 }\n'
SHAPES = COEFFICIENTS + '"upper.r" = { values = [[28.5, 31.5], [28, 32]] }\n'


@pytest.fixture
def write(tmp_path, comm):
    return partial(write_study, tmp_path, comm)


def swept(study, folder, comm, ranks_per_case=1, part=None, retry=False):
    sweep.run_sweep(
        study, folder, comm, ranks_per_case=ranks_per_case, part=part, retry_failed=retry
    )


def same(one, other):
    assert one.keys() == other.keys()
    for name, values in one.items():
        assert np.array_equal(values, other[name], equal_nan=values.dtype.kind == "f"), name


@pytest.fixture(scope="module")
def known(tmp_path_factory, comm):
    """The folder of a sweep of STUDY, beside the study itself; nobody writes to it."""
    folder = tmp_path_factory.mktemp("known")
    swept(write_study(folder, comm, STUDY), folder / "out", comm)
    return folder / "out"


@pytest.fixture
def copied(known, tmp_path, comm):
    """A copy of it."""
    shutil.copytree(known, tmp_path / "out")
    return tmp_path / "out"


def test_equals_single_runs(known, tmp_path, comm):
    """To 1e-12: assembly on all ranks and on one sum in another order, histories do not."""
    folder, run = known, tmp_path / "run.h5"
    found, rows = variables(folder), table(folder)
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
    swept(study, tmp_path / "out", comm)
    with open_ensemble(tmp_path / "out") as data:
        for i, n in enumerate((24, 32)):
            alone = rw.simulate(parse_case(data.case_toml[i].item(), "case"), comm)
            marked = data.edge_element[i].values
            assert np.array_equal(marked[:, :n], alone.to_xarray().edge_element.values)
            assert np.isnan(marked[:, n:]).all()
            assert (np.nansum(marked, axis=1) == 4).all()


def test_opens_lazily_in_xarray_with_coordinates(known, comm):
    with open_ensemble(known) as data:
        assert data.pressure.dims == ("case", "step", "element")
        assert data.pressure._in_memory is False
        assert {"wear.lower.k", "upper.young", "upper.r"} <= set(data.pressure.coords)
        first = data.isel(case=0)
        assert float(first["wear.lower.k"]) == 1e-8
        assert data.sel(case=str(first.case.values)).penetration[-1] == first.penetration[-1]
        assert data.pressure.attrs["units"] == "MPa"
        assert list(data.step.values) == list(range(21))


def test_five_geometries_cost_five_assemblies(write, tmp_path, comm, monkeypatch):
    study = write(
        '[vary]\n"upper.r[1]" = { linear = [30.5, 32.5], count = 5 }\n'
        '"wear.lower.p0" = { linear = [0, 60], count = 6 }\n'
        '"time.steps" = { values = [2] }\n'
    )
    assembled = []
    original = pairs.assemble
    monkeypatch.setattr(
        pairs, "assemble",
        lambda case, team: (assembled.append(case.upper.r), original(case, team))[1],
    )  # fmt: skip
    swept(study, tmp_path / "out", comm)
    everywhere = [r for part in comm.allgather(assembled) for r in part]
    assert 5 <= len(everywhere) <= 4 + comm.size  # once more by each team that helps at the end
    assert len(set(everywhere)) == 5
    assert len(table(tmp_path / "out")) == 30


def test_different_sizes_are_padded(write, tmp_path, comm):
    study = write(
        '[vary]\n"mesh.contact_elements" = { values = [8, 16] }\n'
        '"time.steps" = { values = [3, 7] }\n"output.profiles" = { values = ["last"] }\n'
    )
    swept(study, tmp_path / "out", comm)
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


def test_again_recomputes_nothing_and_changes_nothing(write, copied, comm, monkeypatch):
    study, folder = write(STUDY), copied
    before, rows = variables(folder), table(folder)
    monkeypatch.setattr(single_cases, "simulate_one", None)  # any case would fail
    swept(study, folder, comm)
    same(before, variables(folder))
    assert table(folder) == rows
    content = (folder / "results.h5").read_bytes()
    sweep.run_sweep(study, folder, comm, dry_run=True)
    assert (folder / "results.h5").read_bytes() == content


def test_changed_study_keeps_what_is_the_same(write, copied, comm):
    folder = copied
    before = {row["case"]: row for row in table(folder)}
    swept(write(STUDY.replace("[5e4, 1e5]", "[1e5, 2e5]")), folder, comm)
    after = table(folder)
    assert [row["in_study"] for row in after] == ["yes"] * 12 + ["no"] * 6
    kept = [row for row in after if row["case"] in before]
    assert len(kept) == 12
    for row in kept:
        vanished = row["upper.young"] == "50000.0"
        assert row == {**before[row["case"]], "in_study": "no" if vanished else "yes"}
    assert read_ensemble(folder).in_study.sum() == 12


def test_slices_and_merging_equal_the_whole(write, known, tmp_path, comm):
    study = write(STUDY)
    for part in ((3, 3), (1, 3), (2, 3)):
        swept(study, tmp_path / "sliced", comm, part=part)
        assert not (tmp_path / "sliced" / "results.h5").exists()
    swept(study, tmp_path / "sliced", comm)
    same(variables(known), variables(tmp_path / "sliced"))


def test_files_do_not_depend_on_windows(write, tmp_path, comm, monkeypatch):
    """Neither those of shards nor those of earlier results, nor where cases are gone.

    Of earlier results no case is read for two windows.
    """
    stretches, read = [], results_file.ResultsBlock.read

    def counted(block, names):
        stretches.append((block.path, block.stretch.start))
        return read(block, names)

    studies = [STUDY, STUDY.replace("[5e4, 1e5]", "[1e5, 2e5]"), STUDY]
    for name in ("whole", "parts"):
        if name == "parts":
            monkeypatch.setattr(results_file, "_WINDOW_BYTES", 40000)
            for module in (results_writer, case_table, case_variables):
                monkeypatch.setattr(module, "WINDOW", 4)
        for n, text in enumerate(studies):
            swept(write(text), tmp_path / name, comm)
            with monkeypatch.context() as patch:
                patch.setattr(results_file.ResultsBlock, "read", counted)
                swept(write(text), tmp_path / name, comm)  # writes the files anew
            assert len(stretches) == len(set(stretches)) > 0
            stretches.clear()
            shutil.copytree(tmp_path / name, tmp_path / f"{name}{n}")
    for n in range(len(studies)):
        same(variables(tmp_path / f"whole{n}"), variables(tmp_path / f"parts{n}"))
        whole, parts = (table(tmp_path / f"{name}{n}") for name in ("whole", "parts"))
        for row in (*whole, *parts):
            del row["seconds"]
        assert whole == parts


def test_sizes_that_do_not_divide_are_refused(write, tmp_path, comm):
    m = comm.size + 1
    with pytest.raises(InputError, match=rf"{m}: {comm.size} ranks do not divide into teams"):
        swept(write(STUDY), tmp_path / "out", comm, ranks_per_case=m)
    assert not (tmp_path / "out").exists()


def test_a_failed_case_is_a_row_and_the_others_go_on(
    write, tmp_path, comm, monkeypatch, stopped_after
):
    from ringwear_par.wear.laws.threshold import ThresholdLaw

    original = ThresholdLaw.line

    def line(self, local):
        if abs(self.k - 1e-7) < 1e-12:
            raise RuntimeError("this law blows up")
        return original(self, local)

    monkeypatch.setattr(ThresholdLaw, "line", line)
    folder = tmp_path / "out"
    with pytest.raises(ComputationError, match="1 of 3 cases failed"):
        swept(write(COEFFICIENTS), folder, comm)
    rows = table(folder)
    assert [row["status"] for row in rows] == ["done", "failed", "done"]
    assert "this law blows up" in rows[1]["error"]
    monkeypatch.setattr(ThresholdLaw, "line", original)
    with pytest.raises(ComputationError, match="1 of 3 cases failed"):
        swept(write(COEFFICIENTS), folder, comm)  # failures are results as well
    stopped = pytest.raises(ComputationError, match="stopped by SIGTERM, incomplete")
    with stopped_after(3), stopped:  # of which the failures of before must not make a whole
        swept(write(COEFFICIENTS), folder, comm, retry=True, ranks_per_case=comm.size)
    assert (folder / "STOPPED").exists()
    swept(write(COEFFICIENTS), folder, comm, retry=True)
    assert all(row["status"] == "done" for row in table(folder))


def test_an_operator_that_fails_fails_its_cases_only(write, tmp_path, comm, monkeypatch):
    original = pairs.assemble

    def assemble(case, team):
        if case.upper.r[0] == 28.0:
            raise ComputationError("the factorisation failed")
        return original(case, team)

    monkeypatch.setattr(pairs, "assemble", assemble)
    with pytest.raises(ComputationError, match="3 of 6 cases failed"):
        swept(write(SHAPES), tmp_path / "out", comm)
    failed = [row for row in table(tmp_path / "out") if row["status"] == "failed"]
    assert {row["upper.r"] for row in failed} == {"[28, 32]"}
    assert {row["error"] for row in failed} == {"the factorisation failed"}


def test_a_dry_run_writes_nothing(write, tmp_path, comm, capsys):
    sweep.run_sweep(write(STUDY), tmp_path / "out", comm, dry_run=True)
    assert not (tmp_path / "out").exists()
    told = capsys.readouterr().out
    assert "12 cases" in told
    assert "2 distinct contact pair(s)" in told
    assert "estimate for 12 cases" in told
    found = re.search(r"about (\d+) MB of memory in all \((\d+) MB a rank\)", told)
    all_of_it, a_rank = map(float, found.groups())
    assert all_of_it / comm.size == pytest.approx(a_rank, abs=0.5)
    assert 250 <= a_rank < 300  # the programs themselves, and 16 elements


def test_a_dry_run_knows_that_cases_go_side_by_side(write, tmp_path, comm, capsys):
    """Adaptive histories take some tenth of the time so, or less."""
    text = """
[vary]
"wear.lower.k" = { log = [1e-8, 1e-6], count = 400 }
"time.scheme" = { values = ["adaptive"] }
[design]
method = "grid"
"""
    sweep.run_sweep(write(text), tmp_path / "out", comm, dry_run=True)
    told = capsys.readouterr().out
    timed = re.search(r"([\d.]+) s for an assembly, ([\d.]+) s for the adaptive steps of a case, "
                      r"of (\d+) side by side", told)  # fmt: skip
    assert int(timed[3]) == 33
    assembly, steps = float(timed[1]), float(timed[2])
    seconds = float(re.search(r"about ([\d.]+) s,", told)[1])
    # start and merging come on top of the cases' own, whose steps are about as many
    assert 200 * steps < seconds < 10.0 + assembly + 600 * steps


def test_a_dry_run_whose_first_case_fails_ends_on_all_ranks(write, tmp_path, comm, monkeypatch):
    def failing(*_, **__):
        raise ComputationError("step 1: the contact failed")

    monkeypatch.setattr(estimate, "simulate", failing)
    with pytest.raises(ComputationError, match="step 1: the contact failed"):
        sweep.run_sweep(write(STUDY), tmp_path / "out", comm, dry_run=True)


def test_in_python(write, tmp_path, comm):
    """The command's function by its public names, of a study read already or of its tables."""
    tables = {
        "case": tomllib.loads(CASE),
        "vary": {"wear.lower.k": {"log": [1e-8, 1e-6], "count": 3}},
    }
    summary = sweep.sweep(tables, tmp_path / "out", comm)
    assert (summary.total, summary.done, summary.failed, summary.computed) == (3, 3, 0, 3)
    again = sweep.sweep(read_study(tables), str(tmp_path / "out"), comm)
    assert (again.done, again.computed, again.operators) == (3, 0, 0)
    text = '[vary]\n"wear.lower.k" = { log = [1e-8, 1e-6], count = 3 }\n'
    assert sweep.sweep(write(text), tmp_path / "out", comm).computed == 0
    assert (
        tomllib.loads(read_ensemble(tmp_path / "out").attributes["study"])["vary"]
        == (tables["vary"])
    )


def test_an_interrupted_case_is_stored_with_its_text(write, tmp_path, comm, stopped_after):
    study, folder = write(COEFFICIENTS), tmp_path / "out"
    with stopped_after(7), pytest.raises(ComputationError, match="the same command goes on"):
        swept(study, folder, comm, ranks_per_case=comm.size)
    (stored,) = (folder / "inflight").glob("*.h5")
    read = read_study(study)
    case = read.case(read.ids.index(stored.stem))
    text = open_result(stored).case
    assert text == case.text
    assert parse_case(text, "stored") == case
    swept(study, folder, comm, ranks_per_case=comm.size)
    assert [row["status"] for row in table(folder)] == ["done"] * 3
