"""How far time steps are off over whole histories, and how far they say they are.

    python scripts/step_errors.py [--count 70] [--seed 1] [--tolerance 1e-5]
    python scripts/step_errors.py --coatings 200 [--finer 0.03] [--elements 32]

The adaptive ones of ``random_cases.py`` and the paper's case, each against itself with a tolerance
100 times smaller: largest error of wear depth at any step over the tolerance, and over the error
that the history estimates of itself (told apart where wear brings elements into contact, which that
does not know of). Work is counted in contact problems.

With ``--coatings`` so many random coatings of the paper's rings instead, see ``random_coating``:
largest errors of wear depth and of the penetration at any step, micrometres, and the balance of
energy, where laws have no threshold.
"""

import argparse
import math
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from mpi4py import MPI
from random_cases import random_case

from ringwear_par.cases.case import Case, Output, Stepping
from ringwear_par.cases.files.reading import make_case
from ringwear_par.contact.correction import CorrectedContacts
from ringwear_par.elasticity.mesh import Mesh
from ringwear_par.errors import RingwearError
from ringwear_par.history.elastic.pairs import assemble
from ringwear_par.history.observers.trace import Trace, trace
from ringwear_par.verification.histories import paper_case

#: s, duration of histories with coatings
_END = 300.0
#: errors that are asked for of coatings, um: of depths and of the penetration
_DEPTH, _PENETRATION = 0.01, 0.001


@dataclass
class Work:
    """Contact problems so far."""

    contacts: int = 0

    def counting(self, solve: Callable) -> Callable:
        """Return a method of ``CorrectedContacts`` that counts its calls."""

        def counted(*arguments: Any, **keywords: Any) -> Any:
            self.contacts += 1
            return solve(*arguments, **keywords)

        return counted


@dataclass(frozen=True)
class Row:
    """What a history came to.

    Parameters
    ----------
    error, estimate : mm, largest error of wear, and what the history says of it.
    penetration : mm, largest error of the penetration.
    energy : largest defect of the balance of energy.
    tolerance : mm.
    closing : whether elements came into contact within steps.
    contacts, steps : made for it.
    """

    error: float
    estimate: float
    penetration: float
    energy: float
    tolerance: float
    closing: bool
    contacts: int
    steps: int


def measured(case: Case, work: Work, finer_by: float) -> Row:
    """Return the errors of a case's history against one whose tolerance is this much smaller."""
    pair = None if case.follows_wear else assemble(case, MPI.COMM_SELF)
    before = work.contacts
    history = trace(replace(case, output=Output()), MPI.COMM_SELF, pair=pair)
    contacts = work.contacts - before
    states = history.states[1:]
    finer = replace(
        case.time, tolerance=finer_by * case.time.tolerance, pressure_tolerance=math.inf
    )
    times = Output(times=tuple(state.time for state in states))
    exact = trace(replace(case, time=finer, output=times), MPI.COMM_SELF, pair=pair)
    at_times = [exact.at(state.time) for state in states]
    errors = [
        np.abs((state.wear - true.wear).sum(axis=0)).max()
        for state, true in zip(states, at_times, strict=True)
    ]
    penetrations = [
        abs(float(state.contact.approach - true.contact.approach))
        for state, true in zip(states, at_times, strict=True)
    ]
    return Row(
        float(max(errors)), history.balances.step_error, max(penetrations),
        history.balances.energy, case.time.tolerance, _closes(history), contacts, history.steps,
    )  # fmt: skip


def _closes(history: Trace) -> bool:
    return any(bool(snapshot.step.closing) for snapshot in history.snapshots[1:])


def cases(count: int, seed: int, tolerance: float) -> list[tuple[str, Case]]:
    """Return the paper's case and the adaptive ones among random cases, by name."""
    steps = Stepping("adaptive", until=2000.0, tolerance=tolerance)
    found = [("paper", paper_case(Mesh(32), stepping=steps))]
    for number in range(count):
        keys, sort = random_case(np.random.default_rng((seed, number)))
        if keys["time.scheme"] == "adaptive":
            keys["time.tolerance"] = tolerance
            found.append((f"case {number} ({sort})", make_case(keys, f"case {number}")))
    return found


def random_coating(rng: np.random.Generator, elements: int) -> tuple[dict[str, Any], list[str]]:
    """Return the keys of a random coating of the paper's rings, and what kinds of case it is.

    One to three layers of 0.5 to 10 um and 1 to 500 GPa, on one body or both, whose coefficients
    differ by up to 100, those of bodies by up to 30 from the mean of their layers; without a
    threshold, or with one of 0.2 to 0.9, or 0.9 to 1.2 of the mean pressure. Without a threshold,
    at the mean pressure, layers would be through after 0.2 to 0.9 of the time.
    """

    def log(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    pressure, mu, omega, r = float(rng.uniform(40.0, 95.0)), 0.1, 85.0 / 24.0, 30.0
    keys: dict[str, Any] = {
        "lower.r": [20.0, 40.0], "lower.z": [0.0, 20.0], "lower.young": 10e3,
        "lower.poisson": 0.3, "upper.r": [28.5, 31.5], "upper.z": [20.0, 40.0],
        "upper.young": 100e3, "upper.poisson": 0.3, "contact.friction": mu, "load.omega": omega,
        "time.scheme": "adaptive", "time.end": _END, "mesh.contact_elements": elements,
    }  # fmt: skip
    threshold = str(rng.choice(["no threshold", "p0 below", "p0 near the mean pressure"]))
    shares = {"no threshold": (0.0, 0.0), "p0 below": (0.2, 0.9)}.get(threshold, (0.9, 1.2))
    controlled = rng.random() < 0.3
    if controlled:  # about the approach at this pressure, and as much again while it wears
        first = 1e-3 * pressure
        keys["load.control"] = "displacement"
        keys["load.displacement"] = [[0.0, first], [_END, first + float(rng.uniform(0.0, 0.02))]]
    else:
        keys["load.pressure"] = pressure
    law = "threshold" if rng.random() < 0.6 else str(rng.choice(["power", "table", "running-in"]))

    def wear(k: float, p0: float) -> dict[str, Any]:
        """Return the entries of a law that wears k mu (p - p0) V, or as much at this p V."""
        pv = pressure * omega * r
        if law == "power":
            m = float(rng.uniform(1.1, 2.5))
            return {"law": law, "k": k * mu * pressure ** (1.0 - m), "m": m, "n": 1.0}
        if law == "table":
            rate = k * mu * pv
            return {"law": law, "table": [[0.0, 0.0], [0.5 * pv, 0.2 * rate], [pv, rate],
                                          [3.0 * pv, 5.0 * rate]]}  # fmt: skip
        entries: dict[str, Any] = {"law": law, "k": k, "p0": p0}
        if law == "running-in":
            entries |= {"k_start": k * log(1.0, 10.0), "depth": log(3e-4, 3e-3)}
        return entries

    both = rng.random() < 0.3
    count = 0
    for body in ("lower", "upper") if both else (str(rng.choice(["lower", "upper"])),):
        layers = int(rng.integers(1, 4))
        count = max(count, layers)
        thicknesses = [log(0.5e-3, 10e-3) for _ in range(layers)]
        ratios = [log(0.1, 10.0) for _ in range(layers)]
        slowness = sum(h / k for h, k in zip(thicknesses, ratios, strict=True))
        k = slowness / (float(rng.uniform(0.2, 0.9)) * _END * mu * pressure * omega * r)
        p0 = [float(rng.uniform(*shares)) * pressure for _ in range(layers + 1)]
        keys[f"{body}.layers"] = [
            {"thickness": h, "young": log(1e3, 5e5), "poisson": float(rng.uniform(0.2, 0.4)),
             "wear": wear(k * ratio, threshold)}
            for h, ratio, threshold in zip(thicknesses, ratios, p0, strict=False)
        ]  # fmt: skip
        mean = k * sum(thicknesses) / slowness
        keys |= {f"wear.{body}.{name}": v for name, v in wear(mean * log(0.3, 30), p0[-1]).items()}
    kinds = [
        law if law in ("power", "table") else threshold,
        "displacement" if controlled else "force",
        "one layer" if count == 1 else "two or three layers",
        "both bodies" if both else "one body",
    ]
    return keys, [*kinds, law] if law == "running-in" else kinds


def measure_coatings(count: int, seed: int, finer_by: float, elements: int, each: bool) -> int:
    """Print the errors of random coatings, as a table of the kinds of them; return 1 if one fails.

    They are shared out among the processes that it is started with.
    """
    comm, rows, failures = MPI.COMM_WORLD, [], []
    for number in range(comm.rank, count, comm.size):
        keys, kinds = random_coating(np.random.default_rng((seed, number)), elements)
        name = f"coating {number} ({', '.join(kinds)})"
        try:
            row = measured(make_case(keys, name), Work(), finer_by)
        except RingwearError as error:
            failures.append(f"{name}: {error}")
            continue
        rows.append((kinds, row))
        if each:
            print(
                f"{name}: depth {1e3 * row.error:.4f}, penetration {1e3 * row.penetration:.5f} um, "
                f"estimate {1e3 * row.estimate:.4f}, energy {row.energy:.0e}, {row.steps} steps",
                flush=True,
            )
    all_rows, all_failures = comm.gather(rows), comm.gather(failures)
    if comm.rank > 0 or all_rows is None or all_failures is None:
        return 0
    table = [row for part in all_rows for row in part]
    print(
        "| coatings | number | depth, um: median, 90 %, largest | within 0.01 | penetration, um: "
        "median, 90 %, largest | within 0.001 | energy |\n" + "|---" * 7 + "|"
    )
    for kind in ["all", *sorted({kind for kinds, _ in table for kind in kinds})]:
        of_kind = [row for kinds, row in table if kind == "all" or kind in kinds]
        depths = 1e3 * np.array([row.error for row in of_kind])
        penetrations = 1e3 * np.array([row.penetration for row in of_kind])
        quantiles = 0.5, 0.9, 1.0
        columns = [
            kind, str(len(of_kind)),
            ", ".join(f"{v:.2g}" for v in np.quantile(depths, quantiles)),
            str(np.count_nonzero(depths <= _DEPTH)),
            ", ".join(f"{v:.2g}" for v in np.quantile(penetrations, quantiles)),
            str(np.count_nonzero(penetrations <= _PENETRATION)),
            f"{max(row.energy for row in of_kind):.0e}",
        ]  # fmt: skip
        print(f"| {' | '.join(columns)} |")
    failed = [failure for part in all_failures for failure in part]
    print("\n".join(failed))
    return 1 if failed else 0


def told(rows: list[Row]) -> str:
    """Return what rows say together."""
    off = np.array([row.error / row.tolerance for row in rows])
    lines = [
        f"{len(rows)} histories, {sum(row.contacts for row in rows)} contact problems, "
        f"{sum(row.steps for row in rows)} steps",
        "error over tolerance: median {:.2f}, 90 % below {:.2f}, 95 % below {:.2f}, "
        "largest {:.2f}".format(*np.quantile(off, (0.5, 0.9, 0.95, 1.0)))
        + f"; within 2 tolerances {100.0 * np.mean(off <= 2.0):.0f} %",
    ]
    for closing in (False, True):
        which = [row for row in rows if row.closing == closing and row.estimate > 0.0]
        if which:
            ratios = [row.error / row.estimate for row in which]
            lines.append(
                f"error over estimate, {len(which)} {'with' if closing else 'without'} elements "
                "that close: 10 % below {:.2f}, median {:.2f}, 90 % below {:.2f}, "
                "largest {:.2f}".format(*np.quantile(ratios, (0.1, 0.5, 0.9, 1.0)))
            )
    return "\n".join(lines)


def main() -> int:
    """Measure, and tell; return 1 if a case fails."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=70)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--tolerance", type=float, default=1e-5, help="mm")
    parser.add_argument("--each", action="store_true", help="a line for each history")
    parser.add_argument("--finer", type=float, default=0.01, help="tolerance of what counts as "
                        "exact, in that of the history")  # fmt: skip
    parser.add_argument("--coatings", type=int, help="number of random coatings")
    parser.add_argument("--elements", type=int, default=32, help="in contact, of coatings")
    args = parser.parse_args()
    if args.coatings is not None:
        return measure_coatings(args.coatings, args.seed, args.finer, args.elements, args.each)
    work, rows, failed = Work(), [], 0
    CorrectedContacts.solve = work.counting(CorrectedContacts.solve)  # type: ignore[method-assign]
    for name, case in cases(args.count, args.seed, args.tolerance):
        try:
            row = measured(case, work, args.finer)
        except RingwearError as error:
            failed += 1
            print(f"{name}: {error}", flush=True)
            continue
        if args.each:
            print(
                f"{name}: error {row.error / row.tolerance:.2f} tolerances, estimate "
                f"{row.estimate / row.tolerance:.2f}, {row.contacts} contacts"
                + (", closing" if row.closing else ""),
                flush=True,
            )
        rows.append(row)
    print(told(rows))
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
