"""Fits of invented measurements whose truth is known: whether it is where intervals say.

The paper's rings and law, two tests of 100 s at 50 and 100 MPa, or others (``--loads``), each with
a record of the penetration and a final profile, noise, offset, drift, level and tilt drawn anew in
every repeat. ``[mpirun -n N] python scripts/identification_trials.py --repeats 200``
"""

import argparse
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

import ringwear_par as rw
from ringwear_par.identification.fit import predicted
from ringwear_par.identification.fit_file import read_fit

CASES = Path(__file__).parent / "cases"
TRUTH = {"wear.lower.k": 1e-7, "wear.lower.p0": 40.0}
#: um
DISPLACEMENT, PROFILE, DRIFT = 0.2, 0.1, 0.5
RADII = np.linspace(28.0, 32.0, 201)


def readings(load: float, seconds: float) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Return times, penetration there and the final profile, in s and um, as they would be."""
    times = np.arange(1.0, seconds + 0.5)
    case = rw.read_case(
        CASES / "paper.toml",
        {
            "load.pressure": load, "time.scheme": "adaptive", "time.end": seconds,
            "time.step": None, "time.steps": None, "time.tolerance": 1e-6,
            "output.times": times.tolist(), **TRUTH,
        },
    )  # fmt: skip
    data = rw.simulate(case, MPI.COMM_SELF).to_xarray()
    at = np.searchsorted(data.time.values, times - 1e-9)
    depth = np.zeros(len(RADII))
    r = data.r.values
    inside = (RADII >= 28.5 - 1e-9) & (RADII <= 31.5 + 1e-9)
    depth[inside] = CubicSpline(r, data.wear_lower.values[-1])(np.clip(RADII[inside], r[0], r[-1]))
    return times, 1e3 * data.penetration.values[at], 1e3 * depth


def fit_file(
    folder: Path, tests: list[tuple[float, float]], ideal: list[Any], seed: int, starts: int
) -> dict[str, Any]:
    """Write the files of one repeat, return the fit file as a dict."""
    random = np.random.default_rng(seed)
    experiments = []
    for i, ((load, seconds), (times, penetration, depth)) in enumerate(
        zip(tests, ideal, strict=True)
    ):
        offset, drift, level, tilt = random.standard_normal(4) * (1.0, DRIFT, 0.5, 0.1)
        noisy = penetration + offset + drift * times / seconds
        noisy = noisy + DISPLACEMENT * random.standard_normal(len(times))
        traced = depth + level + tilt * (RADII - 30.0)
        traced = traced + PROFILE * random.standard_normal(len(RADII))
        for name, x, y in (("z", times, noisy), ("p", RADII, traced)):
            table = np.column_stack([x, y])
            np.savetxt(folder / f"{name}{i}.csv", table, delimiter=",", header="x,um", comments="")
        columns = {"value": "um"}
        experiments.append(
            {
                "name": f"test {i + 1}",
                "set": {"load.pressure": load, "time.end": seconds},
                "data": [
                    {
                        "quantity": "penetration", "file": str(folder / f"z{i}.csv"),
                        "columns": {"time": "x", **columns}, "units": {"value": "um"},
                        "sd": DISPLACEMENT,
                        "nuisance": {"offset": {}, "drift": {"prior": {"normal": [0.0, DRIFT]}}},
                    },
                    {
                        "quantity": "profile.lower", "file": str(folder / f"p{i}.csv"),
                        "columns": {"r": "x", **columns}, "units": {"value": "um"},
                        "sd": PROFILE, "at": seconds, "nuisance": {"level": {}, "tilt": {}},
                    },
                ],
            }
        )  # fmt: skip
    return {
        "case": rw.read_case(CASES / "paper.toml"),
        "fit": {
            "parameters": {
                "wear.lower.k": {"start": 5e-8, "bounds": [1e-9, 1e-5], "scale": "log"},
                "wear.lower.p0": {"start": 10.0, "bounds": [0.0, 200.0]},
            },
            "starts": starts,
        },
        "experiment": experiments,
    }


def main() -> None:
    """Fit all repeats, print what came out."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=200)
    parser.add_argument("--starts", type=int, default=1)
    parser.add_argument("--loads", type=float, nargs="+", default=[50.0, 100.0], help="MPa")
    parser.add_argument("--seconds", type=float, nargs="+", default=[100.0, 100.0])
    args = parser.parse_args()
    comm, own = MPI.COMM_WORLD, MPI.COMM_SELF
    tests = list(zip(args.loads, args.seconds, strict=True))
    ideal = [readings(*test) for test in tests]
    found, elsewhere = [], 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for seed in range(args.repeats)[comm.rank :: comm.size]:
            result = rw.fit(fit_file(folder, tests, ideal, seed, args.starts), own)
            found.append([(p.estimate, p.sd) for p in result.parameters])
            elsewhere += sum(
                not one.error and one.objective > 1.001 * result.starts[0].objective
                for one in result.starts
            )
        at_truth = fit_file(folder, tests, ideal, 0, 1)
        for key, value in TRUTH.items():
            at_truth["fit"]["parameters"][key]["start"] = value
        expected = predicted(read_fit(at_truth), own)
    every = np.array([row for part in comm.allgather(found) for row in part], dtype=float)
    elsewhere = comm.allreduce(elsewhere)
    if comm.rank:
        return
    print(f"{len(every)} repeats, tests {tests} (MPa, s); starts that ended elsewhere: {elsewhere}")
    for j, (key, true) in enumerate(TRUTH.items()):
        estimates, sds = every[:, j].T
        inside = 100.0 * np.mean(np.abs(estimates - true) < 2.0 * sds)
        scatter, told = estimates.std(ddof=1), expected.parameters[j].sd
        print(
            f"{key}: within two sd {inside:.3g} %; mean {estimates.mean():.5g}, scatter "
            f"{scatter:.3g}, predicted sd {told:.3g} (ratio {scatter / told:.3g})"
        )


if __name__ == "__main__":
    main()
