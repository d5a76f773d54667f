"""``ringwear measure`` as users type it."""

import shutil
from pathlib import Path

import pytest
from commands import NEEDS_MPIRUN, ringwear, sentences
from paths import ROOT

from ringwear_par.cli import main

EXAMPLE = ROOT / "scripts/measure"


@pytest.fixture
def laboratory(tmp_path, monkeypatch):
    """A copy of the example, in which commands run."""
    folder = tmp_path / "laboratory"
    shutil.copytree(EXAMPLE, folder)
    monkeypatch.chdir(folder)
    return folder


@pytest.fixture
def measure(laboratory, capsys):
    """Function that runs the command here: its status, its output and its sentences."""

    def measure(*words):
        status = main(["measure", *map(str, words), "-o", "out"])
        output, errors = capsys.readouterr()
        return status, output, errors

    return measure


def test_a_measure_file_and_records_alike(measure, laboratory):
    status, output, errors = measure("measure.toml")
    assert (status, errors) == (0, "")
    assert output.startswith("specific wear rate 1.")
    assert {path.name for path in Path("out").iterdir()} == {
        "measure.json", "measure.csv", "measure.png",
    }  # fmt: skip
    records = [f"W{i}.csv" for i in (1, 2, 3, 4)]
    status, other, _ = measure(*records, "--case", "rig.toml", "--masses", "masses.csv")
    assert status == 0
    assert other.splitlines()[0] != ""
    assert len(other.splitlines()) == len(output.splitlines())


@NEEDS_MPIRUN
def test_ranks_say_it_once(laboratory):
    Path("W2.csv").write_text("t / min,z / um\n1,2\n3,x\n")
    result = ringwear("measure", "measure.toml", "-o", "new", ranks=2)
    assert result.returncode == 2
    (sentence,) = sentences(result)
    assert "W2.csv" in sentence
    assert not Path("new").exists()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["W1.csv"], "--case"),
        (["measure.toml", "W1.csv"], "only file"),
        (["measure.toml", "--case", "rig.toml"], "case"),
        (["rig.toml"], "[[test]]"),
    ],
)
def test_what_cannot_be_typed(words, said, measure):
    status, _, errors = measure(*words)
    assert (status, len(errors.splitlines())) == (2, 1)
    assert said in errors
    assert not Path("out").exists()


def test_a_folder_that_cannot_be_written_is_refused_first(measure):
    Path("out").write_text("a file")
    status, _, errors = measure("measure.toml")
    assert status == 2
    assert "out: is a file" in errors
