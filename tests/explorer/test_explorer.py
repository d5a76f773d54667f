"""The explorer without a browser: sliders and their keys, histories, measurements, the server."""

import asyncio
import base64
import json
import re
import signal
import socket
import subprocess
import sys
from contextlib import contextmanager, suppress
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from bokeh.document import Document
from bokeh.server.session import ServerSession
from conftest import SHELL_ENVIRONMENT
from test_cli import RINGWEAR, ringwear, sentences
from tornado.httpclient import AsyncHTTPClient, HTTPClientError, HTTPRequest
from tornado.ioloop import IOLoop
from tornado.websocket import websocket_connect

import ringwear_par as rw
from ringwear_par.explorer.controls import _times, controls_of
from ringwear_par.explorer.exploring import Exploration, raw_keys
from ringwear_par.explorer.figures import MENU, Drawing
from ringwear_par.explorer.measured import read_table
from ringwear_par.explorer.page import Page, _variables
from ringwear_par.explorer.server import _if_there
from ringwear_par.results.history_panels import HISTORY_PANELS

pytestmark = pytest.mark.serial

ROOT = Path(__file__).parents[2]
CASES = ROOT / "scripts" / "cases"
PAPER = CASES / "paper.toml"
FIT = ROOT / "scripts" / "fit"
SMALL = ["mesh.contact_elements=12", "time.steps=8"]
#: keys of a rig as its users write them
RIG = """
[lower]
r = [20.0, 40.0]
z = [0.0, "2 cm"]
young = "10 GPa"
poisson = 0.3
[upper]
r = ["28.5 mm", "3.15 cm"]
z = [20.0, 40.0]
young = 100e3
poisson = 0.3
profile = { fillet = [0.1, "200 um"] }
[contact]
friction = 0.1
[wear.lower]
law = "archard"
k = "1e-5 mm3/(N m)"
[wear.upper]
law = "threshold"
k = { r = [[29.0, 1e-8], [31.0, 2e-8]] }
[load]
force = [["0 h", "30 kN"], ["1 h", 45000]]
omega = "30 rpm"
[time]
scheme = "adaptive"
end = "0.5 h"
[mesh]
contact_elements = 12
[output]
times = ["0.25 h"]
fields = ["gap"]
profiles = "last"
"""


@pytest.fixture
def explored(tmp_path, comm):
    def explored(text, *overrides):
        path = tmp_path / "case.toml"
        path.write_text(text)
        return Exploration(raw_keys(path, list(overrides)), str(path), comm)

    return explored


def same(found, case):
    """Whether a history has the very numbers of rw.simulate at the end and in between.

    Without stresses, which sliders leave out.
    """
    case = case if case.stress is None else case.replace({"stress": None})
    result, other = found.result, rw.simulate(case)
    at = np.isin(result.histories["time"], other.histories["time"])
    for name, values in other.histories.items():
        if name != "contact_iterations":
            assert np.array_equal(result.histories[name][at], values), name
    for name, values in other.profiles.items():
        there = result.profiles[name]
        assert np.array_equal(there[at] if values.ndim == 2 else there[-1], values), name
    assert result.summary() == other.summary()


@pytest.mark.parametrize("path", sorted(CASES.glob("*.toml")), ids=lambda path: path.stem)
def test_the_text_taken_home_gives_the_same_numbers(path, tmp_path, comm):
    if path.stem in ("study", "wear_law"):
        with pytest.raises(rw.InputError, match="is a study, not a case"):
            raw_keys(path, [])
        return
    exploration = Exploration(raw_keys(path, ["mesh.contact_elements=16"]), str(path), comm)
    # a little off, so that whatever is within reach may be
    moved = {
        name: f"{control.value * 1.02:.6g}"
        for name, control in exploration.controls.items()
        if not (control.assembles or control.whole)
    }
    found = exploration.compute(moved)
    assert {name: found.controls[name].value for name in moved} == {
        name: float(text) for name, text in moved.items()
    }
    home = tmp_path / "home.toml"  # another folder
    home.write_text(found.text)
    case = rw.read_case(home)
    assert case == found.case
    same(found, case)
    assert any("wear." in name for name in moved)  # of bodies, or of their layers
    assert any(name.startswith("load.") for name in moved)
    for control in exploration.controls.values():
        assert control.low <= control.value <= control.high
        assert control.step > 0


def test_positions_are_round_in_the_unit_that_is_shown():
    for text, step in (("10 h", 0.2), ("90 min", 2.0), (36000.0, 1000.0)):
        (control,) = _times({"time.end": text})
        assert control.step == step
        places = np.array([control.low, control.value]) / step
        assert places == pytest.approx(np.round(places), rel=1e-9)


def test_numbers_stay_in_the_units_of_the_user(explored):
    exploration = explored(RIG)
    told = {name: (c.value, c.unit) for name, c in exploration.controls.items()}
    assert told["load.omega"] == (30.0, "rpm")
    assert told["wear.lower.k"] == (1e-5, "mm3/(N m)")
    assert told["upper.r[1]"] == (3.15, "cm")
    assert told["lower.young"] == (10.0, "GPa")
    assert told["upper.young"] == (100e3, "MPa")
    assert told["upper.profile.fillet[1]"] == (200.0, "um")
    assert told["time.end"] == (0.5, "h")
    found = exploration.compute(
        {"load.omega": "45", "lower.young": "12000 MPa", "upper.profile.fillet[1]": "250",
         "load.force \N{MULTIPLICATION SIGN}": "0.5", "wear.upper.k \N{MULTIPLICATION SIGN}": "2"}
    )  # fmt: skip
    assert 'omega = "45 rpm"' in found.text
    assert 'young = "12000 MPa"' in found.text
    assert found.controls["lower.young"].value == 12.0  # GPa, as it was
    assert '"fillet" = [0.1, "250 um"]' in found.text
    assert 'force = [["0 h", "15 kN"], ["1 h", 22500.0]]' in found.text
    assert 'k = { "r" = [[29.0, 2e-08], [31.0, 4e-08]] }' in found.text
    assert 'k = "1e-5 mm3/(N m)"' in found.text
    assert found.text.endswith('times = ["0.25 h"]\nfields = ["gap"]\nprofiles = "last"\n')
    assert set(found.result.profiles) == {"pressure", "gap", "wear_lower", "wear_upper"}
    same(found, found.case)


@pytest.mark.parametrize(
    ("key", "linear", "low", "high"),
    [
        ("wear.lower.k", False, 1e-9, 1e-5), ("wear.lower.p0", True, 0.0, 120.0),
        ("contact.friction", True, 0.0, 0.3), ("lower.poisson", True, 0.0, 0.495),
        ("lower.young", False, 1e3, 1e5), ("upper.r[0]", True, 27.0, 30.0),
    ],
)  # fmt: skip
def test_sliders_reach_what_makes_sense(key, linear, low, high, comm):
    control = Exploration(raw_keys(PAPER, SMALL), "paper", comm).controls[key]
    assert (control.low, control.high) == pytest.approx((low, high))
    assert control.log is not linear
    further = control.at(2.0 * high)  # typed
    assert further.low <= control.low
    assert further.high >= 2.0 * high
    assert control.assembles is (key in ("lower.poisson", "upper.r[0]"))


def test_zeros_and_laws_of_users_have_sliders(tmp_path):
    keys = {
        "wear.lower.law": "user", "wear.lower.file": "law.py",
        "wear.lower.parameters": {"a": 0.0, "b": -2.0, "c": 3e-9, "d": [[0, 1], [5, 2]]},
        "contact.friction": 0.0, "load.omega": 0.0, "load.force": 10, "lower.r": [0, 4],
        "lower.z": [0, 1], "lower.young": 1, "lower.poisson": 0, "upper.r": [1, 3],
        "upper.z": [1, 2], "upper.young": 1, "upper.poisson": -0.2, "time.steps": 1,
    }  # fmt: skip
    found = {c.name.removeprefix("wear.lower.parameters."): c for c in controls_of(keys)}
    reach = {name: (c.low, c.high, c.log) for name, c in found.items()}
    assert reach["a"] == (-1.0, 1.0, False)
    assert reach["b"] == (-6.0, 0.0, False)
    assert reach["c"] == (3e-11, 3e-7, True)
    assert reach["d \N{MULTIPLICATION SIGN}"] == (0.1, 10.0, True)
    assert reach["contact.friction"] == (0.0, 0.5, False)
    assert reach["lower.r[0]"][0] == 0.0
    assert reach["upper.poisson"][0] > -1.0
    assert reach["time.steps"][:2] == (1.0, 10.0)


def test_numbers_of_layers_have_sliders(comm):
    keys = raw_keys(CASES / "wear_through.toml", ["mesh.contact_elements=12"])
    exploration, said = Exploration(keys, "wear_through.toml", comm), []
    told = exploration.controls
    layer = {name: told[f"lower.layers[0].{name}"] for name in ("thickness", "young", "poisson")}
    assert [(c.value, c.unit, c.low, c.high) for c in layer.values()][:2] == [
        (3.0, "um", 0.3, 30.0), (100.0, "GPa", 10.0, 1000.0),
    ]  # fmt: skip
    assert {c.group for c in layer.values()} == {"Layer 1 of lower"}
    assert all(c.assembles for c in (*layer.values(), told["lower.young"]))  # ratios of moduli
    assert not told["upper.young"].assembles
    assert told["lower.layers[0].wear.k"].group.startswith("Wear of lower, layer 1: ")
    for moved, times in (
        ({}, 1), ({"lower.layers[0].wear.k": "3e-8", "wear.lower.k": "2e-7"}, 1),
        ({"lower.layers[0].thickness": "4", "lower.young": "2e4"}, 2),
    ):  # fmt: skip
        found = exploration.compute(moved, lambda: said.append(1))
        assert len(said) == times
    assert '"thickness" = "4 um"' in found.text
    assert found.case.lower.layers[0].thickness == pytest.approx(4e-3)
    same(found, found.case)
    with pytest.raises(rw.InputError, match=r"lower.layers\[0\].poisson"):
        exploration.compute({"lower.layers[0].poisson": "0.7"})


def test_all_that_is_wrong_is_told(comm):
    exploration = Exploration(raw_keys(PAPER, SMALL), "paper.toml", comm)
    with pytest.raises(rw.InputError) as caught:
        exploration.compute({"wear.lower.k": "much", "load.omega": "3 m", "away": "1"})
    assert caught.value.faults == (
        "wear.lower.k = much: must be a number in 1/MPa, or one with its unit",
        "load.omega = 3 m: must be a number in rad/s, or one with its unit (m is no unit of rad/s; "
        "turns are rpm or turn/s)",
        "away: is no number of this case that can be moved",
    )
    with pytest.raises(rw.InputError) as caught:
        exploration.compute({"lower.poisson": "0.7", "contact.friction": "-1"})
    with pytest.raises(rw.InputError) as usual:
        rw.read_case(PAPER, {"lower.poisson": 0.7, "contact.friction": -1.0})
    assert [fault.partition(": ")[2] for fault in sorted(caught.value.faults)] == sorted(
        fault.partition("override ")[2] for fault in usual.value.faults
    )
    with pytest.raises(rw.InputError, match="rings do not overlap"):
        exploration.compute({"upper.r[0]": "41", "upper.r[1]": "42"})


def test_pairs_are_used_again(comm):
    exploration, said = Exploration(raw_keys(PAPER, SMALL), "paper.toml", comm), []

    def assembling():
        said.append(1)

    for numbers, times in (
        ({}, 1), ({"wear.lower.k": "2e-7"}, 1), ({"lower.young": "2e4"}, 1),
        ({"upper.r[0]": "28"}, 2), ({"upper.r[0]": "28", "load.pressure": "70"}, 2), ({}, 3),
    ):  # fmt: skip
        exploration.compute(numbers, assembling)
        assert len(said) == times


def test_sketches_are_coarse_and_near(comm):
    for path in (PAPER, CASES / "crown.toml"):
        exploration = Exploration(raw_keys(path, []), path.name, comm)
        found, sketch = (exploration.compute({}, sketch=so) for so in (False, True))
        assert sketch.text == found.text
        assert sketch.result.steps_made[-1] < 0.6 * found.result.steps_made[-1]
        ends = [one.result.histories["penetration"][-1] for one in (sketch, found)]
        assert ends[0] == pytest.approx(ends[1], rel=2e-3)


# -- figures and measurements ----------------------------------------------------------------------


@pytest.fixture(scope="module")
def drawn():
    from mpi4py import MPI

    keys = raw_keys(CASES / "archard.toml", ["mesh.contact_elements=12", "lower.density=0.0019"])
    exploration = Exploration(keys, "archard.toml", MPI.COMM_WORLD)
    return exploration.compute({}), exploration.compute({"wear.lower.k": "3e-8"})


def test_figures_hold_the_history(drawn):
    first, now = drawn
    for menu in MENU.keys() - {"through"}:  # of layers
        told = Drawing(now.result, first.result, now.case, 0.5, menu, []).told()
        curves = HISTORY_PANELS[menu].curves(now.result)
        lines = told["other"]["sources"]["lines"]
        assert len(lines["x"]) == 2 * len(curves)  # and those of the case file
        for y, values in zip(lines["y"][len(curves) :], curves.values(), strict=True):
            assert np.array_equal(np.unique(y), np.unique(values))
    lines = told["wear"]["sources"]["lines"]
    assert np.array_equal(lines["y"][-2], -1e3 * now.result.profiles["wear_lower"][
        np.abs(now.result.histories["time"] - 100.0).argmin()])  # fmt: skip
    ends = [lines["y"][lines["label"].index(label)] for label in ("case file, end", "200 s")]
    wear = (-1e3 * one.result.profiles["wear_lower"][-1] for one in drawn)
    assert all(np.array_equal(*both) for both in zip(ends, wear, strict=True))
    assert told["wear"]["note"] == "lower below 0, upper above"
    top = told["pressure"]["ranges"][1][1]
    assert 80.0 < top < max(map(max, told["pressure"]["sources"]["lines"]["y"]))
    assert "is cut" in told["pressure"]["note"]
    json.dumps(told, allow_nan=False)


def test_the_share_worn_through_is_drawn_of_layers(comm):
    for name, layered in (("wear_through", True), ("paper", False)):
        keys = raw_keys(CASES / f"{name}.toml", ["mesh.contact_elements=12"])
        exploration = Exploration(keys, name, comm)
        menu = _variables(exploration, name, [])["menu"]
        assert ("through" in menu) is layered
        assert len(menu) == len(MENU) - (not layered)
        if layered:
            found = exploration.compute({})
            told = Drawing(found.result, found.result, found.case, 1.0, "through", []).told()
            (y,) = told["other"]["sources"]["lines"]["y"]
            assert y == (100.0 * found.result.layers["share_through_lower"]).tolist()
            assert y[-1] > 0.0


def test_tables_are_read_as_fits_read_them(drawn):
    case = drawn[0].case
    (depth,) = read_table((FIT / "test1_penetration.csv").read_bytes(), "a.csv", case)
    rows = np.loadtxt(FIT / "test1_penetration.csv", delimiter=",", skiprows=2)
    assert (depth.quantity, depth.unit) == ("penetration", "um")
    assert np.allclose(depth.x, rows[:, 0])
    assert np.allclose(depth.values(case), 1e-3 * rows[:, 1])
    (profile,) = read_table((FIT / "test1_profile_lower.csv").read_bytes(), "b.csv", case)
    assert (profile.quantity, profile.along) == ("profile.lower", True)
    many = (
        b"t [h];sd;torque_Nm;mass_lower_mg;depth (mm);other_N m;note\n"
        b"0,5;1;2,5;3;0,001;7;1\n0,25;1;1,5;2;0,002;6;\n"
    )
    found = read_table(many, "c.csv", case)
    assert [one.quantity for one in found] == [
        "torque", "mass.lower", "penetration", "torque", "penetration",
    ]  # fmt: skip
    assert np.allclose(found[0].x, [900.0, 1800.0])  # in order
    assert np.allclose(found[0].values(case), [1500.0, 2500.0])
    assert np.allclose(found[1].values(case), np.array([2e-3, 3e-3]) / 0.0019)
    assert len(found[-1].x) == 1


def test_how_far_readings_are_from_the_curve(drawn):
    now = drawn[1]
    time, depth = (now.result.histories[name] for name in ("time", "penetration"))
    rows = "\n".join(f"{t!r},{1e3 * d + 2.0!r}" for t, d in zip(time, depth, strict=True))
    table = f"time_s,penetration_um\n{rows}\n1e9,5\n".encode()
    (one,) = read_table(table, "a.csv", now.case)
    assert one.off(now.result, one.values(now.case)) == pytest.approx(2e-3)
    table = b"r_mm,wear_upper_um\n10,1\n50,-1\n"  # unworn there
    (one,) = read_table(table, "a.csv", now.case)
    assert one.quantity == "profile.upper"
    assert one.off(now.result, one.values(now.case)) == pytest.approx(1e-3)
    (one,) = read_table(b"time_s,mass_upper_mg\n10,1\n", "a.csv", now.case)
    with pytest.raises(rw.InputError, match=r"must have upper.density \(g/mm"):
        one.values(now.case)


@pytest.mark.parametrize(
    ("table", "words"),
    [
        (b"", "a.csv: is empty"),
        (b"\0\1\2\n", "a.csv: is not a text file"),
        (b"x,y\n1,2\n", "a.csv: has the columns x, y; must have one of times, such as time_s"),
        (b"torque,radial\n1,2\n", "must have one of times"),
        (b"time_s,y\n1,two\n", "a.csv: line 2: y = two: must be a number, or empty"),
        (b"time_s,y\n1,\n", "a.csv: has no readings beside time_s"),
        (b"time_s,y\n" + b"1,1\n" * 1_300_000, "must have at most 5000000"),
    ],
)
def test_tables_that_are_none_are_told(table, words, drawn):
    with pytest.raises(rw.InputError, match=re.escape(words)):
        read_table(table, "a.csv", drawn[0].case)


class Visited:
    """A page without a browser, and what both threads are to do for it."""

    def __init__(self, comm):
        self.exploration = Exploration(raw_keys(PAPER, SMALL), "paper", comm)
        self.tasks, self.later, document = [], [], Document()
        self.page = Page(document, self.exploration, "paper.toml", ["127.0.0.1:1"],
                         self.tasks.append, self.later.append)  # fmt: skip
        self.talk = document.get_model_by_name("talk")

    @property
    def told(self):
        """What the page was told last."""
        return json.loads(self.talk.told)

    def work(self):
        """Do all that is to be done, and return what the page is told then."""
        while self.tasks:
            self.tasks.pop(0)()
            while self.later:
                self.later.pop(0)()
        return self.told

    def ask(self, n, **values):
        """Ask for other numbers."""
        wish = {"n": n, "instant": 1.0, "menu": "torque", "values": values}
        self.talk.asked = json.dumps(wish)

    def give(self, name, table):
        """Lay a table over the history."""
        content = base64.b64encode(table).decode()
        self.talk.given = json.dumps({"name": name, "content": content})


def test_a_page_computes_the_last_wish_and_goes_on_after_faults(comm):
    visited = Visited(comm)
    exploration, talk, work, ask = visited.exploration, visited.talk, visited.work, visited.ask
    computed, compute = [], exploration.compute

    def counted(texts, assembling, sketch):
        computed.append(texts)
        if texts == {"wear.lower.k": "5"}:
            raise ZeroDivisionError("of a fault in the code")
        return compute(texts, assembling)

    exploration.compute = counted
    assert work()["n"] == 0
    for n in range(1, 9):  # moves while one is computed
        ask(n, **{"wear.lower.k": f"{n}e-8"})
    told = work()
    assert told["n"] == 8
    assert [t["wear.lower.k"] for t in computed if t] == ["8e-8"]
    assert told["controls"]["wear.lower.k"]["value"] == 8e-8
    ask(9, **{"wear.lower.k": "8e-8"})  # nothing to compute
    assert json.loads(talk.told)["n"] == 9
    ask(10, **{"wear.lower.k": "0", "contact.friction": "x"})
    assert work()["faults"] == ["contact.friction = x: must be a number"]
    ask(11, **{"wear.lower.k": "5"})
    assert work()["faults"] == [
        "failed unexpectedly: ZeroDivisionError('of a fault in the code')"
    ]  # fmt: skip
    ask(12)
    told = work()
    assert told["n"] == 12
    assert told["faults"] == []
    visited.page._slow, exploration.compute = True, compute
    talk.asked = json.dumps({**json.loads(talk.asked), "n": 12.5, "moving": True,
                             "values": {"wear.lower.k": "2e-7"}})  # fmt: skip
    assert work()["sketch"] is True
    talk.asked = json.dumps({**json.loads(talk.asked), "n": 12, "moving": False})
    assert work()["sketch"] is False  # the same numbers, but at rest
    visited.page._left(None)
    ask(13, **{"wear.lower.k": "9e-8"})
    assert work()["n"] == 12  # nobody is there to see it


def test_faults_stay_until_numbers_can_be_computed(comm):
    visited = Visited(comm)
    visited.work()
    visited.ask(1, **{"contact.friction": "x"})
    said = ["contact.friction = x: must be a number"]
    told = visited.work()
    assert (told["n"], told["faults"], told["controls"]) == (1, said, {})
    visited.give("a.csv", b"time_s,penetration_um\n1,2\n")  # is no answer, and changes no number
    told = visited.told
    assert (told["n"], told["faults"], told["controls"]) == (None, said, {})
    assert [column["column"] for column in told["laid"]] == ["penetration_um"]
    visited.ask(2)
    told = visited.work()
    assert (told["n"], told["faults"]) == (2, [])
    assert told["controls"]
    visited.ask(3, **{"lower.young": "1e308"})  # whose slider would reach infinity
    visited.work()
    assert "Infinity" not in visited.talk.told


def test_only_answers_have_the_number_of_a_wish(comm):
    visited = Visited(comm)
    visited.work()
    visited.ask(1, **{"wear.lower.k": "3e-8"})
    visited.give("a.csv", b"time_s,penetration_um\n1,2\n")  # while that is computed
    assert visited.told["n"] is None
    assert visited.told["controls"]["wear.lower.k"]["value"] != 3e-8
    told = visited.work()
    assert told["n"] == 1
    assert told["controls"]["wear.lower.k"]["value"] == 3e-8


def test_only_the_case_file_stands_as_the_case_file(comm):
    visited = Visited(comm)
    visited.ask(1, **{"load.omega": "9"})  # before the first history
    told = visited.work()
    assert [row[2] for row in told["numbers"]] == [""] * len(told["numbers"])
    assert "case file" not in told["charts"]["penetration"]["sources"]["lines"]["label"]
    visited.ask(2)
    before = {row[0]: row[1] for row in visited.work()["numbers"]}
    visited.ask(3, **{"load.omega": "9"})
    told = visited.work()
    assert {row[0]: row[2] for row in told["numbers"]} == before
    assert "case file" in told["charts"]["penetration"]["sources"]["lines"]["label"]


def test_a_page_that_is_closed_meanwhile_ends_nothing():
    loop, document, called = IOLoop(make_current=False), Document(), []
    context = SimpleNamespace()
    document._session_context = lambda: context  # as bokeh's server sets it
    session = ServerSession("one", document, io_loop=loop)
    _if_there(document, lambda: called.append(1))
    loop.call_later(0.05, loop.stop)
    loop.start()
    assert called == [1]
    session.destroy()
    _if_there(document, lambda: called.append(2))
    loop.close()
    assert called == [1]


# -- the server ------------------------------------------------------------------------------------


@contextmanager
def served(*words, **options):
    """The command, its address, and an end to it."""
    with subprocess.Popen(
        [*RINGWEAR, "explore", *map(str, words), "--no-browser"],
        env=SHELL_ENVIRONMENT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **options,
    ) as process:  # fmt: skip
        try:
            address = process.stdout.readline().strip()
            assert address.startswith("http://127.0.0.1:"), process.stderr.read()
            yield address, process
        finally:
            process.kill()


async def _answers(address):
    client, codes = AsyncHTTPClient(), {}
    host, token = re.fullmatch(r"http://([^/]+)/([^/]+)/", address).groups()
    wrong = f"{token[:-1]}{'a' if token[-1] != 'a' else 'b'}"
    for prefix in ("", f"{token}/", f"{wrong}/", f"{token[:-1]}/"):
        for name in ("", "ws", "metadata", "autoload.js", "static/js/bokeh.min.js"):
            done = await client.fetch(f"http://{host}/{prefix}{name}", raise_error=False)
            codes[prefix.rstrip("/"), name] = done.code
    page = (await client.fetch(address)).body.decode()
    found = re.search(r'"token":"([^"]+)"', page)[1]
    for origin in (f"http://{host}", "http://evil.example", "null"):
        asked = HTTPRequest(f"ws://{host}/{token}/ws", headers={"Origin": origin})
        with suppress(HTTPClientError):
            socket = await websocket_connect(asked, subprotocols=["bokeh", found])
            codes[origin] = (await asyncio.wait_for(socket.read_message(), 20)) is not None
            socket.close()
    return token, host, codes, page


def test_nobody_gets_anything_without_the_token():
    with served(PAPER, "--set", *SMALL) as (address, process):
        token, host, codes, page = asyncio.run(_answers(address))
        assert len(token) >= 32
        for (prefix, _), code in [(k, v) for k, v in codes.items() if isinstance(k, tuple)]:
            assert (code == 404) is (prefix != token), (prefix, code)
        assert codes[token, ""] == 200
        assert codes[f"http://{host}"] is True
        assert "http://evil.example" not in codes
        assert "null" not in codes
        assert not re.findall(r'(?:src|href)="(?:https?:)?//', page)
        with socket.socket() as other, pytest.raises(ConnectionRefusedError):
            other.connect(("127.0.0.2", int(host.rpartition(":")[2])))
        process.send_signal(signal.SIGINT)
        out, said = process.communicate(timeout=60)
        assert process.returncode == 0
        assert out.splitlines()[-1] == "ringwear explore: ended"
        assert "Traceback" not in said
        assert "ringwear: stopped" not in said


def test_a_port_and_a_signal_while_nobody_looks():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        refused = ringwear("explore", PAPER, "--no-browser", "--port", port)
    assert refused.returncode == 2
    assert sentences(refused) == [
        f"ringwear: --port {port}: Address already in use; must be free, or absent for any that is"
    ]
    with served(PAPER, "--port", port) as (address, process):
        assert address.startswith(f"http://127.0.0.1:{port}/")
        process.send_signal(signal.SIGTERM)
        assert process.wait(60) == 0
        assert process.stderr.read() == ""


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["away.toml"], "away.toml: cannot be read: No such file or directory"),
        ([PAPER, "--port", "70000"], "--port: 70000: must be a whole number up to 65535"),
        ([PAPER, "--set", "lower.young=-1"], "--set lower.young = -1: must be a finite number > 0"),
        ([CASES / "study.toml"], "is a study, not a case"),
    ],
)
def test_what_is_refused(words, said, tmp_path):
    done = ringwear("explore", *words, "--no-browser")
    assert done.returncode == 2
    assert len(sentences(done)) == 1
    assert said in sentences(done)[0]
    if "--port" not in words:  # in the words of run
        run = ringwear("run", *words, "-o", tmp_path / "never.h5")
        assert sentences(done) == sentences(run)


def test_two_ranks_are_refused():
    done = ringwear("explore", PAPER, "--no-browser", ranks=2)
    assert done.returncode == 2
    assert sentences(done) == [
        "ringwear: explore: is started on 2 ranks; must be on one, without mpirun, as one page "
        "computes one history at a time"
    ]


def test_a_missing_package_is_named(monkeypatch, comm):
    from ringwear_par.explorer.server import explore

    for name in [n for n in sys.modules if n.partition(".")[0] == "bokeh"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "bokeh", None)
    with pytest.raises(rw.InputError, match=r"pip install 'ringwear-par\[explore\]'"):
        explore(PAPER, [], comm=comm, browser=False)
