"""``rw.measure``: a laboratory whose rates are known, its numbers in closed form, its files."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from figure_texts import check_texts
from paths import ROOT
from rig_records import (
    AREA,
    DENSITY,
    FORCE,
    FRICTION,
    OMEGA,
    RADIUS,
    RIG,
    RUNNING_IN,
    START,
    depth,
    specific,
    write_rig,
)
from rig_records import record as readings

import ringwear_par as rw
from ringwear_par.measuring.analysis.repeats import repeats_of
from ringwear_par.reports.spreadsheets import export

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
    tables = {
        "case": RIG, "measure": {"uncertainty": {
            "load.force": "6 N", "load.omega": "0.1 rpm", "lower.density": {"relative": 0.004},
            "torque": {"relative": 0.01}, "displacement": {"relative": 0.005},
            "time": {"relative": 0.001}}},
        "test": [{"name": "W1", "file": str(EXAMPLE / "W1.csv")}],
    }  # fmt: skip
    tables["measure"]["masses"] = {"file": str(EXAMPLE / "masses.csv"), "sd": "0.1 mg"}
    tables["case"] = str(EXAMPLE / "rig.toml")

    def numbers(**changes):
        tables["test"][0]["set"] = {key.replace("__", "."): v for key, v in changes.items()}
        entry = rw.measure(tables).to_dict()["tests"]["W1"]
        return [
            entry["specific_wear_rate"],
            entry["friction"],
            entry["whole"]["specific_wear_rate"],
        ]

    usual = numbers()
    sources = [{row["source"]: row for row in entry["budget"]} for entry in usual]
    assert sources[0].keys() == {"readings", "steadiness", "displacement", "time", "load.force",
                                 "load.omega"}  # fmt: skip
    assert sources[1].keys() == {"readings", "steadiness", "torque", "load.force"}
    assert sources[2].keys() == {"mass", "lower.density", "load.force", "load.omega", "time"}
    steps = (("load.force", FORCE, 1.0), ("load.omega", OMEGA, 1e-3),
             ("lower.density", DENSITY, 1e-6))  # fmt: skip
    for key, value, step in steps:
        changed = {key.replace(".", "__"): value + step}
        for before, after, budget in zip(usual, numbers(**changed), sources, strict=True):
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


def test_the_page_shows_what_the_example_prints():
    """Each line of its block, up to where it says that more follows."""
    summary = rw.measure(EXAMPLE / "measure.toml").summary().splitlines()
    page = (ROOT / "docs/howto/measure.md").read_text()
    block = page.partition("```text\n")[2].partition("```")[0].splitlines()
    shown = [line.removesuffix("...").rstrip() for line in block if line != "..."]
    assert len(shown) == 5
    for line in shown:
        assert any(printed.startswith(line) for printed in summary), line


def test_a_clock_without_seconds_is_in_hours_where_its_column_says_so(tmp_path):
    """20 h at 1.8 um/h, over midnight; no advice of a message leads to another rate."""
    path = tmp_path / "W1.csv"
    rows = [f"{(7 + i // 60) % 24:02d}:{i % 60:02d};{i * 0.03:.4f}" for i in range(1200)]

    def written(name):
        path.write_text("\n".join([f"{name};Weg_um", *rows]))
        return path

    for name in ("Uhrzeit", "Uhrzeit / s"):
        with pytest.raises(rw.InputError, match=r"07:00.* may be h:min or min:s; .*h"):
            measured(written(name))
    for test in (
        *measured(written("Uhrzeit / h")).tests,
        *measured(written("Uhrzeit"), units={"time": "h"}).tests,
    ):
        assert test.wear_rate.value * 3.6e6 == pytest.approx(1.8, rel=1e-6)


def test_a_copy_of_a_record_adds_nothing(laboratory, tmp_path):
    folder, _, _ = laboratory
    copy = tmp_path / "copy.csv"
    copy.write_bytes((folder / "W1.csv").read_bytes())
    result = rw.measure([folder / "W1.csv", copy], case=folder / "rig.toml")
    first, second = result.tests
    assert result.repeats == ()
    assert not [d for d in first.doubts if d.code == "same-file"]
    assert ["W1.csv and " in d.text for d in second.doubts if d.code == "same-file"] == [True]


def test_only_equal_conditions_are_repeats(laboratory):
    folder, _, _ = laboratory
    tables = {"case": str(folder / "rig.toml"), "test": [
        {"name": name, "file": str(folder / f"{name}.csv"), "set": {"load.force": force}}
        for name, force in (("W1", 1130.0), ("W2", 1150.0), ("W3", 1200.0))]}  # fmt: skip
    assert [one.tests for one in rw.measure(tables).repeats] == [("W1", "W2")]
    assert repeats_of([]) == ()


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
    assert test.part.of == "given part"


def test_records_are_told_how_they_were_read(laboratory):
    tests = laboratory[2].to_dict()["tests"]
    assert tests["W1"]["skipped"] == {"empty": 10, "repeated": 0, "excluded": 0}
    assert tests["W2"]["skipped"]["repeated"] == 4
    assert "falls in total: taken as a position" in tests["W3"]["notes"][0]
    assert tests["W1"]["temperature"]["max"] == pytest.approx(55.0, abs=0.1)


def test_weighings_without_an_sd_tell_it_by_their_scatter(laboratory):
    folder, _, _ = laboratory
    result = rw.measure([folder / "W1.csv"], case=folder / "rig.toml", masses=folder / "masses.csv")
    (source,) = result.tests[0].whole.specific_wear_rate.sources
    assert (source.name, source.type) == ("mass", "A")
    assert 0.4e-4 < source.u < 1.6e-4
    assert "weighed specimens without a test: W2, W3, W4" in result.problem.notes[0]


def test_without_uncertainties_nothing_is_drawn(laboratory, tmp_path):
    folder, _, _ = laboratory
    (tmp_path / "masses.csv").write_text("specimen;before_g;after_g\nW1;41.2004;41.1565\n")
    result = rw.measure(folder / "W1.csv", case=folder / "rig.toml", masses=tmp_path / "masses.csv")
    (test,) = result.tests
    assert test.whole.specific_wear_rate.shortest is None
    assert "monte_carlo" not in result.to_dict()["tests"]["W1"]["whole"]["specific_wear_rate"]
    assert not any("Monte Carlo" in note for note in test.notes)
    assert "by weighing: 1.505e-06 mm3/(N m); 43.9 mg" in result.summary()


def test_equal_weighings_are_not_certain(laboratory, tmp_path):
    folder, _, _ = laboratory
    text = "specimen;before_g;before_g;after_g;after_g\nW1;41.2004;41.2004;41.1565;41.1565\n"
    (tmp_path / "masses.csv").write_text(text)
    result = rw.measure(folder / "W1.csv", case=folder / "rig.toml", masses=tmp_path / "masses.csv")
    (source,) = result.tests[0].whole.mass_loss.sources
    assert (source.type, source.u) == ("B", pytest.approx(1e-4 / np.sqrt(12.0)))
    assert "0.029 mg" in result.summary()


@pytest.mark.parametrize("hours", [20.0, 21.9, 30.0])
def test_a_test_that_lasts_longer_than_its_record_is_told(hours, laboratory):
    folder, _, _ = laboratory
    summary = measured(folder / "W1.csv", set={"time.end": f"{hours} h"}).summary()
    assert ("time.end is 30 h" in summary) == (hours == 30.0)


def test_a_folder_holds_numbers_a_table_and_a_picture(laboratory, tmp_path):
    laboratory[2].save(tmp_path / "out")
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        "measure.json", "measure.csv", "measure.png",
    }  # fmt: skip
    stored = json.loads((tmp_path / "out/measure.json").read_text())
    assert stored == json.loads(json.dumps(rw.to_dict(laboratory[2])))
    assert stored["tests"].keys() == {"W1", "W2", "W3", "W4"}
    assert len(stored["data"]) == 5
    rows = list(csv.DictReader((tmp_path / "out/measure.csv").read_text().splitlines()))
    assert [row["test"] for row in rows] == ["W1", "W2", "W3", "W4"]
    value = float(rows[0]["specific wear rate / mm3/(N m)"])
    assert value == pytest.approx(stored["tests"]["W1"]["specific_wear_rate"]["value"], rel=1e-5)
    assert rows[0]["temperature, mean / degC"]
    assert not rows[1]["temperature, mean / degC"]
    export(tmp_path / "out", tmp_path / "out.csv", "comma")
    header, first, second, *_ = csv.reader(
        (tmp_path / "out.csv").read_text().splitlines(), delimiter=";"
    )
    assert header == list(rows[0])
    assert float(first[header.index("friction / 1")].replace(",", ".")) == pytest.approx(
        float(rows[0]["friction / 1"]), rel=1e-5
    )
    assert second[header.index("temperature, mean / degC")] == ""


def test_a_test_with_one_channel(laboratory, tmp_path):
    folder, _, _ = laboratory
    rows = (folder / "W4.csv").read_text().splitlines()
    (tmp_path / "torque.csv").write_text(
        "\n".join(f"{row.split(';')[0]};{row.split(';')[2]}" for row in rows)
    )
    result = rw.measure(tmp_path / "torque.csv", case=folder / "rig.toml")
    (test,) = result.tests
    assert test.wear_rate is None
    assert test.friction is not None
    assert "friction 0.2" in result.summary()
    assert result.to_dict()["tests"]["torque"]["specific_wear_rate"] is None
    figure = result.plot()
    check_texts(figure)
    assert len(figure.axes) == 1


def test_loads_in_steps_are_averaged_over_the_part(laboratory):
    folder, _, _ = laboratory
    half = [[0.0, 565.0], [36e3, 565.0], [36001.0, 1130.0], [72e3, 1130.0]]
    steady = {"steady": {"from": "12 h"}}
    (test,) = measured(folder / "W1.csv", steady, set={"load.force": half}).tests
    assert test.conditions.force == pytest.approx(1130.0)
    assert test.friction.value == pytest.approx(FRICTION, rel=0.02)


def test_readings_that_are_excluded_at_the_end_are_of_the_test(laboratory):
    folder, _, _ = laboratory
    masses, end = {"masses": {"file": str(folder / "masses.csv")}}, [[16 * 3600.0, 20 * 3600.0]]
    (usual,) = measured(folder / "W1.csv", masses).tests
    (test,) = measured(folder / "W1.csv", masses, exclude=end).tests
    assert test.test.duration == usual.test.duration == 72e3
    assert test.test.record.end < 57600.0
    assert test.whole.distance == usual.whole.distance
    assert test.whole.specific_wear_rate.value == usual.whole.specific_wear_rate.value


@pytest.mark.parametrize(("late", "said"), [(1130.0, False), (1000.0, True)])
def test_a_load_that_was_read_is_compared_at_its_times(late, said, tmp_path):
    """A load in steps, of which the steady part has the last."""
    rows = [f"{60 * i};{i / 30};{565 if i <= 600 else late}" for i in range(1201)]
    (tmp_path / "F.csv").write_text("\n".join(["t_s;z_um;F_N", *rows]))
    steps = [[0.0, 565.0], [36e3, 565.0], [36001.0, 1130.0], [72e3, 1130.0]]
    steady = {"steady": {"from": "12 h"}}
    (test,) = measured(tmp_path / "F.csv", steady, set={"load.force": steps}).tests
    assert any("N on average" in note for note in test.notes) == said


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


def with_exclude(path, *intervals):
    (test,) = measured(path, exclude=[*intervals]).tests
    return [doubt.text for doubt in test.doubts if doubt.code == "gap"]


def test_gaps_are_those_of_a_channel_that_nobody_excludes(tmp_path):
    def cells(i):
        return "" if 600 <= i < 840 else i / 30, "" if i < 180 else 9

    path = tmp_path / "gaps.csv"
    rows = [f"{60 * i};{z};{m}" for i in range(1201) for z, m in [cells(i)]]
    path.write_text("\n".join(["t_s;z_um;M_Nm", *rows]))
    first, second = with_exclude(path)
    assert "displacement for 4.02 h from 9.98 h" in first
    assert "torque for 3 h from 0 h" in second
    excluded = [["10 h", "12 h"], ["11.5 h", "14 h"], ["-1 h", "3 h"]]
    assert with_exclude(path, *excluded) == []
    (gap,) = with_exclude(path, excluded[0], excluded[2])
    assert "displacement for 2.02 h from 9.98 h" in gap
    rows = [row for i, row in enumerate(rows) if not 1000 <= i < 1150]
    path.write_text("\n".join(["t_s;z_um;M_Nm", *(f"{row.split(';')[0]};1;9" for row in rows)]))
    (gap,) = with_exclude(path)
    assert "displacement and torque for 2.52 h from 16.6 h" in gap


@pytest.mark.parametrize(("count", "said"), [(61, True), (66, False), (600, False)])
def test_a_straight_record_of_few_readings_is_not_called_unsteady(count, said, tmp_path):
    rows = [f"{60 * i};{i};9" for i in range(count)]
    (test,) = record(tmp_path, "line", rows).tests
    assert ["too few readings" in doubt.text for doubt in test.doubts] == [True] * said


def test_the_example_is_made_by_the_helper(tmp_path):
    write_rig(tmp_path)
    for path in Path(EXAMPLE).iterdir():
        assert (tmp_path / path.name).read_bytes() == path.read_bytes(), path.name


def record(folder, name, rows):
    (folder / f"{name}.csv").write_text("\n".join(["t_s;z_um;M_Nm", *rows]))
    return rw.measure(folder / f"{name}.csv", case=EXAMPLE / "rig.toml")


@pytest.mark.parametrize(
    ("name", "row"),
    [
        ("constant", lambda t: f"{t};5;9"), ("nothing", lambda t: f"{t};0;0"),
        ("line", lambda t: f"{t};{1e-3 * t};9"), ("steep", lambda t: f"{t};{t}e25;9e25"),
        ("flat", lambda t: f"{t};{t}e-30;9e-30"), ("negative", lambda t: f"{t};{t};-9"),
    ],
)  # fmt: skip
@pytest.mark.filterwarnings("error")
def test_records_without_noise_have_finite_numbers(name, row, tmp_path):
    result = record(tmp_path, name, [row(120 * i) for i in range(600)])
    json.dumps(result.to_dict(), allow_nan=False)
    result.plot()
    assert len(result.summary()) < 1000
    assert ("is negative" in result.summary()) == (name == "negative")


def test_readings_that_are_all_at_one_end_are_refused(tmp_path):
    rows = [*(f"{0.1 * i};{i};9" for i in range(100)), "72000;500;9"]
    with pytest.raises(rw.InputError, match="unevenly"):
        record(tmp_path, "gap", rows)


def test_the_volume_of_a_straight_record_is_that_of_its_ends(tmp_path):
    """61 readings on a line in 20 blocks, whose first and last means are not its ends."""
    rows = [f"{1200 * i};{40.0 * i / 60.0};9" for i in range(61)]
    (test,) = record(tmp_path, "line", rows).tests
    assert test.whole.volume_by_displacement.value == pytest.approx(AREA * 0.04, rel=1e-9)
    mass = f"specimen;loss_mg\nline;{1e3 * AREA * 0.04 * DENSITY}\n"
    (tmp_path / "masses.csv").write_text(mass)
    result = rw.measure(tmp_path / "line.csv", case=EXAMPLE / "rig.toml",
                        masses=tmp_path / "masses.csv")  # fmt: skip
    assert [doubt.code for doubt in result.tests[0].doubts] == ["not-steady"]


def test_readings_a_thousand_times_too_large_or_small_are_asked_about(tmp_path):
    rows = [f"{60 * i};{40e3 * i / 1200.0};0.009" for i in range(1201)]
    record(tmp_path, "units", rows)
    (tmp_path / "masses.csv").write_text("specimen;loss_mg\nunits;50\n")
    result = rw.measure(tmp_path / "units.csv", case=EXAMPLE / "rig.toml",
                        masses=tmp_path / "masses.csv")  # fmt: skip
    told = {doubt.code: doubt.text for doubt in result.tests[0].doubts}
    assert "the unit of the torque" in told["implausible-friction"]
    assert told["displacement-against-weighing"].endswith("look at their units")


@pytest.mark.parametrize(
    ("exclude", "known"), [([0, 0.2], True), ([19.8, 20], True), ([0, 4], False), ([16, 20], False)]
)
def test_volumes_are_not_compared_where_an_end_is_excluded(exclude, known, tmp_path):
    rows = [f"{60 * i};{40.0 * i / 1200.0};9" for i in range(1201)]
    record(tmp_path, "line", rows)
    (tmp_path / "masses.csv").write_text("specimen;loss_mg\nline;50\n")
    masses = {"masses": {"file": str(tmp_path / "masses.csv")}}
    (test,) = measured(tmp_path / "line.csv", masses).tests
    assert [doubt.code for doubt in test.doubts] == ["displacement-against-weighing"]
    left_out = [[3600.0 * hours for hours in exclude]]
    (test,) = measured(tmp_path / "line.csv", masses, exclude=left_out).tests
    assert test.doubts == ()
    assert (test.whole.volume_by_displacement is not None) == known
    if known:
        assert test.whole.volume_by_displacement.value == pytest.approx(AREA * 0.04, rel=1e-6)


def test_the_volume_by_displacement_is_within_its_interval(tmp_path):
    """Forty records whose noise remembers, of rings that do not grow."""
    inside, ratios = 0, []
    for seed in range(40):
        hours, read, torque = readings(20.0, seed, growth=0.0)
        rows = [f"{3600 * h};{z};{m}" for h, z, m in zip(hours, read, torque, strict=True)]
        (test,) = record(tmp_path, f"r{seed}", rows).tests
        estimate, true = test.whole.volume_by_displacement, AREA * depth(20.0) * 1e-3
        inside += estimate.interval[0] <= true <= estimate.interval[1]
        ratios.append((estimate.value - true) / estimate.u)
    assert inside >= 36
    assert abs(np.mean(ratios)) < 0.5
