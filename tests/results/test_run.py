"""``ringwear run`` where a result is there: complete, interrupted, failed, of another case."""

import numpy as np
import pytest
from parts import FigureFile
from paths import PAPER

import ringwear_par as rw
from ringwear_par.results import run
from ringwear_par.results.files import open_result
from ringwear_par.results.run import run_case

SMALL = ["mesh.contact_elements=16", "time.steps=20"]
#: wears half of the lower body off after some steps
TOO_MUCH = [*SMALL, "wear.lower.k=1e-3", "time.step=20"]


def state_of(path):
    """Status and last step of a run."""
    result = open_result(path)
    return result.attributes["status"], int(result.last_state.steps[0])


@pytest.fixture
def interrupted(tmp_path, comm, stopped_after):
    path = tmp_path / "run.h5"
    with stopped_after(7), pytest.raises(rw.ComputationError, match="SIGTERM after step 7"):
        run_case(PAPER, path, SMALL, comm=comm)
    return path


def test_a_failed_run_says_why_and_is_replaced(tmp_path, comm):
    """It has kept the steps before."""
    path = tmp_path / "run.h5"
    with pytest.raises(rw.ComputationError, match="half of its height"):
        run_case(PAPER, path, TOO_MUCH, comm=comm)
    assert "half of its height" in open_result(path).attributes["error"]
    assert "failed" in open_result(path).summary().splitlines()[0]
    assert state_of(path)[0] == "incomplete"
    run_case(PAPER, path, SMALL, comm=comm)
    assert state_of(path) == ("complete", 20)
    assert open_result(path).attributes["error"] == ""


def test_an_interrupted_run_is_kept_until_it_is_said_what_becomes_of_it(interrupted, comm):
    other = [*SMALL, "wear.lower.k=2e-7"]
    for keys, how, said in (
        (SMALL, {}, "step 7"),
        (other, {"restart": True}, "another case"),
        (SMALL, {"restart": True, "overwrite": True}, "--overwrite"),
    ):
        with pytest.raises(rw.InputError, match=said):
            run_case(PAPER, interrupted, keys, comm=comm, **how)
    assert state_of(interrupted) == ("incomplete", 7)
    assert "step 7, t = " in open_result(interrupted).summary().splitlines()[0]
    run_case(PAPER, interrupted, other, comm=comm, overwrite=True)
    assert state_of(interrupted) == ("complete", 20)


@pytest.mark.parametrize(
    ("profiles", "step", "rows"),
    [("all", 8, [0, 6, 8]), ("last", 8, [0, 6, 8]), ("all", 6, [0, 6])],
)
def test_a_stopped_run_stores_its_last_state_once(
    profiles, step, rows, tmp_path, comm, stopped_after
):
    """Its numbers are all of that state; what goes on from it has no such row."""
    path, keys = tmp_path / "run.h5", [*SMALL, "output.every=6", f"output.profiles={profiles}"]
    with stopped_after(step), pytest.raises(rw.ComputationError, match=f"after step {step}"):
        run_case(PAPER, path, keys, comm=comm)
    found = open_result(path)
    assert found.step.tolist() == rows
    numbers = {name: n["value"] for name, n in found.to_dict()["numbers"].items()}
    assert numbers["penetration"] == pytest.approx(numbers["worn_off"] + numbers["elastic"])
    assert 0.0 < numbers["worn_off"] < numbers["penetration"]
    wear = np.atleast_2d(found.profiles["wear_lower"])[-1]
    assert numbers["lower_deepest_wear"] == pytest.approx(1e3 * wear.max())
    run_case(PAPER, path, keys, comm=comm, restart=True)
    assert open_result(path).step.tolist() == [0, 6, 12, 18, 20]


def test_a_boundary_field_is_not_lost_in_a_lengthened_run(tmp_path, comm):
    """The last row of the shorter run is no row of the longer one, nor the row before its times."""
    keys = ["mesh.contact_elements=16", "time.scheme=adaptive", "output.every=7",
            "output.boundary=[3.0]"]  # fmt: skip
    whole, parts = tmp_path / "whole.h5", tmp_path / "parts.h5"
    run_case(PAPER, whole, [*keys, "time.end=50"], comm=comm)
    run_case(PAPER, parts, [*keys, "time.end=5"], comm=comm)
    run_case(PAPER, parts, [*keys, "time.end=50"], comm=comm, restart=True)
    for path in (whole, parts):
        (found,) = open_result(path).boundary
        assert found.step == 7
        assert found.time > 3.0


def test_a_run_of_another_version_does_not_go_on(tmp_path, comm, monkeypatch):
    from ringwear_par import version

    path = tmp_path / "run.h5"
    with monkeypatch.context() as patch:
        patch.setattr(version, "__version__", "0.0.9")
        run_case(PAPER, path, SMALL, comm=comm)
    with pytest.raises(rw.InputError, match=r"version 0\.0\.9"):
        run_case(PAPER, path, [*SMALL, "time.steps=25"], comm=comm, restart=True)


def test_a_complete_run_is_kept_and_drawn(tmp_path, comm):
    """Nor is it made shorter."""
    path, figure = tmp_path / "run.h5", tmp_path / "run.png"
    run_case(PAPER, path, SMALL, comm=comm)
    before = path.read_bytes()
    run_case(PAPER, path, SMALL, comm=comm, restart=True, figure=FigureFile(figure))
    assert figure.exists()
    with pytest.raises(rw.InputError, match="at least as long"):
        run_case(PAPER, path, [*SMALL, "time.steps=10"], comm=comm, restart=True)
    assert path.read_bytes() == before


def test_checkpoints_are_written_on_the_way(tmp_path, comm, monkeypatch):
    seen, write = [], run.write_result

    def noted(path, *args):
        write(path, *args)
        seen.append(state_of(path))

    monkeypatch.setattr(run, "write_result", noted)
    monkeypatch.setattr(run, "CHECKPOINT_SECONDS", 0.0)
    run_case(PAPER, tmp_path / "run.h5", SMALL, comm=comm)
    assert seen == [*(("incomplete", step) for step in range(1, 20)), ("complete", 20)]


@pytest.mark.parametrize(
    ("output", "word"),
    [
        ("text.h5", "not a result"), ("folder.h5", "is a folder"), ("no/run.h5", "does not exist"),
        ("case.toml", "case file"), ("run.csv", "ringwear export"),
    ],
)  # fmt: skip
def test_outputs_that_are_not_ours_are_refused(tmp_path, comm, output, word):
    (tmp_path / "text.h5").write_text("precious")
    (tmp_path / "folder.h5").mkdir()
    case = tmp_path / "case.toml"
    case.write_text(PAPER.read_text())
    before = {path: path.is_file() and path.read_text() for path in tmp_path.rglob("*")}
    with pytest.raises(rw.InputError, match=word):
        run_case(case, tmp_path / output, SMALL, comm=comm, overwrite=output != "text.h5")
    assert {path: path.is_file() and path.read_text() for path in tmp_path.rglob("*")} == before
