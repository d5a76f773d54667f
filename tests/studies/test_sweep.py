"""Sweeps: the numbers of single runs, files as the contract has them, failures, other studies."""

import shutil
import tomllib
from functools import partial

import numpy as np
import pytest
from agreement import assert_values_agree
from parts import LAWS, edge_elements, parse_case, threshold
from swept import CASE, STUDY, assert_same_sweeps, table, variables, write_study

import ringwear_par as rw
from ringwear_par.studies import blocks, many, study, sweep
from ringwear_par.studies.ensemble import open_ensemble, read_ensemble

#: three cases of one operator, and six of two
COEFFICIENTS = '[vary]\n"wear.lower.k" = { log = [1e-8, 1e-6], count = 3 }\n'
OWN_KEYS = """[vary]
"wear.lower.k" = { values = [4e-7, 1e-8, 2e-7] }
"wear.lower.p0" = { values = [35.0, 0.0] }
"upper.young" = { values = [5e4, 1e5] }
"lower.r" = { values = [[20.0, 40.0], [25.0, 36.0]] }
"""
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
def small_blocks(monkeypatch):
    """Have four cases in a block."""
    monkeypatch.setattr(many, "MOST", 4)


def test_rows_are_what_their_own_keys_give(tmp_path, comm):
    """Of two shapes and two moduli, in an order that is not that of any identity."""
    study = write_study(tmp_path, comm, OWN_KEYS, CASE.replace("steps = 20", "steps = 6"))
    rw.sweep(study, tmp_path / "out", comm)
    rows, found = table(tmp_path / "out"), variables(tmp_path / "out")
    assert [row["status"] for row in rows] == ["done"] * 24
    for i in range(0, 24, 5):
        keys = {key: tomllib.loads(f"x = {rows[i][key]}")["x"] for key in rows[i] if "." in key}
        alone = rw.simulate(rw.read_case(tmp_path / "paper.toml", keys | {"time.steps": 6}), comm)
        assert found["case"][i].decode() == rows[i]["case"]
        assert found["wear.lower.k"][i] == keys["wear.lower.k"]
        own = {name: found[name][i] for name in {**alone.histories, **alone.profiles}}
        assert_values_agree(own, alone)
        for name in ("penetration", "worn_volume_lower", "worn_volume_upper"):
            assert float(rows[i][name]) == found[name][i, -1] == found[f"final_{name}"][i]


def test_opens_in_xarray_with_coordinates(known):
    with open_ensemble(known) as data:
        assert data.pressure.dims == ("case", "step", "element")
        assert {"wear.lower.k", "upper.young", "upper.r"} <= set(data.pressure.coords)
        first = data.isel(case=0)
        assert float(first["wear.lower.k"]) == 1e-8
        assert data.sel(case=str(first.case.values)).penetration[-1] == first.penetration[-1]
        assert data.pressure.attrs["units"] == "MPa"
        assert list(data.step.values) == list(range(21))
        assert tomllib.loads(data.attrs["case"])["wear"]["lower"]["p0"] == 40.0


@pytest.mark.usefixtures("small_blocks")
def test_blocks_of_any_size_give_the_same(known, tmp_path, comm):
    """To round-off, in the order of the design; only results are left of them."""
    rw.sweep(known.parent / "study.toml", tmp_path / "out", comm)
    found, exact = variables(tmp_path / "out"), variables(known)
    for name in ("case", "upper.r", "time"):
        assert np.array_equal(found[name], exact[name]), name
    for name in ("penetration", "wear_lower", "worn_volume_lower", "final_penetration"):
        np.testing.assert_allclose(found[name], exact[name], rtol=1e-12, atol=1e-18)
    assert {p.name for p in (tmp_path / "out").iterdir()} == {"results.h5", "cases.csv"}


def test_blocks_do_not_depend_on_anything_but_cases(write, tmp_path):
    """Numbers drawn anew are other blocks; a longer design begins with those of a shorter one."""
    drawn = '[vary]\n"wear.lower.k" = {{ log = [1e-8, 1e-6] }}\n[design]\nmethod = "sobol"\n'
    drawn += "count = {}\nseed = {}\n"
    cases = [rw.read_study(write(drawn.format(*n))) for n in ((4096, 1), (8192, 1), (4096, 2))]
    short, long, other = ([b.path for b in blocks.blocks_of(s, tmp_path)] for s in cases)
    assert len(short) > 1
    assert long[: len(short)] == short
    assert not set(other) & set(short)


def test_different_sizes_are_padded(write, tmp_path, comm):
    path = write(
        '[vary]\n"mesh.contact_elements" = { values = [8, 16] }\n'
        '"time.steps" = { values = [3, 7] }\n"output.profiles" = { values = ["last"] }\n'
    )
    rw.sweep(path, tmp_path / "out", comm)
    found = variables(tmp_path / "out")
    assert found["pressure"].shape == (4, 16)
    assert list(found["elements"]) == [8, 8, 16, 16]
    assert list(found["steps_stored"]) == [4, 8, 4, 8]
    for i, (rows, n) in enumerate(zip(found["steps_stored"], found["elements"], strict=True)):
        assert np.isfinite(found["penetration"][i, :rows]).all()
        assert np.isnan(found["penetration"][i, rows:]).all()
        assert np.isfinite(found["pressure"][i, :n]).all()
        assert np.isnan(found["pressure"][i, n:]).all()
        edges = edge_elements(found["pressure"][i, :n])
        assert np.array_equal(found["edge_element"][i, :n], edges)
        assert np.isnan(found["edge_element"][i, n:]).all()
        assert found["final_penetration"][i] == found["penetration"][i, rows - 1]


def test_again_recomputes_nothing_and_changes_nothing(known, tmp_path, comm):
    """Of the file, or of its tables."""
    copied = shutil.copytree(known, tmp_path / "out")
    path = known.parent / "study.toml"
    tables = tomllib.loads(path.read_text()) | {"case": tomllib.loads(CASE)}
    for source in (path, tables):
        summary = rw.sweep(source, copied, comm)
        assert (summary.total, summary.done, summary.failed, summary.computed) == (12, 12, 0, 0)
        assert_same_sweeps(copied, known)
    assert tomllib.loads(read_ensemble(copied).attributes["study"])["vary"] == tables["vary"]


@pytest.mark.parametrize("changed", ["study", "version"])
def test_a_folder_of_another_study_or_version_is_refused(
    write, known, tmp_path, comm, monkeypatch, changed
):
    copied = shutil.copytree(known, tmp_path / "out")
    path = write(STUDY.replace("[5e4, 1e5]", "[1e5, 2e5]") if changed == "study" else STUDY)
    if changed == "version":
        monkeypatch.setattr(study, "__version__", "98.0")
    with pytest.raises(rw.InputError, match="another study"):
        rw.sweep(path, copied, comm)
    assert table(copied) == table(known)


def raising(monkeypatch, message="this law blows up"):
    """Have the law give no numbers for one of COEFFICIENTS, for a reason."""
    kind = vars(LAWS["threshold"])

    def some(p, at, k, p0):
        rate, rise = threshold(p, at, k, p0)
        return np.where(np.isclose(k, 1e-7), np.nan, rate), rise

    monkeypatch.setitem(kind, "function", some)
    for name in ("contact_failure", "step_failure"):
        where = f"ringwear_par.history.loop.{name}"
        monkeypatch.setattr(where, lambda *_: rw.ComputationError(message))
    return lambda: monkeypatch.setitem(kind, "function", threshold)


@pytest.mark.usefixtures("small_blocks")
def test_a_failed_case_is_a_row_and_the_others_go_on(write, tmp_path, comm, monkeypatch):
    path = write(COEFFICIENTS + '"wear.lower.p0" = { linear = [0, 60], count = 4 }\n')
    message = '\N{GREEK SMALL LETTER MU}, "mm"\n' + 30 * "long "
    folder, mend = tmp_path / "out", raising(monkeypatch, message)
    with pytest.raises(rw.ComputationError, match="4 of 12"):
        rw.sweep(path, folder, comm)
    rows = table(folder)
    assert [row["status"] for row in rows] == ["done"] * 4 + ["failed"] * 4 + ["done"] * 4
    with open_ensemble(folder) as data:
        assert [str(error) for error in data.error.values] == [row["error"] for row in rows]
    assert all("\N{GREEK SMALL LETTER MU}" in row["error"] for row in rows[4:8])
    mend()
    with pytest.raises(rw.ComputationError, match="4 of 12"):
        rw.sweep(path, folder, comm)  # failures are results as well
    summary = rw.sweep(path, folder, comm, retry_failed=True)
    assert (summary.done, summary.failed, summary.computed) == (12, 0, 4)  # a block of four
    assert all(row["status"] == "done" for row in table(folder))


def test_a_bad_corner_is_a_failed_case(write, tmp_path, comm):
    """Each value is right with some of the others."""
    path = write(
        '[vary]\n"lower.r[1]" = { values = [30, 40] }\n"upper.r[0]" = { values = [28.5, 31] }\n'
    )
    with pytest.raises(rw.ComputationError, match="1 of 4"):
        rw.sweep(path, tmp_path / "out", comm)
    (failed,) = [row for row in table(tmp_path / "out") if row["status"] == "failed"]
    assert (failed["lower.r[1]"], failed["upper.r[0]"]) == ("30", "31")
    assert "upper" in failed["error"]


def test_a_dry_run_computes_a_block_and_keeps_it(write, tmp_path, comm, capsys):
    sweep.run_sweep(write(STUDY), tmp_path / "out", comm, dry_run=True)
    output = capsys.readouterr().out
    assert "12 cases in 1 block" in output
    assert "one block of 12 cases took" in output
    assert rw.sweep(write(STUDY), tmp_path / "out", comm).computed == 0


def test_a_sweep_without_memory_for_it_is_refused(write, tmp_path, comm, with_memory):
    with_memory(1e9)
    path = write(COEFFICIENTS + '"mesh.contact_elements" = { values = [6000] }\n')
    with pytest.raises(rw.InputError, match="memory"):
        rw.sweep(path, tmp_path / "out", comm)
    assert not (tmp_path / "out").exists()


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
