"""The command itself, started as a user does, alone and under mpirun."""

import os
import shlex
import signal
import subprocess
import sys
import time

import pytest
from commands import (
    NEEDS_MPIRUN,
    RINGWEAR,
    SHELL_ENVIRONMENT,
    on_ranks,
    python,
    ringwear,
    sentences,
)
from paths import PAPER
from waiting import Waiting

from ringwear_par import cli
from ringwear_par.commands import COMMANDS
from ringwear_par.results.execution import stop_signals
from ringwear_par.results.storage.result_files import read_status

pytestmark = pytest.mark.serial
SMALL = ["mesh.contact_elements=16", "time.steps=20"]


@pytest.mark.parametrize("ranks", on_ranks(2))
def test_run_plot_and_status_0(tmp_path, ranks):
    done = ringwear("run", PAPER, "-o", "a.h5", "--plot", "a.png", "--set", *SMALL,
                    ranks=ranks, cwd=tmp_path)  # fmt: skip
    assert done.returncode == 0, done.stderr
    labels = ["penetration", "worn", "wear", "pressure", "torque", "checks", "written", "next"]
    assert [line.split()[0] for line in done.stdout.splitlines()] == labels
    assert "checks       ok (balances to " in done.stdout
    assert "next         ringwear report a.h5 -o a.html" in done.stdout
    assert "\x1b" not in done.stdout
    assert {p.name for p in tmp_path.iterdir()} == {"a.h5", "a.png"}


@NEEDS_MPIRUN
@pytest.mark.parametrize(
    ("words", "said"),
    [
        ([PAPER, "-o", "a.h5", "--", "-contact_tao_typ", "tron"], "did you mean -contact_tao_type"),
        ([PAPER, "-o", "a.h5", "--", "-malloc_debug", "maybe"], "Unknown logical value: maybe"),
        ([PAPER], "the following arguments are required"),
    ],
)
def test_bad_input_is_said_once_with_status_2(tmp_path, words, said):
    """What depends on how a program starts, parses and ends; for the rest see test_refusals.py."""
    (tmp_path / "taken.h5").write_text("precious")
    result = ringwear("run", *words, ranks=2, cwd=tmp_path)
    assert result.returncode == 2, result.stderr
    told = sentences(result)
    assert len(told) == 1
    assert said in told[0]
    assert "Traceback" not in result.stderr
    assert [p.name for p in tmp_path.iterdir()] == ["taken.h5"]


def test_failed_computation_has_status_1(tmp_path):
    result = ringwear(
        "run", PAPER, "-o", "a.h5", "--set", *SMALL, "--", "-contact_tao_type", "tron",
        "-contact_tao_max_it", "1", "-contact_ksp_max_it", "1", ranks=2, cwd=tmp_path,
    )  # fmt: skip
    assert result.returncode == 1, result.stderr
    (told,) = sentences(result)
    for words in ("step 0", "reason DIVERGED_MAXITS", "residual"):
        assert words in told
    assert "Traceback" not in result.stderr
    assert not list(tmp_path.iterdir())


def test_a_solver_that_does_not_solve_is_an_error(tmp_path):
    result = ringwear("run", PAPER, "-o", "a.h5", "--set", *SMALL, "--", "-bem_pc_type", "jacobi",
                      cwd=tmp_path)  # fmt: skip
    assert result.returncode == 1
    assert "relative residual" in sentences(result)[0]
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("ranks", "number"), [(0, signal.SIGHUP), (2, signal.SIGTERM)])
def test_a_signal_ends_the_run_with_its_steps_on_disk(tmp_path, ranks, number):
    (tmp_path / "case").mkdir()
    (tmp_path / "out").mkdir()
    waiting, output = Waiting(tmp_path / "case"), tmp_path / "out" / "a.h5"
    waiting.hold(0.05)  # mpirun kills a second after its signal
    launcher = ["mpirun", "-n", str(ranks)] if ranks else []
    command = [*launcher, *RINGWEAR, "run", str(waiting.case), "-o", str(output), "--set",
               "time.steps=2000"]  # fmt: skip
    with subprocess.Popen(command, env=SHELL_ENVIRONMENT, text=True, stdout=subprocess.PIPE,
                          stderr=subprocess.PIPE) as process:  # fmt: skip
        try:
            limit = time.monotonic() + 90.0
            while waiting.waits < (ranks or 1) and process.poll() is None:
                assert time.monotonic() < limit, "the run did not begin to step"
                time.sleep(0.02)
            process.send_signal(number)
            _, errors = process.communicate(timeout=60)
        finally:
            process.kill()
    assert process.returncode != 0
    status, step = read_status(output)
    assert status == "incomplete"
    assert step > 1
    if ranks == 0:
        assert process.returncode == 1
        assert f"stopped by {number.name} after step {step} of 2000" in errors
    assert [p.name for p in output.parent.iterdir()] == ["a.h5"]


def test_info_is_of_all_ranks():
    info = ringwear("info", ranks=2)
    assert info.returncode == 0
    assert info.stdout.count("petsc version") == 1
    assert "ranks: 2" in info.stdout
    assert all(
        command.example.startswith(("ringwear ", "mpirun ")) for command in COMMANDS.values()
    )


def test_petsc_options_reach_the_solvers(tmp_path):
    result = ringwear("run", PAPER, "-o", "a.h5", "--set", *SMALL, "--", "-contact_tao_monitor",
                      "-bem_ksp_view", cwd=tmp_path)  # fmt: skip
    assert result.returncode == 0, result.stderr
    assert "preonly" in result.stdout
    assert "Residual" in result.stdout


def test_what_one_can_do_is_a_line_each(capsys):
    def printed(*words, status=0):
        with pytest.raises(SystemExit, match=str(status)):
            sys.exit(cli.main(words))
        return "".join(capsys.readouterr())

    tasks = [line.split()[0] for line in printed().splitlines() if line.startswith("  ")]
    assert tasks == ["simulate", "sweep", "fit", "plan", "predict", "follow", "measure"]
    wrong = printed("rnu", status=2)
    assert "rnu: unknown command (did you mean run?); must be one of run, " in wrong
    assert "(did you mean study?)" in printed("info", "--schema", "stdy", status=2)
    assert "lower.young" in printed("info", "--schema")
    told = printed("--help")
    assert "1 the computation failed or was stopped" in told
    assert "compute every case of a study" in told
    assert "example:\n  ringwear run case.toml -o run.h5\n" in printed("run", "--help")


def test_a_quiet_end_when_the_reader_leaves():
    text = f"{shlex.join(RINGWEAR)} info --schema | head -n 1"
    result = subprocess.run(["bash", "-c", text], env=SHELL_ENVIRONMENT, capture_output=True,
                            text=True, timeout=60, check=False)  # fmt: skip
    assert result.stderr == ""


def test_loaded_code_is_the_code_that_assembles():
    """Otherwise all ranks would compile again, at once, in the middle of the assembly."""
    program = f"""
from mpi4py import MPI
import ringwear_par as rw
from ringwear_par.elasticity.bem.assembly import load_kernels
load_kernels(MPI.COMM_SELF)
from ringwear_par.elasticity.bem.rows import assemble_rows
loaded = list(assemble_rows.signatures)
rw.assemble(rw.read_case({str(PAPER)!r}, {{"mesh.contact_elements": 8}}), MPI.COMM_SELF)
assert len(loaded) == 1
assert list(assemble_rows.signatures) == loaded
"""
    result = python("-c", program)
    assert result.returncode == 0, result.stderr


@pytest.mark.serial
def test_mpi_starts_alone_and_leaves_no_settings(monkeypatch):
    """A program that this one starts may be a launcher of many ranks; one's own settings stay."""
    isolated, transport = "OMPI_MCA_ess_singleton_isolated", "OMPI_MCA_btl"
    monkeypatch.setenv(transport, "self,vader")
    for name in stop_signals._LAUNCHED:
        monkeypatch.delenv(name, raising=False)
    before = dict(os.environ)
    with cli._without_other_processes():
        assert os.environ[isolated] == "1"
        assert os.environ[transport] == "self,vader"
    assert dict(os.environ) == before
    monkeypatch.setenv("PMIX_RANK", "0")
    with cli._without_other_processes():
        assert isolated not in os.environ
