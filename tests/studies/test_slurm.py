"""The batch file, with stand-ins for srun and scontrol: what it starts, and what comes back."""

import os
import signal
import subprocess
import time

import pytest
from paths import ROOT

BATCH = ROOT / "slurm" / "ringwear.sbatch"
SRUN = """#!/bin/bash
trap 'exit 1' USR1
echo "$@" >> started
[ -z "$PAUSE" ] || while :; do sleep 0.02; done
exit $STATUS
"""
SCONTROL = '#!/bin/bash\necho "$@" >> requeued\n'


@pytest.fixture
def submit(tmp_path):
    """A function that runs the batch file as Slurm would; returns what came back and the status."""
    for name, text in (("srun", SRUN), ("scontrol", SCONTROL)):
        (tmp_path / name).write_text(text)
        (tmp_path / name).chmod(0o755)

    def submit(*words, signals=(), **environment):
        environment = {
            "PATH": f"{tmp_path}:{os.environ['PATH']}", "RINGWEAR_LAUNCHER": "srun --mpi=pmix",
            "SLURM_SUBMIT_DIR": str(tmp_path), "SLURM_JOB_ID": "7", "SLURM_NTASKS": "2",
            "SLURM_JOB_CPUS_PER_NODE": "1", "STATUS": "0", "PAUSE": "yes" if signals else "",
            **environment,
        }  # fmt: skip
        job = subprocess.Popen(["bash", BATCH, *words], cwd=tmp_path, env=environment)
        while signals and not (tmp_path / "started").exists():
            time.sleep(0.02)
        for number in signals:
            job.send_signal(number)
        status = job.wait(60)
        requeued = tmp_path / "requeued"
        return requeued.read_text().strip() if requeued.exists() else None, status

    return submit


ARRAY = {"SLURM_ARRAY_JOB_ID": "5", "SLURM_ARRAY_TASK_ID": "3"}


@pytest.mark.parametrize(
    ("words", "environment", "expected"),
    [(["run", "my case.toml", "-o", "a.h5"], {}, "run --restart my case.toml -o a.h5"),
     (["sweep", "study.toml", "-o", "out"], ARRAY, "sweep study.toml -o out")],
)  # fmt: skip
def test_the_words_of_the_command_are_started(submit, tmp_path, words, environment, expected):
    assert submit(*words, **environment) == (None, 0)
    assert (tmp_path / "started").read_text() == f"--mpi=pmix ringwear {expected}\n"


@pytest.mark.parametrize(
    ("status", "environment", "requeued"),
    [("1", {}, None), ("2", {}, None), ("127", {}, None), ("137", {}, "requeue 7"),
     ("137", ARRAY, "requeue 5_3"), ("137", {"SLURM_RESTART_COUNT": "100"}, None)],
)  # fmt: skip
def test_a_job_that_died_comes_back(submit, status, environment, requeued):
    """One that has failed does not."""
    assert submit("sweep", "a.toml", STATUS=status, **environment) == (requeued, int(status))


@pytest.mark.parametrize(
    ("signals", "requeued"),
    [([signal.SIGUSR1], "requeue 7"), ([signal.SIGTERM], None)],
    ids=["wall limit", "scancel"],
)
def test_a_job_stopped_at_the_wall_limit_comes_back(submit, signals, requeued):
    assert submit("run", "a.toml", signals=signals) == (requeued, 1)
