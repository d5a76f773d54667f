"""The job scripts in slurm/, in a Slurm of three nodes that is started here for them."""

import csv
import os
import re
import shutil
from pathlib import Path

import pytest
from cluster import SLURM, Cluster, started, wait_for_waiting
from waiting import Waiting

from ringwear_par.results.storage.result_files import read_status

pytestmark = [pytest.mark.serial, pytest.mark.slow]
PAPER = Path(__file__).parents[2] / "scripts" / "cases" / "paper.toml"
SRUN = "srun --mpi=pmix"
FAILING = ["--", "-contact_tao_type", "tron", "-contact_tao_max_it", "1",
           "-contact_ksp_max_it", "1"]  # fmt: skip
SMALL = ["mesh.contact_elements=16", "time.steps=20"]
STUDY = """
case = "small.toml"
[vary]
"wear.lower.k" = { log = [1e-8, 1e-6], count = 2 }
"wear.lower.p0" = { values = [0, 20] }
[design]
method = "grid"
"""


@pytest.fixture(scope="module")
def slurm(tmp_path_factory):
    """The environment of a local Slurm."""
    yield from started(tmp_path_factory.mktemp("slurm"))


@pytest.fixture
def cluster(slurm, tmp_path):
    shutil.copy(PAPER, tmp_path / "paper.toml")
    return Cluster(slurm, tmp_path)


def write_study(folder):
    """A study of 4 cases."""
    text = re.sub(r"steps = \d+", "steps = 20", PAPER.read_text())
    (folder / "small.toml").write_text(text + "\n[mesh]\ncontact_elements = 16\n")
    (folder / "study.toml").write_text(STUDY)


def statuses(folder):
    with (folder / "out" / "cases.csv").open() as file:
        return [row["status"] for row in csv.DictReader(file)]


@pytest.mark.parametrize("launcher", ["", SRUN])
def test_a_run(cluster, tmp_path, launcher):
    job = cluster.submit("-n2", SLURM / "run.sbatch", "paper.toml", "a.h5", "--set", *SMALL,
                         launcher=launcher)  # fmt: skip
    (end,) = cluster.wait(job)
    assert (end["JobState"], end["ExitCode"]) == ("COMPLETED", "0:0"), cluster.output()
    assert read_status(tmp_path / "a.h5") == ("complete", 20)


def test_a_run_at_its_wall_limit_goes_on_by_itself(cluster, tmp_path):
    waiting = Waiting(tmp_path)
    waiting.hold(0.05)
    patient = {"OMPI_MCA_odls_base_sigkill_timeout": "4"}  # s, not 1, from scancel to kill
    job = cluster.submit("-n2", SLURM / "run.sbatch", waiting.case, tmp_path / "a.h5",
                         "--set", "time.steps=2000", **patient)  # fmt: skip
    wait_for_waiting(2, waiting)
    # a rank a core, where Slurm gives the job all that there are
    seen = os.sched_getaffinity(0)
    each = {len(os.sched_getaffinity(pid)) for pid in cluster.ranks(job)}
    assert each == {1 if len(seen) == 2 else len(seen)}
    cluster.signal(job)
    status, step = read_status(tmp_path / "a.h5")
    assert status == "incomplete"
    waiting.hold(0.05)
    cluster.wait(job, lambda _: f"after step {step} (" in cluster.output())
    for _ in range(8):  # more often than a step is long
        waiting.hold(0.05)
        wait_for_waiting(2, waiting)
    # and scancel is the end of it
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
    array = cluster.submit("-n1", "--exclusive", "--array=1-3", SLURM / "array.sbatch",
                           "study.toml", tmp_path / "out")  # fmt: skip
    merge = cluster.submit("-N2", "-n2", f"--dependency=afterany:{array}", SLURM / "sweep.sbatch",
                           "study.toml", tmp_path / "out")  # fmt: skip
    wait_for_waiting(2, waiting)  # the second slice and the last: the first is the smaller k
    assert {task["NodeList"] for task in cluster.jobs(array)} == {"n1", "n2", "n3"}
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
    # where ranks end one after the other
    apart = cluster.submit("-N2", "-n2", SLURM / "sweep.sbatch", "study.toml", "apart", *FAILING,
                           launcher=SRUN)  # fmt: skip
    missing = cluster.submit("-n1", SLURM / "sweep.sbatch", "study.toml", "missing",
                             launcher="no-such-launcher")  # fmt: skip
    for job, status in ((bad, "2:0"), (failing, "1:0"), (apart, "1:0"), (missing, "127:0")):
        (end,) = cluster.wait(job)
        assert end["JobState"] == "FAILED", cluster.output()
        assert (end["ExitCode"], end["Restarts"]) == (status, "0"), cluster.output()


def test_what_always_dies_ends_after_so_many_restarts(cluster, tmp_path):
    text = (SLURM / "run.sbatch").read_text()
    script, launcher = tmp_path / "run.sbatch", tmp_path / "launcher"
    script.write_text(text.replace("most_restarts=100", "most_restarts=1"))
    launcher.write_text("#!/bin/sh\nexit 205\n")
    launcher.chmod(0o755)
    job = cluster.submit("-n1", script, "paper.toml", "a.h5", launcher=launcher)
    (end,) = cluster.wait(job)
    assert (end["JobState"], end["ExitCode"], end["Restarts"]) == ("FAILED", "205:0", "1")
    assert "a.h5: stopped for good after 1 restarts" in cluster.output()
