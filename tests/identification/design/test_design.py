"""Next tests: what they would tell in closed form and by brute force, and what is said of it."""

import itertools
import json
from dataclasses import replace

import numpy as np
import pytest
from drawn import draws_of, fit_of, save_fit
from laboratory import END, TRUTH, fit_tables, one_test
from parts import StopSignals, toml_text

import ringwear_par as rw
from ringwear_par.identification.definition.fit_file import read_fit
from ringwear_par.identification.design.design import run_design
from ringwear_par.identification.design.information import candidates
from ringwear_par.identification.histories import Readings
from ringwear_par.identification.nuisances import column

K, P0 = TRUTH
VARY = {"load.pressure": [40.0, 96.0]}
ARCHARD = {"wear.lower.law": "archard"}
WARM = {"time": {"start": "25 s", "bounds": ["5 s", "200 s"]}}
#: g, and of log k
SD_MASS, SD_PRIOR = 2e-5, 0.2


@pytest.fixture
def at_truth(tables):
    """A function that makes a fit file at the truth, with a design."""

    def made(vary=VARY, criterion="D", **budget):
        found = tables()
        for key, entry in found["fit"]["parameters"].items():
            entry["start"] = TRUTH[key]
        budget = budget or {"experiments": 2}
        return found | {"design": {"vary": vary, "budget": budget, "criterion": criterion}}

    return made


@pytest.fixture
def weighings(laboratory):
    """A function that makes a plan of single weighings, of which log k alone is fitted."""

    def made(experiments, key, **fit):
        mass = {"quantity": "mass.lower", "unit": "g", "sd": SD_MASS, "density": 1.9e-3}
        mass |= {"times": [END]}
        found = fit_tables(laboratory[0], [one_test("a", 50.0, mass, **ARCHARD)])
        key |= {"start": 1e-7, "bounds": [1e-9, 1e-5], "scale": "log"}
        key |= {"prior": {"normal": [1e-7, SD_PRIOR * 1e-7]}}
        found["fit"] = {"parameters": {K: key}, **fit}
        vary = {"load.pressure": [20.0, 80.0]}
        return found | {"design": {"vary": vary, "budget": {"experiments": experiments}}}

    return made


@pytest.mark.parametrize(
    ("count", "scatter", "size"), [(1, 0.0, 0.0), (2, 0.2, 0.0), (5, 0.2, 0.0), (1, 0.0, 1e-6)]
)
def test_weighings_in_closed_form(weighings, comm, count, scatter, size):
    """Mass m of mean depth S goes with k: log k has a variance of (sd/m)^2 + size/S + scatter^2.

    That of a material is a share of it by the number of specimens, and by its prior.
    """
    key = {"scatter": scatter} if scatter else {}
    process = {"process": {"wear.lower": {"size": size}}} if size else {}
    source = weighings(count, key, **process)
    found = rw.design(source, comm)
    best, today = found.designs[0], found.content["today"]
    case = read_fit(source, plans=True).experiments[0].case.replace(best["experiments"][0])
    volume = rw.simulate(case).histories["worn_volume_lower"][-1]
    variance = (SD_MASS / (1.9e-3 * volume)) ** 2 + size * case.area / volume + scatter**2
    precision = SD_PRIOR**-2 + count / variance
    # means over draws of k about 1e-7
    assert best["sd"][K] == pytest.approx(1e-7 * precision**-0.5, rel=0.06)
    assert best["gain"] == pytest.approx(0.5 * np.log2(SD_PRIOR**2 * precision), rel=0.03)
    assert (today["sd"][K], today["gain"]) == (pytest.approx(SD_PRIOR * 1e-7), 0.0)
    if not scatter:
        assert best["experiments"] == [{"load.pressure": 80.0}]


@pytest.mark.parametrize(
    ("count", "criterion", "warm"),
    [(1, "D", True), (2, "A", False), (3, "D", False), (3, "A", False)],
)
def test_the_best_tests_by_brute_force(at_truth, comm, count, criterion, warm):
    """Of all combinations, by Jacobians and covariances of readings with all nuisances."""
    source = at_truth(criterion=criterion, experiments=count)
    if warm:  # the rig grows
        source["experiment"][0]["data"][0]["nuisance"]["thermal"] = WARM
    found, problem = rw.design(source, comm), read_fit(source)
    tests = candidates(problem.design, problem.experiments[0])
    readings = Readings(replace(problem, experiments=tests), comm, StopSignals())
    x, step = problem.unknowns([*TRUTH.values()]), np.diag([1e-3, 0.02])
    points = np.concatenate([x + step, x - step])
    blocks = readings.lead(lambda: readings([(i, points) for i in range(len(tests))]))
    slopes = [np.linalg.solve(2.0 * step, y[:2] - y[2:]).T for y in blocks]
    each = np.zeros((len(tests), 2, 2))
    for matrix, test, columns in zip(each, tests, slopes, strict=True):
        start = 0
        for series in test.series:
            at, every = np.array([25.0]), series.linear_nuisances
            added = np.column_stack([np.ravel(column(n, series, test.case, at)) for n in every])
            sds = [1e3 if n.prior is None else n.prior.sd for n in every]
            covariance = np.diag(series.sd**2) + (added * np.square(sds)) @ added.T
            part = columns[start : (start := start + series.n)]
            matrix += part.T @ np.linalg.solve(covariance, part)
    widths = np.array([np.log(1e4), 200.0])
    combinations = itertools.combinations_with_replacement(each, count)
    covariances = [np.linalg.inv(np.diag(12.0 / widths**2) + sum(c)) for c in combinations]
    size = np.linalg.det if criterion == "D" else lambda c: np.trace(c / np.outer(widths, widths))
    best = np.sqrt(np.diag(min(covariances, key=size))) * [TRUTH[K], 1.0]
    assert [*found.designs[0]["sd"].values()] == pytest.approx(best, rel=2e-3)


def test_an_earlier_fit_counts(at_truth, comm, tmp_path):
    """Its draws are what is known today, the scatter too, of which the file says nothing."""
    source = at_truth(experiments=1)
    case = read_fit(source).experiments[0].case
    draws = draws_of(case, p0=np.linspace(20.0, 30.0, 200), tau=0.2)
    folder = save_fit(tmp_path / "fit", fit_of(draws))
    found = rw.design(source, comm, after=folder)
    k, p0 = draws.material.T
    spread = np.std([np.log(k), p0], axis=1, ddof=1)
    before, after = (
        np.array([*one["sd"].values()]) for one in (found.content["today"], found.designs[0])
    )
    assert before == pytest.approx(spread * [found.content["parameters"][K], 1.0])
    assert found.content["draws"] == 6
    assert "specimens differ by 20 %" in found.summary()
    assert (after < before).all()
    source["fit"]["parameters"].pop(P0)
    with pytest.raises(rw.InputError, match=f"must be {K}, {P0}"):
        rw.design(source, comm, after=folder)


def test_tests_that_cannot_be_computed_are_left_out(at_truth, comm):
    """Half of the ring would be worn off by the longest ones."""
    found = rw.design(at_truth({"time.end": [100.0, 500000.0]}, experiments=1), comm)
    assert found.content["failed"] > 0
    assert found.content["failed"] + found.content["candidates"] == 10
    assert "worn off lower" in found.summary()
    with pytest.raises(rw.ComputationError, match="too few"):
        rw.design(at_truth({"time.end": [500000.0, 600000.0]}, experiments=1), comm)


def test_candidates_keep_to_their_ranges(at_truth):
    vary = {"load.pressure": [40.0, 80.0], "time.end": [20.0, 100.0], "load.omega": [1.0, 3.0]}
    problem = read_fit(at_truth(vary, **{"time.end": 90.0}))
    every = candidates(problem.design, problem.experiments[0])
    assert len({(*test.changes.items(),) for test in every}) == len(every) == 3 * 15 * 8
    for test in every:
        end, (record, profile, *_) = test.case.time.end, test.series
        assert 40.0 <= test.changes["load.pressure"] <= 80.0
        assert 20.0 <= end == profile.at <= 90.0
        assert record.n == pytest.approx(50 * end / END, abs=1)


def test_the_folder(at_truth, laboratory, tmp_path, comm, capsys):
    """Loads are said in the units of the ranges."""
    source, folder = at_truth({"load.pressure": ["400 bar", "960 bar"]}), tmp_path / "next"
    file = laboratory[0] / "fit.toml"
    file.write_text(toml_text(source))
    run_design(file, folder, comm)
    assert {path.name for path in folder.iterdir()} == {"design.json", "design.png"}
    best, *_ = json.loads((folder / "design.json").read_text())["designs"]
    loads = [f"{10.0 * test['load.pressure']:.4g} bar, 100 s" for test in best["experiments"]]
    assert best["name"] == " + ".join(loads)
    output = capsys.readouterr().out
    assert "2 of 15 tests" in output
    assert best["name"] in output
