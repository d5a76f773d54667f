"""A laboratory for tests: rings of few elements, what instruments read of them, and fit files."""

import copy

import numpy as np
import pytest
from mpi4py import MPI
from paths import PAPER

import ringwear_par as rw
from ringwear_par.errors import InputError
from ringwear_par.identification.definition.fit_file import read_fit

CASE = PAPER.read_text() + ("\n[mesh]\ncontact_elements = 12\n")
TRUTH = {"wear.lower.k": 1.3e-7, "wear.lower.p0": 25.0}
FITTED = {
    "wear.lower.k": {"start": 1e-7, "bounds": [1e-9, 1e-5], "scale": "log"},
    "wear.lower.p0": {"start": 0.0, "bounds": [0.0, 200.0]},
}
END = 100.0
#: mm; radii of profiles, on flanks that do not wear too
RADII = np.concatenate([np.linspace(28.0, 28.4, 15), np.linspace(28.6, 31.4, 60),
                        np.linspace(31.6, 32.0, 15)])  # fmt: skip
SD_PENETRATION, SD_PROFILE = 2e-4, 8e-5
#: of specimens, by which k is another, and the sd of the wear of each at its end, over the wear
FACTORS, SHARE = (0.85, 1.0, 1.2), 0.03


def history(pressure, truth=TRUTH, end=END, **changes):
    """Return the history of a test with many steps."""
    steps = {"time.scheme": "adaptive", "time.end": end, "time.tolerance": 1e-7}
    with_rings = {"load.pressure": pressure, "load.omega": 3.5, **truth, **changes}
    path = PAPER
    case = rw.read_case(path, {"mesh.contact_elements": 12, **steps, **with_rings})
    return rw.simulate(case, MPI.COMM_SELF)


def penetration(result, rng=None, times=None, offset=1e-3, drift=3e-4):
    """Return times (s) and penetrations (mm) with noise, offset and drift."""
    end = result.histories["time"][-1]
    times = np.linspace(end / 50, end, 50) if times is None else times
    there = result.histories["time"]
    values = np.interp(times, there, result.histories["penetration"]) + offset
    noise = 0.0 if rng is None else SD_PENETRATION * rng.standard_normal(len(times))
    return times, values + drift * times / end + noise


def profile(result, rng=None):
    """Return radii (mm) and depths of lower (mm) with noise, flanks, level and tilt."""
    r, worn = RADII, result.profiles["wear_lower"][-1]
    depth = np.where((r > 28.5) & (r < 31.5), np.interp(r, result.line.r, worn), 0.0)
    noise = 0.0 if rng is None else SD_PROFILE * rng.standard_normal(len(r))
    return r, depth + 2e-4 + 5e-5 * (r - 30.0) + noise


def write_table(path, names, *columns):
    """Write a table with commas."""
    rows = [",".join(f"{v:.9g}" for v in row) for row in zip(*columns, strict=True)]
    path.write_text("\n".join([",".join(names), *rows]) + "\n")


def record(path, times, depths, **more):
    """Write the table of a penetration (mm), and return its entry in a fit file."""
    write_table(path, ("t_s", "z_um"), times, 1e3 * depths)
    columns = {"time": "t_s", "value": "z_um"}
    return {"quantity": "penetration", "file": str(path), "columns": columns, "sd": 0.2, **more}


def one_test(name, pressure, *data, **changes):
    """Return a test at a pressure as a fit file has it."""
    changes = {"load.pressure": pressure, "load.omega": 3.5, "time.end": END, **changes}
    return {"name": name, "set": changes, "data": list(data)}


#: of a record: nothing is known of its zero, and its drift may be half a micrometre
ZERO_AND_DRIFT = {"offset": {}, "drift": {"prior": {"normal": [0.0, 0.5]}}}


def write_tests(folder, pressures=(40.0, 85.0), seed=1, **changes):
    """Write the tables of some tests and return the experiments of a fit file as dicts."""
    rng = None if seed is None else np.random.default_rng(seed)
    experiments = []
    for number, pressure in enumerate(pressures, start=1):
        result = history(pressure, **changes)
        t, z = penetration(result, rng)
        r, d = profile(result, rng)
        depth = record(folder / f"z{number}.csv", t, z, nuisance=copy.deepcopy(ZERO_AND_DRIFT))
        write_table(folder / f"d{number}.csv", ("r_mm", "d_um"), r, 1e3 * d)
        face = {"quantity": "profile.lower", "at": END, "file": str(folder / f"d{number}.csv"),
                "columns": {"r": "r_mm", "value": "d_um"}, "sd": 0.08,
                "nuisance": {"level": {}, "tilt": {}}}  # fmt: skip
        experiments.append(one_test(f"test {number}", pressure, depth, face))
    (folder / "case.toml").write_text(CASE)
    return experiments


def fit_tables(folder, experiments, **fit):
    """Return a fit file as a dict."""
    return {
        "case": str(folder / "case.toml"),
        "fit": {"parameters": copy.deepcopy(FITTED), **fit},
        "experiment": experiments,
    }


def refused(tables, **how):
    """Return the faults for which a fit file is refused."""
    with pytest.raises(InputError) as caught:
        read_fit(tables, **how)
    return caught.value.faults
