"""Sweeps that tests kill: a study, the processes at work, what was done before, what differs."""

import csv
import os
import shutil
import signal
import tempfile
import time
from contextlib import suppress
from pathlib import Path

import h5py
import numpy as np
from commands import RINGWEAR
from paths import PAPER

from ringwear_par.studies.storage.shards import read_shard

_STUDY = """case = "paper.toml"
[vary]
"wear.lower.k"  = {{ log = [1e-8, 1e-6], count = {count} }}
"wear.lower.p0" = {{ values = [0, 20, 40, 60, 70] }}
"mesh.contact_elements" = {{ values = {elements} }}
[design]
method = "grid"
"""


def write_study(folder, count, steps, elements):
    """Write a study of 5 * count * len(elements) cases; return its path."""
    text = PAPER.read_text(encoding="utf-8").replace("steps = 200", f"steps = {steps}")
    text += f"\n[mesh]\ncontact_elements = {elements[0]}\n"
    (folder / "paper.toml").write_text(text, encoding="utf-8")
    study = folder / "study.toml"
    study.write_text(_STUDY.format(count=count, elements=list(elements)), encoding="utf-8")
    return study


def command(study, output, ranks):
    """Return the words of a sweep's command; 0 ranks is without mpirun."""
    launcher = ["mpirun", "-n", str(ranks)] if ranks else []
    return [*launcher, *RINGWEAR, "sweep", str(study), "-o", str(output)]


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


def done_before(output):
    """Return the ids and seconds of the cases that have ended, from copies of the shards."""
    found = {}
    if (output / "results.h5").exists():
        with h5py.File(output / "results.h5", "r") as file:
            columns = file["case"].asstr()[:], file["status"].asstr()[:], file["seconds"][:]
            found = {
                key: s for key, status, s in zip(*columns, strict=True) if status != "incomplete"
            }
    with tempfile.TemporaryDirectory() as name:
        for path in (output / "shards").glob("*.blocks"):
            contents = read_shard(Path(shutil.copy(path, name)))  # the shard itself is in use
            for block in contents.blocks if contents is not None else ():
                ids, seconds = block.cases["id"].astype(str), block.cases["seconds"].tolist()
                found.update(zip(ids, seconds, strict=True))
    return found


def seconds_by_id(output):
    """Return the seconds of each case of a sweep."""
    with h5py.File(output / "results.h5", "r") as file:
        return dict(zip(file["case"].asstr()[:], file["seconds"][:].tolist(), strict=True))


def table(output):
    """Return the rows of cases.csv, without their seconds."""
    with (output / "cases.csv").open(newline="", encoding="utf-8") as file:
        return [{k: v for k, v in row.items() if k != "seconds"} for row in csv.DictReader(file)]


def differences(output, reference):
    """Return in what two finished sweeps differ, bit by bit, but for the time they took."""
    faults = [] if table(output) == table(reference) else ["cases.csv"]
    with h5py.File(output / "results.h5", "r") as a, h5py.File(reference / "results.h5", "r") as b:
        faults += a.keys() ^ b.keys()
        if a.attrs["status"] != b.attrs["status"]:
            faults.append("status")
        for name in sorted((a.keys() & b.keys()) - {"seconds"}):
            one, other = a[name][()], b[name][()]
            same = one.shape == other.shape and one.dtype == other.dtype
            if one.dtype.kind == "O":
                same = same and np.array_equal(one, other)
            else:  # NaN included
                same = same and one.tobytes() == other.tobytes()
            if not same or a[name].attrs.get("long_name") != b[name].attrs.get("long_name"):
                faults.append(name)
    return faults + sorted(
        {p.name for p in output.iterdir()} ^ {p.name for p in reference.iterdir()}
    )
