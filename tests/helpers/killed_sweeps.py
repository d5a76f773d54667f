"""Sweeps that tests kill: the processes at work."""

import os
import signal
import time
from contextlib import suppress
from pathlib import Path


def children(pid):
    """Return the processes that mpirun has started; MPICH's has a proxy between."""
    found = []
    for word in Path(f"/proc/{pid}/task/{pid}/children").read_text(encoding="ascii").split():
        name = Path(f"/proc/{word}/comm").read_text(encoding="ascii")
        found += children(int(word)) if name.startswith("hydra_pmi_proxy") else [int(word)]
    return found


def _alive(pid):
    try:
        stat = Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace")
    except OSError:
        return False
    return stat.rpartition(")")[2].split()[0] not in "ZX"


def wait_for_end(pids, patience=20.0):
    """Wait until none of some processes is there."""
    limit = time.monotonic() + patience
    while any(map(_alive, pids)):
        assert time.monotonic() < limit, f"processes {pids} are still there"
        time.sleep(0.01)


def kill(pid, number=signal.SIGKILL):
    """Send a signal, if there is still somebody to receive it."""
    with suppress(ProcessLookupError):
        os.kill(pid, number)
