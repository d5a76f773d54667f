"""Readings that a fit file names: times of day."""

import pytest

from ringwear_par.identification.definition.fit_file import read_fit


@pytest.mark.parametrize(
    ("hour", "minute", "end", "first", "warning"),
    [
        (0, 0, 100.0, 0.0, ""),
        (0, 2, 100.0, 0.0, "after the end"),
        (8, 0, 36e3, 28800.0, ""),
    ],
)  # fmt: skip
def test_times_of_day(hour, minute, end, first, warning, tables, tmp_path, caplog):
    """Clock times that begin after the end of the test; others have elapsed."""
    rows = [f"{hour}:{minute + i // 60:02d}:{i % 60:02d};{0.1 * i}" for i in range(0, 100, 2)]
    path = tmp_path / "z.csv"
    path.write_text("\n".join(["t;z_um", *rows, "OVL;OVL"]))
    given = tables()
    given["experiment"][0]["data"][0] |= {
        "file": str(path), "columns": {"time": "t", "value": "z_um"}, "drop": ["OVL"],
    }  # fmt: skip
    given["experiment"][0]["set"]["time.end"] = end
    series = read_fit(given).experiments[0].series[0]
    assert series.x[[0, -1]] == pytest.approx([first, first + 98.0])
    assert [warning in one for one in caplog.messages] == [True] * bool(warning)
