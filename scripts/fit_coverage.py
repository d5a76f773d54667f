"""How often intervals of a fit hold the truth: synthetic repeats of two tests, seeds fixed.

python scripts/fit_coverage.py [--repeats 200] [--tests LOAD SECONDS ...]

The paper's rings, at 50 and 100 MPa for 100 s each unless other tests are named: penetrations every
second (0.2 um, offset, drift of 0.5 um) and profiles of the lower ring at the end (0.1 um, not
levelled). Readings come from histories of ten times as many steps; repeats advance side by side.
"""

import argparse
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import FloatArray
from ringwear_par.identification.definition.fit_file import read_fit
from ringwear_par.identification.definition.problem import Problem
from ringwear_par.identification.estimation.intervals import estimates
from ringwear_par.identification.estimation.minimise import minimise
from ringwear_par.identification.estimation.misfit import Misfit
from ringwear_par.identification.model.histories import STEPS, Histories
from ringwear_par.identification.model.rounds import WaitFor, side_by_side
from ringwear_par.options import start_petsc

TRUTH = {"wear.lower.k": 1e-7, "wear.lower.p0": 40.0}
DRIFT = 0.5
CASE = str(Path(__file__).parent / "cases/paper.toml")


def problem(folder: Path, tests: Sequence[tuple[float, float]]) -> Problem:
    """Return the problem, with readings that are to be replaced, of tests of MPa and s."""
    r = np.linspace(28.0, 32.0, 81)
    profile = folder / "r.csv"
    profile.write_text("r_mm,d_um\n" + "".join(f"{v:g},{i:g}\n" for i, v in enumerate(r)))

    def experiment(number: int, pressure: float, seconds: float) -> dict[str, Any]:
        drift = {"prior": {"normal": [0.0, DRIFT]}}
        times = folder / f"t{number}.csv"
        read = np.arange(1.0, seconds + 0.5)
        times.write_text("t_s,z_um\n" + "".join(f"{v:g},{i:g}\n" for i, v in enumerate(read)))
        return {
            "name": f"test {number}: {pressure:g} MPa",
            "set": {"load.pressure": pressure, "load.omega": 85 / 24, "time.end": seconds},
            "data": [
                {"quantity": "penetration", "file": str(times), "sd": 0.2,
                 "columns": {"time": "t_s", "value": "z_um"},
                 "nuisance": {"offset": {}, "drift": drift}},
                {"quantity": "profile.lower", "file": str(profile), "sd": 0.1,
                 "columns": {"r": "r_mm", "value": "d_um"},
                 "nuisance": {"level": {}, "tilt": {}},
                 "exclude": [[28.45, 28.55], [31.45, 31.55]]},
            ],
        }  # fmt: skip

    sought = {
        "wear.lower.k": {"start": 3e-8, "bounds": [1e-9, 1e-5], "scale": "log"},
        "wear.lower.p0": {"start": 0.0, "bounds": [0.0, 200.0]},
    }
    tables = {"case": CASE, "fit": {"parameters": sought}}
    # the files hold the same numbers, which two tests may not
    read = [
        read_fit({**tables, "experiment": [experiment(number, *test)]})
        for number, test in enumerate(tests, start=1)
    ]
    return replace(read[0], experiments=tuple(one.experiments[0] for one in read))


def repeated(asked: Problem, truth: FloatArray, rng: np.random.Generator) -> Problem:
    """Return the problem with readings of its own noise, offsets, drifts, levels and tilts."""
    experiments, start = [], 0
    for experiment in asked.experiments:
        series = []
        for one in experiment.series:
            bare = truth[start : start + one.n]
            start += one.n
            if one.profile:
                shift = 3e-4 * rng.standard_normal() + 1e-4 * rng.standard_normal() * (one.x - 30)
            else:
                shift = 1e-3 * rng.standard_normal()
                drift = 1e-3 * DRIFT * rng.standard_normal()
                shift = shift + drift * one.x / experiment.case.time.end
            noise = one.sd * rng.standard_normal(one.n)
            series.append(replace(one, value=bare + shift + noise))
        experiments.append(replace(experiment, series=tuple(series)))
    return replace(asked, experiments=tuple(experiments))


def coverage(asked: Problem, repeats: int) -> tuple[FloatArray, FloatArray, FloatArray, int, float]:
    """Return what came of all repeats.

    Returns
    -------
    Estimates and their sd, (repeats, 2, parameters); chi2 over its freedom and whether converged,
    (repeats, 2); predicted sd (parameters,); histories computed; CPU s.
    """
    histories = Histories(asked, MPI.COMM_SELF)
    point = np.array(list(TRUTH.values()))
    truth = histories.responses(point[None], 10 * STEPS)[0][:, 0]
    posed = [
        Misfit(repeated(asked, truth, np.random.default_rng(seed)), histories)
        for seed in range(repeats)
    ]
    known: dict[tuple[int, bytes], np.ndarray] = {}
    for misfit in posed:
        misfit.responses.known = known  # the histories do not depend on the noise
    begun, before = time.process_time(), histories.count

    def fitted(misfit: Misfit, wait_for: WaitFor) -> tuple[Any, Any]:
        found = minimise(misfit, misfit.with_best_nuisances(list(asked.start.values())), wait_for)
        told, _ = estimates(misfit, found.x, found.evaluation)
        values = [[p.estimate for p in told], [p.sd for p in told]]
        freedom = misfit.n + len(misfit.priors) - len(misfit.names)
        return values, [2 * found.evaluation.objective / freedom, found.converged]

    rows = side_by_side([partial(fitted, misfit) for misfit in posed], posed[0].responses.compute)
    seconds = time.process_time() - begun
    spent = histories.count - before
    values, quality = (np.array(part, dtype=float) for part in zip(*rows, strict=True))
    x = posed[0].with_best_nuisances(point.tolist())
    told, _ = estimates(posed[0], x, posed[0].evaluate(x))
    return values, quality, np.array([p.sd for p in told]), spent, seconds


def main() -> None:
    """Print how often the truth is within two standard deviations, and how estimates scatter."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=200)
    parser.add_argument(
        "--tests", type=float, nargs="+", default=[50.0, 100.0, 100.0, 100.0],
        help="load (MPa) and duration (s) of each test",
    )  # fmt: skip
    args = parser.parse_args()
    tests = list(zip(args.tests[::2], args.tests[1::2], strict=True))
    start_petsc([])
    with tempfile.TemporaryDirectory() as folder:
        asked = problem(Path(folder), tests)
    values, quality, predicted, histories, seconds = coverage(asked, args.repeats)
    for j, (key, true) in enumerate(TRUTH.items()):
        found, sds = values[:, 0, j], values[:, 1, j]
        errors = (found - true) / sds
        scatter = found.std(ddof=1)
        print(
            f"{key}: within 2 sd {100 * np.mean(np.abs(errors) < 2.0):.1f} %, errors "
            f"{errors.mean():+.2f} +- {errors.std():.2f} sd; scatter {scatter:.4g}, "
            f"{scatter / predicted[j]:.3f} of the predicted sd"
        )
    print(
        f"chi2 / freedom {quality[:, 0].mean():.3f}; converged {int(quality[:, 1].sum())} of "
        f"{args.repeats}; {histories / args.repeats / len(tests):.1f} histories an experiment; "
        f"{seconds / args.repeats:.2f} s of CPU a fit, side by side"
    )


if __name__ == "__main__":
    main()
