"""Each row of a sweep's table is what the keys in that row give, computed alone."""

import pytest
from swept import CASE, table

import ringwear_par as rw

#: two shapes and two moduli, in an order that is not that of any identity
STUDY = """case = "paper.toml"
[vary]
"wear.lower.k" = { values = [4e-7, 1e-8, 2e-7, 6e-8] }
"wear.lower.p0" = { values = [35.0, 0.0, 20.0] }
"upper.young" = { values = [5e4, 1e5] }
"lower.r" = { values = [[20.0, 40.0], [25.0, 36.0]] }
[design]
method = "grid"
"""
KEYS = {"wear.lower.k": float, "wear.lower.p0": float, "upper.young": float,
        "lower.r": lambda text: [float(v) for v in text.strip("[]()").split(",")]}  # fmt: skip
FINAL = ("penetration", "worn_volume_lower", "worn_volume_upper")


def test_rows_are_what_their_own_keys_give(tmp_path, comm):
    (tmp_path / "paper.toml").write_text(CASE)
    (tmp_path / "study.toml").write_text(STUDY)
    rw.sweep(rw.read_study(tmp_path / "study.toml"), tmp_path / "out", comm)
    rows = table(tmp_path / "out")
    assert [row["status"] for row in rows] == ["done"] * 48
    with rw.open_ensemble(tmp_path / "out") as data:
        data = data.sortby("number")
        for i in range(0, 48, 7):
            row = rows[i]
            keys = {key: read(row[key]) for key, read in KEYS.items()}
            alone = rw.simulate(rw.read_case(tmp_path / "paper.toml", keys), comm)
            for name in FINAL:
                value = alone.histories[name][-1]
                assert float(row[name]) == pytest.approx(value, rel=1e-4, abs=1e-12), (i, name)
            one = data.isel(case=i)
            assert str(one.case.values) == row["case"]
            assert float(one["wear.lower.k"]) == keys["wear.lower.k"]
            assert one.penetration[-1] == pytest.approx(float(row["penetration"]), rel=1e-12)
