"""A worked sweep that shows where the threshold pressure changes the life.

Usage: [mpirun -n N] python scripts/sweep_wear_law.py [FOLDER]      (default: out/wear_law)

Sweeps scripts/cases/wear_law.toml (wear coefficient k, threshold p0 and load around the paper's
case) into the folder, draws life.png there and prints three numbers. The same command again
computes only what is missing. Life is the time until the penetration reaches 10 um.

What to expect: once the rings have run in, wear rate and approach agree, so p = p0 + c/r, where
c = (P - p0) (a + b)/2 follows from the mean pressure P on the annulus a < r < b, and the approach
grows at k mu omega c. Hence, were it so from the start,

    life = depth / (k mu omega (P - p0) (a + b)/2).

Running in adds some 1.2 um (at 80 MPa) to the penetration and so shortens life by an eighth, but
nearly alike for every p0: ratios of lives are close to those of the steady state.
"""

import sys
from pathlib import Path

import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from mpi4py import MPI

import ringwear_par as rw

STUDY = Path(__file__).parent / "cases" / "wear_law.toml"
K, P0, LOAD = "wear.lower.k", "wear.lower.p0", "load.pressure"
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
    return np.array([
        np.interp(DEPTH, depth[~np.isnan(depth)], t[~np.isnan(depth)], right=np.nan)
        for t, depth in zip(time, penetration, strict=True)
    ])  # fmt: skip


def study(folder: Path, comm: MPI.Intracomm) -> dict[str, float]:
    """Sweep what is missing, draw life.png and return the numbers of NUMBERS. Collective."""
    rw.sweep(STUDY, folder, comm)
    return comm.bcast(evaluated(folder) if comm.rank == 0 else None)


def evaluated(folder: Path) -> dict[str, float]:
    """Draw the picture and return the numbers."""
    with rw.open_ensemble(folder) as data:
        keys = {key: ("case", data[key].to_numpy()) for key in (K, P0, LOAD)}
        found = lives(data["time"].to_numpy(), data["penetration"].to_numpy())
    life = xr.DataArray(found, keys, "case").set_index(case=[K, P0, LOAD]).unstack("case")

    def along(key: str, **fixed: float) -> xr.DataArray:
        """Return the lives along a key, the others being those of the paper, or as given."""
        at = {K: PAPER_K, P0: PAPER_P0, LOAD: PAPER_LOAD, **fixed}
        return life.sel({k: v for k, v in at.items() if k != key}, method="nearest").dropna(key)

    draw(folder / "life.png", along)
    by_p0, by_k, by_load = along(P0), along(K, **{P0: 0.0}), along(LOAD)
    ends = by_k * by_k[K]
    return {
        # 1/life is all but linear in p0
        "doubling_threshold": float(np.interp(-0.5, -by_p0[0] / by_p0, by_p0[P0])),
        "similarity": float(ends[-1] / ends[0]),
        "load_sensitivity": float(by_load.sel({LOAD: 80.0}) / by_load.sel({LOAD: 100.0})),
    }


def draw(path, along) -> None:  # noqa: ANN001
    """Draw the lives, and those of the steady state, over p0 and over k."""
    case = rw.read_case(STUDY.parent / "paper.toml")
    sliding = case.friction * case.load.omega * sum(case.contact) / 2  # mm/s
    figure = Figure(figsize=(7.4, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    for load in (60.0, 80.0, 100.0):
        life = along(P0, **{LOAD: load})
        (line,) = left.plot(life[P0], life, "o-", ms=4, label=f"{load:g} MPa")
        p0 = np.linspace(0.0, life[P0][-1], 200)
        left.plot(p0, DEPTH / (PAPER_K * sliding * (load - p0)), ":", color=line.get_color())
    for p0 in (0.0, 20.0, 40.0, 60.0):
        life = along(K, **{P0: p0})
        (line,) = right.loglog(life[K], life, "o-", ms=4, label=f"p0 = {p0:g} MPa")
        steady = DEPTH / (life[K] * sliding * (PAPER_LOAD - p0))
        right.loglog(life[K], steady, ":", color=line.get_color())
    left.set(xlabel="threshold pressure p0 (MPa)", ylim=(0.0, 320.0), title="k = 1e-7 1/MPa")
    right.set(xlabel="wear coefficient k (1/MPa)", title=f"mean pressure {PAPER_LOAD:g} MPa")
    right.set_xticks([5e-8, 1e-7, 2e-7, 4e-7, 8e-7], ["5e-8", "1e-7", "2e-7", "4e-7", "8e-7"])
    right.set_yticks([20, 50, 100, 200], ["20", "50", "100", "200"])
    right.minorticks_off()
    for axes in (left, right):
        axes.set_ylabel(f"life: time to {1e3 * DEPTH:g} µm (s)")
        axes.plot([], [], ":", color="0.3", label="steady state")
        axes.legend(frameon=False)
    figure.savefig(path, dpi=200)


if __name__ == "__main__":
    output = Path(*sys.argv[1:2] or ["out/wear_law"])
    numbers = study(output, MPI.COMM_WORLD)
    if MPI.COMM_WORLD.rank == 0:
        print(f"{'number':<20}{'found':>9}{'steady':>9}  unit")
        for name, (limit, unit, meaning) in NUMBERS.items():
            print(f"{name:<20}{numbers[name]:>9.4f}{limit:>9.4f}  {unit:<5}{meaning}")
        print(output / "life.png")
