"""What two records of ``scripts/baseline.py`` say of each other."""

import baseline
import h5py
import numpy as np
import pytest


def write(path, **contents):
    with h5py.File(path, "w") as file:
        for name, value in contents.items():
            file[f"run/{name}"] = value
    return path


@pytest.fixture
def before(tmp_path):
    wear = np.linspace(0.0, 1e-2, 5)
    return write(tmp_path / "before.h5", wear=wear, count=np.arange(3), text="one line\nanother")


def test_the_last_bit_of_an_array_and_a_word_of_a_text_are_differences(before, tmp_path, capsys):
    wear = np.linspace(0.0, 1e-2, 5)
    wear[2] = np.nextafter(wear[2], 1.0)
    after = write(tmp_path / "b.h5", wear=wear, count=np.arange(4), text="one line\nan other")
    assert baseline.compare(before, after) == 1
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "run/count: int64 (3,) became int64 (4,)"
    assert lines[1] == "run/text: 'another' became 'an other'"
    assert lines[2].startswith("run/wear: by 8.7e-19")


def test_arrays_of_one_record_alone_are_differences(before, tmp_path, capsys):
    after = write(tmp_path / "b.h5", wear=np.linspace(0.0, 1e-2, 5), gap=np.zeros(2))
    assert baseline.compare(before, after) == 1
    lines = capsys.readouterr().out.splitlines()
    assert [line.partition(": only ")[0] for line in lines[:3]] == [
        "run/count", "run/text", "run/gap",
    ]  # fmt: skip


def test_lines_and_numbers_of_clocks_and_versions_are_left_out(tmp_path):
    text = f"wear 3 um\nseconds: start-up 0.7\nwritten to {tmp_path}/run.h5"
    assert baseline.steady_text(text, tmp_path) == "wear 3 um\nwritten to FOLDER/run.h5"
    numbers = {"k": 1.0, "versions": {"numpy": "1"}, "tests": [{"seconds": 2.0, "n": 3}]}
    assert baseline.steady_numbers(numbers) == {"k": 1.0, "tests": [{"n": 3}]}
