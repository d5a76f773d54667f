"""Files of loggers as they are: preambles, rows of units, stamps, empty cells, decimal marks."""

import numpy as np
import pytest

import ringwear_par as rw
from ringwear_par.files.measurements import measurements_in

HOUR = 3600.0


def table(text, **options):
    content = text if isinstance(text, bytes) else text.encode()
    return measurements_in(content, "a.csv", **options)


def column(read, number, hour=None):
    name = read.columns[number]
    return read.numbers(name, read.filled(name), hour)


@pytest.mark.parametrize("mark", ["utf-8", "utf-8-sig", "cp1252", "utf-16"])
@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_a_preamble_without_marks(mark, newline):
    lines = [
        "Prüfstand RR-2;Software 4.1.7", "Probe;W1;Werkstoff;PEEK-CF", "Last / N;1130",
        "Drehzahl / 1/min;60", "", "t / min;Verschleiß / µm;M / N m;T / °C",
        *(f"{i},0;{i},25;9,{700 + i};22,6" for i in range(8)),
    ]  # fmt: skip
    read = table(newline.join(lines).encode(mark))
    assert read.columns == ("t / min", "Verschleiß / µm", "M / N m", "T / °C")
    assert read.lines[0] == 7
    assert column(read, 1).tolist() == [i + 0.25 for i in range(8)]
    assert column(read, 2)[3] == 9.703


@pytest.mark.parametrize("delimiter", [";", "\t", ","])
def test_a_row_of_units_below_the_names(delimiter):
    rows = ["Rig 7", "t;Weg;M", "s;mm;Nm", *(f"{i};1.5;2" for i in range(3))]
    read = table("\n".join(rows).replace(";", delimiter))
    assert [read.label(name) for name in read.columns] == ["t [s]", "Weg [mm]", "M [Nm]"]
    assert column(read, 0).tolist() == [0.0, 1.0, 2.0]
    read = table("t;Weg;M\n[min];(um);-\n1;2;3\n")
    assert [read.label(name) for name in read.columns] == ["t [min]", "Weg [um]", "M"]


@pytest.mark.parametrize("cell", ["", "nan", "n.a.", "-", "---"])
def test_cells_that_are_empty(cell):
    read = table(f"t_s;z\n0;1\n1;{cell}\n2;3\n")
    assert read.filled("t_s", "z").tolist() == [True, False, True]


@pytest.mark.parametrize(
    ("stamps", "seconds"),
    [
        (["2026-03-14 08:15:00", "2026-03-14T08:15:30.5"], [0, 30.5]),
        (["2026-03-14T23:30:00Z", "2026-03-15T00:15:00Z"], [0, 2700]),
        (["2026-03-29T01:30:00+01:00", "2026-03-29T03:00:00+0200"], [0, 1800]),
        (["17.03.2026 23:59:30", "18.03.2026 00:00:30"], [0, 60]),
        (["03/04/2026 08:00:00", "04/04/2026 08:00:00"], [0, 86400]),  # day first
        (["03/12/2026 08:00:00", "03/13/2026 08:00:00"], [0, 86400]),  # there is no 13th month
        (["3/14/2026 11:59:00 AM", "3/14/2026 12:00:00 PM"], [0, 60]),
        (["28.02.2028 23:00:00", "28.02.2028 24:00:00", "01.03.2028 00:00:00"], [0, 3600, 90000]),
    ],
)  # fmt: skip
def test_stamps(stamps, seconds):
    read = table("\n".join(["Datum/Uhrzeit;z", *(f"{stamp};1" for stamp in stamps)]))
    assert column(read, 0, HOUR).tolist() == seconds
    assert column(read, 0, 1.0) == pytest.approx(np.array(seconds) / HOUR)


def test_clock_times_over_midnight():
    read = table("t;z\n23:59:00;1\n0:00:30;2\n12:00:00;3\n23:00:00;4\n00:30:00;5\n")
    assert column(read, 0, HOUR).tolist() == [86340.0, 86430.0, 129600.0, 169200.0, 174600.0]
    long = table("t;z\n25:00:00;1\n0:30:00;2\n")  # of a stopwatch: nothing says midnight
    assert column(long, 0, HOUR).tolist() == [90000.0, 1800.0]


def test_repeated_stamps_are_left_out_and_repeated_numbers_are_not():
    read = table("t;z\n2026-03-14 08:15:00;1\n2026-03-14 08:15:00;2\n2026-03-14 08:16:00;3\n")
    assert read.first_stamps("t", read.filled("t")).tolist() == [True, False, True]
    read = table("t;z\n1;1\n1;2\n2;3\n")
    assert read.first_stamps("t", read.filled("t")).all()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("rig\nt;z\n1;2\n2;3\n3;4;5\n4;5\n5;6\n6;7\n", ["line 5", "3 values"]),
        ("rig 7\nt;z\n0;1\n1;x\n2;3\n", ["line 4", "x"]),
        ("t;z\n2026-03-14 08:15:00;1\n2026-02-30 08:15:00;2\n", ["line 3", "no such day"]),
        ("t;z\n2026-03-14 08:15:00;1\n2026-03-14 24:59:00;2\n", ["line 3", "no such hour"]),
        ("t;z\n2026-03-14 08:15:00;1\n2026-03-14 08:14:00;2\n", ["line 3", "back", "line 2"]),
        ("t;z\n2026-03-14 08:15:00;1\n7;2\n", ["line 3", "date"]),
        ("t;z\n03/13/2026 08:15:00;1\n13/03/2026 08:15:00;2\n", ["month"]),
        ("t;z\n0.5;1,130\n1.5;1,140\n", ["line 2", "comma", "thousands"]),
        ("t;z\n0.5;1'130.5\n1.5;1\n", ["line 2", "thousands"]),
        ("t;z\n0.5;<15\n1.5;1\n", ["line 2", "<15", "censored"]),
        ("t z\n0 1\n1 2\n", ["one column", "semicolons"]),
    ],
)
def test_what_cannot_be_read_is_named_by_its_line(text, words):
    with pytest.raises(rw.InputError) as caught:  # noqa: PT012
        columns = table(text)
        column(columns, 0, HOUR)
        column(columns, 1)
    assert all(word in str(caught.value) for word in ["a.csv", *words]), str(caught.value)


def test_three_decimals_are_no_thousands():
    read = table("t;M\n0,0;9,760\n1,0;9,386\n")
    assert column(read, 1).tolist() == [9.76, 9.386]
