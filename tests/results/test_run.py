"""``ringwear run`` where a result is there: complete, interrupted, failed, of another case."""

from pathlib import Path

import h5py
import pytest

from ringwear_par.errors import ComputationError, InputError
from ringwear_par.results.files import open_result, read_status
from ringwear_par.results.run import run_case

PAPER = Path(__file__).parents[2] / "scripts" / "cases" / "paper.toml"
SMALL = ["mesh.contact_elements=16", "time.steps=20"]
#: wears half of the lower body off after some steps
TOO_MUCH = [*SMALL, "wear.lower.k=1e-3", "time.step=20"]


@pytest.fixture
def failed(shared_path, comm):
    """A run that has failed, and kept the steps before."""
    path = shared_path / "run.h5"
    with pytest.raises(ComputationError, match=r"half of its height; .*holds the steps before"):
        run_case(PAPER, path, TOO_MUCH, comm=comm)
    return path


@pytest.fixture
def interrupted(shared_path, comm, stopped_after):
    path = shared_path / "run.h5"
    with stopped_after(7), pytest.raises(ComputationError, match="SIGTERM after step 7"):
        run_case(PAPER, path, SMALL, comm=comm)
    return path


def test_a_failed_run_says_why_and_is_replaced(failed, comm):
    assert "more than half of its height" in open_result(failed).attributes["error"]
    assert read_status(failed)[0] == "incomplete"
    run_case(PAPER, failed, SMALL, comm=comm)
    assert read_status(failed) == ("complete", 20)
    assert open_result(failed).attributes["error"] == ""


def test_a_failed_run_does_not_go_on_as_another_case(failed, comm):
    with pytest.raises(InputError, match="holds another case"):
        run_case(PAPER, failed, SMALL, comm=comm, restart=True)


def test_an_interrupted_run_is_kept(interrupted, comm):
    with pytest.raises(InputError, match=r"after step 7; --restart continues it, --overwrite"):
        run_case(PAPER, interrupted, SMALL, comm=comm)
    with pytest.raises(InputError, match=r"one of another case, and --overwrite replaces it"):
        run_case(PAPER, interrupted, [*SMALL, "wear.lower.k=2e-7"], comm=comm)
    assert read_status(interrupted) == ("incomplete", 7)


def test_an_interrupted_run_is_overwritten_if_that_is_said(interrupted, comm):
    run_case(PAPER, interrupted, [*SMALL, "wear.lower.k=2e-7"], comm=comm, overwrite=True)
    assert read_status(interrupted) == ("complete", 20)


def test_going_on_and_starting_anew_exclude_each_other(interrupted, comm):
    with pytest.raises(InputError, match="--restart, --overwrite: must be one of them"):
        run_case(PAPER, interrupted, SMALL, comm=comm, overwrite=True, restart=True)


def test_what_makes_an_answer_doubtful_is_stored(shared_path, comm, caplog):
    path = shared_path / "run.h5"
    keys = [*SMALL, "time.scheme=explicit", "time.step=60", "time.steps=3"]
    run_case(PAPER, path, keys, comm=comm)
    (told,) = open_result(path).doubts
    assert "times its stability limit" in told
    if comm.rank == 0:
        assert told in caplog.text


def test_the_summary_leads_with_what_can_be_wrong(shared_path, comm, capsys):
    run_case(PAPER, shared_path / "run.h5", SMALL, comm=comm)
    if comm.rank > 0:
        return
    lines = capsys.readouterr().out.splitlines()
    places = [
        next(i for i, line in enumerate(lines) if words in line)
        for words in (
            "lower wears by k mu max(0, p - p0) V with k = 1e-07 1/MPa, p0 = 40 MPa",
            "contact (KKT)",
            "force on the fixed faces",
            "estimated error of wear of a time step",
            "approach 0.0",
        )
    ]
    assert places == sorted(places)
    with h5py.File(shared_path / "run.h5") as file:
        assert file.attrs["law_lower"].startswith("k mu max(0, p - p0) V with k")
        assert file.attrs["law_upper"] == ""
