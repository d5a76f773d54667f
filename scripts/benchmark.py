"""Speed: histories a second of a core side by side, single histories, and ``ringwear run``.

Usage: python scripts/benchmark.py [--count 1024] [--turns 3] [--elements 64]

CPU seconds of one process, medians over the turns, after one that is not counted. Cases side by
side have loads of 60 to 90 MPa and, with the threshold law, k of 1e-8 to 1e-6 and p0 of 0 to 60
MPa; they go through ``rw.simulate_all``, with checks and results.
Ratios to another commit are worth more than times: start both in turns, on a machine at rest.
"""

import argparse
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

import numpy as np
from mpi4py import MPI

import ringwear_par as rw

CASES = Path(__file__).parent / "cases"
#: base case, and share of the count
KINDS = {
    "adaptive": ("adaptive.toml", 1.0),
    "200 implicit steps": ("paper.toml", 0.5),
    "power law": ("power.toml", 0.5),
    "running-in": ("running_in.toml", 0.5),
    "growing contact": ("crown.toml", 0.25),
    "own moduli": ("adaptive.toml", 0.25),
    "worn through": ("wear_through.toml", 0.05),
}
SINGLE = "paper.toml", "adaptive.toml", "wear_through.toml", "updated.toml", "stress.toml"


def cases_of(kind: str, count: int, elements: int) -> list[rw.Case]:
    """Return random cases of a kind; the same at each call."""
    name, share = KINDS[kind]
    rng, cases = np.random.default_rng(1), []
    for _ in range(max(2, round(share * count))):
        load, k, p0 = rng.uniform(60.0, 90.0), 10.0 ** rng.uniform(-8.0, -6.0), rng.uniform(0, 60)
        keys = {"mesh.contact_elements": elements, "load.pressure": load}
        if name in ("adaptive.toml", "paper.toml"):
            keys |= {"wear.lower.k": k, "wear.lower.p0": p0}
        if kind == "own moduli":
            keys["upper.young"] = 10.0 ** rng.uniform(4.5, 5.5)
        cases.append(rw.read_case(CASES / name, keys))
    return cases


def cpu_seconds(turns: int, action: Callable[[], object], who: int = resource.RUSAGE_SELF) -> float:
    """Return the median CPU time of an action, of this process or of its children, s."""
    times = []
    for _ in range(turns + 1):
        before = resource.getrusage(who)
        action()
        after = resource.getrusage(who)
        times.append(after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime)
    return median(times[1:])


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=1024, help="cases side by side")
    parser.add_argument("--turns", type=int, default=3)
    parser.add_argument("--elements", type=int, default=64, help="of the contact")
    args = parser.parse_args()

    print(f"{'side by side':<28}{'cases':>8}{'a second':>12}")
    for kind in KINDS:
        cases = cases_of(kind, args.count, args.elements)
        seconds = cpu_seconds(args.turns, lambda: rw.simulate_all(cases, MPI.COMM_SELF))  # noqa: B023
        print(f"{kind:<28}{len(cases):>8}{len(cases) / seconds:>12.4g}", flush=True)

    print(f"\n{'one history':<28}{'ms':>8}")
    for name in SINGLE:
        case = rw.read_case(CASES / name, {"mesh.contact_elements": args.elements})
        seconds = cpu_seconds(args.turns, lambda: rw.simulate(case, MPI.COMM_SELF))  # noqa: B023
        print(f"{name:<28}{1e3 * seconds:>8.4g}", flush=True)

    with TemporaryDirectory() as folder:
        words = [sys.executable, "-m", "ringwear_par", "run", str(CASES / "paper.toml"), "-o",
                 f"{folder}/run.h5"]  # fmt: skip
        started = time.perf_counter()
        seconds = cpu_seconds(
            args.turns,
            lambda: subprocess.run(words, check=True, capture_output=True),
            resource.RUSAGE_CHILDREN,
        )
        wall = (time.perf_counter() - started) / (args.turns + 1)
    print(f"\nringwear run paper.toml: {seconds:.2f} s of CPU, {wall:.2f} s of wall time")
    print(f"peak memory: {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3:.0f} MB")


if __name__ == "__main__":
    main()
