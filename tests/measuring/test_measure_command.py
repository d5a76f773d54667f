"""``ringwear measure`` as users type it."""

import shutil
from pathlib import Path

import pytest
from parts import main
from paths import ROOT


@pytest.fixture
def measure(tmp_path, monkeypatch, capsys):
    """Function that runs the command in a copy of the example: status, output and sentences."""
    monkeypatch.chdir(shutil.copytree(ROOT / "scripts/measure", tmp_path / "laboratory"))

    def measure(*words):
        status = main(["measure", "-o", "out", *words])
        output, errors = capsys.readouterr()
        return status, output, errors

    return measure


def test_a_measure_file_and_records_alike(measure):
    status, output, errors = measure("measure.toml")
    assert (status, errors) == (0, "")
    assert output.startswith("specific wear rate 1.")
    assert {path.name for path in Path("out").iterdir()} == {
        "measure.json", "measure.csv", "measure.png",
    }  # fmt: skip
    records = [f"W{i}.csv" for i in (1, 2, 3, 4)]
    status, other, _ = measure(*records, "--case", "rig.toml", "--masses", "masses.csv")
    assert status == 0
    assert len(other.splitlines()) == len(output.splitlines())


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["W1.csv"], "--case"),
        (["measure.toml", "W1.csv"], "only file"),
        (["measure.toml", "--case", "rig.toml"], "case"),
        (["rig.toml"], "[[test]]"),
        (["measure.toml", "-o", "W1.csv"], "is a file"),
    ],
)
def test_what_cannot_be_typed(words, said, measure):
    status, _, errors = measure(*words)
    assert (status, len(errors.splitlines())) == (2, 1)
    assert said in errors
    assert not Path("out").exists()
