"""What the explorer draws: figures of histories, and measurements laid over them."""

import json

import numpy as np
import pytest
from paths import CASES, FIT

import ringwear_par as rw
from ringwear_par.explorer.exploring import Exploration
from ringwear_par.explorer.figures import CASE_FILE, Drawing
from ringwear_par.explorer.measured import read_table
from ringwear_par.explorer.moved_keys import raw_keys


@pytest.fixture(scope="module")
def drawn():
    from mpi4py import MPI

    keys = raw_keys(CASES / "archard.toml", ["mesh.contact_elements=12", "lower.density=0.0019"])
    exploration = Exploration(keys, "archard.toml", MPI.COMM_WORLD)
    return exploration.compute({}), exploration.compute({"wear.lower.k": "3e-8"})


def test_figures_hold_the_history(drawn):
    first, now = drawn
    for menu, factor in (("penetration", 1e3), ("approach", 1e3), ("torque", 1e-3)):
        told = Drawing(now.result, {CASE_FILE: first.result}, now.case, 0.5, menu, []).columns()
        drawings = told["other"]["sources"]["lines"]["y"]
        for one, drawing in zip((first, now), drawings, strict=True):
            assert np.allclose(drawing, factor * one.result.histories[menu], rtol=1e-14)
    lines = told["wear"]["sources"]["lines"]
    assert lines["label"][-2:] == ["time chosen"] * 2
    assert np.array_equal(lines["y"][-2], 1e3 * now.result.profiles["wear_lower"][
        np.abs(now.result.histories["time"] - 100.0).argmin()])  # fmt: skip
    ends = [lines["y"][lines["label"].index(label)] for label in ("case file, end", "200 s")]
    wear = (1e3 * one.result.profiles["wear_lower"][-1] for one in drawn)
    assert all(np.array_equal(*both) for both in zip(ends, wear, strict=True))
    json.dumps(told, allow_nan=False)


def test_tables_are_read_as_fits_read_them(drawn):
    case = drawn[0].case
    (depth,) = read_table((FIT / "test1_penetration.csv").read_bytes(), "a.csv", case)
    rows = np.loadtxt(FIT / "test1_penetration.csv", delimiter=",", skiprows=2)
    assert (depth.quantity, depth.unit) == ("penetration", "um")
    assert np.allclose(depth.x, rows[:, 0])
    assert np.allclose(depth.values(case, drawn[0].result), 1e-3 * rows[:, 1])
    (profile,) = read_table((FIT / "test1_profile_lower.csv").read_bytes(), "b.csv", case)
    assert (profile.quantity, profile.along) == ("profile.lower", True)
    many = b"t [h];torque_Nm;mass_lower_mg\n0,5;2,5;3\n0,25;1,5;2\n"
    found = read_table(many, "c.csv", case)
    assert [one.quantity for one in found] == ["torque", "mass.lower"]
    assert np.allclose(found[0].x, [900.0, 1800.0])  # in order
    assert np.allclose(found[0].values(case, drawn[0].result), [1500.0, 2500.0])
    assert np.allclose(found[1].values(case, drawn[0].result), np.array([2e-3, 3e-3]) / 0.0019)


def test_how_far_readings_are_from_the_curve(drawn):
    now = drawn[1]
    time, depth = (now.result.histories[name] for name in ("time", "penetration"))
    rows = "\n".join(f"{t!r},{1e3 * d + 2.0!r}" for t, d in zip(time, depth, strict=True))
    table = f"time_s,penetration_um\n{rows}\n1e9,5\n".encode()
    (one,) = read_table(table, "a.csv", now.case)
    assert one.off(now.result, one.values(now.case, now.result)) == pytest.approx(2e-3)
    table = b"r_mm,wear_upper_um\n10,1\n50,-1\n"  # unworn there
    (one,) = read_table(table, "a.csv", now.case)
    assert one.quantity == "profile.upper"
    assert one.off(now.result, one.values(now.case, now.result)) == pytest.approx(1e-3)


@pytest.mark.parametrize(
    ("table", "word"), [(b"x,y\n1,2\n", "time_s"), (b"time_s,y\n1,two\n", "line 2")]
)
def test_tables_that_cannot_be_read(table, word, drawn):
    with pytest.raises(rw.InputError, match=word):
        read_table(table, "a.csv", drawn[0].case)
