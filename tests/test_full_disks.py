"""Full disks: one sentence, status 1, what was there before, and what is done stays."""

import resource
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from commands import RINGWEAR, SHELL_ENVIRONMENT, sentences
from paths import PAPER
from swept import variables, write_study

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


@pytest.mark.parametrize("size", [1000, 20_000, 50_000])
def test_run(tmp_path, size):
    path = tmp_path / "run.h5"
    path.write_bytes(b"of before")
    status, said = limited(size, "run", PAPER, "-o", path, *SMALL, "--overwrite")
    assert status == 1
    (told,) = [line for line in said if "File too large" in line]
    assert "nothing of this run is stored" in told
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
    assert rw.open_result(tmp_path / "run.h5").steps_made[-1] == 20


def test_sweep(tmp_path, comm):
    """Neither its block fits nor, once it does, results.h5; then there is room."""
    vary = '[vary]\n"wear.lower.k" = { log = [1e-8, 1e-6], count = 6 }\n'
    study, out = write_study(tmp_path, comm, vary), tmp_path / "out"
    rw.sweep(study, tmp_path / "reference", comm)
    for size, there in ((10_000, 0), (0.5 * (tmp_path / "reference/results.h5").stat().st_size, 1)):
        status, said = limited(size, "sweep", study, "-o", out)
        assert status == 1
        (told,) = said
        assert "File too large" in told
        assert f"{there} of 1 blocks are there, and the same command goes on" in told
        assert not list(out.rglob("*.tmp*"))
        assert not (out / "results.h5").exists()
        subprocess.run(  # the block
            [*RINGWEAR, "sweep", str(study), "-o", str(out), "--dry-run"], check=True,
            env=SHELL_ENVIRONMENT, timeout=200,
        )  # fmt: skip
    assert rw.sweep(study, out, comm).computed == 0
    found, exact = variables(out), variables(tmp_path / "reference")
    assert found.keys() == exact.keys()
    for name, values in exact.items():
        assert np.array_equal(found[name], values, equal_nan=values.dtype.kind == "f"), name


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
