"""Histories a second of ensembles: what ``scripts/benchmark.py --ensembles`` prints.

The paper's rings, 200 s; k, p0 and load are drawn by Sobol. "Together" is ``rw.simulate_all``,
checks and results included; "alone" is ``rw.simulate``, one case after another, of sixteen of them,
chosen evenly by their numbers of steps.
The bare loop is what a script does that has the compliance of both bodies, here ours: 200 explicit
steps, in each of which NumPy solves the bordered system of the elements in contact. All of one kind
are timed in turns; medians. A sweep is ``ringwear sweep`` from the command to its files; outside of
stepping is all that it took but that, of all ranks, for each case; in the last rows a case is one
step on 8 elements, so that the rest is what is left.
"""

import re
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from mpi4py import MPI
from scipy.stats import qmc

import ringwear_par as rw
from ringwear_par.history.elastic.bodies import young

CASES = Path(__file__).parent / "cases"
_ADAPTIVE = {
    "time.scheme": "adaptive", "time.end": 200.0, "time.step": None, "time.steps": None,
    "output.profiles": "last",
}  # fmt: skip
_RUNNING_IN = {
    "law": "running-in", "k": 1e-7, "k_start": 1e-6, "depth": 1e-3, "p0": None,
}  # fmt: skip
#: radius of the crown 11 mm, about a tenth of a millimetre at its ends
_CROWN = [[r, 20.0 + (r - 30.0) ** 2 / 22.0] for r in np.linspace(28.5, 31.5, 25).tolist()]
_STUDY = """case = "case.toml"
[vary]
"wear.lower.k" = {{ log = [1e-8, 1e-6] }}
"wear.lower.p0" = {{ linear = [0, 60] }}
"load.pressure" = {{ linear = [40, 90] }}
[design]
method = "sobol"
count = {}
seed = 1
"""
#: what each kind of case has beside the paper's
KINDS: dict[str, dict[str, Any]] = {
    "adaptive": _ADAPTIVE,
    "200 implicit steps": {"output.profiles": "last"},
    "two bodies": {**_ADAPTIVE, "wear.upper.law": "archard", "wear.upper.k": 1e-8},
    "running-in": {**_ADAPTIVE, **{f"wear.lower.{k}": v for k, v in _RUNNING_IN.items()}},
    "growing contact": {**_ADAPTIVE, "upper.profile": _CROWN},
    "own moduli": _ADAPTIVE,
}
#: histories that are timed alone
_ALONE = 16
_ONE_STEP = {"time.steps": 1, "output.profiles": "last", "mesh.contact_elements": 8}


def cases_of(kind: str, count: int, elements: int) -> list[rw.Case]:
    """Return cases of a kind."""
    base = {**KINDS[kind], "mesh.contact_elements": elements}
    drawn = qmc.Sobol(4, seed=1).random(count)
    first = rw.read_case(CASES / "paper.toml", base)
    changed = []
    for k, p0, pressure, modulus in drawn.tolist():
        own = {"wear.lower.k": 10.0 ** (-8.0 + 2.0 * k), "load.pressure": 40.0 + 50.0 * pressure}
        if kind != "running-in":
            own["wear.lower.p0"] = 60.0 * p0
        if kind == "own moduli":
            own["lower.young"] = 8e3 + 4e3 * modulus
        changed.append(first.replace(own))
    return changed


def bare_loop(pair: rw.ContactPair, case: rw.Case) -> float:
    """Step a history as a script would; return its penetration, mm."""
    compliance = pair.compliance(young(case)).collocated
    area, n = case.line.area, case.line.n
    power = case.friction * float(case.load.omega) * case.line.r
    force, law = float(case.load.force), case.wear_lower
    gap, approaches = case.initial_gap.copy(), []
    for _ in range(201):
        touching = np.ones(n, dtype=bool)
        while True:
            e = np.flatnonzero(touching)
            system = np.zeros((len(e) + 1, len(e) + 1))
            system[:-1, :-1] = compliance[np.ix_(e, e)]
            system[:-1, -1], system[-1, :-1] = -1.0, area[e]
            solution = np.linalg.solve(system, np.append(-gap[e], force))
            p = np.zeros(n)
            p[e] = solution[:-1]
            if (p >= 0.0).all():
                break
            touching &= p > 0.0
        approaches.append(solution[-1])
        gap += float(law.k) * power * np.maximum(p - float(law.p0), 0.0)  # in a second
    return approaches[-1] - approaches[0]


def _seconds(action: Callable[[], object]) -> float:
    begun = time.perf_counter()
    action()
    return time.perf_counter() - begun


def measure(kind: str, count: int, elements: int, repeats: int) -> tuple[float, float, float]:
    """Return histories a second together, alone, and of the bare loop."""
    cases, alone = cases_of(kind, count, elements), MPI.COMM_SELF
    pair = rw.assemble(cases[0], alone)
    # histories differ by ten times in their steps: those alone are chosen evenly by them
    steps = [len(result.histories["time"]) for result in rw.simulate_all(cases, alone)]
    parts = np.array_split(np.argsort(steps, kind="stable"), min(_ALONE, count))
    few = [cases[part[len(part) // 2]] for part in parts]
    plain = cases_of("adaptive", len(few), elements)
    actions: dict[Callable[[], object], int] = {
        lambda: rw.simulate_all(cases, alone): count,
        lambda: [rw.simulate(case, alone, pair=pair) for case in few]: len(few),
        lambda: [bare_loop(pair, case) for case in plain]: len(few),
    }
    times = [[_seconds(action) / of for action, of in actions.items()] for _ in range(repeats)]
    together, one, bare = (1.0 / median(column) for column in zip(*times, strict=True))
    return together, one, bare


def _environment() -> dict[str, str]:
    """Return the environment of before MPI, which must not find itself in what it starts."""
    words = Path("/proc/self/environ").read_text(encoding="utf-8").split("\0")
    return dict(word.split("=", 1) for word in words if word)


def measure_sweep(
    kind: dict[str, Any], count: int, ranks: int
) -> tuple[float, float, float, float]:
    """Return cases a second, us outside of stepping, bytes on disk a case, and MB of a rank."""
    case = rw.read_case(CASES / "paper.toml", kind)
    command = [sys.executable, "-m", "ringwear_par", "sweep", "study.toml", "-o", "out"]
    if ranks > 1:
        command = ["mpirun", "-n", str(ranks), *command]
    with TemporaryDirectory() as folder:
        (Path(folder) / "case.toml").write_text(case.text, encoding="utf-8")
        (Path(folder) / "study.toml").write_text(_STUDY.format(count), encoding="utf-8")
        begun = time.perf_counter()
        done = subprocess.run(
            command, cwd=folder, env=_environment(), check=True, capture_output=True, text=True,
            timeout=36000,
        )  # fmt: skip
        seconds = time.perf_counter() - begun
        size = sum(path.stat().st_size for path in (Path(folder) / "out").iterdir())
    (stepping,) = re.findall(r"([\d.]+) % stepping", done.stdout)
    (memory,) = re.findall(r"peak memory of a rank ([\d.]+) MB", done.stdout)
    outside = 1e6 * seconds * ranks * (1.0 - 0.01 * float(stepping)) / count
    return count / seconds, outside, size / count, float(memory)


def print_table(count: int, elements: int, repeats: int) -> None:
    """Print all of it, of so many cases of each kind."""
    print(f"{'histories a second':<30}{'together':>10}{'alone':>9}{'ratio':>8}", end="")
    print(f"{'bare loop':>11}{'ratio':>8}")
    for kind in KINDS:
        together, one, bare = measure(kind, count, elements, repeats)
        print(f"{kind:<30}{together:>10.4g}{one:>9.3g}{together / one:>8.3g}", end="")
        print(f"{bare:>11.3g}{together / bare:>8.3g}", flush=True)
    print(f"{'sweeps, start to files':<40}{'a second':>10}{'us outside':>12}", end="")
    print(f"{'bytes':>8}{'MB a rank':>11}")
    of_size = {"mesh.contact_elements": elements}
    sweeps: list[tuple[str, dict[str, Any], int]] = [
        ("adaptive", {**_ADAPTIVE, **of_size}, count),
        ("200 implicit steps", {**KINDS["200 implicit steps"], **of_size}, count),
        ("one step", _ONE_STEP, 10 * count),
    ]
    for name, kind, number in sweeps:
        for ranks in (1, 2):
            rate, outside, size, memory = measure_sweep(kind, number, ranks)
            kind_and_ranks = f"{name}, {number} cases, ranks: {ranks}"
            print(
                f"{kind_and_ranks:<40}{rate:>10.4g}{outside:>12.4g}{size:>8.0f}{memory:>11.0f}",
                flush=True,
            )
