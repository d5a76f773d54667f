"""``ringwear measure`` as users type it: all that is wrong is told, and nothing is written."""

import shutil
from pathlib import Path

import pytest
from commands import on_ranks, ringwear, sentences
from paths import ROOT

from ringwear_par.cli import main

pytestmark = pytest.mark.serial
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


@pytest.mark.parametrize("ranks", on_ranks(2))
def test_ranks_say_it_once(ranks, laboratory):
    result = ringwear("measure", "measure.toml", "-o", "out", ranks=ranks)
    assert result.returncode == 0, result.stderr
    assert result.stdout.count("repeatability") == 1
    Path("W2.csv").write_text("t / min,z / um\n1,2\n3,x\n")
    result = ringwear("measure", "measure.toml", "-o", "new", ranks=ranks)
    assert result.returncode == 2
    (sentence,) = sentences(result)
    assert 'measure.toml: test "W2": W2.csv: has 2 different times' in sentence
    assert not Path("new").exists()


def change(name, old, new):
    path = Path(name)
    content = path.read_bytes()
    assert old.encode("cp1252") in content or old.encode() in content
    encoding = "cp1252" if name == "W1.csv" else "utf-8"
    path.write_bytes(content.replace(old.encode(encoding), new.encode(encoding), 1))


@pytest.mark.parametrize(
    ("name", "old", "new", "said"),
    [
        # each laboratory's file in a broken version
        ("W1.csv", "4,0;", "4,0;;", "W1.csv: line 9: has 5 values; must have 4, as line 6"),
        ("W2.csv", "2026-03-14 08:19:00", "2026-03-14 08:16:00", "W2.csv: line 6: timestamp = "
         "2026-03-14 08:16:00: goes back, line 5 has 2026-03-14 08:17:00"),
        ("W2.csv", "timestamp,", "wann,", "has the columns wann, wear [µm], friction torque [Nm]; "
         "must have one of time"),
        ("W4.csv", "torque_Nm", "depth_mm", "columns depth_um and depth_mm may both be of"),
        ("masses.csv", "W2;", "W1;", "masses.csv: line 4: W1: has two rows"),
        # keys
        ("measure.toml", "masses.csv", "mass.csv", "measure.toml: measure.masses: mass.csv"),
        ("measure.toml", "sd =", "u =", "masses: u: unknown key; must be one of file, sd"),
        ("measure.toml", '"0.1 mg"', "0.1", 'sd = 0.1: must have its unit, such as "0.1 mg"'),
        ("measure.toml", "W1.csv", "masses.csv", "is a table of weighings, not a record; it must"),
        ("measure.toml", '"0.1 mg"', '"0.1 mm"', "must be a finite number > 0 (mm is no unit"),
        ("measure.toml", '"6 N"', '"6 kg"', "load.force = \"6 kg\": must be a number > 0"),
        ("measure.toml", "load.force", "load.forse", "load.forse: unknown key (did you mean load"),
        ("measure.toml", "relative = 0.004", "relative = 4", 'lower.density = { "relative" = 4 }'),
        ("measure.toml", 'case = "rig.toml"', 'case = "no.toml"', "no.toml: cannot be read"),
        ("measure.toml", "[measure]", "[measures]", "measures: unknown key (did you mean measure"),
        ("measure.toml", '"W2"', '"W1"', 'test "W1": name: there are two tests of this name'),
        ("measure.toml", "W3.csv", "W7.csv", "W7.csv: cannot be read: No such file"),
        ("measure.toml", "[measure]", "[measure]\nsteady = { wear = 2 }", "must be a number > 0"),
        ("measure.toml", "[measure]", '[measure]\nsteady = { from = "19 h" }', "must be at most"),
        ("measure.toml", '"W1.csv"', '"W1.csv"\nset = { "time.end" = "20 min" }',
         "time.end = 1200 s: the record is 72000 s long"),
        ("measure.toml", '"W1.csv"', '"W1.csv"\nset = { "load.forces" = 3 }', "load.forces"),
        ("measure.toml", '"W1.csv"', '"W1.csv"\nsense = "down"', 'sense = "down": must be one of'),
        ("measure.toml", '"W1.csv"', '"W1.csv"\nexclude = [[3, 2]]', "must be a list of"),
        ("measure.toml", '"W1.csv"', '"W1.csv"\ncolumns = { weg = "z" }', "must be a table of"),
        # the rig
        ("rig.toml", "density = 0.0019\n", "", "lower.density is missing: a weighing needs it"),
        ("rig.toml", "force = 1130.0", "displacement = 0.1",
         'load.control = "displacement": must be "force"'),
        ("rig.toml", "[wear.lower]", "[wear.upper]", "upper.density is missing"),
        ("rig.toml", "force = 1130.0", "force = [[0, 9], [1, 0], [2, 9]]", "load.force = a table "
         "to 9 and load.omega = 6.28319: the load must be > 0 at all times"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_told(name, old, new, said, measure):
    if new == "displacement = 0.1":
        change(name, 'omega = "60 rpm"', 'omega = "60 rpm"\ncontrol = "displacement"')
    change(name, old, new)
    status, output, errors = measure("measure.toml")
    assert (status, output) == (2, "")
    assert said in errors
    assert "Traceback" not in errors
    assert not Path("out").exists()


def test_all_faults_together(measure):
    change("W1.csv", "t / min;", "t;")
    change("W3.csv", "17.03.2026 17:44:30", "17.03.2026 17:40:00")
    change("masses.csv", "W2;", "W1;")
    change("measure.toml", '"6 N"', "-6")
    status, _, errors = measure("measure.toml")
    assert status == 2
    assert len(errors.splitlines()) == 4
    assert all(line.startswith("ringwear: measure.toml: ") for line in errors.splitlines())


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["W1.csv"], "W1.csv: case is missing: --case RIG.toml (a case file with rings, load"),
        (["measure.toml", "W1.csv"], "measure.toml: a measure file must be the only file"),
        (["measure.toml", "--case", "rig.toml"], "case = rig.toml: must be absent beside"),
        (["rig.toml"], "rig.toml: is a case, not a measure file; [[test]] is missing"),
        (["W1.csv", "W1.csv", "--case", "rig.toml"], 'test "W1": name: there are two tests'),
        (["no.csv", "--case", "rig.toml"], "no.csv: cannot be read: No such file or directory"),
        (["W1.csv", "--case", "no.toml"], "no.toml: cannot be read"),
        (["rig.toml.csv"], "case is missing"),
    ],
)  # fmt: skip
def test_what_cannot_be_typed(words, said, measure):
    status, _, errors = measure(*words)
    assert status == 2
    assert said in errors
    assert len(errors.splitlines()) == 1
    assert not Path("out").exists()


def test_a_folder_that_cannot_be_written_is_refused_first(measure):
    Path("out").write_text("a file")
    status, _, errors = measure("measure.toml")
    assert (status, errors) == (2, "ringwear: out: is a file; must be a folder, or new\n")
