"""Fit the thickness, the modulus and k of a coating to readings of two tests, and time it.

Usage: [mpirun -n N] python scripts/coating_fit.py [--starts 8] [--elements 64]

The readings are of histories with known numbers, with noise: approaches over time, and a profile at
the end. Prints the summary of the fit, and its CPU and wall seconds on the first rank.
"""

import argparse
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from mpi4py import MPI

import ringwear_par as rw

CASE = Path(__file__).resolve().parent / "cases" / "coated.toml"
TRUTH = {
    "lower.layers[0].thickness": 0.06,
    "lower.layers[0].young": 8e4,
    "lower.layers[0].wear.k": 6e-8,
}
START = {
    "lower.layers[0].thickness": {"start": 0.05, "bounds": [0.02, 0.2], "scale": "log"},
    "lower.layers[0].young": {"start": 1e5, "bounds": [2e4, 3e5], "scale": "log"},
    "lower.layers[0].wear.k": {"start": 1e-7, "bounds": [1e-9, 1e-5], "scale": "log"},
}
PRESSURES = 40.0, 85.0
#: mm, of all readings; readings of a record or a profile
SD, READINGS = 2e-5, 60


def write_readings(folder: Path, elements: int, seed: int = 1) -> None:
    """Write the readings of both tests as tables. On one rank."""
    rng = np.random.default_rng(seed)
    for number, pressure in enumerate(PRESSURES):
        changes = {"load.pressure": pressure, "mesh.contact_elements": elements}
        result = rw.simulate(rw.read_case(CASE, {**changes, **TRUTH}), MPI.COMM_SELF)
        t, r = np.linspace(2.0, 200.0, READINGS), np.linspace(28.6, 31.4, READINGS)
        approach = np.interp(t, result.histories["time"], result.histories["approach"])
        depth = np.interp(r, result.line.r, result.profiles["wear_lower"][-1])
        for name, x, values in (("approach", t, approach), ("profile", r, depth)):
            header = f"{'time / s' if name == 'approach' else 'r / mm'},value / mm"
            table = np.c_[x, values + SD * rng.standard_normal(READINGS)]
            np.savetxt(folder / f"{name}{number}.csv", table, "%.9g", ",", header=header,
                       comments="")  # fmt: skip


def fit_tables(folder: Path, elements: int, **settings: Any) -> dict[str, Any]:
    """Return the fit file of both tests, as a dict."""
    tests = [
        {"name": f"{pressure:g} MPa",
         "set": {"load.pressure": pressure, "mesh.contact_elements": elements},
         "data": [
             {"quantity": "approach", "file": str(folder / f"approach{number}.csv"), "sd": SD,
              "columns": {"time": "time / s", "value": "value / mm"}},
             {"quantity": "profile.lower", "file": str(folder / f"profile{number}.csv"), "sd": SD,
              "columns": {"r": "r / mm", "value": "value / mm"}},
         ]}
        for number, pressure in enumerate(PRESSURES)
    ]  # fmt: skip
    return {"case": str(CASE), "fit": {"parameters": START, **settings}, "experiment": tests}


def main() -> None:
    """Make readings, fit and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--starts", type=int, default=8)
    parser.add_argument("--elements", type=int, default=64)
    arguments, comm = parser.parse_args(), MPI.COMM_WORLD
    with TemporaryDirectory() as name:
        folder = Path(comm.bcast(name))
        if comm.rank == 0:
            write_readings(folder, arguments.elements)
        comm.Barrier()
        cpu, wall = time.process_time(), time.perf_counter()
        result = rw.fit(fit_tables(folder, arguments.elements, starts=arguments.starts), comm)
        cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
        if comm.rank == 0:
            print(f"{result.summary()}\n{cpu:.1f} s of CPU, {wall:.1f} s of wall time")
        comm.Barrier()


if __name__ == "__main__":
    main()
