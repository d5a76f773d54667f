"""``rw.measure``: a laboratory whose rates are known, its numbers in closed form, its files."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from figure_texts import check_texts
from parts import export
from paths import ROOT
from rig_records import (
    AREA,
    DENSITY,
    FORCE,
    FRICTION,
    OMEGA,
    RADIUS,
    RUNNING_IN,
    START,
    depth,
    record,
    specific,
    write_rig,
)

import ringwear_par as rw

EXAMPLE = ROOT / "scripts/measure"


@pytest.fixture(scope="module")
def laboratory(tmp_path_factory):
    """The folder of a laboratory, the rates (um/h) of its tests, and what is measured of it."""
    folder = tmp_path_factory.mktemp("laboratory")
    rates = write_rig(folder, seed=11, minutes=1.0)
    return folder, rates, rw.measure(folder / "measure.toml")


def measured(path, measure=(), **test):
    """Return what is measured of one record on the example's rig."""
    tables = {
        "case": str(EXAMPLE / "rig.toml"), "measure": dict(measure),
        "test": [{"name": path.stem, "file": str(path), **test}],
    }  # fmt: skip
    return rw.measure(tables)


def measured_rows(folder, rows, masses="", **test):
    """Return the test of a record of times (s), depths (um) and torques (N m), and its result."""
    (folder / "line.csv").write_text("\n".join(["t_s;z_um;M_Nm", *rows]))
    (folder / "masses.csv").write_text(masses)
    weighed = {"masses": {"file": str(folder / "masses.csv")}} if masses else {}
    result = measured(folder / "line.csv", weighed, **test)
    return result.tests[0], result


def at_end(rate, hours):
    return rate * (1.0 + (START - 1.0) * np.exp(-hours / RUNNING_IN))


def test_the_truth_is_within_the_intervals(laboratory):
    _, rates, result = laboratory
    tests = result.to_dict()["tests"]
    assert [tests[name]["steady"] for name in rates] == [True, True, True, False]
    for name, rate in rates.items():
        entry, hours = tests[name], 2.5 if name == "W4" else 20.0
        low, high = entry["wear_rate"]["interval"]
        assert low <= at_end(rate, hours) / 3.6e6 <= high, name
        low, high = entry["specific_wear_rate"]["interval"]
        assert low <= specific(at_end(rate, hours)) <= high, name
        low, high = entry["friction"]["interval"]
        assert low <= FRICTION + 0.05 * np.exp(-hours) <= high, name
        volume = AREA * depth(hours, rate) * 1e-3
        whole = entry["whole"]
        assert whole["volume"]["interval"][0] <= volume <= whole["volume"]["interval"][1]
        true = volume / (FORCE * OMEGA * RADIUS * hours * 3.6)
        for interval in ("interval", "monte_carlo"):
            low, high = whole["specific_wear_rate"][interval]
            assert low <= true <= high, (name, interval)


def test_numbers_in_closed_form(laboratory):
    _, _, result = laboratory
    entry = result.to_dict()["tests"]["W1"]
    pressure, speed = FORCE / AREA, OMEGA * RADIUS
    assert entry["pv"]["MPa m/s"] == pytest.approx(pressure * speed * 1e-3)
    assert entry["pv"]["psi ft/min"] == pytest.approx(28550.7 * entry["pv"]["MPa m/s"], rel=1e-5)
    assert entry["whole"]["distance"]["value"] == pytest.approx(speed * 72e3 * 1e-3)
    rate, k = entry["wear_rate"], entry["specific_wear_rate"]
    assert k["value"] == pytest.approx(1e3 * rate["value"] / (pressure * speed))
    assert k["in3 min/(ft lbf h)"] == pytest.approx(k["value"] / 201.44, rel=1e-4)
    assert k["us"]["u"] / k["us"]["value"] == pytest.approx(k["u"] / k["value"])
    assert rate["um/h"] == pytest.approx(3.6e6 * rate["value"])
    assert rate["in/h"] == pytest.approx(3600.0 * rate["value"] / 25.4)
    whole = entry["whole"]
    assert whole["volume"]["value"] == pytest.approx(whole["mass_loss"]["value"] / 1e3 / DENSITY)
    u = {row["source"]: row["u"] for row in whole["specific_wear_rate"]["budget"]}
    assert u["mass"] == pytest.approx(1e-4 * np.sqrt(2.0 / 3.0))
    relative = np.sqrt((u["mass"] * 1e3 / whole["mass_loss"]["value"]) ** 2 + 0.004**2
                       + (6.0 / FORCE) ** 2)  # fmt: skip
    value = whole["specific_wear_rate"]
    assert value["u"] / value["value"] == pytest.approx(relative)
    half = 0.5 * np.diff(value["monte_carlo"])[0]
    assert half == pytest.approx(1.96 * value["u"], rel=0.02)


def test_sensitivities_are_derivatives():
    """Each budget's sensitivity to load and speed against a case that is changed by a little."""
    uncertainty = {
        "load.force": "6 N", "load.omega": "0.1 rpm", "lower.density": {"relative": 0.004},
        "torque": {"relative": 0.01}, "displacement": {"relative": 0.005},
        "time": {"relative": 0.001},
    }  # fmt: skip
    masses = {"file": str(EXAMPLE / "masses.csv"), "sd": "0.1 mg"}
    measure = {"uncertainty": uncertainty, "masses": masses}

    def numbers(changes=()):
        result = measured(EXAMPLE / "W1.csv", measure, set=dict(changes))
        entry = result.to_dict()["tests"]["W1"]
        whole = entry["whole"]["specific_wear_rate"]
        return [entry["specific_wear_rate"], entry["friction"], whole]

    usual = numbers()
    sources = [{row["source"]: row for row in entry["budget"]} for entry in usual]
    assert sources[0].keys() == {"readings", "steadiness", "displacement", "time", "load.force",
                                 "load.omega"}  # fmt: skip
    assert sources[1].keys() == {"readings", "steadiness", "torque", "load.force"}
    assert sources[2].keys() == {"mass", "lower.density", "load.force", "load.omega", "time"}
    steps = (("load.force", FORCE, 1.0), ("load.omega", OMEGA, 1e-3),
             ("lower.density", DENSITY, 1e-6))  # fmt: skip
    for key, value, step in steps:
        changed = numbers({key: value + step})
        for before, after, budget in zip(usual, changed, sources, strict=True):
            slope = (after["value"] - before["value"]) / step
            expected = budget[key]["sensitivity"] if key in budget else 0.0
            assert slope == pytest.approx(expected, rel=2e-3, abs=1e-15), key


def test_repeats(laboratory):
    _, _, result = laboratory
    (repeats,) = result.repeats
    rates = [t.specific_wear_rate.value for t in result.tests if t.part.steady]
    assert repeats.tests == ("W1", "W2", "W3")
    assert repeats.mean == pytest.approx(np.prod(rates) ** (1 / 3))
    assert repeats.s_r == pytest.approx(np.log(rates).std(ddof=1))
    assert repeats.r == pytest.approx(2.8 * repeats.s_r)
    half = np.log(repeats.interval[1] / repeats.mean)
    scatter = 4.30265 * repeats.s_r / np.sqrt(3.0)
    budgets = [t.specific_wear_rate for t in result.tests if t.part.steady]
    own = {"readings", "steadiness"}
    shared = np.mean([np.sqrt(sum(s.contribution**2 for s in one.sources if s.name not in own))
                      / one.value for one in budgets])  # fmt: skip
    assert half == pytest.approx(np.hypot(scatter, 2.0 * shared), rel=1e-4)


def test_a_load_and_a_speed_that_change_together(laboratory):
    """Load 500 to 1500 N, speed 3 to 9 rad/s: the mean of the product is a twelfth larger."""
    folder, _, _ = laboratory
    slopes = {"load.force": [[0.0, 500.0], [72e3, 1500.0]],
              "load.omega": [[0.0, 3.0], [72e3, 9.0]]}  # fmt: skip
    uncertain = {"load.force": {"relative": 0.01}, "load.omega": {"relative": 0.02}}
    masses = {"file": str(folder / "masses.csv"), "sd": "1e-3 mg"}
    measure = {"masses": masses, "uncertainty": uncertain, "steady": {"from": "10 h"}}
    (test,) = measured(folder / "W1.csv", measure, set=slopes).tests
    whole = test.whole
    product = 1000.0 * 6.0 * (1.0 + 1.0 / 12.0)
    assert whole.distance == pytest.approx(6.0 * RADIUS * 72.0)
    work = product * RADIUS * 72.0
    k = whole.volume.value / work
    assert whole.specific_wear_rate.value == pytest.approx(k)
    assert np.mean(whole.specific_wear_rate.shortest) == pytest.approx(k, rel=2e-3)
    half = 0.5 * np.diff(whole.specific_wear_rate.shortest)[0]
    assert half == pytest.approx(1.96 * np.hypot(0.01, 0.02) * k, rel=0.02)
    # the later half: 1000 to 1500 N, 6 to 9 rad/s
    pv = (1250.0 * 7.5 + 500.0 * 3.0 / 12.0) / AREA * RADIUS * 1e-3
    end = test.test.record.end
    assert end == 72e3
    assert test.conditions.pv == pytest.approx(pv)
    assert test.specific_wear_rate.value == pytest.approx(test.wear_rate.value / pv)


def test_the_example_is_made_by_the_helper(tmp_path):
    write_rig(tmp_path)
    for path in Path(EXAMPLE).iterdir():
        assert (tmp_path / path.name).read_bytes() == path.read_bytes(), path.name


def test_a_clock_without_seconds_is_in_hours_where_its_column_says_so(tmp_path):
    """20 h at 1.8 um/h, over midnight; where nothing says so, it is asked for."""
    path = tmp_path / "W1.csv"
    rows = [f"{(7 + i // 60) % 24:02d}:{i % 60:02d};{i * 0.03:.4f}" for i in range(1200)]
    path.write_text("\n".join(["Uhrzeit;Weg_um", *rows]))
    with pytest.raises(rw.InputError, match=r"07:00.*h:min"):
        measured(path)
    (test,) = measured(path, units={"time": "h"}).tests
    assert test.wear_rate.value * 3.6e6 == pytest.approx(1.8, rel=1e-6)


def test_repeats_are_other_records_under_equal_conditions(laboratory, tmp_path):
    folder, _, _ = laboratory
    tables = {"case": str(folder / "rig.toml"), "test": [
        {"name": name, "file": str(folder / f"{name}.csv"), "set": {"load.force": force}}
        for name, force in (("W1", 1130.0), ("W2", 1150.0), ("W3", 1200.0))]}  # fmt: skip
    assert [one.tests for one in rw.measure(tables).repeats] == [("W1", "W2")]
    copy = tmp_path / "copy.csv"
    copy.write_bytes((folder / "W1.csv").read_bytes())
    result = rw.measure([folder / "W1.csv", copy], case=folder / "rig.toml")
    assert result.repeats == ()
    assert [d.code for test in result.tests for d in test.doubts].count("same-file") == 1


def test_doubts(laboratory, tmp_path):
    folder, _, result = laboratory
    codes = {t.name: [doubt.code for doubt in t.doubts] for t in result.tests}
    assert codes["W1"] == ["displacement-against-weighing"]  # of rings that grow
    assert "gap" in codes["W2"]
    assert "not-steady" in codes["W4"]
    rows = [row.split(";") for row in (folder / "W4.csv").read_text().splitlines()]
    half = len(rows) // 2
    stuck = rows[:half] + [[time, "999.9", *others] for time, _, *others in rows[half:]]
    (tmp_path / "stuck.csv").write_text("\n".join(map(";".join, stuck)))
    (test,) = measured(tmp_path / "stuck.csv").tests
    assert [doubt.code for doubt in test.doubts] == ["not-steady", "stands-still"]
    (test,) = measured(folder / "W1.csv", {"steady": {"from": "16 h"}}).tests
    assert [doubt.code for doubt in test.doubts] == ["steady-part-short"]
    # readings a thousand times too large and too small
    rows = [f"{60 * i};{40e3 * i / 1200.0};0.009" for i in range(1201)]
    test, _ = measured_rows(tmp_path, rows, "specimen;loss_mg\nline;50\n")
    assert {doubt.code for doubt in test.doubts} >= {"implausible-friction",
                                                     "displacement-against-weighing"}  # fmt: skip


def test_what_is_skipped_is_counted(laboratory):
    tests = laboratory[2].to_dict()["tests"]
    assert tests["W1"]["skipped"] == {"empty": 10, "repeated": 0, "excluded": 0}
    assert tests["W2"]["skipped"]["repeated"] == 4
    assert tests["W1"]["temperature"]["max"] == pytest.approx(55.0, abs=0.1)


@pytest.mark.parametrize(
    ("cells", "kind", "u"),
    [
        ("before_g;before_g;after_g\nW1;41.2002;41.2004;41.1565", "A", 1e-4 * np.sqrt(3.0)),
        ("before_g;before_g;after_g\nW1;41.2004;41.2004;41.1565", "B", 1e-4 / np.sqrt(8.0)),
        ("before_g;after_g\nW1;41.2004;41.1565", None, None),
    ],
)
def test_weighings_without_an_sd_are_known_by_their_scatter(cells, kind, u, laboratory, tmp_path):
    """Equal ones to their last digit; of one alone nothing is known, and nothing drawn."""
    folder, _, _ = laboratory
    (tmp_path / "masses.csv").write_text(f"specimen;{cells}\n")
    result = rw.measure(folder / "W1.csv", case=folder / "rig.toml", masses=tmp_path / "masses.csv")
    whole = result.tests[0].whole
    sources = [(source.type, source.u) for source in whole.mass_loss.sources]
    assert sources == ([(kind, pytest.approx(u))] if kind else [])
    assert (whole.specific_wear_rate.shortest is None) == (kind is None)


def test_a_folder_holds_numbers_a_table_and_a_picture(laboratory, tmp_path):
    laboratory[2].save(tmp_path / "out")
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        "measure.json", "measure.csv", "measure.png",
    }  # fmt: skip
    stored = json.loads((tmp_path / "out/measure.json").read_text())
    assert stored == json.loads(json.dumps(laboratory[2].to_dict()))
    rows = list(csv.DictReader((tmp_path / "out/measure.csv").read_text().splitlines()))
    assert [row["test"] for row in rows] == ["W1", "W2", "W3", "W4"]
    value = float(rows[0]["specific wear rate / mm3/(N m)"])
    assert value == pytest.approx(stored["tests"]["W1"]["specific_wear_rate"]["value"], rel=1e-5)
    export(tmp_path / "out", tmp_path / "out.csv")
    header, first, *_ = csv.reader((tmp_path / "out.csv").read_text().splitlines())
    assert header == list(rows[0])
    friction = float(first[header.index("friction / 1")])
    assert friction == pytest.approx(float(rows[0]["friction / 1"]), rel=1e-5)


def test_a_test_with_one_channel(laboratory, tmp_path):
    cells = [row.split(";") for row in (laboratory[0] / "W4.csv").read_text().splitlines()]
    (tmp_path / "torque.csv").write_text("\n".join(f"{time};{m}" for time, _, m in cells))
    result = measured(tmp_path / "torque.csv")
    (test,) = result.tests
    assert test.wear_rate is None
    assert test.friction is not None
    figure = result.plot()
    check_texts(figure)
    assert len(figure.axes) == 1


def test_readings_that_are_excluded_at_the_end_are_of_the_test(laboratory):
    folder, _, _ = laboratory
    masses, end = {"masses": {"file": str(folder / "masses.csv")}}, [[16 * 3600.0, 20 * 3600.0]]
    (usual,) = measured(folder / "W1.csv", masses).tests
    (test,) = measured(folder / "W1.csv", masses, exclude=end).tests
    assert test.test.duration == usual.test.duration == 72e3
    assert test.test.record.end < 57600.0
    assert test.whole.distance == usual.whole.distance
    assert test.whole.specific_wear_rate.value == usual.whole.specific_wear_rate.value


@pytest.mark.parametrize(("late", "differs"), [(1130.0, False), (1000.0, True)])
def test_a_load_that_was_read_is_compared_at_its_times(late, differs, tmp_path):
    """A load in steps, of which the steady part has the last."""
    rows = [f"{60 * i};{i / 30};{565 if i <= 600 else late}" for i in range(1201)]
    (tmp_path / "F.csv").write_text("\n".join(["t_s;z_um;F_N", *rows]))
    steps = [[0.0, 565.0], [36e3, 565.0], [36001.0, 1130.0], [72e3, 1130.0]]
    steady = {"steady": {"from": "12 h"}}
    (test,) = measured(tmp_path / "F.csv", steady, set={"load.force": steps}).tests
    assert test.conditions.force == pytest.approx(1130.0)
    assert any("N on average" in note for note in test.notes) == differs


def test_gaps_are_those_of_a_channel_that_are_not_excluded(tmp_path):
    def gaps(*intervals):
        test, _ = measured_rows(tmp_path, rows, exclude=[*intervals])
        return [doubt.text for doubt in test.doubts if doubt.code == "gap"]

    cells = [("" if 600 <= i < 840 else i / 30, "" if i < 180 else 9) for i in range(1201)]
    rows = [f"{60 * i};{z};{m}" for i, (z, m) in enumerate(cells)]
    first, second = gaps()
    assert "displacement for 4.02 h from 9.98 h" in first
    assert "torque for 3 h from 0 h" in second
    assert gaps(["10 h", "12 h"], ["11.5 h", "14 h"], ["-1 h", "3 h"]) == []
    (gap,) = gaps(["10 h", "12 h"], ["-1 h", "3 h"])
    assert "displacement for 2.02 h from 9.98 h" in gap


@pytest.mark.parametrize(
    "row",
    [
        lambda t: f"{t};5;9", lambda t: f"{t};0;0", lambda t: f"{t};{1e-3 * t};9",
        lambda t: f"{t};{t}e25;9e25", lambda t: f"{t};{t}e-30;9e-30", lambda t: f"{t};{t};-9",
    ],
    ids=["constant", "nothing", "line", "steep", "flat", "negative"],
)  # fmt: skip
@pytest.mark.filterwarnings("error")
def test_records_without_noise_have_finite_numbers(row, tmp_path):
    _, result = measured_rows(tmp_path, [row(120 * i) for i in range(600)])
    json.dumps(result.to_dict(), allow_nan=False)
    result.plot()


def test_the_volume_of_a_straight_record_is_that_of_its_ends(tmp_path):
    """61 readings on a line in 20 blocks, whose first and last means are not its ends."""
    rows = [f"{1200 * i};{40.0 * i / 60.0};9" for i in range(61)]
    mass = f"specimen;loss_mg\nline;{1e3 * AREA * 0.04 * DENSITY}\n"
    test, _ = measured_rows(tmp_path, rows, mass)
    assert test.whole.volume_by_displacement.value == pytest.approx(AREA * 0.04, rel=1e-9)
    assert [doubt.code for doubt in test.doubts] == ["not-steady"]  # too few readings


@pytest.mark.parametrize(
    ("exclude", "known"), [([0, 0.2], True), ([19.8, 20], True), ([0, 4], False), ([16, 20], False)]
)
def test_volumes_are_not_compared_where_an_end_is_excluded(exclude, known, tmp_path):
    rows = [f"{60 * i};{40.0 * i / 1200.0};9" for i in range(1201)]
    left_out = [[3600.0 * hours for hours in exclude]]
    test, _ = measured_rows(tmp_path, rows, "specimen;loss_mg\nline;50\n", exclude=left_out)
    assert test.doubts == ()
    assert (test.whole.volume_by_displacement is not None) == known
    if known:
        assert test.whole.volume_by_displacement.value == pytest.approx(AREA * 0.04, rel=1e-6)


def test_the_volume_by_displacement_is_within_its_interval(tmp_path):
    """Forty records whose noise remembers, of rings that do not grow."""
    inside, ratios = 0, []
    for seed in range(40):
        hours, read, torque = record(20.0, seed, growth=0.0)
        rows = [f"{3600 * h};{z};{m}" for h, z, m in zip(hours, read, torque, strict=True)]
        test, _ = measured_rows(tmp_path, rows)
        estimate, true = test.whole.volume_by_displacement, AREA * depth(20.0) * 1e-3
        inside += estimate.interval[0] <= true <= estimate.interval[1]
        ratios.append((estimate.value - true) / estimate.u)
    assert inside >= 36
    assert abs(np.mean(ratios)) < 0.5
