"""Full disks: one sentence, status 1, what was there before, and what is done stays."""

import resource
import subprocess
import sys
from pathlib import Path

import pytest
from commands import RINGWEAR, SHELL_ENVIRONMENT, sentences
from paths import PAPER
from swept import write_study

import ringwear_par as rw
from ringwear_par.results import run as run_command

pytestmark = pytest.mark.slow
SMALL = ["--set", "mesh.contact_elements=16", "time.steps=20"]


def limited(size, *words):
    """Run a command whose files may have so many bytes each; return status and sentences."""

    def limit():
        resource.setrlimit(resource.RLIMIT_FSIZE, (int(size), int(size)))

    # Python would leave half of what it compiles beside the package, too
    environment = {**SHELL_ENVIRONMENT, "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(
        [*RINGWEAR, *map(str, words)], env=environment, preexec_fn=limit,
        capture_output=True, text=True, timeout=200, check=False,
    )  # fmt: skip
    assert "Traceback" not in done.stderr
    return done.returncode, sentences(done)


@pytest.mark.parametrize("size", [1000, 20_000, 40_000])
def test_run(tmp_path, size):
    path = tmp_path / "run.h5"
    path.write_bytes(b"of before")
    status, said = limited(size, "run", PAPER, "-o", path, *SMALL, "--overwrite")
    assert status == 1
    (told,) = [line for line in said if "File too large" in line]
    assert str(path) in told
    assert path.read_bytes() == b"of before"
    assert list(tmp_path.iterdir()) == [path]


def test_a_run_goes_on_without_checkpoints(tmp_path, comm, monkeypatch, caplog):
    write, calls = run_command.write_result, []

    def failing(*words):
        calls.append(1)
        if len(calls) in (2, 3, 4):
            raise OSError(28, "No space left on device", "run.h5")
        write(*words)

    caplog.set_level("INFO")
    monkeypatch.setattr(run_command, "write_result", failing)
    monkeypatch.setattr(run_command, "CHECKPOINT_SECONDS", 0.0)
    run_command.run_case(PAPER, tmp_path / "run.h5", SMALL[1:], comm=comm)
    assert len([m for m in caplog.messages if "checkpoint not written" in m]) == 1
    assert rw.open_result(tmp_path / "run.h5").step[-1] == 20


def test_sweep(tmp_path, comm):
    """Its block does not fit; then there is room."""
    vary = '[vary]\n"wear.lower.k" = { log = [1e-8, 1e-6], count = 6 }\n'
    study, out = write_study(tmp_path, comm, vary), tmp_path / "out"
    status, said = limited(10_000, "sweep", study, "-o", out)
    assert status == 1
    (told,) = said
    assert "File too large" in told
    assert "0 of 1 blocks are there, and the same command goes on" in told
    assert not list(out.rglob("*.tmp*"))
    assert rw.sweep(study, out, comm).computed == 6


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full")
def test_standard_output():
    words = [sys.executable, "-m", "ringwear_par", "info", "--schema"]
    with open("/dev/full", "w") as nowhere:
        result = subprocess.run(
            words, stdout=nowhere, stderr=subprocess.PIPE, text=True, env=SHELL_ENVIRONMENT,
            timeout=100, check=False,
        )  # fmt: skip
    assert result.returncode == 1
    assert "No space left on device" in result.stderr
