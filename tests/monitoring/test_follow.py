"""Running tests: the posterior of a bank, the alarm, files that grow, what is refused."""

import json
import threading
import time
from dataclasses import replace

import numpy as np
import pytest
from commands import ringwear
from laboratory import CASE, END, fit_tables, history, penetration, write_table
from mpi4py import MPI
from parts import (
    ProcessNoise,
    Rounds,
    StopSignals,
    fit_knowledge,
    log_densities,
    probabilities,
    toml_text,
)
from scipy.special import logsumexp

import ringwear_par as rw
from ringwear_par.monitoring.bank import Bank, quantiles
from ringwear_par.monitoring.follow import run_follow
from ringwear_par.monitoring.histories import planned
from ringwear_par.monitoring.outlook import time_to
from ringwear_par.monitoring.prior_knowledge import followed_test
from ringwear_par.monitoring.running_state import RunningTestState, Targets
from ringwear_par.monitoring.running_test import RunningTest

pytestmark = pytest.mark.slow

KEY, P0, TRUE_K = "wear.lower.k", 25.0, 1.3e-7
#: of the running specimen, over the material's k
FACTOR = 1.15


def experiment(folder, number, factor, rng, load=80.0):
    """Write the record of a specimen, and return its experiment."""
    values = {KEY: TRUE_K * factor, "wear.lower.p0": P0}
    t, z = penetration(history(load, values), rng)
    write_table(folder / f"z{number}.csv", ("t_s", "z_um"), t, 1e3 * z)
    record = {
        "quantity": "penetration", "file": f"z{number}.csv", "sd": 0.2,
        "columns": {"time": "t_s", "value": "z_um"},
        "nuisance": {"offset": {}, "drift": {"prior": {"normal": [0.0, 0.5]}}},
    }  # fmt: skip
    changes = {"load.pressure": load, "load.omega": 3.5, "time.end": END, "wear.lower.p0": P0}
    return {"name": f"test {number}", "set": changes, "data": [record]}


@pytest.fixture(scope="module")
def laboratory(tmp_path_factory):
    """A folder with a fit of four specimens, and fit files of more of them, of which one runs."""
    folder, rng = tmp_path_factory.mktemp("laboratory"), np.random.default_rng(3)
    (folder / "case.toml").write_text(CASE)
    factors = (0.8, 1.0, 1.1, 1.3, FACTOR)
    tests = [experiment(folder, n, factor, rng) for n, factor in enumerate(factors, start=1)]
    tables = fit_tables(folder, tests)
    key = {**tables["fit"]["parameters"][KEY], "scatter": "fit"}
    tables["fit"]["parameters"], tables["fit"]["units"] = {KEY: key}, {KEY: "mm3/(N m)"}
    law = {"wear.lower.law": "archard"}
    tables["compare"] = {"archard": {"set": law, "parameters": {KEY: {**key, "start": 1e-8}}}}
    light = experiment(folder, 6, FACTOR, rng, 45.0)
    files = {"fit": tests[:4], "running": tests[4:], "light": [light], "all": [*tests[:4], light]}
    for name, chosen in files.items():
        (folder / f"{name}.toml").write_text(toml_text({**tables, "experiment": chosen}))
    assert ringwear("fit", folder / "fit.toml", "-o", folder / "out", "--compare").returncode == 0
    return folder


def followed(laboratory, folder, name="running", **options):
    """Follow the running test once, and return what is stored of it."""
    options = {"after": laboratory / "out", "once": True, "draws": 4000, **options}
    run_follow(laboratory / f"{name}.toml", folder, MPI.COMM_SELF, **options)
    return json.loads((folder / "follow.json").read_text())


@pytest.fixture(scope="module")
def stored(laboratory, tmp_path_factory):
    """What is stored of the running test, and the folder."""
    folder = tmp_path_factory.mktemp("stored")
    return followed(laboratory, folder, to="2%", depth="5 um"), folder


def exact_quantiles(laboratory, problem, unknowns):
    """Return quantiles of the running specimen's k, by quadrature of prior times likelihood.

    Over 141 unknowns, at equal distances.
    """
    (test,), known = problem.experiments, fit_knowledge(laboratory / "out").values
    record = test.series[0]
    times = record.x
    k = np.exp(unknowns[::20])
    rounds = Rounds(problem, MPI.COMM_SELF, StopSignals())
    readings = rounds.read(k[:, None], [(i, 0) for i in range(len(k))], derivatives=False)
    weights = np.polynomial.chebyshev.chebfit(np.linspace(-1, 1, 8), np.array(readings)[:, :, 0], 7)
    model = np.polynomial.chebyshev.chebval(np.linspace(-1, 1, 141), weights).T
    column = times / END
    covariance = np.diag(record.sd**2) + 1.0
    drift = record.factor * record.nuisances[1].prior.sd
    covariance += drift**2 * np.outer(column, column)
    rest = record.value - model
    logs = -0.5 * np.einsum("ki,ij,kj->k", rest, np.linalg.inv(covariance), rest)
    logs += logsumexp(log_densities(known, "next specimen", unknowns[:, None]), axis=1)
    share = np.exp(logs - logsumexp(logs))
    return np.exp(quantiles(unknowns, share, [0.025, 0.5, 0.975]))


def test_the_posterior_of_a_running_test(laboratory, stored):
    """By quadrature; the interval narrows, its goal comes, and nothing is out of the way."""
    stored, folder = stored
    problem, key = RunningTest.of(laboratory / "running.toml", None).read(), stored["keys"][KEY]
    unknowns = np.log(TRUE_K) + np.linspace(-0.7, 0.7, 141)
    exact = np.log(exact_quantiles(laboratory, problem, unknowns))
    sd = (exact[2] - exact[0]) / 3.92
    quantiles_of_key = np.log([key["interval"][0], key["estimate"], key["interval"][1]])
    assert quantiles_of_key == pytest.approx(exact, abs=0.12 * sd)
    in_unit = key["told"]
    for name in ("estimate", "interval", "before"):
        assert np.array(in_unit[name]) == pytest.approx(1e3 * np.array(key[name]))
    assert f"{in_unit['estimate']:.4g} mm3/(N m)" in stored["summary"][1]
    assert stored["alarm"] is None
    assert stored["interpolated"] < 1e-4
    assert key["percent"] < 0.2 * (50 * (key["before"][1] - key["before"][0]) / key["estimate"])
    assert key["interval"][0] < FACTOR * TRUE_K < key["interval"][1]
    truth = history(80.0, {KEY: TRUE_K * FACTOR, "wear.lower.p0": P0})
    reached = np.interp(5e-3, truth.histories["penetration"], truth.histories["time"])
    low, high = stored["depth"]["interval"]
    assert low < reached < high
    half = stored["trace"][len(stored["trace"]) // 2]
    assert half[3] - half[1] > key["interval"][1] - key["interval"][0]
    page = (folder / "follow.html").read_text()
    assert 'http-equiv="refresh"' not in page  # it has ended


def test_laws_are_as_probable_as_by_a_fit_of_all_tests(laboratory, tmp_path):
    stored = followed(laboratory, tmp_path / "out", "light")
    fit = rw.fit(laboratory / "all.toml", MPI.COMM_SELF, compare=True)
    evidences = {"this law": fit, **fit.alternatives}
    shares = probabilities({law: of.to_dict()["log_evidence"] for law, of in evidences.items()})
    now = {law: share for law, (_, share) in stored["laws"].items()}
    assert 0.6 < shares["this law"] < 0.99
    assert now == pytest.approx(shares, abs=0.02)
    trace = np.array(stored["law_trace"])  # from what is known before the test to the answer
    before, after = np.array([*stored["laws"].values()]).T
    assert trace[0, 1:] == pytest.approx(before)
    assert trace[-1, 1:] == pytest.approx(after)
    assert trace[:, 1:].sum(axis=1) == pytest.approx(1.0)


def test_half_a_test_predicts_when_it_is_enough(laboratory, stored, tmp_path):
    """The time that is expected half way is that at which the whole record is as narrow."""
    whole, _ = stored
    at_60 = next(row for row in whole["trace"] if row[0] >= 60.0)
    wished = 50.0 * (at_60[3] - at_60[1]) / at_60[2]
    lines = (laboratory / "z5.csv").read_text().splitlines(keepends=True)
    try:  # to 30 s, and half a line
        (laboratory / "z5.csv").write_text("".join(lines[:16]) + lines[16][:4])
        half = followed(laboratory, tmp_path / "half", to=f"{wished:.3f}%")
    finally:
        (laboratory / "z5.csv").write_text("".join(lines))
    assert half["readings"] == 15
    assert half["goal"]["time"] == pytest.approx(60.0, abs=12.0)
    assert 'http-equiv="refresh"' in (tmp_path / "half" / "follow.html").read_text()


def test_a_transition_raises_an_alarm_while_the_file_grows(laboratory, tmp_path, capsys):
    """Lines come in halves, the file is replaced; the answer stays that before the transition."""
    lines = (laboratory / "z5.csv").read_text().splitlines(keepends=True)
    rows = [line.split(",") for line in lines[1:]]
    faster = [f"{t},{float(z) + 0.2 * max(float(t) - 60.0, 0.0):.6g}\n" for t, z in rows]

    def write():
        path = laboratory / "grown.csv"
        path.write_text(lines[0] + "".join(faster[:10]))
        time.sleep(0.5)
        path.write_text(lines[0])  # truncated
        with path.open("a") as file:
            for line in faster:
                for part in (line[:3], line[3:]):
                    file.write(part)
                    file.flush()
                    time.sleep(0.02)

    text = (laboratory / "running.toml").read_text().replace("z5.csv", "grown.csv")
    (laboratory / "growing.toml").write_text(text)
    writer = threading.Thread(target=write)
    writer.start()
    try:
        run_follow(laboratory / "growing.toml", tmp_path / "out", MPI.COMM_SELF,
                   after=laboratory / "out", draws=2000)  # fmt: skip
    finally:
        writer.join()
    stored = json.loads((tmp_path / "out" / "follow.json").read_text())
    assert stored["readings"] == len(rows)
    assert 60.0 <= stored["alarm"]["time"] <= 75.0
    low, high = stored["keys"][KEY]["interval"]
    assert low < FACTOR * TRUE_K < high
    assert "alarm" in capsys.readouterr().out


def fine_record(laboratory, name, factor):
    """Write a record of a sensor that is twenty times as good, and return its fit file."""
    times, z = penetration(history(80.0, {KEY: TRUE_K * factor, "wear.lower.p0": P0}), drift=0.0)
    z += 1e-5 * np.random.default_rng(1).standard_normal(len(z))
    write_table(laboratory / f"{name}.csv", ("t_s", "z_um"), times, 1e3 * z)
    text = (laboratory / "running.toml").read_text().replace("z5.csv", f"{name}.csv")
    text = text.replace('"sd" = 0.2', '"sd" = 0.01').replace("[0.0, 0.5]", "[0.0, 0.001]")
    (laboratory / f"{name}.toml").write_text(text)
    return laboratory / f"{name}.toml"


def bank_of(followed, draws=2000):
    """Return the bank of a followed test, before its readings."""
    problem = followed.problem
    rounds = Rounds(planned(problem), MPI.COMM_SELF, StopSignals())
    return Bank(followed.known.values, followed.specimen, problem, rounds, draws, 0)


def test_draws_that_are_made_anew_and_a_record_that_is_replaced(laboratory):
    """By quadrature, though few draws of before are near; nothing is left of another record."""
    tests = {
        name: followed_test(RunningTest.of(fine_record(laboratory, name, factor), None),
                            laboratory / "out", MPI.COMM_SELF)
        for name, factor in (("quick", FACTOR), ("slow", 0.7))
    }  # fmt: skip

    def state():
        return RunningTestState(
            lambda _: bank_of(tests["slow"], 4000), {}, Targets(0, 10.0, None), "", ()
        )

    replaced = state()
    for name, factor in (("quick", FACTOR), ("slow", 0.7)):
        problem = tests[name].problem
        answer = replaced.answer(problem)
        key = answer.keys[KEY]
        unknowns = np.log(TRUE_K * factor) + np.linspace(-0.006, 0.006, 141)
        exact = np.log(exact_quantiles(laboratory, problem, unknowns))
        sd = (exact[2] - exact[0]) / 3.92
        assert answer.redraws > 0
        assert np.log([key["interval"][0], key["estimate"], key["interval"][1]]) == pytest.approx(
            exact, abs=0.15 * sd
        )
        assert not answer.warnings
    fresh = state().answer(problem).keys[KEY]
    assert (key["estimate"], *key["interval"]) == pytest.approx(
        (fresh["estimate"], *fresh["interval"]), rel=1e-9
    )


def test_readings_after_an_alarm_do_not_change_the_time_to_a_depth(laboratory):
    """Where wear is random and goes on from the readings before."""
    followed = followed_test(
        RunningTest.of(laboratory / "running.toml", None), laboratory / "out", MPI.COMM_SELF
    )
    values, problem = followed.known.values, followed.problem
    settings = replace(problem.settings, process={"wear.lower": ProcessNoise(size=1.0)})
    sizes = np.tile([2e-5, 0.0], (len(values.weights), 1))
    known = replace(followed.known, values=replace(values, sizes=sizes))
    followed = replace(followed, known=known, problem=replace(problem, settings=settings))
    (test,) = followed.problem.experiments
    record = test.series[0]
    later = record.x > 60.0
    other = replace(record, value=record.value + 1e-2 * later)
    changed = replace(followed.problem, experiments=(replace(test, series=(other,)),))
    depths = []
    for problem in (followed.problem, changed):
        histories = bank_of(followed)
        weights = histories.update(problem, ~later)
        depths.append(time_to(histories, problem, weights, 8e-3, ~later))
    low, high = np.quantile(depths[0], (0.1, 0.5))
    assert 60.0 < low < high - 1.0 < END
    assert depths[1] == pytest.approx(depths[0], rel=1e-9)


def test_a_robust_loss_is_not_misled_by_outliers(laboratory, stored, tmp_path):
    clean = stored[0]["keys"][KEY]
    head, *rows = (laboratory / "z5.csv").read_text().splitlines()
    table = np.array([row.split(",") for row in rows], dtype=float)
    table[[7, 19, 33, 48], 1] += (3.0, -2.0, 4.0, 3.0)
    lines = [head, *(f"{t:g},{z:.6g}" for t, z in table)]
    (laboratory / "spoilt.csv").write_text("\n".join(lines) + "\n")
    text = (laboratory / "running.toml").read_text().replace("z5.csv", "spoilt.csv")
    for name in ("gaussian", "student"):
        changed = text.replace("fit = { ", f'fit = {{ "loss" = "{name}", ')
        assert changed != text
        (laboratory / f"{name}.toml").write_text(changed)
    assert followed(laboratory, tmp_path / "gaussian", "gaussian")["alarm"] is not None
    robust = followed(laboratory, tmp_path / "student", "student")
    assert robust["alarm"] is None
    # sums of weighed squares do not tell of how laws differ
    assert not robust["laws"]
    sd = (clean["interval"][1] - clean["interval"][0]) / 3.92
    ends = [*clean["interval"], clean["estimate"]]
    key = robust["keys"][KEY]
    assert [*key["interval"], key["estimate"]] == pytest.approx(ends, abs=0.6 * sd)


@pytest.mark.parametrize(
    ("word", "edit", "options"),
    [
        ("test 9", (), {"test": "test 9"}),
        ("twice", ('"test 5"', '"test 1"'), {}),
        ("--after", (), {"after": None}),
        ("15%", (), {"to": "0.15"}),
        ("compare.other", ("archard", "other"), {}),
        ("sd", ('"sd" = 0.2', '"sd" = "fit"'), {}),
        ("none.csv", ("z5.csv", "none.csv"), {}),
        ("--draws = 10(.|\n)*percentage(.|\n)*length", (),
         {"draws": 10, "to": "a bit", "depth": "3 s"}),
    ],
)  # fmt: skip
def test_what_is_refused(word, edit, options, laboratory, tmp_path):
    text = (laboratory / "running.toml").read_text()
    path = laboratory / "refused.toml"
    path.write_text(text.replace(*edit) if edit else text)
    options = {"after": laboratory / "out", "once": True, **options}
    with pytest.raises(rw.InputError, match=word):
        run_follow(path, tmp_path / "out", MPI.COMM_SELF, **options)
    assert not (tmp_path / "out").exists()
