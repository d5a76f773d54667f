"""Result files of strangers: looking at one runs nothing, and a damaged one is one sentence."""

import json
import os
import sys
from pathlib import Path

import h5py
import pytest
from paths import PAPER
from swept import CASE, write_study

import ringwear_par as rw
from ringwear_par.cli import main
from ringwear_par.errors import InputError

PAPER = str(PAPER)
SMALL = ["--set", "mesh.contact_elements=8", "time.steps=3"]
LAW = """
from pathlib import Path
Path({marker!r}).touch()
def rate(p, at):
    return 0.0 * p
"""

pytestmark = pytest.mark.serial


@pytest.fixture
def trap(tmp_path):
    """A Python file that leaves another when it is run, and the latter's name."""
    law, marker = tmp_path / "trap.py", tmp_path / "has_run"
    law.write_text(LAW.format(marker=str(marker)))
    return law, marker


@pytest.fixture
def run(tmp_path):
    """An interrupted run of a small case."""
    path = tmp_path / "run.h5"
    assert main(["run", PAPER, "-o", str(path), *SMALL]) == 0
    return path


def set_trap(path, law, told):
    """Let the stored case name a Python file; ``told``: the file says what it says, too."""
    keys = f'law = "user"\nfile = {json.dumps(str(law))}\n'
    with h5py.File(path, "r+") as file:
        text = file.attrs["case"]
        before, after = text.split("[wear.lower]\n")
        file.attrs["case"] = f"{before}[wear.lower]\n{keys}{after[after.index('[load]') :]}"
        file.attrs["status"] = "incomplete"
        if told:
            file.attrs["user_laws"] = json.dumps({"lower": law.read_text()})


@pytest.mark.parametrize(
    ("told", "words"),
    [
        (False, ["run", PAPER, "-o", "run.h5", *SMALL, "--restart"]),
        (True, ["run", PAPER, "-o", "run.h5", *SMALL, "--restart"]),
        (True, ["run", PAPER, "-o", "run.h5", *SMALL]),
        (True, ["plot", "run.h5", "-o", "a.png", "--panels", "wear,penetration,pressure"]),
        (True, ["plot", "run.h5", "other.h5", "-o", "a.png"]),
        (True, ["export", "run.h5", "-o", "a.csv"]),
        (True, ["report", "run.h5", "-o", "a.html"]),
        (True, ["run", PAPER, "-o", "run.h5", *SMALL, "--overwrite"]),
    ],
)
def test_a_law_that_only_a_result_file_names_is_not_run(
    run, trap, words, told, monkeypatch, capsys
):
    law, marker = trap
    set_trap(run, law, told)
    Path(run.parent / "other.h5").write_bytes(run.read_bytes())
    monkeypatch.chdir(run.parent)
    status = main(words)
    errors = capsys.readouterr().err
    assert status == (2 if words[0] == "run" and "--overwrite" not in words else 0), errors
    assert not marker.exists()
    result = rw.open_result("run.h5")
    assert result.summary(verbose=True)
    assert result.to_xarray()
    assert not marker.exists()


def test_a_law_that_the_case_names_too_is_run(run, trap, monkeypatch, capsys):
    """Else the tests above would show nothing."""
    law, marker = trap
    set_trap(run, law, told=True)
    case = ["--set", "wear.lower.law=user", f"wear.lower.file={law}", *SMALL[1:]]
    status = main(["run", PAPER, "-o", str(run), *case, "--restart"])
    assert marker.exists()
    assert status == 0, capsys.readouterr().err


def test_a_sweep_does_not_run_laws_that_only_its_folder_names(run, trap, tmp_path, comm, capsys):
    law, marker = trap
    vary = '[vary]\n"load.pressure" = { values = [50, 60] }\n'
    study = write_study(tmp_path, comm, vary, CASE.replace("elements = 16", "elements = 8"))
    out = tmp_path / "out"
    assert main(["sweep", str(study), "-o", str(out)]) == 0
    set_trap(run, law, told=True)
    identity = rw.read_study(study).ids[0]
    (out / "inflight").mkdir()
    (out / "inflight" / f"{identity}.h5").write_bytes(run.read_bytes())
    (out / "inflight" / "0123456789abcdef.h5").write_bytes(run.read_bytes())
    with h5py.File(out / "results.h5", "r+") as file:
        text = rw.open_result(run).case
        file["case_toml"][:] = [text, text]
        file["seconds"][0] = float("nan")  # it is to be computed again
    for words in (
        ["sweep", str(study), "-o", str(out)],
        ["plot", str(out), "-o", str(out) + ".png"],
    ):
        assert main(words) == 0, capsys.readouterr().err
    assert len(rw.open_ensemble(out).penetration) >= 2
    assert not marker.exists()


@pytest.mark.parametrize("shape", ["profile = { file", "profile.file"])
def test_looking_at_a_result_opens_nothing_that_its_case_names(tmp_path, capsys, shape):
    """What is shown comes from the file itself."""
    path, pipe = tmp_path / "run.h5", tmp_path / "pipe"
    words = ["mesh.contact_elements=8", "time.steps=3", "output.boundary=last"]
    words += ["stress.times=last", "stress.grid={r=[28, 32], z=[19.9, 20.1], n=[5, 4]}"]
    assert main(["run", PAPER, "-o", str(path), "--set", *words]) == 0
    os.mkfifo(pipe)  # who opens it waits for ever
    with h5py.File(path, "r+") as file:
        entry = f"{shape} = {json.dumps(str(pipe))}{' }' if '{' in shape else ''}"
        file.attrs["case"] = file.attrs["case"].replace("[upper]\n", f"[upper]\n{entry}\n")
    opened = []
    watchers.append(lambda name: opened.append(name) if name == str(pipe) else None)
    try:
        for command in (
            ["plot", "-o", "a.png", "--panels", "wear,pressure"],
            ["plot", "-o", "a.png", "--panels", "section"],
            ["plot", "-o", "a.png", "--panels", "stress"],
            ["report", "-o", "a.html"],
            ["export", "-o", "a.csv"],
        ):
            output = str(tmp_path / command[2])
            status = main([command[0], str(path), "-o", output, *command[3:]])
            assert status in (0, 2)
            assert "Traceback" not in capsys.readouterr().err
    finally:
        watchers.clear()
    assert not opened


#: what is called with the name of each file that is opened, as long as it is here
watchers = []


def _look(event, arguments):
    if event == "open" and watchers and isinstance(arguments[0], str | os.PathLike):
        watchers[0](os.fspath(arguments[0]))


sys.addaudithook(_look)


def flipped(contents, place, bit=0):
    return contents[:place] + bytes([contents[place] ^ 1 << bit]) + contents[place + 1 :]


def test_any_flipped_bit_is_one_sentence(run):
    contents = run.read_bytes()
    for place in range(0, len(contents) - 30, 997):
        run.write_bytes(flipped(contents, place, place % 8))
        os.utime(run, ns=(place, place))  # the clock may stand still between two files
        with pytest.raises(InputError, match=r"run.h5: is damaged: its checksum is not that of"):
            rw.open_result(run)
    run.write_bytes(contents)
    assert rw.open_result(run).steps_made[-1] == 3


def test_a_file_that_another_program_has_changed_is_read(run, caplog):
    with pytest.raises(InputError, match="is not a result file of ringwear, or is damaged"):
        rw.open_result(__file__)
    contents = run.read_bytes()
    run.write_bytes(contents[: len(contents) // 2])
    with pytest.raises(InputError, match="is not a result file of ringwear, or is damaged"):
        rw.open_result(run)
    assert not caplog.text  # no word of a checksum
    run.write_bytes(contents)
    with h5py.File(run, "r+") as file:
        file.attrs["title"] = "another"
    assert rw.open_result(run).attributes["title"] == "another"
    with h5py.File(run, "r+") as file:
        file["time"][1] = float("nan")
    with pytest.raises(InputError, match="is not a result file of ringwear, or is damaged"):
        rw.open_result(run)


@pytest.mark.parametrize("name", ["balance_residual", "symmetry_defect", "time_steps", "angle"])
def test_a_file_that_lacks_what_files_have_is_one_sentence(run, name, tmp_path, capsys):
    with h5py.File(run, "r+") as file:
        del file.attrs[name]
    for words in (["report", str(run), "-o", str(tmp_path / "a.html")], ["plot", str(run), "-o",
                  str(tmp_path / "a.png")]):  # fmt: skip
        assert main(words) == 2
        assert "is not a result file of ringwear, or is damaged" in capsys.readouterr().err
    assert {path.suffix for path in tmp_path.iterdir()}.isdisjoint({".html", ".png"})


@pytest.mark.parametrize("title", ["costs $x_$", "$", "a\nb", "\x1b[2J", "_"])
def test_any_title_is_drawn_and_printed(run, title, tmp_path):
    with h5py.File(run, "r+") as file:
        file.attrs["title"] = title
    result = rw.open_result(run)
    assert all(line.isprintable() for line in result.summary(verbose=True).splitlines())
    other = tmp_path / "$a_$.h5"
    other.write_bytes(run.read_bytes())
    rw.plot([result, other], "penetration").savefig(tmp_path / "a.png")
