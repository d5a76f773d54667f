#!/usr/bin/env python
"""How often intervals of a material hold the truth, where specimens scatter and wear is random.

    python scripts/scatter_coverage.py specimens [--trials 1000]    # some 3 minutes
    python scripts/scatter_coverage.py limits [--trials 1000]       # some 5 minutes
    python scripts/scatter_coverage.py wear [--trials 400]          # some 10 minutes
    python scripts/scatter_coverage.py predict [--trials 200]       # some 10 minutes
    python scripts/scatter_coverage.py chain [--trials 200]         # some 15 minutes

``specimens``: repeats whose k scatter (normal in its logarithm), each known to 2 % from its own
readings. ``limits``: of those below the material's k it is only known that they are. ``wear``:
records of 150 readings of 15 um of wear, which grows at random (a gamma process), by a sensor of
0.2 um whose zero is not known. Intervals are those of the program, at 95 %; beside them those of
one k for all, as of a fit without scatter. ``predict``: fits of k and p0 to records of specimens at
40 and 60 MPa, and how often the band of the next specimen's penetration at 80 MPa and another speed
holds that of a new one. ``chain``: nine specimens in three conditions, of each a record that drifts
and three weighings, from simulated histories to the printed intervals of a fit. Seeds are fixed;
under mpirun ranks share the rows out.
"""

import argparse
import logging
import tempfile
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

import ringwear_par as rw
from ringwear_par.arrays import FloatArray
from ringwear_par.identification.definition.problem import Series
from ringwear_par.identification.scatter.likelihood import (
    Level,
    Limits,
    LinearisedTest,
    MixedModel,
    ReducedTest,
    reduce_test,
)
from ringwear_par.identification.scatter.linearisation import TestClocks
from ringwear_par.identification.scatter.posterior import Size, integrate

LEVEL = 0.95
#: two-sided 95 % of a normal distribution
TWO_SIDED = 1.959964
#: of each test's own k, relative
OWN_SD = 0.02
#: of a record: readings, depth at its end and sd of the sensor, um
READINGS, DEPTH, SENSOR = 150, 15.0, 0.2
SCATTERS, SPECIMENS = (0.05, 0.12, 0.30), (2, 3, 5, 10)
SHARES, RECORDS = (0.01, 0.03, 0.10), (1, 2, 3, 5, 10)
#: loads of tests (MPa), the material's k (1/MPa) and p0 (MPa), and where the next specimen runs
LOADS, K, P0 = (40.0, 60.0), 1e-7, 25.0
ELSEWHERE = {"load.pressure": 80.0, "load.omega": 5.0}
#: of a prediction
DRAWS = 300
#: of nine tests: loads (MPa), p0 (MPa), sd of the drift (um), times (s) and sd (mg) of weighings,
#: density (g/mm3)
CONDITIONS, THRESHOLD, DRIFT = (50.0, 80.0, 110.0), 15.0, 0.5
WEIGHED, BALANCE, DENSITY = (50.0, 100.0, 150.0), 0.1, 1.9e-3
PAPER = Path(__file__).parent / "cases" / "paper.toml"
TIMED = {
    "mesh.contact_elements": 12, "time.scheme": "adaptive", "time.step": None, "time.steps": None,
    "time.end": 150.0,
}  # fmt: skip


def specimens_row(
    tau: float, count: int, trials: int, rng: np.random.Generator, limit: float = -np.inf
) -> str:
    """Return the row of repeats that scatter by tau (relative), those below a limit unread."""
    below = Limits(np.array([limit / OWN_SD]), np.array([[-1.0 / OWN_SD]]))
    unread = ReducedTest(np.zeros((1, 1)), np.zeros(1), 0.0, 0.0, limits=below)
    level = Level(0, "specimen", np.arange(count))
    information, common = np.array([[OWN_SD**-2]]), TWO_SIDED * OWN_SD / np.sqrt(count)
    hits, widths = np.zeros(4), []
    for _ in range(trials):
        values = np.full(count, -np.inf)
        while (values <= limit).all():  # such a fit is refused
            values = np.hypot(tau, OWN_SD) * rng.standard_normal(count)
        tests = [
            ReducedTest(information, np.array([v / OWN_SD**2]), (v / OWN_SD) ** 2, 0.0)
            if v > limit
            else unread
            for v in values
        ]
        models = [MixedModel(tests, [level], np.zeros(1), np.zeros(1))]
        posterior = integrate(lambda _, models=models: models, [Size(None, 0.3)])
        low, high = posterior.unknown(0).interval(LEVEL)
        size_low, size_high = posterior.size(0, LEVEL).interval
        next_low, next_high = posterior.next_specimen(0).interval(LEVEL)
        widths.append(0.5 * (high - low))
        hits += [
            abs(values.mean()) < common,
            low < 0.0 < high,
            size_low <= tau <= size_high,
            next_low < tau * rng.standard_normal() < next_high,
        ]
    one, material, size, following = hits / trials
    return (
        f"| {100 * tau:g} % | {count} | {one:.2f} ({100 * common:.2g}) | "
        f"{material:.2f} ({100 * np.median(widths):.2g}) | {size:.2f} | {following:.2f} |"
    )


def record(k: float, share: float, rng: np.random.Generator) -> FloatArray:
    """Return the readings (um) of a record whose wear is random by a share of its depth."""
    size = share**2 * DEPTH
    wear = np.cumsum(rng.gamma(k * DEPTH / READINGS / size, size, READINGS))
    return wear + SENSOR * rng.standard_normal(READINGS) + rng.normal(0.0, 1.0)


def wear_row(share: float, count: int, trials: int, rng: np.random.Generator) -> str:
    """Return the row of records whose wear is random by a share of its depth."""
    depth = DEPTH * np.arange(1, READINGS + 1) / READINGS
    noise = np.full(READINGS, SENSOR)
    series = Series("record", "penetration", depth, depth, noise)
    # a reading answers to what is worn too much by as much
    clock = TestClocks([series], noise, np.ones(READINGS), np.ones((READINGS, 1)), depth[:, None])
    hits, widths = np.zeros(3), []
    slope = depth - depth.mean()
    common = TWO_SIDED * SENSOR / np.sqrt(count * slope @ slope)
    for _ in range(trials):
        readings = [record(1.0, share, rng) for _ in range(count)]
        tests = [
            LinearisedTest(
                y / SENSOR, depth[:, None] / SENSOR, np.ones((READINGS, 1)) / SENSOR,
                np.zeros((0, 1)), np.zeros(0), 0.0, clock.kernels,
            )
            for y in readings
        ]  # fmt: skip

        def models_at(shares: FloatArray) -> list[MixedModel]:
            reduced = [reduce_test(test, shares**2 * DEPTH) for test in tests]  # noqa: B023
            return [MixedModel(r, [], np.zeros(1), np.zeros(1)) for r in zip(*reduced, strict=True)]

        posterior = integrate(models_at, [], [Size(None, 0.1)])
        low, high = posterior.unknown(0).interval(LEVEL)
        size_low, size_high = posterior.share(0, LEVEL).interval
        best = np.mean([slope @ y for y in readings]) / (slope @ slope)
        widths.append(0.5 * (high - low))
        hits += [abs(best - 1.0) < common, low < 1.0 < high, size_low <= share <= size_high]
    one, random, size = hits / trials
    return (
        f"| {100 * share:g} % | {count} | {one:.2f} ({100 * common:.2g}) | "
        f"{random:.2f} ({100 * np.median(widths):.2g}) | {size:.2f} |"
    )


def predict_row(tau: float, count: int, trials: int, rng: np.random.Generator) -> str:
    """Return the row of predictions from specimens that scatter by tau (relative)."""
    logging.disable(logging.WARNING)  # of predictions that extrapolate
    case = rw.read_case(PAPER, {**TIMED, "wear.lower.p0": P0})
    elsewhere = case.replace(ELSEWHERE)
    hits, widths = np.zeros(2), []
    for _ in range(trials):
        *values, following = K * np.exp(tau * rng.standard_normal(count + 1))
        tests = [
            case.replace({"load.pressure": LOADS[i % 2], "wear.lower.k": float(k)})
            for i, k in enumerate(values)
        ]
        new = elsewhere.replace({"wear.lower.k": float(following)})
        *results, truth = rw.simulate_all([*tests, new], MPI.COMM_SELF)
        with tempfile.TemporaryDirectory() as folder:
            found = rw.fit(_fit_of(results, LOADS, Path(folder), rng), MPI.COMM_SELF)
        predicted = rw.predict(found, elsewhere, draws=DRAWS, comm=MPI.COMM_SELF)
        low, lower, median, upper, high = predicted.quantiles()[:, -1]
        depth = truth.histories["penetration"][-1]
        hits += [low < depth < high, lower < depth < upper]
        widths.append(0.5 * (high - low) / median)
    wide, half = hits / trials
    return (
        f"| {100 * tau:g} % | {count} | {wide:.2f} | {half:.2f} | {100 * np.median(widths):.2g} % |"
    )


def chain_row(tau: float, count: int, trials: int, rng: np.random.Generator) -> str:
    """Return the row of fits to tests of specimens that scatter by tau (relative)."""
    case = rw.read_case(PAPER, {**TIMED, "wear.lower.p0": THRESHOLD})
    hits, widths = np.zeros(6), []
    for _ in range(trials):
        values = K * np.exp(tau * rng.standard_normal(count))
        loads = [CONDITIONS[i % len(CONDITIONS)] for i in range(count)]
        tests = [
            case.replace({"load.pressure": load, "wear.lower.k": float(k)})
            for load, k in zip(loads, values, strict=True)
        ]
        results = rw.simulate_all(tests, MPI.COMM_SELF)
        with tempfile.TemporaryDirectory() as folder:
            fit = _fit_of(results, loads, Path(folder), rng, weighed=WEIGHED)
            found = rw.fit(fit, MPI.COMM_SELF)
            del fit["fit"]["parameters"]["wear.lower.k"]["scatter"]
            one = rw.fit(fit, MPI.COMM_SELF)
        entries = found.to_dict()["parameters"]
        k, p0 = entries["wear.lower.k"], entries["wear.lower.p0"]
        size = k["scatter"]["specimen"]["interval"]
        truths = (K, THRESHOLD, tau, K * np.exp(tau * rng.standard_normal()), K, THRESHOLD)
        intervals = [k["interval"], p0["interval"], size, k["next"]]
        intervals += [p["interval"] for p in one.to_dict()["parameters"].values()]
        hits += [
            low <= truth <= high
            for truth, (low, high) in zip(truths, map(_ends, intervals), strict=True)
        ]
        widths.append(0.5 * np.log(k["interval"][1] / k["interval"][0]))
    k, p0, size, following, *one = (f"{share:.2f}" for share in hits / trials)
    return (
        f"| {100 * tau:g} % | {count} | {one[0]}, {one[1]} | {k} ({100 * np.median(widths):.2g}) | "
        f"{p0} | {size} | {following} |"
    )


def _ends(interval: list[float | None]) -> tuple[float, float]:
    """Return the ends of an interval, of which one may be open."""
    low, high = interval
    return -np.inf if low is None else low, np.inf if high is None else high


def _fit_of(
    results: list[rw.Result],
    loads: Sequence[float],
    folder: Path,
    rng: np.random.Generator,
    *,
    weighed: Sequence[float] = (),
) -> dict[str, Any]:
    """Return the fit of records of tests, which drift where they are weighed, in a folder."""
    time = np.linspace(3.0, 150.0, 50)
    nuisance: dict[str, Any] = {"offset": {}}
    if weighed:
        nuisance["drift"] = {"prior": {"normal": [0.0, DRIFT]}}
    experiments = []
    for i, result in enumerate(results):
        depth, volume = (
            np.interp([*time, *weighed], result.histories["time"], result.histories[name])
            for name in ("penetration", "worn_volume_lower")
        )
        read = 1e3 * depth[: len(time)] + SENSOR * rng.standard_normal(len(time)) + rng.normal()
        if weighed:
            read += DRIFT * rng.standard_normal() * time / time[-1]
        masses = 1e3 * DENSITY * volume[len(time) :] + BALANCE * rng.standard_normal(len(weighed))
        file = folder / f"{i}.csv"
        np.savetxt(file, np.column_stack([time, read]), "%.6g", ",", header="t_s,z_um", comments="")
        data = [
            {
                "quantity": "penetration",
                "file": str(file),
                "sd": SENSOR,
                "nuisance": nuisance,
                "columns": {"time": "t_s", "value": "z_um"},
            }
        ]
        data += [
            {"quantity": "mass.lower", "value": float(mass), "at": at, "unit": "mg",
             "density": DENSITY, "sd": BALANCE}
            for at, mass in zip(weighed, masses, strict=True)
        ]  # fmt: skip
        set_of_test = {"load.pressure": loads[i % len(loads)]}
        experiments.append({"name": f"{i}", "set": set_of_test, "data": data})
    parameters = {
        "wear.lower.k": {"start": K, "bounds": [1e-9, 1e-5], "scale": "log", "scatter": "fit"},
        "wear.lower.p0": {"start": P0, "bounds": [0.0, 200.0]},
    }
    case = folder / "case.toml"
    case.write_text(rw.read_case(PAPER, TIMED).text)
    return {
        "case": str(case),
        "fit": {"parameters": parameters, "starts": 1},
        "experiment": experiments,
    }


TABLES: dict[str, tuple[str, tuple[float, ...], tuple[int, ...], Callable[..., str], int]] = {
    "specimens": (
        "| scatter | specimens | one k for all | k of the material | scatter | next specimen |\n"
        "|---|---|---|---|---|---|",
        SCATTERS, SPECIMENS, specimens_row, 1000,
    ),
    "limits": (
        "| scatter | specimens | (one k for all, all read) | k of the material | scatter | "
        "next specimen |\n|---|---|---|---|---|---|",
        SCATTERS, SPECIMENS[1:], partial(specimens_row, limit=0.0), 1000,
    ),
    "wear": (
        "| share at the end | records | one sensor's noise | k | share |\n|---|---|---|---|---|",
        SHARES, RECORDS, wear_row, 400,
    ),
    "predict": (
        "| scatter | specimens | in the band of 95 % | of 50 % | half width of 95 % |\n"
        "|---|---|---|---|---|",
        (0.12,), (5, 10), predict_row, 200,
    ),
    "chain": (
        "| scatter | specimens | one for all: k, p0 | k | p0 | scatter | next specimen |\n"
        "|---|---|---|---|---|---|---|",
        SCATTERS, (9,), chain_row, 200,
    ),
}  # fmt: skip


def main() -> None:
    """Print a table. Collective."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("table", choices=TABLES)
    parser.add_argument("--trials", type=int)
    options = parser.parse_args()
    head, sizes, counts, row, trials = TABLES[options.table]
    comm = MPI.COMM_WORLD
    rows = [(size, count) for size in sizes for count in counts]
    own = {
        number: row(size, count, options.trials or trials, np.random.default_rng([7, number]))
        for number, (size, count) in enumerate(rows)
        if number % comm.size == comm.rank
    }
    gathered = comm.gather(own)
    if gathered is not None:
        texts = {number: text for part in gathered for number, text in part.items()}
        print(head, *(texts[number] for number in range(len(rows))), sep="\n")


if __name__ == "__main__":
    main()
