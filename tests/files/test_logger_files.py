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


def test_names_that_look_like_units_are_names():
    read = table("s;m\n1;2\n")
    assert (read.columns, read.units) == (("s", "m"), ())


@pytest.mark.parametrize("cell", ["", "nan", "NaN", "n.a.", "NA", "-", "--", "---"])
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
        (["1.4.26 8:15", "1.4.26 8:16"], [0, 60]),
        (["03/04/2026 08:00:00", "04/04/2026 08:00:00"], [0, 86400]),  # day first
        (["03/12/2026 08:00:00", "03/13/2026 08:00:00"], [0, 86400]),  # there is no 13th month
        (["3/14/2026 11:59:00 AM", "3/14/2026 12:00:00 PM"], [0, 60]),
        (["28.02.2028 12:00:00", "29.02.2028 12:00:00", "01.03.2028 12:00:00"],
         [0, 86400, 172800]),
    ],
)  # fmt: skip
def test_stamps(stamps, seconds):
    read = table("\n".join(["Datum/Uhrzeit;z", *(f"{stamp};1" for stamp in stamps)]))
    assert column(read, 0, HOUR).tolist() == seconds
    assert column(read, 0, 1.0) == pytest.approx(np.array(seconds) / HOUR)
    assert read.names_seconds("Datum/Uhrzeit", read.filled("z"))


@pytest.mark.parametrize(("time", "there"), [("24:00:00", True), ("24:59:00", False)])
def test_a_day_ends_at_24(time, there):
    read = table(f"t;z\n14.03.2026 23:00:00;1\n14.03.2026 {time};2\n")
    if there:
        assert column(read, 0, HOUR).tolist() == [0.0, HOUR]
        return
    with pytest.raises(rw.InputError, match=r"line 3: .*no such hour; must be from 0:00 to 24:00"):
        column(read, 0, HOUR)


def test_stamps_count_from_the_first_of_the_table():
    rows = [f"2026-03-14 08:1{i}:00,{'' if i == 0 else i}" for i in range(3)]
    read = table("\n".join(["t,z", *rows]))
    assert read.numbers("t", read.filled("t", "z"), HOUR).tolist() == [60.0, 120.0]


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


def test_weighings_have_names_first_and_columns_of_one_name():
    text = "Wägungen, u = 0,1 mg (k = 1)\nProbe;m vor / g;m vor / g;m nach / g\nW1;41,1;41,2;41,0\n"
    read = table(text, labelled=True)
    assert read.columns == ("Probe", "m vor / g", "m vor / g", "m nach / g")
    assert read.rows == (("W1", "41,1", "41,2", "41,0"),)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("rig\nt;z\n1;2\n2;3\n3;4;5\n4;5\n5;6\n6;7\n",
         "line 5: has 3 values; must have 2, as line 2"),
        ("rig 7\nt;z\n0;1\n1;x\n2;3\n", "line 4: z = x: must be a number, or empty"),
        ("rig 7\nt;z\nabc;1\n1;2\n2;3\n", "line 3: t = abc: must be a number"),
        ("t;z\n2026-03-14 08:15:00;1\n2026-02-30 08:15:00;2\n", "line 3: t = 2026-02-30 08:15:00: "
         "there is no such day"),
        ("t;z\n2026-03-14 08:15:00;1\n2026-03-14 08:14:00;2\n",
         "line 3: t = 2026-03-14 08:14:00: goes back, line 2 has 2026-03-14 08:15:00"),
        ("t;z\n2026-03-14 08:15:00;1\n7;2\n", "line 3: t = 7: must be a date with a time"),
        ("t;z\n03/13/2026 08:15:00;1\n13/03/2026 08:15:00;2\n", "the month is first here"),
        ("t;z\n0.5;1,130\n1.5;1,140\n", "line 2: z = 1,130: has a comma where other numbers, as in "
         "line 2, have decimal points; must be without separators of thousands"),
        ("t;z\n0,5;1.130\n1,5;1.140\n", "z = 1.130: has a point where other numbers, as in line 2, "
         "have decimal commas"),
        ("t;z\n0.5;1,130.5\n1.5;1\n", "line 2: z = 1,130.5: must be a number, or empty; thousands "
         "must not be separated"),
        ("t;z\n0.5;1 130,5\n1.5;1\n", "thousands must not be separated"),
        ("t;z\n0.5;1'130.5\n1.5;1\n", "thousands must not be separated"),
        ("t;z\n0.5;<15\n1.5;1\n", "line 2: z = <15: must be a number, or empty; of a limit, the "
         "number, and below or above in a column censored, which fits read"),
    ],
)  # fmt: skip
def test_what_cannot_be_read_is_told_by_its_line(text, said):
    def read():
        columns = table(text)
        column(columns, 0, HOUR)
        column(columns, 1)

    with pytest.raises(rw.InputError) as caught:
        read()
    assert said in str(caught.value)
    assert "a.csv: " in str(caught.value)


def test_three_decimals_are_no_thousands():
    read = table("t;M\n0,0;9,760\n1,0;9,386\n")
    assert column(read, 1).tolist() == [9.76, 9.386]
    read = table("t;M\n0;1,760\n1;9,386\n")
    assert column(read, 1).tolist() == [1.76, 9.386]


def test_long_files_are_looked_at_once():
    text = "\n".join([*(f"channel {i}; of the rig" for i in range(20_000)), "x;1;2"])
    with pytest.raises(rw.InputError, match="must have 2, as the first line"):
        table(text)
    read = table("\n".join(["t;z", *(f"{i};{i}" for i in range(50_000))]))
    assert column(read, 1)[-1] == 49_999


def test_cells_that_nothing_known_separates():
    with pytest.raises(rw.InputError, match=r"line 1: t z: is one column; .* semicolons or tabs"):
        table("t z\n0 1\n1 2\n")
