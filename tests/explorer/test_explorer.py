"""The explorer without a browser: sliders and their keys, histories, charts, readings."""

import numpy as np
import pytest
from bokeh.models import TextInput
from mpi4py import MPI
from paths import CASES, FIT, PAPER

import ringwear_par as rw
from ringwear_par.explorer.page import CASE_FILE, PINNED, Explorer, history_of
from ringwear_par.explorer.readings import read_readings

SMALL = {"mesh.contact_elements": 12}


def opened(name, **changes):
    case = rw.read_case(CASES / f"{name}.toml", {**SMALL, **changes})
    return Explorer(case, history_of(case, MPI.COMM_SELF), f"{name}.toml", MPI.COMM_SELF)


def field(page, name):
    return page.layout.select_one({"type": TextInput, "name": name})


def curves(chart):
    """Return the last curve of each label of a chart."""
    data = chart.figure.renderers[0].data_source.data
    return {
        label: (np.array(x), np.array(y))
        for label, x, y in zip(data["line"], data["x"], data["y"], strict=True)
    }


@pytest.mark.parametrize("name", ["user_law", "updated", "wear_through", "table", "start_stop"])
def test_the_case_that_is_saved_gives_the_same_numbers(name, tmp_path):
    page = opened(name)
    for number in page.numbers.values():  # a little off, so that each is within reach
        if number.group in ("Wear", "Load and friction"):
            page.moved[number.name] = number.text(number.position(1.02 * number.value))
    page.compute()
    assert page.status.text == ""
    assert len(page.moved) >= 2
    (tmp_path / "home.toml").write_text(page.case.text)
    case = rw.read_case(tmp_path / "home.toml")
    assert case == page.case
    result = rw.simulate(case.replace({"stress": None}), MPI.COMM_SELF)
    for variable in ("penetration", "torque", "worn_volume_lower"):
        values = page.result.histories[variable][-1], result.histories[variable][-1]
        assert values[0] == pytest.approx(values[1], rel=1e-4)


def test_fields_take_units_and_any_value():
    page = opened("paper", **{"time.steps": 8})
    field(page, "wear.lower.k").value = "2e-5 mm3/(N m)"
    field(page, "load.omega").value = "45 rpm"
    field(page, "upper.r[1]").value = "40"
    field(page, "time.steps").value = "9"
    assert page.status.text == ""
    assert 'k = "2e-5 mm3/(N m)"' in page.case.text
    assert page.case.load.omega == pytest.approx(1.5 * np.pi)
    assert (page.case.upper.r, page.case.time.steps) == ((28.5, 40.0), 9)
    before = page.result
    for wrong, word in (("abc", "wear.lower.k"), ("-1", "wear.lower.k"), ("3 kg", "kg")):
        field(page, "wear.lower.k").value = wrong
        assert word in page.status.text
        assert page.result is before
    page.reset()
    assert page.moved == {}
    assert page.case == rw.read_case(PAPER, {**SMALL, "time.steps": 8})
    assert field(page, "time.steps").value == "8"


@pytest.mark.parametrize(
    ("key", "low", "high"),
    [("wear.lower.k", 1e-9, 1e-5), ("contact.friction", 0.0, 0.3), ("upper.r[0]", 27.0, 30.0)],
)
def test_sliders_reach_what_makes_sense(key, low, high):
    number = opened("paper").numbers[key]
    assert (number.low, number.high) == pytest.approx((low, high))


def test_numbers_of_layers_have_sliders():
    page = opened("wear_through")
    assert page.numbers["lower.layers[0].thickness"].value == pytest.approx(3e-3)
    page.move("lower.layers[0].thickness", "4 um")
    assert page.case.lower.layers[0].thickness == pytest.approx(4e-3)
    page.move("lower.layers[0].poisson", "0.7")
    page.move("contact.friction", "-1")
    assert all(key in page.status.text for key in ("layers[0].poisson", "contact.friction"))


def test_charts_hold_the_history_and_what_it_is_compared_with():
    page = opened("archard", **{"lower.density": 0.0019})
    first = page.result
    page.move("wear.lower.k", "3e-8")
    page.pin()
    page.move("wear.lower.k", "5e-8")
    drawn = curves(page.charts["left"])
    for label, result in (
        (CASE_FILE, first), (PINNED, page.others[PINNED]), ("now", page.result),
    ):  # fmt: skip
        assert np.allclose(drawn[label][1], 1e3 * result.histories["penetration"])
    drawn = curves(page.charts["wear"])
    assert np.allclose(drawn[f"{CASE_FILE}, end"][1], 1e3 * first.profiles["wear_upper"][-1])
    assert np.allclose(drawn["time chosen"][1], 1e3 * page.result.profiles["wear_upper"][-1])
    figure = page.charts["wear"].figure
    assert figure.y_range.start > figure.y_range.end  # worn depths grow downwards
    page.pin()
    assert set(page.others) == {CASE_FILE}


def test_tables_are_read_by_the_names_of_their_columns():
    page = opened("paper")
    page.lay((FIT / "test1_penetration.csv").read_bytes(), "a.csv")
    rows = np.loadtxt(FIT / "test1_penetration.csv", delimiter=",", skiprows=2)
    (one,) = page.readings
    assert (one.panel, one.variable) == ("penetration", "penetration")
    assert np.allclose(one.x, rows[:, 0])
    assert np.allclose(one.y, 1e-3 * rows[:, 1])
    assert "readings" in page._about_readings.text
    (one,) = read_readings((FIT / "test1_profile_lower.csv").read_bytes(), "b.csv", "lower")
    assert (one.panel, one.variable) == ("wear", "wear_lower")
    table = b"t [h];torque_Nm;volume_upper_mm3\n0,5;2,5;3\n0,25;1,5;2\n"
    torque, volume = read_readings(table, "c.csv", "lower")
    assert (torque.variable, volume.variable) == ("torque", "worn_volume_upper")
    assert np.allclose(torque.x, [900.0, 1800.0])  # in order
    assert np.allclose(torque.y, [1500.0, 2500.0])
    time, depth = (page.result.histories[name] for name in ("time", "penetration"))
    rows = "\n".join(f"{t!r},{1e3 * d + 2.0!r}" for t, d in zip(time, depth, strict=True))
    (one,) = read_readings(f"time_s,penetration_um\n{rows}\n1e9,5\n".encode(), "a.csv", "lower")
    assert one.distance(page.result) == pytest.approx(2e-3)
    (one,) = read_readings(b"r_mm,wear_upper_um\n10,1\n50,-1\n", "a.csv", "lower")
    assert one.distance(page.result) == pytest.approx(1e-3)  # unworn there


@pytest.mark.parametrize(
    ("table", "word"),
    [(b"x,y\n1,2\n", "time_s"), (b"time_s,y_um\n1,2\n", "penetration"),
     (b"time_s,torque\n1,two\n", "line 2")],
)  # fmt: skip
def test_tables_that_cannot_be_read(table, word):
    with pytest.raises(rw.InputError, match=word):
        read_readings(table, "a.csv", "lower")
