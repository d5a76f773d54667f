"""The explorer's page without a browser: requests, faults, answers."""

import json

import pytest
from bokeh.document import Document
from paths import PAPER

from ringwear_par.explorer.exploring import Exploration
from ringwear_par.explorer.moved_keys import raw_keys
from ringwear_par.explorer.page import Page

SMALL = ["mesh.contact_elements=12", "time.steps=8"]


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
        return json.loads(self.talk.answer)

    def work(self):
        """Do all that is to be done, and return what the page is told then."""
        while self.tasks:
            self.tasks.pop(0)()
            while self.later:
                self.later.pop(0)()
        return self.told

    def request(self, n, values, pinned=None):
        """Ask for other numbers, beside those that are pinned."""
        request = {"n": n, "instant": 1.0, "menu": "torque", "values": values, "pinned": pinned}
        self.talk.request = json.dumps(request)


def test_a_page_computes_the_last_request_and_goes_on_after_faults(comm):
    visited = Visited(comm)
    exploration, work, ask = visited.exploration, visited.work, visited.request
    computed, compute = [], exploration.compute

    def counted(texts, assembling, stops):
        computed.append(texts)
        if texts == {"wear.lower.k": "5"}:
            raise ZeroDivisionError("of a fault in the code")
        return compute(texts, assembling)

    exploration.compute = counted
    assert work()["n"] == 0
    for n in range(1, 9):  # moves while one is computed
        ask(n, {"wear.lower.k": f"{n}e-8"})
    told = work()
    assert told["n"] == 8
    assert [t["wear.lower.k"] for t in computed if t] == ["8e-8"]
    assert told["controls"]["wear.lower.k"]["value"] == 8e-8
    ask(10, {"wear.lower.k": "0", "contact.friction": "x"})
    assert "contact.friction" in work()["faults"][0]
    ask(11, {"wear.lower.k": "5"})
    assert "ZeroDivisionError" in work()["faults"][0]
    ask(12, {})
    told = work()
    assert told["n"] == 12
    assert told["faults"] == []


def test_malformed_requests_are_answered_by_a_sentence(comm):
    visited = Visited(comm)
    visited.work()
    for request in ("{", "{}"):
        visited.talk.answer = ""
        visited.talk.request = request
        assert "cannot be read" in visited.told["faults"][0]
    assert not visited.tasks


def test_a_pinned_variant_stands_beside_the_present_one(comm):
    """Its curves are dashed, and its numbers in a column; a fault marks the field that it is of."""
    visited = Visited(comm)
    visited.request(1, {"load.omega": "9"}, {"load.omega": "6"})  # as an address that is opened
    told = visited.work()
    assert told["compared"] == ["case file", "pinned"]
    lines = told["charts"]["penetration"]["sources"]["lines"]
    ends = {label: y[-1] for label, y in zip(lines["label"], lines["y"], strict=True)}
    assert ends["case file"] < ends["pinned"] < ends["now"]
    assert lines["dash"][lines["label"].index("pinned")] == "dashed"
    name, now, _, of_file, pinned = told["answers"][0]
    assert name == "penetration"
    assert float(pinned) == pytest.approx(ends["pinned"], rel=1e-3)
    assert float(of_file) < float(pinned) < float(now)
    visited.request(2, {"load.omega": "9", "contact.friction": "x"}, {"load.omega": "6"})
    told = visited.work()
    assert told["wrong"] == {"contact.friction": told["faults"][0]}
    visited.request(3, {"load.omega": "9"})
    assert visited.work()["compared"] == ["case file"]
    visited.talk.order = json.dumps({"order": "report"})
    assert visited.work()["report"].startswith("<!DOCTYPE html>")
