"""Records and weighings: which columns they are, in which unit, and what is refused."""

from datetime import datetime, timedelta

import numpy as np
import pytest
from parts import read_measurements, read_weighings

import ringwear_par as rw
from ringwear_par.measuring.definition.records import read_record


@pytest.fixture
def read(tmp_path):
    """Function that reads a record of a line of names and rows that a function makes."""

    def read(names, row=None, count=60, **options):
        row = row or (lambda i: ";".join(str(i + j) for j in range(names.count(";") + 1)))
        path = tmp_path / "w.csv"
        path.write_text("\n".join([names, *(row(i) for i in range(count))]))
        usual = {"columns": {}, "units": {}, "exclude": [], "sense": None}
        return read_record(read_measurements(path), **{**usual, **options})

    return read


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        ("t / min;Verschleiß / µm;M / N m;T / °C",
         {"time": 60.0, "wear": 1e-3, "torque": 1e3, "temperature": 1.0}),
        ("time_h;depth (mm);torque [N mm]", {"time": 3600.0, "wear": 1.0, "torque": 1.0}),
        ("Zeit [s];Weg / mm;Reibmoment / Ncm;Last / kN",
         {"time": 1.0, "wear": 1.0, "torque": 10.0, "load": 1e3}),
        ("t_s;position_nm;wear_um", {"time": 1.0, "wear": 1e-3}),
        ("Time (min);Friction torque (Nm);Friction force (N)", {"time": 60.0, "torque": 1e3}),
    ],
)  # fmt: skip
def test_known_names_of_columns(names, expected, read):
    record = read(names)
    assert expected.keys() <= record.columns.keys()
    assert record.time[1] - record.time[0] == pytest.approx(expected["time"])
    for channel, factor in expected.items():
        if channel not in ("time", "temperature"):
            assert np.diff(getattr(record, channel)) == pytest.approx(factor)


def test_what_falls_in_total_is_a_position(read):
    def row(i):
        return f"{i};{12.5 - 0.001 * i}"

    record = read("t_s;Weg / mm", row)
    assert record.falling
    assert np.diff(record.wear) == pytest.approx(0.001)
    assert not read("t_s;Weg / mm", row, sense="rising").falling
    assert np.diff(read("t_s;z_mm", sense="falling").wear) == pytest.approx(-1.0)


def test_columns_and_units_that_are_named(read):
    record = read("A;B;C", columns={"time": "A", "wear": "C"}, units={"time": "h", "wear": "nm"})
    assert record.end == 59 * 3600.0
    assert np.diff(record.wear) == pytest.approx(1e-6)


@pytest.mark.parametrize(
    ("unit", "celsius"), [("K", 2.0 - 273.15), ("°F", -30.0 / 1.8), ("degC", 2.0)]
)
def test_temperatures(unit, celsius, read):
    assert read(f"t_s;z_um;T / {unit}").temperature[0] == pytest.approx(celsius)


@pytest.mark.parametrize(
    ("names", "first"), [("Datum;Uhrzeit;Weg / um", "{0:%d.%m.%Y};{0:%H:%M:%S}"),
                         ("Uhrzeit;Datum;Weg / um", "{0:%H:%M};{0:%Y-%m-%d}")],
)  # fmt: skip
def test_a_pause_of_days_between_dates_and_times_of_day(names, first, read):
    def row(i):
        pause = timedelta(hours=48 if i >= 30 else 0)
        return f"{first.format(datetime(2026, 3, 14, 23, 45) + timedelta(minutes=i) + pause)};{i}"

    record = read(names, row)
    assert record.time[30] - record.time[29] == 60.0 + 48 * 3600.0
    assert record.end == 59 * 60.0 + 48 * 3600.0


def weighings(tmp_path, text):
    path = tmp_path / "m.csv"
    path.write_text(text)
    return read_weighings(path)


def test_weighings_are_averaged(tmp_path):
    """And a loss is of two weighings: it scatters by the root of two more than masses."""
    text = "rig 7\nProbe;m vor / g;m vor / g;m nach / mg\nA;1,0002;1,0004;998,3\nB;2;2,0002;1999\n"
    read = weighings(tmp_path, text)
    assert read.specimens["A"].loss == 0.002  # its digits, and no more
    assert read.specimens["A"].u(1e-4) == pytest.approx(1e-4 * np.sqrt(1.5))
    assert read.scatter == pytest.approx(1e-4 * np.sqrt(2.0))
    read = weighings(tmp_path, "specimen;loss_mg;loss_mg\nA;1.4;1.6\nB;2.0;-\n")
    assert read.specimens["A"].loss == pytest.approx(1.5e-3)
    assert read.specimens["A"].u(1e-4) == pytest.approx(1e-4)
    assert read.specimens["B"].u(1e-4) == pytest.approx(1e-4 * np.sqrt(2.0))
    assert read.scatter == pytest.approx(1e-4)


@pytest.mark.parametrize(
    ("text", "resolution", "scatter"),
    [
        ("m;before_g;before_g;after_g\nA;2;2;1,9998\nB;2,001;2,001;2\n", 1e-4, 0.0),
        ("m;before_mg;before_mg;after_mg\nA;2000.00;2000.00;1e3\n", 1e-5, 0.0),
        ("m;before_g;before_g;after_g\nA;2.000;2.010;1.000\n", 1e-3, 1e-2 / np.sqrt(2.0)),
    ],
)
def test_weighings_are_known_to_their_last_digit_at_best(text, resolution, scatter, tmp_path):
    read = weighings(tmp_path, text)
    assert read.resolution == pytest.approx(resolution)
    assert read.scatter == pytest.approx(scatter)
    assert read.sd == pytest.approx(max(scatter, resolution / np.sqrt(12.0)))
    assert read.coarse == (scatter == 0.0)


def test_half_days_have_twelve_hours(read):
    rows = [f"2026-03-14 {1 + i // 60}:{i % 60:02d} PM;{i}" for i in range(80)]
    assert read("time;z_um", rows.__getitem__, 80).duration == 79 * 60.0
    rows[70] = rows[70].replace("2:10", "14:10")
    with pytest.raises(rw.InputError, match=r"line 72.*14:10 PM"):
        read("time;z_um", rows.__getitem__, 80)
