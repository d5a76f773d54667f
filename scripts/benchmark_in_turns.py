"""Stepping of histories by several checkouts in turns: CPU time a history, and ratios to the last.

    python scripts/benchmark_in_turns.py 3 OLD NEW [kind...] ["own moduli:1024" ...]

Each checkout (a folder, its compiled code in the cache) has a process of its own, and they compute
one after another, so that a busy machine is busy for all of them. Stepping is ``simulate``: no
checks of cases, no files; all histories side by side, as many of them as stand after a kind.
Medians of so many turns.
"""

import os
import subprocess
import sys
from pathlib import Path
from statistics import median

WORKER = """
import sys, time
sys.path.insert(0, "scripts")
from mpi4py import MPI
from scipy.stats import qmc
import benchmark_ensembles as ensembles
import ringwear_par as rw
try:
    from ringwear_par.history.loop import simulate
except ImportError:  # up to commit 0113fc3
    from ringwear_par.history.batch import simulate_batch
    def simulate(cases, comm, pair):
        return simulate_batch(cases, pair, lambda snapshot: None, most=256)

P0 = {"above": (0.0, 5.0), "35 to 60": (35.0, 60.0), "implicit": (0.0, 5.0), "power": None}
COUNT = {"implicit": 256, "own moduli": 256, "alone": 1, "wear through": 1, "96 wear through": 96}

def drawn(words):
    kind, _, number = words.partition(":")
    count = int(number or COUNT.get(kind, 512))
    if kind == "alone":
        return [ensembles.cases_of("adaptive", 1, 64)[0].replace({"wear.lower.k": 1e-7})]
    if "through" in kind:
        case = rw.read_case(ensembles.CASES / "wear_through.toml", {"mesh.contact_elements": 64})
        loads = [60.0 + 35.0 * i / (count - 1) for i in range(count)] if count > 1 else []
        return [case.replace({"load.pressure": load}) for load in loads] or [case]
    if kind not in P0:
        return ensembles.cases_of(kind, count, 64)
    keys = dict(ensembles.KINDS["200 implicit steps" if kind == "implicit" else "adaptive"])
    if kind == "power":
        power = {"law": "power", "p0": None, "m": 1.4, "k": 1e-8}
        keys |= {f"wear.lower.{key}": value for key, value in power.items()}
    first = rw.read_case(ensembles.CASES / "paper.toml", {**keys, "mesh.contact_elements": 64})
    cases = []
    for k, p0, load in qmc.Sobol(3, seed=1).random(count).tolist():
        own = {"wear.lower.k": 10.0 ** (2.0 * k - 8.0), "load.pressure": 60.0 + 30.0 * load}
        if kind == "power":
            own["wear.lower.k"] *= 0.0209  # about the same wear
        else:
            low, high = P0[kind]
            own["wear.lower.p0"] = low + (high - low) * p0
        cases.append(first.replace(own))
    return cases

ready = {}
for kind in map(str.strip, sys.stdin):
    if kind not in ready:
        cases = drawn(kind)
        ready[kind] = cases, rw.assemble(cases[0], MPI.COMM_SELF)
        simulate(cases[:16], MPI.COMM_SELF, pair=ready[kind][1])
    cases, pair = ready[kind]
    # a sweep has each case once: what the turn before has kept of its compliances is forgotten
    kept = sys.modules.get("ringwear_par.contact.scaled_compliances")
    getattr(kept, "_CACHE", {}).clear()
    getattr(pair, "families", {}).clear()
    begun = time.process_time()
    simulate(cases, MPI.COMM_SELF, pair=pair)
    print("CPU", (time.process_time() - begun) / len(cases), flush=True)
"""
KINDS = (
    "above", "35 to 60", "implicit", "power", "running-in", "growing contact", "own moduli",
    "two bodies", "alone", "wear through", "96 wear through",
)  # fmt: skip


def _worker(folder: Path) -> subprocess.Popen[str]:
    environment = {**os.environ, "PYTHONPATH": str(folder), "OPENBLAS_NUM_THREADS": "1"}
    return subprocess.Popen(
        [sys.executable, "-c", WORKER], cwd=folder, env=environment, text=True,
        stdin=subprocess.PIPE, stdout=subprocess.PIPE,
    )  # fmt: skip


def _seconds(worker: "subprocess.Popen[str]", kind: str) -> float:
    """Return the CPU time a history of a kind."""
    assert worker.stdin is not None
    assert worker.stdout is not None
    worker.stdin.write(f"{kind}\n")
    worker.stdin.flush()
    for line in worker.stdout:
        if line.startswith("CPU"):
            return float(line.split()[1])
    raise SystemExit(f"a checkout cannot compute {kind}")


def main() -> None:
    """Print a line for each kind."""
    turns, words = int(sys.argv[1]), sys.argv[2:]
    folders = [Path(word).resolve() for word in words if Path(word).is_dir()]
    kinds = [word for word in words if not Path(word).is_dir()] or KINDS
    workers = [_worker(folder) for folder in folders]
    for kind in kinds:
        times = [[_seconds(worker, kind) for worker in workers] for _ in range(turns)]
        medians = [median(column) for column in zip(*times, strict=True)]
        rates = "  ".join(f"{1.0 / time:>8.4g}/s" for time in medians)
        ratios = "  ".join(f"{time / medians[-1]:.2f}" for time in medians)
        print(f"{kind:<18}{rates}   ratios {ratios}", flush=True)


if __name__ == "__main__":
    main()
