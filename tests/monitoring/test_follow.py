"""Running tests: their posterior against sums over histories, alarms, and files that grow."""

import functools
import json
import threading
import time
from dataclasses import replace

import numpy as np
import pytest
from drawn import TAU, K, draws_of, fit_of, save_fit
from laboratory import CASE, END, fit_tables, history, one_test, penetration, record, write_tests
from laboratory import write_table as write
from mpi4py import MPI
from parts import (
    ProcessNoise,
    Readings,
    Setting,
    StopSignals,
    TestLikelihood,
    TimeTo,
    fit_draws,
    parse_toml,
    toml_text,
)
from scipy.special import logsumexp

import ringwear_par as rw
from ringwear_par.monitoring.follow import answer_of, read_running, run_follow
from ringwear_par.monitoring.follower import Follower, part_of

pytestmark = pytest.mark.slow

P0 = {"wear.lower.p0": 25.0}
#: of the material, and of the specimen that runs
MATERIAL, TRUE_K = 1e-7, 1.3e-7
OFFSET_AND_DRIFT = {"offset": {}, "drift": {"prior": {"normal": [0.0, 0.5]}}}
WARM = {"offset": {}, "thermal": {"time": {"start": 20.0, "bounds": [3.0, 150.0],
                                           "prior": {"normal": [20.0, 7.0]}}}}  # fmt: skip
TIMES = np.linspace(2.0, END, 50)
QUANTILES = (0.025, 0.5, 0.975)
MORE = '"parameters" = { "contact.friction" = { "start" = 0.1, "bounds" = [0.01, 1.0] },'


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a case, a fit of k by draws that are known, and the record of a test."""
    path = tmp_path_factory.mktemp("laboratory")
    (path / "case.toml").write_text(CASE)
    case = rw.read_case(path / "case.toml", {"load.pressure": 80.0, "load.omega": 3.5,
                                             "time.end": END, "time.scheme": "adaptive",
                                             "time.step": None, "time.steps": None})  # fmt: skip
    draws = draws_of(case, count=2000, tau=TAU)
    save_fit(path / "fit", fit_of(draws))
    record(path / "z.csv", *clean(1))
    return path


@functools.cache
def truth():
    """Return the history of the specimen that runs, for longer than its test."""
    return history(80.0, {K: TRUE_K, **P0}, 3.0 * END)


def clean(seed, k=TRUE_K, sd=2e-4, times=TIMES, drift=3e-4):
    """Return times and penetrations (mm) of a specimen, with an offset, a drift and noise."""
    z = penetration(truth(), None, times * k / TRUE_K, drift=0.0)[1]  # wear goes with k times time
    noise = np.random.default_rng(seed).standard_normal(len(times))
    return times, z + drift * times / END + sd * noise


def running(folder, name="z", more=(), **changed):
    """Write the fit file of a running test; return its path."""
    entry = {"quantity": "penetration", "file": f"{name}.csv", "sd": 0.2,
             "columns": {"time": "t_s", "value": "z_um"}, "nuisance": OFFSET_AND_DRIFT}  # fmt: skip
    tables = fit_tables(folder, [one_test("runs", 80.0, entry | changed, *more, **P0)])
    key = tables["fit"]["parameters"][K] | {"scatter": 0.3}
    tables["fit"] = {"parameters": {K: key}, "units": {K: "mm3/(N m)"}}
    path = folder / f"{name}.toml"
    path.write_text(toml_text(tables))
    return path


def problem_of(path, **settings):
    """Return the problem of a running test."""
    problem = read_running(path)
    return replace(problem, settings=replace(problem.settings, **settings))


def follower_of(problem, draws, count=20_000):
    readings = Readings(problem, MPI.COMM_SELF, StopSignals())
    return Follower(draws, problem, readings, count, 0)


def answered(follower, problem, depth=None):
    return answer_of(follower, problem, 5.0, depth)[0]


def exactly(problem, k, size=0.0, width=0.6):
    """Return log k on a grid, and log p of them and of the readings, by a history each."""
    x, (test,) = np.log(k) + np.linspace(-width, width, 241), problem.experiments
    (y,) = Readings(problem, MPI.COMM_SELF, StopSignals())([(0, x[:, None])])
    given, slopes = Setting.before(test), np.gradient(y, x, axis=0)
    if size:
        worn = truth().histories["worn_volume_lower"] / truth().line.area.sum()
        depth = np.interp(test.times, truth().histories["time"], worn) / TRUE_K
        clocks = [((slope / depth, depth),) for slope in slopes]
        logs = [
            TestLikelihood(test, replace(given, clocks=clock), np.sqrt([size / np.exp(at)]))(row)[0]
            for at, clock, row in zip(x, clocks, y[:, None], strict=True)
        ]
    else:
        logs = TestLikelihood(test, given, np.zeros(0))(y)
    return x, logs - 0.5 * (x - np.log(MATERIAL)) ** 2 / (0.1**2 + TAU**2)


def quantiles_of(x, logs):
    weights = np.exp(logs - logsumexp(logs))
    return np.interp(QUANTILES, np.cumsum(weights) - 0.5 * weights, x)


def quantiles_of_draws(found):
    return np.quantile(found.unknowns[:, 0], QUANTILES)


def check(found, exact, share=0.15):
    """Compare three quantiles, in standard deviations."""
    assert found == pytest.approx(exact, abs=share * (exact[2] - exact[0]) / 3.92)


def follow(path, folder, name="out", **options):
    """Follow a running test once, and return what is stored of it."""
    options = {"after": folder / "fit", "once": True, "draws": 20_000, **options}
    run_follow(path, folder / name, MPI.COMM_SELF, **options)
    return json.loads((folder / name / "follow.json").read_text())


def test_the_posterior_of_a_running_test(folder):
    """On a grid; the interval narrows, and what half the test expects of the whole is right."""
    path = running(folder)
    stored = follow(path, folder, depth=5e-3)
    key, problem = stored["keys"][K], problem_of(path)
    low, high = key["interval"]
    check(np.log([low, key["estimate"], high]), quantiles_of(*exactly(problem, TRUE_K)))
    assert np.array(key["told"]["interval"]) == pytest.approx(1e3 * np.array([low, high]))
    assert np.log(key["before"][1] / MATERIAL) == pytest.approx(1.96 * np.hypot(0.1, TAU), rel=0.05)
    assert stored["alarm"] is None
    true = truth().histories
    first, last = stored["depth"]["interval"]
    assert first < np.interp(5e-3, true["penetration"], true["time"]) < last
    at_40 = next(row for row in stored["trace"] if row[0] >= 39.0)
    wished = 50.0 * (at_40[3] - at_40[1]) / at_40[2]
    lines = (folder / "z.csv").read_text().splitlines(keepends=True)
    (folder / "half.csv").write_text("".join(lines[:16]) + lines[16][:4])  # and half a line
    half = follow(running(folder, "half"), folder, to=wished)
    assert (half["readings"], half["goal"]["time"]) == (15, pytest.approx(at_40[0], abs=12.0))
    assert half["goal"]["at_end"] == pytest.approx(key["percent"], rel=0.1)
    assert 'http-equiv="refresh"' in (folder / "out" / "follow.html").read_text()


def test_a_scale_that_is_not_that_of_the_fit(folder):
    """The fit's draws are of log k; the file of the running test has k itself."""
    path, found = running(folder), []
    text = path.read_text()
    assert '"log"' in text
    for scale in ("log", "linear"):
        (folder / "scale.toml").write_text(text.replace('"log"', f'"{scale}"'))
        problem = problem_of(folder / "scale.toml")
        follower = follower_of(problem, fit_draws(folder / "fit"), 4000)
        specimen = follower.update(problem.experiments[0])
        found.append(np.quantile(problem.values(specimen.unknowns[:, :1]), QUANTILES))
    check(found[1], found[0])


def test_a_sensor_that_leaves_few_draws(folder):
    """Its draws are made anew, about those that are left."""
    record(folder / "fine.csv", *clean(2, sd=1e-6))
    problem = problem_of(running(folder, "fine", sd=1e-3))
    follower = follower_of(problem, fit_draws(folder / "fit"))
    found = follower.update(problem.experiments[0])
    assert not np.isin(found.unknowns, follower.before).any()
    check(quantiles_of_draws(found), quantiles_of(*exactly(problem, TRUE_K, width=0.03)))


def test_random_wear_is_as_on_a_grid(folder):
    """And goes on from the readings: the larger it is, the less is known of the time to a depth."""
    problem = problem_of(running(folder), process={"wear.lower": ProcessNoise()})
    (test,), reached = problem.experiments, []
    for size in (2e-6, 2e-5, 2e-4):
        draws = replace(fit_draws(folder / "fit"), process={"wear.lower": np.full(2000, size)})
        follower = follower_of(problem, draws)
        if size < 1e-4:  # where it is all but normal
            found = follower.update(test)
            check(quantiles_of_draws(found), quantiles_of(*exactly(problem, TRUE_K, size)))
        depths = follower.penetrations(follower.update(part_of(test, test.times <= 60.0)))
        life = TimeTo.of(follower.time, depths, 6.5e-3, 0.6)
        reached.append([life.interval[0], life.median, life.interval[1] or np.inf])
    assert 60.0 < reached[2][0] < reached[2][1] < END
    assert np.ptp(reached[2]) > 1.3 * np.ptp(reached[0])


def test_no_alarm_without_a_change_and_one_with_it(folder):
    """Twenty rigs that warm up at rates of which the fit file knows a little, k constant."""
    random = np.random.default_rng(0)
    draws, times = fit_draws(folder / "fit"), np.linspace(2.0, END, 60)
    problem = problem_of(running(folder, "z", nuisance=WARM))
    (test,) = problem.experiments
    follower, alarms, inside = follower_of(problem, draws, 2000), 0, 0

    def answer(k, seed, later=1.0):
        _, z = clean(seed, k, 2e-4, np.where(times < 50, times, 50 + later * (times - 50)), 0.0)
        growth = -3e-3 * (1.0 - np.exp(-times / max(20.0 + 7.0 * random.standard_normal(), 4.0)))
        sd = np.full(60, 2e-4)
        series = replace(test.series[0], x=times, value=z + growth, sd=sd, lines=None)
        return answered(follower, replace(problem, experiments=(replace(test, series=(series,)),)))

    for seed in range(20):
        k = MATERIAL * np.exp(np.hypot(0.1, TAU) * random.standard_normal())
        found = answer(k, seed)
        alarms += found["alarm"] is not None
        low, high = found["keys"][K]["interval"]
        inside += low < k < high
    assert alarms <= 1
    assert inside >= 16
    changed = answer(MATERIAL, 30, later=1.9)
    assert 50.0 <= changed["alarm"]["time"] <= 70.0
    low, high = changed["keys"][K]["interval"]
    assert low < MATERIAL < high


def test_readings_in_one_portion_or_many(folder):
    """Answers depend on the readings alone, another record before them included."""
    problem, draws = problem_of(running(folder)), fit_draws(folder / "fit")
    (test,) = problem.experiments
    other = replace(test, series=(replace(test.series[0], value=0.7 * test.series[0].value),))
    follower = follower_of(problem, draws)
    for part in (other, *(part_of(test, test.times <= until) for until in (17.0, 40.0, END))):
        answer = answered(follower, replace(problem, experiments=(part,)), 5e-3)
    assert json.dumps(answer) == json.dumps(answered(follower_of(problem, draws), problem, 5e-3))


def test_profiles_limits_and_an_sd_that_is_fitted(folder):
    """Once they are there they narrow the interval; an sd that is fitted is integrated."""
    (test,) = write_tests(folder, (80.0,), truth={K: TRUE_K, **P0})
    face = test["data"][1]
    limit = {"quantity": "volume.lower", "value": 3.0, "at": 50.0, "unit": "mm^3", "sd": 0.1,
             "censored": "below"}  # fmt: skip
    draws = fit_draws(folder / "fit")
    alone = problem_of(running(folder, sd="fit", nuisance={"offset": {}}))
    follower = follower_of(alone, draws)
    alone_exact = quantiles_of(*exactly(alone, TRUE_K))
    check(quantiles_of_draws(follower.update(alone.experiments[0])), alone_exact)
    problem = problem_of(running(folder, more=[limit, face]))
    exact = quantiles_of(*exactly(problem, TRUE_K, width=0.1))
    check(quantiles_of_draws(follower_of(problem, draws).update(problem.experiments[0])), exact)
    assert np.ptp(exact) < 0.3 * np.ptp(alone_exact)
    assert answered(follower_of(problem, draws), problem)["alarm"] is None


def test_measured_friction_as_far_as_it_was_read(folder):
    """After a fit without scatter, of which there is a warning."""
    t = np.linspace(1.0, 60.0, 40)
    torque = 0.1 * 80.0 * truth().line.area.sum() * 30.0 * np.ones(40)
    write(folder / "m.csv", ("t_s", "M_Nmm"), t, torque)
    tables = parse_toml(running(folder).read_text(), "fit")
    tables["experiment"][0]["input"] = [{
        "key": "contact.friction", "quantity": "torque", "file": "m.csv",
        "columns": {"time": "t_s", "value": "M_Nmm"},
    }]  # fmt: skip
    (folder / "torque.toml").write_text(toml_text(tables))
    alone = replace(fit_draws(folder / "fit"), scatter={})
    save_fit(folder / "alone", fit_of(replace(alone, material=1.3 * alone.material)))
    stored = follow(folder / "torque.toml", folder, after=folder / "alone")
    low, high = stored["keys"][K]["interval"]
    assert low < TRUE_K < high
    assert any("no scatter" in doubt for doubt in stored["doubts"])


def test_a_transition_raises_an_alarm_while_the_file_grows(folder, capsys):
    """The file is replaced, and grows; the answer stays that before the transition."""
    lines = (folder / "z.csv").read_text().splitlines(keepends=True)
    rows = [line.split(",") for line in lines[1:]]
    faster = [f"{t},{float(z) + 0.2 * max(float(t) - 60.0, 0.0):.6g}\n" for t, z in rows]
    path = folder / "grown.csv"

    path.write_text(lines[0] + "".join(faster[:10]))

    def grow():
        time.sleep(2.0)
        path.write_text(lines[0])  # truncated
        with path.open("a") as file:
            for line in faster:
                file.write(line)
                file.flush()
                time.sleep(0.04)

    writer = threading.Thread(target=grow)
    writer.start()
    try:
        stored = follow(running(folder, "grown"), folder, "growing", once=False)
    finally:
        writer.join()
    assert stored["readings"] == len(rows)
    assert 60.0 <= stored["alarm"]["time"] <= 75.0
    low, high = stored["keys"][K]["interval"]
    assert low < TRUE_K < high
    assert "alarm" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("word", "edit", "options"),
    [
        ("test 9", (), {"test": "test 9"}),
        ("S1", ('"runs"', '"S1"'), {}),
        ("--after", (), {"after": None}),
        ("fits contact.friction", ('"parameters" = {', MORE), {}),
        ("none.csv", ("z.csv", "none.csv"), {}),
    ],
)  # fmt: skip
def test_what_is_refused(word, edit, options, folder, tmp_path):
    text = running(folder).read_text()
    path = folder / "refused.toml"
    path.write_text(text.replace(*edit) if edit else text)
    options = {"after": folder / "fit", "once": True, **options}
    with pytest.raises(rw.InputError, match=word):
        run_follow(path, tmp_path / "out", MPI.COMM_SELF, **options)
    assert not (tmp_path / "out").exists()
