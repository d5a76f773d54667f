#!/usr/bin/env python
"""Kill sweeps at random moments, go on with them, and compare with one that was left in peace.

    python scripts/try_faults.py --times 20 --ranks 2
    python scripts/try_faults.py --times 20 --ranks 4 --ranks-per-case 2 --scheme adaptive

Alternately one rank, or every rank and mpirun, gets SIGKILL. The same command then has to finish
with the same results, bit for bit, and without computing a case again that was done before.
"""

import argparse
import csv
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from ringwear_par.studies.storage.shards import read_shard

CASES = Path(__file__).parent / "cases"
RINGWEAR = [sys.executable, "-m", "ringwear_par"]
#: of the whole study: nothing here may take longer, s
PATIENCE = 120.0
_STUDY = """case = "paper.toml"
[vary]
"wear.lower.k"  = {{ log = [1e-8, 1e-6], count = {count} }}
"wear.lower.p0" = {{ values = [0, 20, 40, 60, 70] }}
"mesh.contact_elements" = {{ values = [{elements}] }}
[design]
method = "grid"
"""


@dataclass(frozen=True)
class Trial:
    """What became of one sweep that was killed.

    Parameters
    ----------
    moment : seconds after its start.
    victims : number of processes that were killed; 0 if it had ended by itself.
    before, total : cases that were done when it was killed, and all.
    restarts : commands that it took to finish.
    faults : what is wrong.
    """

    moment: float
    victims: int
    before: int
    total: int
    restarts: int
    faults: tuple[str, ...]


def write_study(
    folder: Path,
    count: int = 30,
    steps: int = 100,
    elements: tuple[int, ...] = (48, 64),
    scheme: str = "implicit",
) -> Path:
    """Write a study of 5 * count * len(elements) cases; return its path.

    Adaptive histories are as long as so many steps of 1 s.
    """
    length = f"end = {steps}.0" if scheme == "adaptive" else f"step = 1.0\nsteps = {steps}"
    lines = (CASES / "paper.toml").read_text(encoding="utf-8").splitlines()
    lines = [line for line in lines if not line.startswith(("scheme =", "step =", "steps ="))]
    lines.insert(lines.index("[time]") + 1, f'scheme = "{scheme}"\n{length}')
    text = "\n".join([*lines, "", "[mesh]", f"contact_elements = {elements[0]}", ""])
    (folder / "paper.toml").write_text(text, encoding="utf-8")
    study = folder / "study.toml"
    listed = ", ".join(map(str, elements))
    study.write_text(_STUDY.format(count=count, elements=listed), encoding="utf-8")
    return study


def command(study: Path, output: Path, ranks: int, team: int = 1) -> list[str]:
    """Return the words of a sweep's command; 0 ranks is without mpirun."""
    launcher = ["mpirun", "-n", str(ranks)] if ranks else []
    how = ["--ranks-per-case", str(team)]
    return [*launcher, *RINGWEAR, "sweep", str(study), "-o", str(output), *how]


def children(pid: int) -> list[int]:
    """Return the processes that a launcher has started; MPICH's has a proxy between."""
    try:
        listed = Path(f"/proc/{pid}/task/{pid}/children").read_text(encoding="ascii")
    except OSError:
        listed = subprocess.run(
            ["pgrep", "-P", str(pid)], capture_output=True, text=True, check=False
        ).stdout
    found = [int(word) for word in listed.split()]
    return [rank for each in found for rank in (children(each) if _is_proxy(each) else [each])]


def _is_proxy(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/comm").read_text(encoding="ascii").startswith("hydra_pmi_proxy")
    except OSError:
        return False


def _alive(pid: int) -> bool:
    try:
        stat = Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace")
    except OSError:
        return False
    return stat.rpartition(")")[2].split()[0] not in "ZX"


def wait_for_end(pids: list[int], patience: float = 20.0) -> None:
    """Wait until none of some processes is there."""
    limit = time.monotonic() + patience
    while any(map(_alive, pids)):
        if time.monotonic() > limit:
            raise TimeoutError(f"processes {pids} are still there after {patience:g} s")
        time.sleep(0.01)


def kill(pid: int, number: int = signal.SIGKILL) -> bool:
    """Send a signal; return whether there was somebody to receive it."""
    try:
        os.kill(pid, number)
    except ProcessLookupError:
        return False
    return True


def done_before(output: Path) -> dict[str, float]:
    """Return the ids and seconds of the cases that have ended, from copies of the shards."""
    found: dict[str, float] = {}
    if (output / "results.h5").exists():
        with h5py.File(output / "results.h5", "r") as file:
            for identity, status, seconds in zip(
                file["case"].asstr()[:], file["status"].asstr()[:], file["seconds"][:], strict=True
            ):
                if status != "incomplete":
                    found[identity] = float(seconds)
    with tempfile.TemporaryDirectory() as name:
        for path in (output / "shards").glob("*.blocks"):
            copy = shutil.copy(path, name)  # the shard itself is in use
            contents = read_shard(Path(copy))
            for block in contents.blocks if contents is not None else ():
                ids, seconds = block.cases["id"].astype(str), block.cases["seconds"].tolist()
                found.update(zip(ids, seconds, strict=True))
    return found


def seconds_by_id(output: Path) -> dict[str, float]:
    """Return the seconds of each case of a finished sweep."""
    with h5py.File(output / "results.h5", "r") as file:
        return dict(zip(file["case"].asstr()[:], file["seconds"][:].tolist(), strict=True))


def table(output: Path) -> list[dict[str, str]]:
    """Return the rows of cases.csv, without their seconds."""
    with (output / "cases.csv").open(newline="", encoding="utf-8") as handle:
        rows = list(csv.DictReader(handle))
    for row in rows:
        row.pop("seconds")
    return rows


def differences(output: Path, reference: Path) -> list[str]:
    """Return in what two finished sweeps differ, bit by bit, but for the time they took."""
    faults = []
    if table(output) != table(reference):
        faults.append("cases.csv differs")
    with h5py.File(output / "results.h5", "r") as a, h5py.File(reference / "results.h5", "r") as b:
        if a.keys() != b.keys():
            faults.append(f"results.h5: only one has {sorted(a.keys() ^ b.keys())}")
        if a.attrs["status"] != b.attrs["status"]:
            faults.append(f"results.h5: status is {a.attrs['status']}")
        for name in sorted((a.keys() & b.keys()) - {"seconds"}):
            one, other = a[name][()], b[name][()]
            if one.shape != other.shape or one.dtype != other.dtype:
                faults.append(f"results.h5: {name} has another shape or type")
            elif one.dtype.kind == "O":
                if not np.array_equal(one, other):
                    faults.append(f"results.h5: {name} differs")
            elif one.tobytes() != other.tobytes():
                faults.append(f"results.h5: {name} differs")
            texts = [dict(x[name].attrs).get("long_name") for x in (a, b)]
            if texts[0] != texts[1]:
                faults.append(f"results.h5: {name} is called {texts[0]!r}, not {texts[1]!r}")
    left = {p.name for p in output.iterdir()} ^ {p.name for p in reference.iterdir()}
    if left:
        faults.append(f"only one folder has {', '.join(sorted(left))}")
    return faults


def run_reference(words: list[str], environment: dict[str, str]) -> float:
    """Run a sweep in peace; return its seconds."""
    started = time.monotonic()
    subprocess.run(
        words, env=environment, capture_output=True, text=True,
        timeout=PATIENCE, check=True,
    )  # fmt: skip
    return time.monotonic() - started


def run_trial(
    words: list[str],
    output: Path,
    reference: Path,
    moment: float,
    everybody: bool,
    choice: random.Random,
    environment: dict[str, str],
) -> Trial:
    """Kill a sweep, one of its ranks or everybody, finish it and compare.

    Parameters
    ----------
    words, output : of the sweep.
    reference : folder of the same, left in peace.
    moment : when to kill, s after the start.
    everybody : whether mpirun and all ranks die, or one rank.
    choice : draws the rank.
    environment : of the commands.
    """
    quiet = subprocess.DEVNULL
    process = subprocess.Popen(words, env=environment, stdout=quiet, stderr=quiet)
    family: list[int] = []
    victims = 0
    try:
        time.sleep(moment)
        family = children(process.pid)
        if process.poll() is None and family:
            chosen = [process.pid, *family] if everybody else [choice.choice(family)]
            victims = sum([kill(pid) for pid in chosen])
        process.wait(timeout=PATIENCE)
    finally:
        for pid in (process.pid, *family) if process.poll() is None else ():
            kill(pid)
        process.wait()
    wait_for_end(family)
    before = done_before(output) if output.exists() else {}
    faults: list[str] = []
    total, restarts = len(table(reference)), 0
    while True:
        restarts += 1
        again = subprocess.run(
            words, env=environment, capture_output=True, text=True, timeout=PATIENCE, check=False
        )
        said = [line for line in again.stderr.splitlines() if "are there already" in line]
        if restarts == 1 and before:
            wanted = f"{len(before)} of {total} cases are there already"
            if len(said) != 1 or wanted not in said[0]:
                faults.append(f"said {said}, not {wanted!r}")
        if "Traceback" in again.stderr:
            faults.append("a traceback")
        if again.returncode == 0:
            break
        if restarts == 3:
            faults.append(f"still status {again.returncode}: {again.stderr[-300:]}")
            return Trial(moment, victims, len(before), total, restarts, tuple(faults))
    computed = re.search(r"^(\d+) (?:cases )?computed in ", again.stdout, re.MULTILINE)
    count = int(computed[1]) if computed else 0
    if restarts == 1 and count != total - len(before):
        faults.append(f"computed {count} cases, not the {total - len(before)} that were missing")
    after = seconds_by_id(output)
    repeated = [identity for identity, seconds in before.items() if after.get(identity) != seconds]
    if repeated:
        faults.append(f"{len(repeated)} cases were computed again")
    faults += differences(output, reference)
    return Trial(moment, victims, len(before), total, restarts, tuple(faults))


def run_trials(
    study: Path,
    folder: Path,
    times: int,
    ranks: int,
    seed: int,
    environment: dict[str, str],
    team: int = 1,
) -> list[Trial]:
    """Run a study in peace and then killed at random moments; print a line a trial."""
    choice = random.Random(seed)
    reference = folder / "reference"
    whole = run_reference(command(study, reference, ranks, team), environment)
    print(f"reference: {len(table(reference))} cases on {ranks} ranks in {whole:.1f} s", flush=True)
    trials = []
    for number in range(times):
        output = folder / f"trial_{number}"
        everybody = number % 2 == 1
        moment = choice.uniform(0.5, max(whole, 0.6))
        words = command(study, output, ranks, team)
        trial = run_trial(words, output, reference, moment, everybody, choice, environment)
        who = "nobody" if not trial.victims else "everybody" if everybody else "one rank"
        print(
            f"{number + 1:3d}: {who} killed after {moment:.2f} s, {trial.before} of {trial.total} "
            f"cases done before, finished after {trial.restarts} restart(s): "
            + ("; ".join(trial.faults) or "equal"),
            flush=True,
        )
        trials.append(trial)
        if not trial.faults:
            shutil.rmtree(output)
    return trials


def main() -> int:
    """Run the trials and sum up."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--times", type=int, default=20, help="sweeps to kill")
    parser.add_argument("--ranks", type=int, default=2, help="of each sweep")
    parser.add_argument("--seed", type=int, default=1, help="of the random moments")
    parser.add_argument("--cases", type=int, default=300, help="of the study, a multiple of 10")
    parser.add_argument("--ranks-per-case", type=int, default=1, help="size of the teams")
    parser.add_argument(
        "--scheme", choices=["implicit", "adaptive"], default="implicit", help="of time"
    )
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        study = write_study(folder, count=max(2, args.cases // 10), scheme=args.scheme)
        trials = run_trials(
            study, folder, args.times, args.ranks, args.seed, dict(os.environ), args.ranks_per_case
        )
    bad = sum(bool(trial.faults) for trial in trials)
    killed = sum(trial.victims > 0 for trial in trials)
    kept = sum(trial.before for trial in trials)
    print(
        f"{len(trials)} sweeps, {killed} of them killed, {kept} cases done before and kept: "
        + (f"{bad} sweeps differ" if bad else "all equal to the one left in peace, bit for bit")
    )
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
