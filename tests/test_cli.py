"""The command itself, started as a user does, alone and under mpirun: what it says, and status."""

import os
import shlex
import shutil
import subprocess
import time
from pathlib import Path

import pytest
from commands import (
    NEEDS_MPIRUN,
    RINGWEAR,
    SHELL_ENVIRONMENT,
    on_ranks,
    ringwear,
    sentences,
)
from paths import CASES, PAPER

from ringwear_par.cli import main

SMALL = ["mesh.contact_elements=16", "time.steps=20"]
LAW = """
import os

calls = 0

def rate(p, at):
    global calls
    calls += 1
    if calls > 20 and os.environ["OMPI_COMM_WORLD_RANK"] == "1":
        raise KeyboardInterrupt
    return 1e-9 * p
"""


@NEEDS_MPIRUN
def test_run_plot_and_status_0(tmp_path):
    """As without mpirun, which other tests run."""
    words = ["run", PAPER, "-o", "a.h5", "--plot", "a.png", "--set", *SMALL]
    done = ringwear(*words, ranks=2, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert {p.name for p in tmp_path.iterdir()} == {"a.h5", "a.png"}


@pytest.mark.parametrize("ranks", on_ranks(0, 2))
def test_bad_input_is_one_sentence_with_status_2(tmp_path, ranks):
    result = ringwear("run", "nowhere.toml", "-o", "a.h5", ranks=ranks, cwd=tmp_path)
    assert result.returncode == 2, result.stderr
    (sentence,) = sentences(result)
    assert "nowhere.toml" in sentence
    assert "Traceback" not in result.stderr
    assert not list(tmp_path.iterdir())


@NEEDS_MPIRUN
def test_failed_computation_has_status_1(tmp_path):
    result = ringwear(
        "run", PAPER, "-o", "a.h5", "--set", *SMALL, "--", "-contact_tao_max_it", "1", ranks=2,
        cwd=tmp_path,
    )  # fmt: skip
    assert result.returncode == 1, result.stderr
    (told,) = sentences(result)
    for words in ("step 0", "contact: is not solved"):
        assert words in told
    assert "Traceback" not in result.stderr
    assert not list(tmp_path.iterdir())


@NEEDS_MPIRUN
def test_a_rank_that_fails_alone_ends_the_job(tmp_path):
    (tmp_path / "user_law.py").write_text(LAW)
    case = shutil.copy(CASES / "user_law.toml", tmp_path)
    started = time.monotonic()
    result = ringwear("run", case, "-o", "a.h5", "--set", "wear.lower.parameters={}", ranks=2,
                      cwd=tmp_path)  # fmt: skip
    assert time.monotonic() - started < 100.0
    assert result.returncode == 1, result.stderr
    (told,) = sentences(result)
    assert "KeyboardInterrupt" in told


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["rnu"], "rnu"),
        (["run", PAPER], "--output"),
        (["run", PAPER, "-o", "a.h5", "--nothing"], "--nothing"),
        (["run", PAPER, "-o", "a.h5", "--set", "wear.lower.K=1"], "wear.lower.k"),
        (["run", PAPER, "-o", "no/a.h5"], "no/a.h5"),
        (["run", PAPER, "-o", "taken.h5"], "taken.h5"),
        (["run", PAPER, "-o", "a.h5", "--plot", "no/a.png"], "no/a.png"),
        (["run", PAPER, "-o", "a.h5", "--set", "time.steps=1000000000000"], "memory"),
        (["plot", "a.h5", "-o", "a.png", "--dpi", "9"], "2400"),
        (["follow", "a.toml", "-o", "a", "--after", "b", "--to", "0.15"], "15%"),
        (["follow", "a.toml", "-o", "a", "--after", "b", "--draws", "10"], "2000"),
        (["follow", "a.toml", "-o", "a", "--after", "b", "--depth", "3 s"], "20 um"),
        (["info", "--schema", "nothing_like_it"], "nothing_like_it"),
    ],
)
def test_one_sentence_and_status_2(tmp_path, monkeypatch, capfd, words, said):
    monkeypatch.chdir(tmp_path)
    Path("taken.h5").write_text("precious")
    assert main([str(word) for word in words]) == 2
    errors = capfd.readouterr().err
    assert errors.startswith("ringwear: ")
    assert errors.count("\n") == 1
    assert said.lower() in errors.lower()
    assert os.listdir() == ["taken.h5"]


def test_petsc_has_the_options(tmp_path):
    words = ["run", PAPER, "-o", "a.h5", "--set", *SMALL, "--"]
    result = ringwear(*words, "-contact_tao_monitor", "-bem_ksp_view", "-bem_no", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    for word in ("preonly", "Residual", "Option left: name:-bem_no"):
        assert word in result.stdout
    result = ringwear(*words, "-bem_pc_type", "jacobi", cwd=tmp_path)
    assert result.returncode == 1
    assert "relative residual" in sentences(result)[-1]


@NEEDS_MPIRUN
def test_info_is_of_all_ranks():
    info = ringwear("info", ranks=2)
    assert info.stdout.count("petsc version") == 1
    assert "ranks: 2" in info.stdout


def test_a_quiet_end_when_the_reader_leaves():
    text = f"{shlex.join(RINGWEAR)} info --schema | head -n 1"
    result = subprocess.run(["bash", "-c", text], env=SHELL_ENVIRONMENT, capture_output=True,
                            text=True, timeout=60, check=False)  # fmt: skip
    assert result.stderr == ""
