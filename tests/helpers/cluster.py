"""A Slurm of three nodes on this machine, for the tests of the job scripts in slurm/."""

import re
import subprocess
import sys
import time
from pathlib import Path

import pytest
from commands import SHELL_ENVIRONMENT
from paths import ROOT

SLURM = ROOT / "slurm"
_LOCAL_SLURM = ["bash", ROOT / "scripts" / "local_slurm.sh"]
#: exit status of local_slurm.sh where Slurm cannot be started
_CANNOT = 77
#: states of a job that has not ended
_UNDER_WAY = {"PENDING", "CONFIGURING", "RUNNING", "COMPLETING", "REQUEUED", "SUSPENDED"}


def _environments():
    """Yield the ids of all processes that can be looked at, and their environments."""
    for path in Path("/proc").glob("[0-9]*/environ"):
        try:
            words = path.read_bytes().decode(errors="replace").split("\0")
        except OSError:
            continue
        yield int(path.parent.name), dict(word.partition("=")[::2] for word in words)


def started(folder):
    """Start Slurm in a folder, yield the environment of its users, and stop it however we end."""
    foreign = ("SLURM_", "SBATCH_", "RINGWEAR_LAUNCHER")
    environment = {k: v for k, v in SHELL_ENVIRONMENT.items() if not k.startswith(foreign)}
    # stops Slurm at the end of its input: also if pytest is killed
    stop = ["bash", "-c", 'read -r; exec "$@"', "bash", *_LOCAL_SLURM, "stop", folder]
    with subprocess.Popen(stop, env=environment, stdin=subprocess.PIPE, start_new_session=True):
        result = subprocess.run(
            [*_LOCAL_SLURM, "start", folder],
            env=environment, capture_output=True, text=True, timeout=110, check=False,
        )  # fmt: skip
        if result.returncode == _CANNOT:
            pytest.skip(result.stderr.splitlines()[-1])
        assert result.returncode == 0, result.stderr
        environment["SLURM_CONF"] = result.stdout.split("'")[1]
        environment["SLURM_WAIT"] = "5"
        environment.setdefault("RINGWEAR_ACTIVATE", f"{sys.prefix}/bin/activate")
        yield environment
    limit = time.monotonic() + 20.0
    while any(e.get("SLURM_CONF") == environment["SLURM_CONF"] for _, e in _environments()):
        assert time.monotonic() < limit, "processes are left of the local Slurm"
        time.sleep(0.1)


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

    def submit(self, *words, launcher="", **variables):
        """Submit a job script; return the number of the job."""
        variables |= {"RINGWEAR_LAUNCHER": str(launcher)}
        return self("sbatch", "--parsable", *words, **variables).strip()

    def jobs(self, job):
        """What Slurm says of a job, or of every task of an array, as dictionaries."""
        lines = self("scontrol", "show", "job", "--oneliner", job).splitlines()
        return [dict(re.findall(r"(\S+?)=(\S*)", line)) for line in lines]

    def wait(self, job, condition=lambda j: j["JobState"] not in _UNDER_WAY, timeout=120.0):
        """Wait until a condition holds for a job, or all tasks of an array; return them."""
        limit = time.monotonic() + timeout
        while time.monotonic() < limit:
            jobs = self.jobs(job)
            if all(map(condition, jobs)):
                return jobs
            time.sleep(0.1)
        raise AssertionError(f"{jobs}\n{self.output()}")

    def output(self, job="*"):
        """Return what a job, or all jobs of this folder, have printed."""
        return "\n".join(p.read_text() for p in sorted(self.folder.glob(f"slurm-{job}.out")))

    def signal(self, job):
        """Signal a job as its wall limit does, and see it back in the queue."""
        self("scancel", "--signal=USR1", "--batch", job)
        self.wait(job, lambda j: j["Restarts"] == "1" and j["JobState"] == "PENDING")

    def processes(self, job, words):
        """Return the processes of a job whose commands have some words in them."""
        found, own = [], {"SLURM_JOB_ID": job, "SLURM_CONF": self.environment["SLURM_CONF"]}
        for pid, environment in _environments():
            if own.items() <= environment.items():
                command = Path(f"/proc/{pid}/cmdline").read_bytes().decode().replace("\0", " ")
                found += [pid] if words in command else []
        return found

    def ranks(self, job):
        """Return the processes of a job's ranks."""
        return self.processes(job, "bin/ringwear ")

    def node(self, what, name):
        """Crash or boot a node."""
        folder = Path(self.environment["SLURM_CONF"]).parent
        self(*_LOCAL_SLURM, what, folder, name)

    def wait_for_nodes(self, timeout=60.0):
        """Wait until all nodes have nothing to do."""
        limit = time.monotonic() + timeout
        while (states := self("sinfo", "-h", "-p", "main", "-o", "%T %D")) != "idle 3\n":
            assert time.monotonic() < limit, states
            time.sleep(0.1)


def wait_for_waiting(number, waiting, timeout=120.0):
    """Wait until so many processes compute cases that wait."""
    limit = time.monotonic() + timeout
    while waiting.waits < number:
        assert time.monotonic() < limit, "no case began to wait"
        time.sleep(0.02)
