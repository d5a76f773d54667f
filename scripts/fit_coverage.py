"""How often intervals of fits hold the truth: simulated laboratories, fixed seeds, tables.

Usage: python scripts/fit_coverage.py [--lab NAME ...] [--sets 200] [--first 0]

Polynomials of the readings of each test, made once from histories, simulate the readings of each
set and stand for histories in its fit, which is that of ``ringwear fit`` otherwise. Printed are the
shares of 95 % intervals that hold the truth, binomial errors, and in brackets median half widths.
"""

import argparse
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from ringwear_par import read_case
from ringwear_par.arrays import FloatArray
from ringwear_par.identification import solution
from ringwear_par.identification.definition import problem as fits
from ringwear_par.identification.emulator import Box, emulate
from ringwear_par.identification.histories import Readings
from ringwear_par.identification.key_estimates import judged
from ringwear_par.identification.nuisances import column
from ringwear_par.results.progress import StopSignals

Wanted = Sequence[tuple[int, FloatArray]]
#: whether an interval holds the truth, and half its width
Score = tuple[bool, float]
PAPER = Path(__file__).parent / "cases" / "paper.toml"
#: histories for polynomials, their error over a reading's noise, mm that need not be as good
HISTORIES, GOOD, FAR = 800, 0.02, 0.02
#: effective draws: fewer than of fits, whose ends repeat better
DRAWS = 1000.0
#: mm of displacements and profiles, g of weighings; g/mm3; sd of nuisances without a prior, mm
SENSOR, PROFILER, BALANCE, DENSITY, FREE = 2e-4, 8e-5, 1e-4, 1.9e-3, 1e-3
OFFSET, DRIFT = fits.Nuisance("offset"), fits.Nuisance("drift", fits.Prior(0.0, 5e-4))
SKEW = fits.Nuisance("level"), fits.Nuisance("tilt")
#: amplitude and time (s) of thermal growth
WARM, TIME = fits.Nuisance("thermal"), fits.Prior(1500.0, 500.0)
THERMAL = WARM, fits.Nuisance("thermal time", TIME, (100.0, 9000.0), 1500.0)


def key(name: str, start: float, low: float, high: float, log: bool = True) -> fits.FittedParameter:
    return fits.FittedParameter(f"wear.lower.{name}", start, (low, high), log)


def series(
    quantity: str, x: FloatArray, sd: float, *nuisances: fits.Nuisance, at: float | None = None
) -> fits.Series:
    """Return a series that has not been read yet."""
    none, sds = np.zeros(len(x)), np.full(len(x), sd)
    more: Any = {"at": at, "density": DENSITY, "nuisances": nuisances}
    return fits.Series(quantity, quantity, x, none, sds, **more)


def worn(pressure: float, end: float, *read: fits.Series, **changed: Any) -> fits.Experiment:
    changed |= {"load.pressure": pressure, "time.end": end, "time.scheme": "adaptive"}
    case = read_case(PAPER, {**changed, "time.step": None, "time.steps": None})
    return fits.Experiment("", case, read)


def laboratories() -> dict[str, tuple[Any, ...]]:
    """Return the arguments of each ``Laboratory`` by its name."""

    def record(end: float, count: int, *nuisances: fits.Nuisance) -> fits.Series:
        return series("penetration", np.linspace(end / count, end, count), SENSOR, *nuisances)

    read = record(150.0, 50, OFFSET, DRIFT), series("mass.lower", 50.0 * np.arange(1, 4), BALANCE)
    at = {p: worn(p, 150.0, *read) for p in (50.0, 80.0, 100.0, 110.0)}
    k, p0 = key("k", 1e-7, 2e-8, 5e-7), key("p0", 15.0, 0.0, 45.0, False)
    nine, wide = [at[50.0], at[80.0], at[110.0]] * 3, replace(k, bounds=(2e-8, 2e-6))
    labs: dict[str, tuple[Any, ...]] = {}
    for tau in (0.05, 0.12, 0.3):
        labs[f"nine-{100 * tau:g}"] = nine, [k, p0], [1e-7, 15.0], tau
    for n in (2, 3):
        labs[f"{n}-specimens"] = [at[80.0]] * n, [k], [1e-7], 0.12
    labs["one-load"] = [at[50.0]], [wide, p0], [None, None]
    labs["one-load-0"] = [at[50.0]], [wide, p0], [1e-7, 0.0]
    labs["two-loads-0"] = [at[50.0], at[100.0]], [wide, p0], [1e-7, 0.0]
    end, r = 7200.0, np.linspace(28.0, 32.0, 201)
    profile = series("profile.lower", r, PROFILER, *SKEW, at=end)
    read = record(end, 360, OFFSET, *THERMAL), series("mass.lower", end * np.ones(1), BALANCE)
    keys = [key("k", 6e-9, 3e-9, 9.5e-9), key("k_start", 1.8e-8, 1e-8, 8e-8)]
    keys.append(key("distance", 3e4, 6e3, 1.5e5))
    rig = {"load.omega": 1.0, "contact.friction": 0.12, **{k.key: k.start for k in keys}}
    rig |= {"wear.lower.law": "running-in", "wear.lower.p0": 0.0}
    tests = [worn(p, end, *read, profile, **rig) for p in (40.0, 70.0)]
    labs["running-in"] = tests, keys, [k.start for k in keys]
    k, rig = key("k", 9e-9, 3e-9, 3e-8), {"wear.lower.law": "archard", "wear.lower.k": 9e-9}
    test = worn(80.0, 200.0, record(200.0, 150, OFFSET), **rig)
    for share in (0.01, 0.03, 0.1):
        for n in (1, 3, 10):
            labs[f"random-{100 * share:g}-{n}"] = [test] * n, [k], [9e-9], 0.0, share
    return labs


class Laboratory:
    """Stands for ``Readings`` in a fit: polynomials of tests' readings, made once from histories.

    Behind the readings of each test they have the volumes worn off then, for random wear. A factor
    on rates is one on the first key, k: so it is for the laws archard and threshold.

    Parameters
    ----------
    truth : of the material, by key; None: flat within the bounds, as the fit is told.
    tau, share : scatter of the first key between specimens, and share of random wear; 0: none.
    """

    failed, steps, count, reason, tell = 0, 40, 0, "a key is beyond its bounds", str

    def __init__(
        self, tests: list[fits.Experiment], keys: list[fits.FittedParameter],
        truth: list[float | None], tau: float = 0.0, share: float = 0.0,
    ) -> None:  # fmt: skip
        self.keys, self.truth, self.tau, self.share = keys, truth, tau, share
        scatter = fits.Scatter({"specimen": None}) if tau else None
        parameters = (replace(keys[0], scatter=scatter), *keys[1:])
        settings = fits.Settings(process={"wear.lower": fits.ProcessNoise()} if share else {})
        own = [replace(t, name=f"{i}", groups=(f"{i}", "", "")) for i, t in enumerate(tests)]
        design = fits.DesignSpace()
        problem = fits.Problem("", "", settings, parameters, tuple(own), {}, {}, design)
        tests = []
        for test in own:
            volume = series("volume.lower", test.times, 0.1)
            tests.append(replace(test, series=(*test.series, volume)))
        self.problem, (low, high) = problem, problem.unknown_bounds
        self.box = Box(low, high, 0.5 * (low + high), np.diag(0.5 * (high - low)))
        x, self.emulators = self.box.design(HISTORIES), {}
        with StopSignals() as signals:
            true = Readings(replace(problem, experiments=tuple(tests)), MPI.COMM_SELF, signals)
            self.same_as = true.same_as
            blocks = true.lead(lambda: true([(i, x) for i in sorted({*self.same_as})]))
        for i, y in zip(sorted({*self.same_as}), blocks, strict=True):
            sd = np.concatenate([s.sd for s in tests[i].series])
            most = np.abs(y[:, : problem.experiments[i].n]).max(axis=1)
            weights = (1.0 / np.maximum(1.0, most / FAR))[np.isfinite(y).all(axis=1)]
            self.emulators[i] = emulate(self.box, x, y, sd, weights, GOOD)[0]

    def __call__(self, wanted: Wanted, **how: Any) -> list[FloatArray]:
        """Return readings (P, n) of each test at unknowns (P, m), as ``Readings`` does."""
        tests = how.get("experiments") or self.problem.experiments
        blocks, (factor, *_) = [], how.get("factors", (1.0,))
        for test, x in wanted:
            beyond = (x < self.box.low - 1e-9) | (x > self.box.high + 1e-9)
            y = self.emulators[self.same_as[test]](x + np.log(factor) * np.eye(x.shape[1])[0])
            y[beyond.any(axis=1)] = np.nan
            blocks.append(y[:, : tests[test].n])
        return blocks

    def simulate(self, x: FloatArray, random: np.random.Generator) -> None:
        """Read all tests anew at unknowns (tests, m), wear a gamma process where it has a share."""
        tests = []
        for number, test in enumerate(self.problem.experiments):
            # readings are functions of the worn volume alone, which those of a faster test tell
            rates = np.log([[1.0], [1.5]]) * np.eye(x.shape[1])[0]
            y, faster = self.emulators[self.same_as[number]](x[number] + rates)
            if self.share:
                size = self.share**2 * y[test.n :].max()
                volume = np.cumsum(random.gamma(np.diff(y[test.n :], prepend=0.0) / size, size))
                y = np.interp(volume, [0.0, *faster[test.n :]], [0.0, *faster[: test.n]])
            read = []
            for s in test.series:
                values, y = y[: s.n], y[s.n :]
                for nuisance in s.linear_nuisances:
                    warm, (mean, sd) = nuisance is WARM, nuisance.prior or (0.0, FREE)
                    times = np.array([max(random.normal(*TIME), 100.0) if warm else 1.0])
                    z = random.standard_normal()
                    size = -2.0 * FREE * np.exp(0.3 * z) if warm else mean + sd * z
                    values = values + size * np.ravel(column(nuisance, s, test.case, times))
                read.append(replace(s, value=values + s.sd * random.standard_normal(s.n)))
            tests.append(replace(test, series=tuple(read)))
        self.problem = replace(self.problem, experiments=tuple(tests))


def holds(draws: FloatArray, truth: float, low: float = -np.inf, high: float = np.inf) -> Score:
    """Tell whether the interval of draws (s,) holds the truth, and half its width."""
    a, b = judged(draws, low, high, np.inf, 0.95)[1]
    a, b = low if a is None else a, high if b is None else b
    return bool(a <= truth <= b), 0.5 * (b - a)


def one_set(lab: Laboratory, seed: int) -> dict[str, Score]:
    """Return of each number whether its interval holds the truth, and its half width."""
    random, low, high = np.random.default_rng([7, seed]), lab.box.low, lab.box.high
    truth = [
        random.uniform(a, b) if value is None else p.unknown(value)
        for p, a, b, value in zip(lab.keys, low, high, lab.truth, strict=True)
    ]
    x = np.tile(truth, (len(lab.same_as), 1))
    x[:, 0] += lab.tau * random.standard_normal(len(x))
    lab.simulate(x, random)
    found = solution.solve(lab, seed, DRAWS)  # type: ignore[arg-type]
    material, scores = found.posterior.material(found.theta, random), {}
    for j, p in enumerate(lab.keys):
        name = f"{p.key.rpartition('.')[2]} ({'%' if p.log else 'MPa'})"
        scores[name] = holds(material[:, j], truth[j], low[j], high[j])
    for size in found.posterior.sizes:
        name = "scatter (%)" if lab.tau else "share (%)"
        scores[name] = holds(found.theta[:, size.place], float(np.log(lab.tau or lab.share)))
    for s in found.posterior.scatterings:
        draws = material[:, 0] + s.spread(found.theta) * random.standard_normal(len(material))
        scores["next specimen (%)"] = holds(draws, truth[0] + lab.tau * random.standard_normal())
    return scores


def main() -> None:
    """Fit the laboratories and print the shares."""
    labs, head = laboratories(), ""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--lab", nargs="*", choices=labs, default=[*labs])
    parser.add_argument("--sets", type=int, default=200)
    parser.add_argument("--first", type=int, default=0, help="number of the first set")
    args = parser.parse_args()
    for name in args.lab:
        lab, scores, started = Laboratory(*labs[name]), [], time.process_time()
        for seed in range(args.first, args.first + args.sets):
            scores.append(one_set(lab, seed))
            n, cells = len(scores), []
            for number in scores[0]:
                hits, widths = np.array([s[number] for s in scores]).T
                share, half = hits.mean(), np.median(widths) * (1.0 if "MPa" in number else 100.0)
                cells.append(f"{share:.3f} ± {np.sqrt(share * (1.0 - share) / n):.3f} ({half:.2g})")
            row = f"| {name} | {n} | {' | '.join(cells)} |"
            if n % 10 == 0:
                print(f"    {row} {(time.process_time() - started) / n:.2f} s a set", flush=True)
        if head != (head := f"| laboratory | sets | {' | '.join(scores[0])} |"):
            print(f"\n{head}\n{'|---' * (2 + len(scores[0]))}|")
        print(row, flush=True)


if __name__ == "__main__":
    main()
