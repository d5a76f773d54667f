"""Sweeps on two nodes of a Slurm, and nodes, launchers and ranks that die."""

import os
import re

import pytest
import try_faults as faults
from cluster import SLURM, Cluster, started, wait_for_waiting
from waiting import Waiting

from ringwear_par.studies.execution.sweep import run_sweep

pytestmark = [pytest.mark.serial, pytest.mark.slow]
LAUNCHERS = ["mpirun -n 2", "srun --mpi=pmix"]


@pytest.fixture(scope="module")
def slurm(tmp_path_factory):
    """The environment of a local Slurm."""
    yield from started(tmp_path_factory.mktemp("slurm"))


@pytest.fixture(scope="module")
def unhurried(tmp_path_factory, comm):
    """A study whose cases can wait under way, and its folder of results."""
    folder = tmp_path_factory.mktemp("waiting")
    waiting = Waiting(folder, thresholds=(0, 20, 40))
    run_sweep(waiting.study, folder / "reference", comm)
    return waiting, folder / "reference"


@pytest.fixture
def cluster(slurm, tmp_path):
    cluster = Cluster(slurm, tmp_path)
    cluster.wait_for_nodes()
    return cluster


class Sweeps:
    """Two sweeps on two nodes each, one a launcher, whose cases wait.

    Parameters
    ----------
    cluster : to submit them to.
    study : with its results of an undisturbed sweep.
    words : of sbatch, for each of the launchers.
    """

    def __init__(self, cluster, study, words=((), ())):
        self.cluster, (self.waiting, self.reference) = cluster, study
        self.restarts, self.outputs, self.done = 0, {}, {}
        self.waiting.hold(1.0)
        for launcher, more in zip(LAUNCHERS, words, strict=True):
            output = cluster.folder / launcher[:4]
            words = "-N2", "-n2", *more, SLURM / "sweep.sbatch", self.waiting.study, output
            self.outputs[cluster.submit(*words, launcher=launcher)] = output
        self.see_under_way()

    def see_under_way(self):
        """Wait until all ranks compute cases that wait; note what is done."""
        wait_for_waiting(2 * len(LAUNCHERS), self.waiting)
        self.done = {job: faults.done_before(path) for job, path in self.outputs.items()}
        assert all(self.done.values())

    def see_back(self):
        """Wait until all are in the queue again, or under way again."""
        self.restarts += 1
        for job in self.outputs:
            self.cluster.wait(
                job,
                lambda j: int(j["Restarts"]) >= self.restarts and j["JobState"] != "COMPLETING",
            )
        self.waiting.hold(1.0)

    def see_end(self):
        """Let cases go on; see that all sweeps end as if nothing had been."""
        self.waiting.release()
        for job, output in self.outputs.items():
            (end,) = self.cluster.wait(job)
            told = self.cluster.output(job)
            assert (end["JobState"], end["ExitCode"]) == ("COMPLETED", "0:0"), told
            # a node that has crashed may be tried once more, before Slurm knows of it
            assert self.restarts <= int(end["Restarts"]) <= self.restarts + 1, told
            assert not faults.differences(output, self.reference), told
            after = faults.seconds_by_id(output)
            assert all(after[i] == seconds for i, seconds in self.done[job].items()), told
            there = int(re.findall(r"(\d+) of \d+ cases are there already", told)[-1])
            computed = int(re.findall(r"^(\d+) computed in ", told, re.MULTILINE)[-1])
            assert there >= len(self.done[job]), told
            assert there + computed == self.waiting.cases, told


def test_nodes_set_down_preemption_launchers_and_ranks_killed(cluster, unhurried):
    sweeps = Sweeps(cluster, unhurried)
    for job in sweeps.outputs:
        ranks = cluster.ranks(job)
        assert len({os.readlink(f"/proc/{pid}/ns/uts") for pid in ranks}) == len(ranks) == 2
        # two jobs share these nodes: not one core for both
        assert all(os.sched_getaffinity(pid) == os.sched_getaffinity(0) for pid in ranks)
    cluster("scontrol", "update", "nodename=n2", "state=down", "reason=trial")
    sweeps.see_back()
    sweeps.see_under_way()
    urgent = cluster.submit("-p", "urgent", "-N3", "--exclusive", "--wrap", "hostname")
    sweeps.see_back()
    assert cluster.wait(urgent)[0]["JobState"] == "COMPLETED"
    sweeps.see_under_way()
    for job, launcher in zip(sweeps.outputs, LAUNCHERS, strict=True):
        for pid in cluster.processes(job, f"{launcher} ringwear"):
            faults.kill(pid)
    sweeps.see_back()
    sweeps.see_under_way()
    for job in sweeps.outputs:
        faults.kill(cluster.ranks(job)[-1])
    sweeps.see_back()
    sweeps.see_end()


def test_a_node_crashes(cluster, unhurried):
    # one loses the other node, one that of its job script
    sweeps = Sweeps(cluster, unhurried, (["-x", "n3"], ["-x", "n1"]))
    cluster.node("crash", "n2")
    sweeps.see_back()
    cluster.node("boot", "n2")
    sweeps.see_end()
