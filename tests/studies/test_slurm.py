"""The job scripts in slurm/, in a Slurm of one node that is started here for them."""

import csv
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest
from conftest import SHELL_ENVIRONMENT
from waiting import Waiting

from ringwear_par.results.files import read_status

pytestmark = pytest.mark.serial
TOP = Path(__file__).parents[2]
PAPER = TOP / "scripts" / "cases" / "paper.toml"
SLURM = TOP / "slurm"
LOCAL_SLURM = ["bash", TOP / "scripts" / "local_slurm.sh"]
FAILING = ["--", "-contact_tao_type", "tron", "-contact_tao_max_it", "1",
           "-contact_ksp_max_it", "1"]  # fmt: skip
#: exit status of local_slurm.sh where Slurm cannot be started
CANNOT = 77
#: states of a job that has not ended
UNDER_WAY = {"PENDING", "CONFIGURING", "RUNNING", "COMPLETING", "REQUEUED", "SUSPENDED"}
SMALL = ["mesh.contact_elements=16", "time.steps=20"]
STUDY = """
case = "small.toml"
[vary]
"wear.lower.k" = { log = [1e-8, 1e-6], count = 2 }
"wear.lower.p0" = { values = [0, 20] }
[design]
method = "grid"
"""


class Cluster:
    """Slurm's commands for one test, in its folder."""

    def __init__(self, environment, folder):
        self.environment, self.folder = environment, folder

    def __call__(self, *words, **variables):
        """Run a command, with variables added to its environment; return what it prints."""
        result = subprocess.run(
            list(map(str, words)), env=self.environment | variables, cwd=self.folder,
            capture_output=True, text=True, timeout=20, check=False,
        )  # fmt: skip
        assert result.returncode == 0, result.stderr
        return result.stdout

    def submit(self, *words, **variables):
        """Submit a job script; return the number of the job."""
        return self("sbatch", "--parsable", *words, **variables).strip()

    def jobs(self, job):
        """What Slurm says of a job, or of every task of an array, as dictionaries."""
        lines = self("scontrol", "show", "job", "--oneliner", job).splitlines()
        return [dict(re.findall(r"(\S+?)=(\S*)", line)) for line in lines]

    def wait(self, job, condition=lambda j: j["JobState"] not in UNDER_WAY, timeout=120.0):
        """Wait until a condition holds for a job, or all tasks of an array; return them."""
        started = time.monotonic()
        while time.monotonic() - started < timeout:
            jobs = self.jobs(job)
            if all(map(condition, jobs)):
                return jobs
            time.sleep(0.1)
        raise AssertionError(f"{jobs}\n{self.output()}")

    def output(self):
        """Return what all jobs of this folder have printed."""
        return "\n".join(p.read_text() for p in sorted(self.folder.glob("slurm-*.out")))

    def signal(self, job):
        """Signal a job as its wall limit does, and see it back in the queue."""
        self("scancel", "--signal=USR1", "--batch", job)
        self.wait(job, lambda j: j["Restarts"] == "1" and j["JobState"] == "PENDING")


@pytest.fixture(scope="module")
def slurm(tmp_path_factory):
    """The environment of a local Slurm, which ends with these tests, however they end."""
    folder = tmp_path_factory.mktemp("slurm")
    foreign = ("SLURM_", "SBATCH_", "RINGWEAR_LAUNCHER")
    environment = {k: v for k, v in SHELL_ENVIRONMENT.items() if not k.startswith(foreign)}
    # stops Slurm at the end of its input: also if pytest is killed
    stop = ["bash", "-c", 'read -r; exec "$@"', "bash", *LOCAL_SLURM, "stop", folder]
    with subprocess.Popen(stop, env=environment, stdin=subprocess.PIPE, start_new_session=True):
        start = [*LOCAL_SLURM, "start", folder]
        result = subprocess.run(
            start, env=environment, capture_output=True, text=True, timeout=110, check=False
        )
        if result.returncode == CANNOT:
            pytest.skip(result.stderr.splitlines()[-1])
        assert result.returncode == 0, result.stderr
        environment["SLURM_CONF"] = result.stdout.split("'")[1]
        environment.setdefault("RINGWEAR_ACTIVATE", f"{sys.prefix}/bin/activate")
        yield environment


@pytest.fixture
def cluster(slurm, tmp_path):
    shutil.copy(PAPER, tmp_path / "paper.toml")
    return Cluster(slurm, tmp_path)


def write_study(folder):
    """A study of 4 cases."""
    text = re.sub(r"steps = \d+", "steps = 20", PAPER.read_text())
    (folder / "small.toml").write_text(text + "\n[mesh]\ncontact_elements = 16\n")
    (folder / "study.toml").write_text(STUDY)


def wait_for_waiting(number, waiting, timeout=120.0):
    """Wait until so many processes compute cases that wait."""
    started = time.monotonic()
    while waiting.waits < number:
        assert time.monotonic() - started < timeout, "no case began to wait"
        time.sleep(0.02)


def statuses(folder):
    with (folder / "out" / "cases.csv").open() as file:
        return [row["status"] for row in csv.DictReader(file)]


@pytest.mark.parametrize("launcher", ["", "srun --mpi=pmix"])
def test_a_run(cluster, tmp_path, launcher):
    job = cluster.submit("-n2", SLURM / "run.sbatch", "paper.toml", "a.h5", "--set", *SMALL,
                         RINGWEAR_LAUNCHER=launcher)  # fmt: skip
    (end,) = cluster.wait(job)
    assert (end["JobState"], end["ExitCode"]) == ("COMPLETED", "0:0"), cluster.output()
    assert read_status(tmp_path / "a.h5") == ("complete", 20)


def test_a_run_at_its_wall_limit_goes_on_by_itself(cluster, tmp_path):
    waiting = Waiting(tmp_path)
    waiting.hold(0.05)  # at scancel, mpirun kills a second after the signal
    job = cluster.submit("-n2", SLURM / "run.sbatch", waiting.case, tmp_path / "a.h5",
                         "--set", "time.steps=2000")  # fmt: skip
    wait_for_waiting(2, waiting)
    cluster.signal(job)
    status, step = read_status(tmp_path / "a.h5")
    assert status == "incomplete"
    waiting.hold(0.05)
    cluster.wait(job, lambda _: f"after step {step} (" in cluster.output())
    # and scancel is the end of it
    wait_for_waiting(2, waiting)
    cluster("scancel", job)
    (end,) = cluster.wait(job)
    assert (end["JobState"], end["Restarts"]) == ("CANCELLED", "1")
    status, last = read_status(tmp_path / "a.h5")
    assert status == "incomplete"
    assert last > step


def test_a_sweep_at_its_wall_limit_goes_on_by_itself(cluster, tmp_path):
    waiting = Waiting(tmp_path, thresholds=(0, 20))
    waiting.hold()
    job = cluster.submit("-n2", SLURM / "sweep.sbatch", "study.toml", tmp_path / "out")
    wait_for_waiting(2, waiting)
    cluster.signal(job)
    waiting.release()
    assert (tmp_path / "out" / "STOPPED").exists()
    (end,) = cluster.wait(job)
    assert (end["JobState"], end["ExitCode"]) == ("COMPLETED", "0:0"), cluster.output()
    assert not (tmp_path / "out" / "STOPPED").exists()
    assert statuses(tmp_path) == ["done"] * 4


def test_an_array_of_slices_and_its_merge(cluster, tmp_path):
    waiting = Waiting(tmp_path, thresholds=(0, 20, 40))
    waiting.hold()
    array = cluster.submit("-n1", "--array=1-3", SLURM / "array.sbatch", "study.toml",
                           tmp_path / "out")  # fmt: skip
    merge = cluster.submit("-n2", f"--dependency=afterany:{array}", SLURM / "sweep.sbatch",
                           "study.toml", tmp_path / "out")  # fmt: skip
    wait_for_waiting(2, waiting)  # the second slice and the last: the first is the smaller k
    # SLURM_JOB_ID of the last task is the number of the whole array
    cluster.signal(f"{array}_3")
    waiting.release()
    (end,) = cluster.wait(merge)
    assert (end["JobState"], end["ExitCode"]) == ("COMPLETED", "0:0"), cluster.output()
    tasks = {task["ArrayTaskId"]: task for task in cluster.jobs(array)}
    assert {k: (t["JobState"], t["Restarts"]) for k, t in tasks.items()} == {
        "1": ("COMPLETED", "0"), "2": ("COMPLETED", "0"), "3": ("COMPLETED", "1"),
    }, cluster.output()  # fmt: skip
    assert statuses(tmp_path) == ["done"] * 6


def test_what_fails_does_not_come_back(cluster, tmp_path):
    write_study(tmp_path)
    (tmp_path / "bad.toml").write_text("case = 3")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "STOPPED").touch()
    bad = cluster.submit("-n1", SLURM / "sweep.sbatch", "bad.toml", "out")
    failing = cluster.submit("-n1", SLURM / "sweep.sbatch", "study.toml", "failing", *FAILING)
    for job, status in ((bad, "2:0"), (failing, "1:0")):
        (end,) = cluster.wait(job)
        assert end["JobState"] == "FAILED", cluster.output()
        assert (end["ExitCode"], end["Restarts"]) == (status, "0"), cluster.output()
