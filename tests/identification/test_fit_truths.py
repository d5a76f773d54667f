"""What fits print, against scipy's distributions and against truths that were planted."""

import numpy as np
import pytest
from fit_coverage import Laboratory, laboratories, one_set
from laboratory import write_table
from mpi4py import MPI
from paths import PAPER
from scipy.stats import kstest, norm

import ringwear_par as rw

END = 40.0
TRUTH = {"wear.lower.k": 3e-8, "wear.upper.k": 2e-8, "contact.friction": 0.2}
#: in um
OFFSET, TILT = 1.0, 0.1
#: by quantity: standard deviations and places of readings, in the units of the files
SD = {"penetration": 0.05, "torque": 2.0, "profile.lower": 0.05, "profile.upper": 0.05}
TIMES, FITS = np.linspace(2.0, END, 20), 12
CASE = {"wear.lower.law": "archard", "wear.lower.p0": None, "wear.upper.law": "archard", **TRUTH,
        "mesh.contact_elements": 12}  # fmt: skip


def readings(values):
    """Return what instruments would read without noise, and where: by quantity (x, y).

    Profiles are read where depths are known, in the middle of elements.
    """
    time = {"scheme": "adaptive", "end": END, "tolerance": 1e-7}
    case = rw.read_case(PAPER, {**CASE, "time": time}).replace(values)
    result = rw.simulate(case, MPI.COMM_SELF)
    in_time = {name: np.interp(TIMES, result.histories["time"], result.histories[name])
               for name in ("penetration", "torque")}  # fmt: skip
    read = {"penetration": (TIMES, 1e3 * in_time["penetration"] + OFFSET),
            "torque": (TIMES, 1e-3 * in_time["torque"])}  # fmt: skip
    r = result.line.r[2:-2]
    for body in ("lower", "upper"):
        depth = 1e3 * result.profiles[f"wear_{body}"][-1][2:-2]
        read[f"profile.{body}"] = (r, depth + TILT * (r - 30.0))
    return read


@pytest.fixture(scope="module")
def laboratory(tmp_path_factory):
    """Function that fits readings with the noise of a seed; returns the fit, and the readings."""
    folder, true = tmp_path_factory.mktemp("truths"), readings(TRUTH)
    (folder / "case.toml").write_text(rw.read_case(PAPER, {**CASE, "time.scheme": "adaptive",
                                                           "time.end": END}).text)  # fmt: skip
    keys = {
        key: {"start": 0.9 * value, "bounds": [0.3 * value, 3.0 * value], "scale": "log"}
        for key, value in TRUTH.items()
    }

    def fitted(seed, **settings):
        rng, data, read = np.random.default_rng(seed), [], {}
        for quantity, sd in SD.items():
            is_profile = quantity.startswith("profile")
            name, place = ("r", "r_mm") if is_profile else ("time", "t_s")
            unit = "q_Nm" if quantity == "torque" else "z_um"
            x, y = true[quantity]
            read[quantity] = y + sd * rng.standard_normal(len(x))
            path = folder / f"{quantity}.csv"
            write_table(path, (place, unit), x, read[quantity])
            nuisance = {"penetration": {"offset": {}}, "torque": {}}.get(quantity, {"tilt": {}})
            data.append({"quantity": quantity, "file": str(path), "sd": sd, "nuisance": nuisance,
                         "columns": {name: place, "value": unit},
                         **({"at": END} if is_profile else {})})  # fmt: skip
        test = {"name": "test", "set": {"time.end": END}, "data": data}
        settings = {"parameters": keys, **settings}
        tables = {"case": str(folder / "case.toml"), "fit": settings, "experiment": [test]}
        return rw.fit(tables, MPI.COMM_SELF), read

    return fitted


@pytest.fixture(scope="module")
def fits(laboratory):
    """Fits of many seeds, and the readings of the last one."""
    every = [laboratory((2, seed)) for seed in range(FITS)]
    return [found for found, _ in every], every[-1][1]


def test_chi2_and_its_freedom(fits):
    """Of a history in other steps, nuisances at their best: a number less for each that is free."""
    found, read = fits[0][-1], fits[1]
    told, best = found.to_dict(), np.exp(found.solution.best)
    model = readings(dict(zip(TRUTH, best, strict=True)))
    number = squares = 0.0
    for quantity, sd in SD.items():
        x, y = model[quantity]
        column = {"penetration": 1.0 + 0 * x, "torque": 0 * x}.get(quantity, x - 30.0)
        y = y + column * (column @ (read[quantity] - y)) / max(column @ column, 1.0)
        squares += (((read[quantity] - y) / sd) ** 2).sum()
        number += quantity != "torque"
    number, n = number + len(TRUTH), sum(map(len, read.values()))
    assert told["chi2"] == pytest.approx(squares, abs=0.5)
    assert told["degrees_of_freedom"] == pytest.approx(n - number, abs=0.5)


@pytest.mark.parametrize("level", [0.95, 0.8])
def test_intervals_are_as_wide_as_their_level_says(laboratory, fits, level):
    """Of keys that are known to 1 %, so that their logarithms are as good as themselves."""
    found = fits[0][0] if level == 0.95 else laboratory((2, 0), level=level)[0]
    for one in found.to_dict()["parameters"].values():
        low, high = one["interval"]
        assert 0.0 < one["sd"] < 0.01 * one["estimate"]
        half = 0.5 * (high - low) / one["sd"]
        assert half == pytest.approx(norm.ppf(0.5 + 0.5 * level), rel=0.06)


@pytest.mark.slow
def test_intervals_hold_the_truth_as_often_as_they_say(fits):
    """Six numbers of each fit, which hardly depend on each other; chi2 is by chance."""
    errors, inside = [], []
    for found in fits[0]:
        for key, one in found.to_dict()["parameters"].items():
            errors.append((one["estimate"] - TRUTH[key]) / one["sd"])
            inside.append(one["interval"][0] < TRUTH[key] < one["interval"][1])
        for series, of in found.to_dict()["nuisance"]["test"].items():
            (one,), true = of.values(), OFFSET if series == "penetration" else TILT
            errors.append((one["estimate"] - true) / one["sd"])
            inside.append(abs(errors[-1]) < norm.ppf(0.975))
    assert len(inside) == 6 * FITS
    assert 0.88 <= np.mean(inside) <= 0.99
    assert np.std(errors) == pytest.approx(1.0, abs=0.25)  # three times how well 72 tell it
    assert np.mean(errors) == pytest.approx(0.0, abs=0.35)
    assert kstest([found.content["p_value"] for found in fits[0]], "uniform").pvalue > 0.01


def test_the_script_of_coverage_fits_a_set():
    scores = one_set(Laboratory(*laboratories()["2-specimens"]), 0)
    assert list(scores) == ["k (%)", "scatter (%)", "next specimen (%)"]
    assert all(0.0 < half < np.inf for _, half in scores.values())
