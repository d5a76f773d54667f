"""``ringwear run`` where a result is there: complete, interrupted, failed, of another case."""

import pytest
from changed_steps import change_steps
from paths import PAPER

import ringwear_par as rw
from ringwear_par.results.execution.run import run_case
from ringwear_par.results.storage.result_files import open_result, read_status

SMALL = ["mesh.contact_elements=16", "time.steps=20"]
#: wears half of the lower body off after some steps
TOO_MUCH = [*SMALL, "wear.lower.k=1e-3", "time.step=20"]


@pytest.fixture
def failed(tmp_path, comm):
    """A run that has failed, and kept the steps before."""
    path = tmp_path / "run.h5"
    with pytest.raises(rw.ComputationError, match="half of its height"):
        run_case(PAPER, path, TOO_MUCH, comm=comm)
    return path


@pytest.fixture
def interrupted(tmp_path, comm, stopped_after):
    path = tmp_path / "run.h5"
    with stopped_after(7), pytest.raises(rw.ComputationError, match="SIGTERM after step 7"):
        run_case(PAPER, path, SMALL, comm=comm)
    return path


def test_a_failed_run_says_why_and_is_replaced(failed, comm):
    assert "half of its height" in open_result(failed).attributes["error"]
    assert "failed" in open_result(failed).summary().splitlines()[0]
    assert read_status(failed)[0] == "incomplete"
    run_case(PAPER, failed, SMALL, comm=comm)
    assert read_status(failed) == ("complete", 20)
    assert open_result(failed).attributes["error"] == ""


def test_an_interrupted_run_is_kept_until_it_is_said_what_becomes_of_it(interrupted, comm):
    other = [*SMALL, "wear.lower.k=2e-7"]
    for keys, how, said in (
        (SMALL, {}, "step 7"),
        (other, {}, "another case"),
        (other, {"restart": True}, "another case"),
        (SMALL, {"restart": True, "overwrite": True}, "--overwrite"),
    ):
        with pytest.raises(rw.InputError, match=said):
            run_case(PAPER, interrupted, keys, comm=comm, **how)
    assert read_status(interrupted) == ("incomplete", 7)
    assert "step 7 of 20" in open_result(interrupted).summary().splitlines()[0]
    run_case(PAPER, interrupted, other, comm=comm, overwrite=True)
    assert read_status(interrupted) == ("complete", 20)


def test_a_case_file_is_never_overwritten(tmp_path, comm):
    path = tmp_path / "case.toml"
    path.write_text(PAPER.read_text())
    with pytest.raises(rw.InputError, match="case file"):
        run_case(path, path, SMALL, comm=comm, overwrite=True)
    assert path.read_text() == PAPER.read_text()


def test_what_makes_an_answer_doubtful_is_stored(tmp_path, comm, capsys):
    path = tmp_path / "run.h5"
    keys = [*SMALL, "time.scheme=explicit", "time.step=60", "time.steps=3"]
    run_case(PAPER, path, keys, comm=comm)
    (doubt,) = open_result(path).doubts
    told = doubt.text
    assert "times its stability limit" in told
    out, err = capsys.readouterr()
    assert out.splitlines()[0] == f"warning: {told}"
    assert told not in err


def test_a_failure_at_a_time_of_output_leaves_no_row_twice(tmp_path, comm, monkeypatch):
    """Neither in the file of the failed run, nor after it has been gone on with."""
    whole, parts = tmp_path / "whole.h5", tmp_path / "parts.h5"
    keys = ["mesh.contact_elements=16", "time.step=1", "time.steps=4", "output.times=[0.5,2.2,2.5]"]
    run_case(PAPER, whole, keys, comm=comm)

    def failing(scheme, physics, contacts, state, end):
        if end[0] == 2.5:
            raise rw.ComputationError("contact: no")
        return scheme(physics, contacts, state, end)

    with monkeypatch.context() as patch:
        change_steps(patch, failing)
        with pytest.raises(rw.ComputationError, match=r"contact: no.*step 3"):
            run_case(PAPER, parts, keys, comm=comm)
    assert open_result(parts).histories["time"].tolist() == [0.0, 0.5]
    run_case(PAPER, parts, keys, comm=comm, restart=True)
    one, two = open_result(whole), open_result(parts)
    assert one.histories["time"].tolist() == [0.0, 0.5, 2.2, 2.5, 4.0]
    for name, values in one.histories.items():
        if name != "contact_iterations":  # a failed run goes on from cold
            assert two.histories[name] == pytest.approx(values, rel=1e-9, abs=1e-12), name


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


def test_a_run_of_another_version_says_so(tmp_path, comm, monkeypatch, caplog):
    from ringwear_par import __version__, version

    path = tmp_path / "run.h5"
    with monkeypatch.context() as patch:
        patch.setattr(version, "__version__", "0.0.9")
        run_case(PAPER, path, SMALL, comm=comm)
    run_case(PAPER, path, [*SMALL, "time.steps=25"], comm=comm, restart=True)
    found = open_result(path).attributes
    assert (found["begun_by"], found["version"]) == ("0.0.9", __version__)
    assert "computed so far by version 0.0.9" in caplog.text


def test_a_result_with_derivatives_does_not_go_on_without_them(tmp_path, comm):
    path = tmp_path / "derived.h5"
    keys = dict(key.split("=") for key in SMALL)
    case = rw.read_case(PAPER, {key: float(value) for key, value in keys.items()})
    rw.simulate(case, comm, derivatives=["wear.lower.k"]).save(path)
    longer = [*SMALL, "time.steps=25"]
    with pytest.raises(rw.InputError, match="derivatives"):
        run_case(PAPER, path, longer, comm=comm, restart=True)
    assert read_status(path) == ("complete", 20)
    assert open_result(path).derivatives
