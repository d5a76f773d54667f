"""Test designs: information that adds, its best division, and what is said of it."""

import copy
import itertools
import json
import tomllib
from dataclasses import replace

import numpy as np
import pytest
from laboratory import END, TRUTH, fit_tables, write_tests
from parts import toml_text

import ringwear_par as rw
from ringwear_par.identification.definition.fit_file import read_fit
from ringwear_par.identification.fit import expected_result, fit
from ringwear_par.identification.test_design.candidates import candidates
from ringwear_par.identification.test_design.design import run_design
from ringwear_par.identification.test_design.design_folder import FILES, next_tests

VARY = {"load.pressure": [40.0, 96.0]}


@pytest.fixture(scope="module")
def laboratory(tmp_path_factory):
    """Two tests without noise, and their folder."""
    folder = tmp_path_factory.mktemp("design")
    return folder, write_tests(folder, seed=None)


@pytest.fixture
def tables(laboratory):
    """A function that makes a fit file at the truth, with a design."""

    def made(vary=VARY, budget=None, criterion="D", **settings):
        folder, written = laboratory
        found = fit_tables(folder, copy.deepcopy(written), **settings)
        found["fit"]["parameters"] = {
            key: {**entry, "start": TRUTH[key]} for key, entry in found["fit"]["parameters"].items()
        }
        budget = {"experiments": 2} if budget is None else budget
        return found | {"design": {"vary": vary, "budget": budget, "criterion": criterion}}

    return made


def spreads(found):
    """Return the standard deviations that a fit's dry run tells."""
    return np.array([p.sd for p in found.parameters])


@pytest.mark.parametrize("elements", [12, 16])
def test_information_is_that_of_a_fit(tables, comm, elements):
    """With all nuisances eliminated from each test by itself, as the fit has them together.

    Of tests that share an operator, or have their own.
    """
    source = tables()
    source["experiment"][1]["set"]["mesh.contact_elements"] = elements
    found = rw.design(source, comm)
    assert found.planned.sd == pytest.approx(
        spreads(expected_result(read_fit(source), comm)), rel=1e-6
    )


def test_what_the_best_tests_tell_is_what_a_fit_of_them_tells(tables, comm):
    source = tables()
    best = rw.design(source, comm)
    tests = [best.candidates[i] for i in best.designs[0].tests]
    for experiment, test in zip(source["experiment"], tests, strict=True):
        experiment["set"] |= test.changes()
    told = expected_result(read_fit(source), comm)
    assert best.designs[0].sd == pytest.approx(spreads(told), rel=1e-6)
    volumes = np.linalg.det(told.covariance[:2, :2])
    assert volumes < np.linalg.det(expected_result(read_fit(tables()), comm).covariance[:2, :2])


def test_exchange_finds_the_best_three(tables, comm):
    """Of 15 loads all 680 triples are looked at."""
    best = {
        criterion: rw.design(tables(budget={"experiments": 3}, criterion=criterion), comm)
        for criterion in ("D", "A")
    }
    widths = np.array([np.log(1e4), 200.0])
    information = []
    for test in best["D"].candidates:
        source = tables()
        source["experiment"] = source["experiment"][:1]
        source["experiment"][0]["set"] |= test.changes()
        covariance = expected_result(read_fit(source), comm).covariance[:2, :2]
        information.append(np.linalg.inv(covariance / np.outer(widths, widths)))
    threes = itertools.combinations_with_replacement(information, 3)
    wholes = np.array([sum(three) for three in threes])
    assert len(wholes) == 680
    scores = {
        "D": 0.5 * np.linalg.slogdet(wholes)[1],
        "A": -np.trace(np.linalg.inv(wholes), axis1=1, axis2=2),
    }
    for criterion, found in best.items():
        assert found.designs[0].score == pytest.approx(scores[criterion].max(), rel=1e-5)


def test_an_earlier_fit_counts(tables, comm, tmp_path):
    """Information of the fit and of the tests add up; draws are around its estimates."""
    source = tables()
    earlier = fit(source, comm, compare=False)
    folder = str(tmp_path)
    earlier.save(folder)
    found = rw.design(source, comm, after=folder)
    assert found.after == folder
    assert found.nominal == pytest.approx([p.estimate for p in earlier.parameters])
    # the same tests again halve the variances
    assert found.planned.sd == pytest.approx(spreads(earlier) / np.sqrt(2.0), rel=1e-3)
    assert found.draws == 8
    low, high = found.designs[0].range
    assert (low <= found.designs[0].sd).all()
    assert (found.designs[0].sd <= high).all()
    assert (low < high).all()
    gain = rw.design(source, comm, after=folder, criterion="eig").designs[0]
    assert gain.tests == found.designs[0].tests  # they differ by what was known before
    assert 0.0 < gain.score < 5.0


def test_tests_that_cannot_be_computed_are_left_out(tables, comm):
    """Half of the ring would be worn off by the longest ones."""
    found = rw.design(tables({"time.end": [100.0, 500000.0]}, {"experiments": 1}), comm)
    assert found.failed
    assert len(found.failed) + len(found.candidates) == 10
    assert all("worn off lower" in why for why in found.failed.values())
    with pytest.raises(rw.ComputationError, match="too few"):
        rw.design(tables({"time.end": [500000.0, 600000.0]}, {"experiments": 1}), comm)


def test_instants_of_profiles_vary(tables, comm):
    """All instants are read of one history of each load; their information is that of a fit."""
    vary = {**VARY, "profiles": [1, 2], "profile.at": [0.2, 1.0]}
    found = rw.design(tables(vary), comm)
    assert len(found.candidates) == 15 * (10 + 10)
    assert found.histories == 15 + 2
    parts = [np.array(test.profiles) / test.seconds for test in found.candidates]
    assert all((at >= 0.2).all() and (at <= 1.0).all() and (np.diff(at) > 0).all() for at in parts)
    source = tables(vary)
    best = found.designs[0]
    for experiment, number in zip(source["experiment"], best.tests, strict=True):
        test = found.candidates[number]
        experiment["set"] |= test.changes()
        record, profile = experiment["data"]
        experiment["data"] = [record, *({**profile, "at": at} for at in test.profiles)]
        radii = {"r": np.genfromtxt(profile["file"], delimiter=",", skip_header=1)[:, 0]}
        for one in experiment["data"][1:]:  # the same table twice would be a fault
            for key in ("file", "columns"):
                del one[key]
            one |= {**radii, "unit": "um"}
    told = expected_result(read_fit(source, plans=True), comm)
    # steps of the one history end at all instants
    assert best.sd == pytest.approx(spreads(told), rel=1e-3)


def test_noise_that_a_fit_has_found_counts(tables, comm, tmp_path):
    """The file's is but a guess, of second differences."""
    source = tables()
    for experiment in source["experiment"]:
        experiment["data"][0]["sd"] = "fit"
    folder = str(tmp_path)
    earlier = fit(source, comm)
    earlier.save(folder)
    found = rw.design(source, comm, after=folder)
    for experiment, own in earlier.experiments.items():
        (series,) = (one.series[0] for one in found.problem.experiments if one.name == experiment)
        assert series.sd / series.factor == pytest.approx(own["penetration"]["sd"])
    guessed, known = (p.experiments[0].series[0].sd for p in (read_fit(source), found.problem))
    assert guessed != pytest.approx(known)


def test_candidates_keep_to_their_ranges(tables):
    vary = {
        "load.pressure": [40.0, 80.0], "time.end": [20.0, 100.0], "load.steps": [1, 2],
        "profiles": [1, 2], "load.omega": [1.0, 3.0],
    }  # fmt: skip
    problem = read_fit(tables(vary, {"time.end": 90.0}))
    every = candidates(problem.design, problem.experiments[0])
    assert len({json.dumps([test.to_dict(), test.seconds]) for test in every}) == len(every)
    for test in every:
        assert all(40.0 <= load <= 80.0 for load in test.loads)
        assert list(test.loads) == sorted(test.loads)
        assert 20.0 <= test.seconds <= 90.0
        series = test.experiment.series
        assert tuple(one.at for one in series if one.profile) == test.profiles
        assert max(one.at for one in series if one.profile) == pytest.approx(test.seconds)
        (record,) = (one for one in series if one.quantity == "penetration")
        assert record.x[-1] == pytest.approx(test.seconds)
        assert record.n == pytest.approx(50 * test.seconds / END, abs=1)
    assert {len(test.loads) for test in every} == {1, 2}


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"vary": {**VARY, "time.end": [60.0, 100.0]}}, "120"),
        ({"budget": {"experiments": 2, "time.end": 100.0}}, "200"),
        ({"criterion": "eig"}, "known before"),
        ({"vary": {**VARY, "profile.at": [0.5, 50.0]}}, "parts of the test"),
        ({"vary": {**VARY, "load.steps": [1, 4], "profiles": [1, 4], "time.end": [10.0, 100.0],
                   "load.omega": [1.0, 2.0]}}, "7800 tests"),
    ],
)  # fmt: skip
def test_spaces_that_are_refused(tables, change, said, comm):
    budget = {"experiments": 2, "time.end": 100.0 if "time.end" in str(change) else 200.0}
    with pytest.raises(rw.InputError, match=said):
        rw.design(tables(**{"budget": budget, **change}), comm)


def test_the_folder_holds_the_next_tests(tables, laboratory, tmp_path, comm, capsys):
    folder, next_folder = laboratory[0], tmp_path / "next"
    source = folder / "fit.toml"
    source.write_text(toml_text(tables()))
    run_design(source, next_folder, comm)
    assert {path.name for path in next_folder.iterdir()} == set(FILES)
    stored = json.loads((next_folder / "design.json").read_text())
    assert set(stored["designs"][0]["sd"]) == set(TRUTH)
    tests = tomllib.loads((next_folder / "next.toml").read_text())["experiment"]
    assert [t["set"]["load.pressure"] for t in tests] == [
        t["load.pressure"] for t in stored["designs"][0]["experiments"]
    ]
    # beside those of the fit file they are tests that are planned, which tell what it says
    both = tables()
    both["experiment"] += tests
    problem = read_fit(both, plans=True)
    assert [test.name for test in problem.experiments] == ["test 1", "test 2", "next 1", "next 2"]
    for one in problem.experiments[2:]:
        assert all(series.planned for series in one.series)
    alone = expected_result(replace(problem, experiments=problem.experiments[2:]), comm)
    expected = stored["designs"][0]["sd"].values()
    assert spreads(alone) == pytest.approx(list(expected), rel=1e-6)
    assert "2 of 15 tests" in capsys.readouterr().out
    with pytest.raises(rw.InputError, match=r"fit\.json"):
        run_design(source, tmp_path / "later", comm, after=next_folder)
    assert not (tmp_path / "later").exists()


def test_next_tests_have_the_noise_of_the_readings_that_they_are_measured_as(tables, comm):
    """Of two records of one quantity each its own, of profiles that of the last one; its units."""
    source = tables({**VARY, "load.pressure": ["300 bar", "1000 bar"]})
    data = source["experiment"][0]["data"]
    early = {"quantity": "profile.lower", "r": {"from": 28.0, "to": 32.0, "count": 9},
             "unit": "mm", "at": 0.2 * END, "sd": 0.6}  # fmt: skip
    other = {"quantity": "penetration", "times": [0.5 * END, END], "unit": "mm", "sd": 0.07}
    source["experiment"][0]["data"] = [early, *data, other]
    found = rw.design(source, comm)
    for test in tomllib.loads(next_tests(found))["experiment"]:
        assert test["set"]["load.pressure"].endswith(" bar")
        told = [(one["quantity"], one["unit"], one["sd"]) for one in test["data"]]
        assert sorted(told) == [
            ("penetration", "mm", 0.07), ("penetration", "um", 0.2), ("profile.lower", "um", 0.08),
        ]  # fmt: skip
