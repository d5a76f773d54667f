"""How often intervals of fits hold the truth: simulated laboratories, seeds fixed.

Usage: python scripts/fit_coverage.py [--sets 100] [--scatter 0.12] [--specimens 3]

Each laboratory wears specimens of one material at 50, 80 and 110 MPa, reads their penetration 50
times (0.2 um, with an unknown zero) and fits k and p0. With a scatter k differs between specimens,
and intervals are those of the material and of the next specimen; ``--scatter 0`` has one k, as two
tests of one specimen would. Printed are the shares of 95 % intervals that hold the truth.
"""

import argparse
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from mpi4py import MPI

import ringwear_par as rw

PAPER = Path(__file__).resolve().parent / "cases" / "paper.toml"
LOADS = 50.0, 80.0, 110.0
K, P0 = "wear.lower.k", "wear.lower.p0"
#: of the material, 1/MPa and MPa
TRUTH = {K: 1e-7, P0: 40.0}
#: s, and um of the sensor
READ, NOISE = np.linspace(3.0, 150.0, 50), 0.2


def histories() -> list[tuple[np.ndarray, np.ndarray]]:
    """Return times and penetrations in um at each load, four times as long as a test.

    At a steady speed k and time enter by their product: one history serves every k.
    """
    keys = {**TRUTH, "time.step": 0.5, "time.steps": 1200}
    results = [rw.simulate(rw.read_case(PAPER, {**keys, "load.pressure": p})) for p in LOADS]
    return [(r.histories["time"], 1e3 * r.histories["penetration"]) for r in results]


def laboratory(
    folder: Path, true: list[tuple[np.ndarray, np.ndarray]], specimens: int, scatter: float,
    rng: np.random.Generator,
) -> dict[str, Any]:  # fmt: skip
    """Return the fit file of a laboratory, as a dict; its readings are in the folder."""
    experiments = []
    for number in range(specimens):
        ratio = np.exp(scatter * rng.standard_normal())
        depth = np.interp(ratio * READ, *true[number % len(LOADS)])
        read = depth + rng.normal() + NOISE * rng.standard_normal(len(READ))
        file = folder / f"{number}.csv"
        np.savetxt(file, np.c_[READ, read], "%.6g", ",", header="t_s,z_um", comments="")
        experiments.append({
            "name": f"{number}",
            "set": {"load.pressure": LOADS[number % len(LOADS)], "time.steps": 150},
            "data": [{"quantity": "penetration", "file": str(file), "sd": NOISE,
                      "nuisance": {"offset": {}}, "columns": {"time": "t_s", "value": "z_um"}}],
        })  # fmt: skip
    parameters: dict[str, dict[str, Any]] = {
        K: {"start": 1e-7, "bounds": [1e-9, 1e-5], "scale": "log"},
        P0: {"start": 30.0, "bounds": [0.0, 200.0]},
    }
    if scatter:
        parameters[K]["scatter"] = "fit"
    fit = {"parameters": parameters}
    return {"case": str(PAPER), "fit": fit, "experiment": experiments}


def main() -> None:
    """Fit the laboratories and print the shares."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sets", type=int, default=100)
    parser.add_argument("--scatter", type=float, default=0.12, help="relative, of k")
    parser.add_argument("--specimens", type=int, default=3)
    args = parser.parse_args()
    true, rows, started = histories(), [], time.process_time()
    for seed in range(args.sets):
        rng = np.random.default_rng(seed)
        with TemporaryDirectory() as name:
            tables = laboratory(Path(name), true, args.specimens, args.scatter, rng)
            fit = rw.fit(tables, MPI.COMM_SELF).to_dict()
        numbers = fit["parameters"]
        ends = {key: (TRUTH[key], numbers[key]["interval"]) for key in TRUTH}
        if args.scatter:
            following = TRUTH[K] * np.exp(args.scatter * rng.standard_normal())
            ends["next specimen"] = following, numbers[K]["next"]
        rows.append([
            (-np.inf if low is None else low) <= value <= (np.inf if high is None else high)
            for value, (low, high) in ends.values()
        ])  # fmt: skip
    shares = np.mean(rows, axis=0)
    for name, share in zip(ends, shares, strict=True):
        print(f"{name:<16}{share:.3f} of {args.sets}")
    print(f"{(time.process_time() - started) / args.sets:.2f} s of CPU a fit")


if __name__ == "__main__":
    main()
