"""A worked sweep that shows where the threshold pressure changes the life.

Usage: [mpirun -n N] python scripts/sweep_wear_law.py [-o out/wear_law]

Sweeps scripts/cases/wear_law.toml (wear coefficient k, threshold p0 and load around the paper's
case) into the folder, draws life.png there and prints three numbers. The same command again
computes only what is missing. Life is the time until the penetration reaches 10 um, interpolated
between stored steps; NaN where the time computed does not suffice.

What to expect: once the rings have run in, wear rate and approach agree, so p = p0 + c/r, where
c = (P - p0) (a + b)/2 follows from the mean pressure P on the annulus a < r < b, and the approach
grows at k mu omega c. Hence, were it so from the start,

    life = depth / (k mu omega (P - p0) (a + b)/2).

Running in adds some 1.2 um (at 80 MPa) to the penetration and so shortens life by an eighth, but
nearly alike for every p0: ratios of lives are close to those of the steady state.
"""

import argparse
import logging
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

import matplotlib
import numpy as np
import petsc4py
from mpi4py import MPI

STUDY = Path(__file__).parent / "cases" / "wear_law.toml"
#: penetration at the end of life, mm
DEPTH = 10e-3
#: of the paper, 1/MPa and MPa; the load is our reading
PAPER_K, PAPER_P0, PAPER_LOAD = 1e-7, 40.0, 80.0
#: value in steady state, unit and meaning of each number
NUMBERS = {
    "doubling_threshold": (PAPER_LOAD / 2, "MPa", "p0 that doubles the life of p0 = 0"),
    "similarity": (1.0, "1", "k life at the largest k over that at the smallest, p0 = 0"),
    "load_sensitivity": (1.5, "1", "life at 80 MPa over that at 100 MPa, p0 = 40 MPa"),
}


def lives(time: np.ndarray, penetration: np.ndarray) -> np.ndarray:
    """Return when each history, (cases, steps) in s and mm, reaches DEPTH; NaN where it does not.

    Histories end where they are NaN.
    """
    found = np.full(len(time), np.nan)
    for i, (t, depth) in enumerate(zip(time, penetration, strict=True)):
        there = depth >= DEPTH
        if there.any():
            after = max(1, int(np.argmax(there)))
            found[i] = np.interp(DEPTH, depth[after - 1 : after + 1], t[after - 1 : after + 1])
    return found


def study(folder: Path, comm: MPI.Intracomm) -> dict[str, float]:
    """Sweep what is missing, draw life.png and return the numbers of NUMBERS. Collective.

    Parameters
    ----------
    folder : of the results.
    comm : must be COMM_WORLD, with PETSc initialised.
    """
    from ringwear_par.parallel import on_first_rank
    from ringwear_par.studies.execution.sweep import run_sweep

    run_sweep(STUDY, folder, comm)
    return on_first_rank(comm, partial(_evaluated, folder))


def _evaluated(folder: Path) -> dict[str, float]:
    """Draw the picture and return the numbers. On one rank."""
    from ringwear_par.studies.definition.study import read_study
    from ringwear_par.studies.storage.ensemble import read_ensemble

    case = read_study(STUDY).case(0)
    sliding = case.friction * case.load.omega * sum(case.contact) / 2  # mm/s

    def steady(k: float, p0: float, load: float) -> float:
        return DEPTH / (k * sliding * (load - p0)) if load > p0 else np.inf

    ensemble = read_ensemble(folder)
    cases = np.flatnonzero(ensemble.in_study)
    life = lives(*(ensemble.histories(name, cases) for name in ("time", "penetration")))
    k, p0, load = (
        ensemble.varied[name][cases] for name in ("wear.lower.k", "wear.lower.p0", "load.pressure")
    )

    def along(axis: np.ndarray, **fixed: float) -> tuple[np.ndarray, np.ndarray]:
        """Return one axis, increasing, and the lives along it at fixed values of the others."""
        columns = {"k": k, "p0": p0, "load": load}
        chosen = np.all([np.isclose(columns[n], v) for n, v in fixed.items()], axis=0)
        order = np.argsort(axis[chosen])
        return axis[chosen][order], life[chosen][order]

    _draw(folder / "life.png", k, p0, load, along, steady)
    thresholds, by_p0 = along(p0, k=PAPER_K, load=PAPER_LOAD)
    coefficients, by_k = along(k, p0=0.0, load=PAPER_LOAD)
    loads, by_load = along(load, k=PAPER_K, p0=PAPER_P0)
    reached = np.isfinite(by_p0)
    # 1/life is all but linear in p0
    doubling = np.interp(-0.5, -by_p0[0] / by_p0[reached], thresholds[reached])
    ends = (coefficients * by_k)[[-1, 0]]
    at = dict(zip(loads, by_load, strict=True))
    return {
        "doubling_threshold": float(doubling),
        "similarity": float(ends[0] / ends[1]),
        "load_sensitivity": float(at[80.0] / at[100.0]),
    }


def _draw(
    path: Path,
    k: np.ndarray,
    p0: np.ndarray,
    load: np.ndarray,
    along: Callable[..., tuple[np.ndarray, np.ndarray]],
    steady: Callable[[float, float, float], float],
) -> None:
    from matplotlib.figure import Figure
    from matplotlib.ticker import NullFormatter

    from ringwear_par.pictures.style import COLOURS, STYLE

    def written(number: float) -> str:
        return f"{number:.0e}".replace("e-0", "e-")

    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(7.4, 3.6), layout="constrained")
        left, right = figure.subplots(1, 2)
        for pressure, colour in zip(np.unique(load), COLOURS, strict=False):
            x, y = along(p0, k=PAPER_K, load=pressure)
            left.plot(x, y, "o-", ms=4, color=colour, label=f"{pressure:g} MPa")
            fine = np.linspace(0.0, x[-1], 200)
            limit = [steady(PAPER_K, value, pressure) for value in fine]
            left.plot(fine, limit, ":", color=colour)
        left.set_xlabel("threshold pressure p0 (MPa)")
        left.set_ylim(0.0, 320.0)
        left.set_title(f"k = {written(PAPER_K)} / MPa")
        chosen = np.unique(p0)[::2]
        for threshold, colour in zip(chosen, COLOURS, strict=False):
            x, y = along(k, p0=threshold, load=PAPER_LOAD)
            right.loglog(x, y, "o-", ms=4, color=colour, label=f"p0 = {threshold:g} MPa")
            right.loglog(x, [steady(v, threshold, PAPER_LOAD) for v in x], ":", color=colour)
        right.set_xlabel("wear coefficient k (1/MPa)")
        right.set_ylim(8.0, 400.0)
        right.set_xticks(np.unique(k), [written(v) for v in np.unique(k)])
        right.set_yticks([10, 20, 50, 100, 200], ["10", "20", "50", "100", "200"])
        right.set_title(f"mean pressure {PAPER_LOAD:g} MPa")
        for axis in (right.xaxis, right.yaxis):
            axis.set_minor_formatter(NullFormatter())
        for axes, title in ((left, "mean pressure"), (right, None)):
            axes.set_ylabel(f"life: time to {1e3 * DEPTH:g} µm (s)")
            axes.plot([], [], ":", color="0.3", label="steady state")
            axes.legend(title=title, frameon=False)
        figure.suptitle("Where the threshold changes the life (load and speed are our reading)")
        figure.savefig(path)


def main() -> int:
    """Run the study, print its numbers beside their steady state, return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, default=Path("out/wear_law"))
    args = parser.parse_args()
    petsc4py.init(["sweep_wear_law", "-no_signal_handler"])
    from ringwear_par.errors import RingwearError

    comm = MPI.COMM_WORLD
    level = logging.INFO if comm.rank == 0 else logging.ERROR
    logging.basicConfig(format="%(message)s", level=level)
    logging.getLogger("matplotlib").setLevel(logging.WARNING)
    try:
        numbers = study(args.output, comm)
    except RingwearError as error:
        if comm.rank == 0:
            print(error, file=sys.stderr)
        return error.exit_status
    if comm.rank == 0:
        print(f"{'number':<20}{'found':>9}{'steady':>9}  unit")
        for name, value in numbers.items():
            limit, unit, meaning = NUMBERS[name]
            print(f"{name:<20}{value:>9.4f}{limit:>9.4f}  {unit:<5}{meaning}")
        print(args.output / "life.png")
    return 0


if __name__ == "__main__":
    sys.exit(main())
