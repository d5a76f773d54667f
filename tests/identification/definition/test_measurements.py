"""Tables of measurements as laboratories write them, and their units."""

import pytest
from parts import factor, named_unit, read_measurements, unit_of_column


def numbers(path, *names):
    table = read_measurements(path)
    rows = table.filled(*names)
    return [table.numbers(name, rows).tolist() for name in names]


@pytest.mark.parametrize(
    "text",
    [
        "t,z\n0.5,1\n1.5,-2e-1\n",
        "# a rig\n\nt;z\n0,5;1\n# a remark\n1,5;-2e-1\n",
        "t\tz\n0.5\t1\n1.5\t-.2\n",
        '\ufefft,z\r\n"0,5",1\r\n1.5,-0.2,\r\n',
        "sep=;\r\nt;z\r\n0,5;1\r\n1,5;-0,2\r\n",
        '\ufeff"sep=,"\nt,z\n0.5,1\n1.5,-0.2\n',
        "t;z;more\n0.5;1;\n;3;\n0.7;;x\n0.8;nan;\n1.5;-0.20;text\n",
    ],
)
def test_tables(text, tmp_path):
    path = tmp_path / "a.csv"
    path.write_bytes(text.encode())
    assert numbers(path, "t", "z") == [[0.5, 1.5], [1.0, -0.2]]


@pytest.mark.parametrize(
    ("hour", "cells", "expected"),
    [
        (3600.0, ["00:10:00", "1:00:30", "90"], [600.0, 3630.0, 90.0]),
        (60.0, ["0:10:00", "1:30", "2:07,5"], [10.0, 1.5, 2.125]),
        (1.0, ["1:30", "26:00", "0:00:36"], [1.5, 26.0, 0.01]),
        (1.0, ["23:30", "0:30"], [23.5, 24.5]),
    ],
)
def test_clock_times(hour, cells, expected, tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("\n".join(["t;z", *(f"{cell};1" for cell in cells)]))
    table = read_measurements(path)
    assert table.numbers("t", table.filled("t"), hour) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("name", "base", "unit"),
    [
        ("t / min", "s", "min"), ("t/min", "s", "min"), ("time / h", "s", "h"),
        ("z / um", "mm", "um"), ("z / µm", "mm", "µm"), ("z_lower/um", "mm", "um"),
        ("m / mg", "g", "mg"), ("M / N m", "N mm", "N m"), ("M/(N m)", "N mm", "N m"),
        ("Datum/Uhrzeit", "s", None), ("depth / 2", "mm", None), ("Weg/Zeit (um)", "mm", "um"),
        ("rate mm/s", "s", None), ("z_um", "mm", "um"), ("z [um]", "mm", "um"),
        ("depth (µm)", "mm", "µm"), ("z", "mm", None), ("wear_lower", "mm", None),
        ("z_mm", "mm", "mm"), ("M_Nm", "N mm", "Nm"), ("M [N m]", "N mm", "N m"),
        ("z_2", "mm", None), ("höhe", "mm", None), ("z_A1", "mm", None),
    ],
)  # fmt: skip
def test_units_of_columns(name, base, unit):
    assert named_unit(name, base) == unit
    if unit is not None:
        assert unit_of_column(name, base) == unit
        assert factor(unit, base) > 0.0
