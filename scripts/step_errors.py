"""How far time steps are off over whole histories, and how far they say they are.

    python scripts/step_errors.py [--count 70] [--seed 1] [--tolerance 1e-5]

The adaptive ones of ``random_cases.py`` and the paper's case, each against itself with a tolerance
100 times smaller: largest error of wear depth at any step over the tolerance, and over the error
that the history estimates of itself (told apart where wear brings elements into contact, which that
does not know of). Work is counted in contact problems.
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

#: how much smaller the tolerance of what counts as exact is
_FINER = 0.01


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
    tolerance : mm.
    closing : whether elements came into contact within steps.
    contacts, steps : made for it.
    """

    error: float
    estimate: float
    tolerance: float
    closing: bool
    contacts: int
    steps: int


def measured(case: Case, work: Work) -> Row:
    """Return the errors of a case's history against one with a tolerance 100 times smaller."""
    pair = None if case.follows_wear else assemble(case, MPI.COMM_SELF)
    before = work.contacts
    history = trace(replace(case, output=Output()), MPI.COMM_SELF, pair=pair)
    contacts = work.contacts - before
    states = history.states[1:]
    finer = replace(case.time, tolerance=_FINER * case.time.tolerance, pressure_tolerance=math.inf)
    times = Output(times=tuple(state.time for state in states))
    exact = trace(replace(case, time=finer, output=times), MPI.COMM_SELF, pair=pair)
    errors = [np.abs((s.wear - exact.at(s.time).wear).sum(axis=0)).max() for s in states]
    return Row(
        float(max(errors)), history.balances.step_error, case.time.tolerance, _closes(history),
        contacts, history.steps,
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
    args = parser.parse_args()
    work, rows, failed = Work(), [], 0
    CorrectedContacts.solve = work.counting(CorrectedContacts.solve)  # type: ignore[method-assign]
    for name, case in cases(args.count, args.seed, args.tolerance):
        try:
            row = measured(case, work)
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
