"""What the command refuses: one sentence from all ranks together, status 2, and nothing written.

In this process, on its ranks; test_cli.py starts the command as a user does.
"""

import sys
from pathlib import Path

import pytest
from paths import CASES
from petsc4py import PETSc
from swept import write_study

from ringwear_par.cli import main

PAPER, COATED, STRESS = (str(CASES / f"{name}.toml") for name in ("paper", "coated", "stress"))


@pytest.fixture
def ringwear(shared_path, comm, monkeypatch, capfd):
    """Function that runs the command: its status here, and what all ranks say of errors."""
    monkeypatch.chdir(shared_path)

    def ringwear(*words):
        with monkeypatch.context() as patch:
            patch.setattr(sys, "stdout", sys.stdout)
            status = main(words)
            if comm.rank > 0:
                sys.stdout.close()
        said = comm.allgather(capfd.readouterr().err)
        return status, "".join(said)

    return ringwear


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["nowhere.toml", "-o", "a.h5"], "nowhere.toml: cannot be read"),
        ([PAPER, "-o", "a.h5", "--set", "wear.lower.K=1"], "did you mean wear.lower.k?"),
        ([PAPER, "-o", "no/a.h5"], "its folder no does not exist"),
        ([PAPER, "-o", "taken.h5"], "not a result file of ringwear"),
        ([PAPER, "-o", "a.h5", "--plot", "no/a.png"], "its folder no does not exist"),
        (
            [PAPER, "-o", "a.h5", "--plot", "a.png", "--set", "output.fields=['gap']"],
            "output.fields",
        ),
        ([PAPER, "-o", "a.h5", "--set", "time.steps=1000000000000"], "GB of memory"),
        (
            [COATED, "-o", "a.h5", "--set", "lower.layers[0].thickness=25"],
            "are 25 mm thick together; must be less than the 20 mm of lower",
        ),
        (
            [COATED, "-o", "a.h5", "--set", "lower.layers[0].wear={ law = 'treshold', k = 1 }"],
            '(did you mean "threshold"?)',
        ),
        (
            [PAPER, "-o", "a.h5", "--set", "stress.points=[[30, 20]]"],
            "lies on the faces of both bodies; must have its side",
        ),
        (
            [STRESS, "-o", "a.h5", "--set", "stress.grid.n=[1, 1]"],
            "--set stress.grid.n = [1, 1]: must be two whole numbers from 2 to 10000",
        ),
        (
            [STRESS, "-o", "a.h5", "--set", "stress.grid.n=[10000, 10000]"],
            "stress.grid.n = [10000, 10000]: needs about",
        ),
        ([PAPER, "-o", "a.h5", "--", "-bem_nonsense", "3"], "-bem_nonsense: no solver"),
        ([PAPER, "-o", "a.h5", "--", "-contact_tao_type", "lmvm"], "must be one of python, tron"),
        ([PAPER, "-o", "a.h5", "--", "-bem_pc_type", "nonsense"], "-bem_... options"),
    ],
)
def test_bad_input_is_said_once_with_status_2(ringwear, shared_path, comm, words, said):
    if comm.rank == 0:
        (shared_path / "taken.h5").write_text("precious")
    comm.Barrier()
    options = PETSc.Options()
    if "--" in words:  # PETSc is under way here, and takes no more words
        name, value = words[words.index("--") + 1 :]
        options[name.lstrip("-")] = value
    try:
        status, errors = ringwear("run", *words)
    finally:
        if "--" in words:
            options.delValue(name.lstrip("-"))
    assert status == 2
    assert "Traceback" not in errors
    assert errors.startswith("ringwear: ")
    assert errors.count("ringwear: ") == errors.count("\n") == 1
    assert said in errors
    assert [p.name for p in shared_path.iterdir()] == ["taken.h5"]


@pytest.mark.serial
@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["sweep", "no.toml", "-o", "a", "--slice", "1/" + "9" * 20], "and N at most 100000"),
        (["sweep", "no.toml", "-o", "a", "--slice", "3/2"], "I/N with I from 1 to N"),
        (["export", "a.h5", "-o", "a.vtkhdf", "--revolve", "99999999"], "must be from 3 to 3600"),
        (["run", PAPER, "-o", "a.h5", "--", "foo"], "-- foo: must be an option of PETSc"),
        (["run", PAPER, "-o", "a.h5", "--", "-options_file", "no"], "-options_file no: cannot be"),
        (["run", "x" * 5000, "-o", "a.h5"], "x ... xxxxxxxxxxxxxxxx: File name too long"),
        (["run", PAPER, "-o", "x" * 250], "cannot be written: File name too long"),
        (
            ["run", PAPER, "-o", "a.h5", "--set", "lower.young=\x1b\r"],
            r'young = "\u001b": must',
        ),
        (["run", PAPER, "-o", "a.h5", "--set", "\x1b=1"], r"--set \x1b: unknown key"),
        (["plot", "a\x1b.h5", "-o", "a.png"], r"a\x1b.h5: does not exist"),
        (["plot", "/proc/self/mem", "-o", "a.png"], "mem: cannot be read: Input/output error"),
    ],
)
def test_words_of_any_sort_are_refused_in_one_sentence(ringwear, shared_path, words, said):
    status, errors = ringwear(*words)
    assert status == 2
    assert errors.startswith("ringwear: ")
    assert errors.count("ringwear: ") == errors.count("\n") == 1
    assert said in errors
    assert len(errors) < 1100
    assert not list(shared_path.iterdir())


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="no such folders here")
@pytest.mark.parametrize("where", ["/proc/no", "/sys/no", "/dev/null"])
def test_a_folder_that_cannot_be_written_is_refused(ringwear, shared_path, comm, where):
    study = write_study(shared_path, comm)
    status, errors = ringwear("sweep", str(study), "-o", where)
    assert status == 2, errors
    assert errors.startswith("ringwear: ")
    assert errors.count("ringwear: ") == errors.count("\n") == 1
