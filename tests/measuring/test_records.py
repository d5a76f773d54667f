"""Records and weighings: which columns they are, in which unit, and what is refused."""

from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from ringwear_par.cases.files.weighings import read_weighings
from ringwear_par.errors import InputError
from ringwear_par.files.measurements import read_measurements
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
        ("t_s;z_um;position_mm;wear_um", None),
        ("t_s;displacement_um;wear_um;speed_rpm", {"time": 1.0, "wear": 1e-3}),
        ("t_s;penetration/um;F/N;temperature [K]", {"time": 1.0, "wear": 1e-3, "load": 1.0}),
        ("Time (min);Friction torque (Nm);Friction force (N)", {"time": 60.0, "torque": 1e3}),
        ("t / s;T / °C;M / N m", {"time": 1.0, "torque": 1e3, "temperature": 1.0}),
    ],
)  # fmt: skip
def test_known_names_of_columns(names, expected, read):
    record = read(names)
    if expected is None:
        assert record.columns["wear"] == "wear_um"
        return
    assert expected.keys() <= record.columns.keys()
    assert record.time[1] - record.time[0] == pytest.approx(expected["time"])
    for channel, factor in expected.items():
        if channel not in ("time", "temperature"):
            assert np.diff(getattr(record, channel)) == pytest.approx(factor)


def test_temperatures(read):
    assert read("t_s;z_um;T / K").temperature[0] == pytest.approx(2.0 - 273.15)
    assert read("t_s;z_um;T / °F").temperature[0] == pytest.approx(-30.0 / 1.8)
    assert read("t_s;z_um;T [degC]").temperature[0] == 2.0
    assert read("t_s;z_um;T").temperature is None  # nothing depends on it


def test_what_falls_in_total_is_a_position(read):
    def row(i):
        return f"{i};{12.5 - 0.001 * i}"

    record = read("t_s;Weg / mm", row)
    assert record.falling
    assert np.diff(record.wear) == pytest.approx(0.001)
    assert not read("t_s;Weg / mm", row, sense="rising").falling
    assert np.diff(read("t_s;z_mm", sense="falling").wear) == pytest.approx(-1.0)


def test_what_is_skipped_is_counted(read):
    def row(i):
        return f"{i if i != 7 else 6};{'n.a.' if i % 10 == 3 else i};{i}"

    record = read("t_s;z_um;M_Nm", row, count=100, exclude=[(50.0, 59.5)])
    assert (record.empty, record.repeated, record.excluded) == (10, 1, 10)
    assert len(record.time) == 89
    assert np.isnan(record.wear).sum() == 9


def test_a_date_beside_a_time_of_day(read):
    def row(i):
        minutes = 23 * 60 + 30 + i
        return f"14.03.2026;{minutes // 60 % 24}:{minutes % 60:02d}:00;{i}"

    record = read("Datum;Uhrzeit;Weg / um", row)
    assert record.columns["time"] == "Uhrzeit"
    assert record.end == 59 * 60.0


@pytest.mark.parametrize("columns", [{}, {"time": "Uhrzeit"}])
@pytest.mark.parametrize(
    ("names", "first"), [("Datum;Uhrzeit;Weg / um", "{0:%d.%m.%Y};{0:%H:%M:%S}"),
                         ("Uhrzeit;Datum;Weg / um", "{0:%H:%M};{0:%Y-%m-%d}")],
)  # fmt: skip
def test_a_pause_of_days_between_dates_and_times_of_day(names, first, columns, read):
    def row(i):
        pause = timedelta(hours=48 if i >= 30 else 0)
        return f"{first.format(datetime(2026, 3, 14, 23, 45) + timedelta(minutes=i) + pause)};{i}"

    record = read(names, row, columns=columns)
    assert record.columns["time"] == "Uhrzeit"
    assert record.end == 59 * 60.0 + 48 * 3600.0
    assert record.time[30] - record.time[29] == 60.0 + 48 * 3600.0


@pytest.mark.parametrize(
    ("day", "months", "told"), [(3, 4, True), (13, 4, False), (3, 13, False), (3, 3, False)]
)
def test_slashes_whose_order_no_date_tells_are_noted(day, months, told, read):
    def row(i):
        return f"{'3/3/2026' if i < 30 else f'{day}/{months}/2026'} 8:{i:02d};{i}"

    (*notes,) = read("timestamp;z_um", row).notes
    assert ["day first" in note for note in notes] == [True] * told


def test_columns_and_units_that_are_named(read):
    record = read("A;B;C", columns={"time": "A", "wear": "C"}, units={"time": "h", "wear": "nm"})
    assert record.end == 59 * 3600.0
    assert np.diff(record.wear) == pytest.approx(1e-6)


def weighings(tmp_path, text):
    path = Path(tmp_path) / "m.csv"
    path.write_text(text)
    return read_weighings(path)


def test_weighings_are_averaged(tmp_path):
    read = weighings(
        tmp_path,
        "rig 7\nProbe;m vor / g;m vor / g;m nach / mg\nA;1,0002;1,0004;998,3\nB;2;2,0002;1999\n",
    )
    assert read.specimens["A"].loss == 0.002  # its digits, and no more
    assert (read.specimens["A"].before, read.specimens["A"].after) == (2, 1)
    assert read.specimens["A"].u(1e-4) == pytest.approx(1e-4 * np.sqrt(1.5))
    assert read.scatter == pytest.approx(1e-4 * np.sqrt(2.0))
    read = weighings(tmp_path, "specimen,loss_mg\nA,1.5\n")
    assert read.specimens["A"].loss == pytest.approx(1.5e-3)
    assert read.scatter is None
    read = weighings(
        tmp_path,
        "specimen,before_g,after_g,final Ra / um,loss_mg,sd loss / mg\nA,2.00000,1.99845,3,1.5,9\n",
    )
    assert read.specimens["A"].loss == pytest.approx(1.5e-3)  # rounded, so it is that of both
    assert read.notes == ("weighings: columns not used: final Ra / um, sd loss / mg",)


def test_a_loss_is_of_two_weighings(tmp_path):
    """Losses scatter as differences do: by the root of two more than masses."""
    read = weighings(tmp_path, "specimen;loss_mg;loss_mg\nA;1.4;1.6\nB;2.0;-\n")
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


def test_columns_of_which_nothing_is_taken_are_named(read, tmp_path):
    assert read("t_s;z_um;humidity_%;room").notes == ("columns not used: humidity_%, room",)
    assert read("t_s;z_um;M / N m").notes == ()
    path = tmp_path / "m.csv"
    path.write_text("specimen,before / g,after / g,operator\na,12.1,12.0,n/a\n")
    assert read_weighings(path).notes == ("weighings: columns not used: operator",)


def test_half_days_have_twelve_hours(read):
    rows = [f"2026-03-14 {1 + i // 60}:{i % 60:02d} PM;{i}" for i in range(80)]
    assert read("time;z_um", rows.__getitem__, 80).duration == 79 * 60.0
    rows[70] = rows[70].replace("2:10", "14:10")
    with pytest.raises(InputError, match=r"line 72.*14:10 PM"):
        read("time;z_um", rows.__getitem__, 80)
