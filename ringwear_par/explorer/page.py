"""A page of the explorer: what it asks for is computed, the last request first, then drawn."""

import base64
import binascii
import json
import logging
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from importlib.resources import files
from itertools import count, groupby
from typing import Any

import jinja2
from bokeh.core.properties import String
from bokeh.model import DataModel
from markupsafe import Markup

from ringwear_par.cases.units import in_signs, with_signs
from ringwear_par.cases.values import is_number
from ringwear_par.errors import InputError, RingwearError, reason_of
from ringwear_par.explorer.controls import Control
from ringwear_par.explorer.exploring import Exploration, Explored
from ringwear_par.explorer.figures import CASE_FILE, MENU, PINNED, Drawing, figures
from ringwear_par.explorer.measured import LARGEST, MeasuredColumn, read_table
from ringwear_par.pictures.rig import rig_address
from ringwear_par.reports.report import html_text
from ringwear_par.reports.run_page import answers, key_rows, run_page
from ringwear_par.results.key_numbers import KeyNumber, key_numbers
from ringwear_par.results.result import Result
from ringwear_par.results.variables import DISPLAY_UNITS
from ringwear_par.version import __version__

log = logging.getLogger(__name__)

#: groups of controls that are folded at first
_FOLDED = ("Shape",)
#: what the page asks for at first
_START: dict[str, Any] = {"n": 0, "values": {}, "instant": 1.0, "menu": "volume",
                          "moving": False, "pinned": None}  # fmt: skip
#: s between messages on how far a history is
_PROGRESS = 0.2
_STOPPED = "stopped before its end; it is computed again once a number is changed"
_BAD_REQUEST = "the page sent a request that cannot be read; load it again"


class Talk(DataModel):  # type: ignore[misc]
    """The messages between a page and its server, in JSON.

    ``request`` (numbers by the names of controls and whether one is moving, those that are pinned,
    the time and chart chosen), ``order`` (to stop what is computed, or to make a report) and
    ``table`` (a table of measurements, or what its columns are) come from the page, ``answer`` goes
    to it: all that is seen of a history in one message, so that figures are painted once. The ``n``
    of a request comes back with its answer, and with nothing else.
    """

    request = String(default="")
    order = String(default="")
    table = String(default="")
    answer = String(default="")


class Page:
    """The page of one visitor. Its methods are of the server's thread, but for ``_compute``.

    Parameters
    ----------
    document : of bokeh, to be filled.
    exploration : of the case; used by the main thread.
    title : of the page.
    hosts : under which it is served, with the port.
    put : gives the main thread something to do.
    later : gives the server's thread something to do with the document, if it is still there.
    """

    def __init__(
        self,
        document: Any,
        exploration: Exploration,
        title: str,
        hosts: Sequence[str],
        put: Callable[[Callable[[], None]], None],
        later: Callable[[Callable[[], None]], None],
    ) -> None:
        self._exploration, self._put, self._later = exploration, put, later
        self._talk = Talk(name="talk")
        self._wanted: dict[str, Any] = dict(_START)
        self._computing = self._wanted
        self._document, self._busy, self._gone = document, False, False
        #: time of the last message on how far a history is
        self._progress_time = 0.0
        #: what is drawn, the request that it answers, and what it is compared with: numbers and
        #: their history, None where they have none
        self._explored: Explored | None = None
        self._drawn: dict[str, Any] | None = None
        self._references: dict[str, tuple[dict[str, str], Explored | None]] = {}
        #: whether the visitor wants what is computed no more
        self._stopped = False
        #: why the last request could not be computed
        self._faults: tuple[str, ...] = ()
        #: by numbers that stay theirs
        self._laid: dict[int, MeasuredColumn] = {}
        self._numbers = count()
        self._seconds = 0.0
        for root in (*figures(), self._talk):
            document.add_root(root)
        document.title = f"{title} \N{EN DASH} ringwear explore"
        document.template = _template()
        document.template_variables.update(_variables(exploration, title, hosts))
        document.on_session_destroyed(self._left)
        self._talk.on_change("request", lambda _, __, new: self._ask(_message(new)))
        self._talk.on_change("order", lambda _, __, new: self._obey(_message(new)))
        self._talk.on_change("table", lambda _, __, new: self._give(_message(new)))
        self._start()

    def _left(self, _: Any) -> None:
        self._gone = True

    @property
    def _left_alone(self) -> bool:
        """Whether nobody sees the page: its socket is closed, or not open yet."""
        context = self._document.session_context
        session = None if context is None else context.session
        return self._gone or (session is not None and not session.connection_count)

    def _stops(self, fraction: float) -> bool:
        """Tell the page how far a history is; return whether to stop it. In the main thread."""
        # what the page shows of the same history needs no other
        another = self._wanted["values"] != self._computing["values"]
        if self._stopped or self._left_alone or (another and not self._wanted["moving"]):
            return True
        now = time.perf_counter()
        if now - self._progress_time > _PROGRESS:
            self._progress_time = now
            self._later(lambda: self._tell({"progress": fraction}))
        return False

    # -- histories ---------------------------------------------------------------------------------

    def _ask(self, request: dict[str, Any]) -> None:
        """Take a request; it replaces one whose computation has not begun."""
        if fault := _request_fault(request):
            self._tell({"n": request.get("n"), "faults": [fault]})
            return
        self._wanted = request
        if self._busy:
            return
        drawn = self._drawn
        if drawn is not None and all(request[name] == drawn[name] for name in ("values", "pinned")):
            self._draw(request["n"])
        else:
            self._start()

    def _obey(self, order: dict[str, Any]) -> None:
        """Stop what is computed, or make the report of what is drawn."""
        if order.get("order") == "stop":
            self._stopped = self._busy
        elif order.get("order") == "report" and self._explored is not None:
            self._put(self._report)

    def _report(self) -> None:
        """Make the report of what is drawn. In the main thread."""
        assert self._explored is not None
        text = html_text(run_page(self._explored.result))
        self._later(lambda: self._tell({"report": text}))

    def _start(self) -> None:
        self._busy, self._stopped = True, False
        self._put(self._compute)

    def _compute(self) -> None:
        """Compute what is wanted. In the main thread."""
        if self._left_alone:  # a page whose socket opens asks again
            self._busy = False
            return
        request, started = self._wanted, time.perf_counter()
        self._computing, self._progress_time = request, started
        outcome: Explored | tuple[str, ...] | None
        outcome, references = None, self._references
        try:
            compared = self._compared(request)
            if compared is not None:
                references, outcome = compared, self._history(request["values"])
        except InputError as error:
            outcome = error.faults
        except RingwearError as error:
            outcome = (str(error),)
        except Exception as error:  # the page goes on; the terminal has the traceback
            log.exception("a history failed unexpectedly")
            outcome = (f"failed unexpectedly: {reason_of(error)}",)
        seconds = time.perf_counter() - started
        self._later(lambda: self._computed(request, outcome, references, seconds))

    def _history(self, values: dict[str, str]) -> Explored | None:
        """Return the history of some numbers, None if it was stopped. In the main thread."""
        computed = [(self._drawn["values"], self._explored)] if self._drawn is not None else []
        for numbers, explored in (*computed, *self._references.values()):
            if numbers == values and explored is not None:
                return explored
        return self._exploration.compute(values, self._assembling, stops=self._stops)

    def _compared(
        self, request: dict[str, Any]
    ) -> dict[str, tuple[dict[str, str], Explored | None]] | None:
        """Return the histories that a request is compared with, None if one was stopped.

        In the main thread.
        """
        numbers = {CASE_FILE: {}, PINNED: request["pinned"]}
        references = {}
        for name, values in numbers.items():
            if values is None or values == request["values"]:
                continue
            old = self._references.get(name)
            if old is None or old[0] != values:
                try:
                    explored = self._history(values)
                    if explored is None:
                        return None
                except RingwearError:  # there is nothing to compare with
                    explored = None
                old = values, explored
            references[name] = old
        return references

    def _assembling(self) -> None:
        """Say that the bodies are assembled. In the main thread."""
        self._later(lambda: self._tell({"assembling": True}))

    def _computed(
        self,
        request: dict[str, Any],
        outcome: Explored | tuple[str, ...] | None,
        references: dict[str, tuple[dict[str, str], Explored | None]],
        seconds: float,
    ) -> None:
        self._busy = False
        if outcome is None and self._stopped and self._wanted is request:
            outcome = (_STOPPED,)
        if outcome is None:  # nobody is there, or wants something else
            if self._wanted is not request:
                self._ask(self._wanted)
            return
        if isinstance(outcome, Explored):
            self._explored, self._drawn, self._faults = outcome, request, ()
            self._references = references
            self._seconds = seconds
            if not request["values"]:  # kept for later
                self._references = {CASE_FILE: ({}, outcome), **references}
        else:
            self._drawn, self._faults = None, outcome
        self._draw(request["n"])
        if self._wanted is not request:
            self._ask(self._wanted)

    # -- measurements ------------------------------------------------------------------------------

    def _give(self, table: dict[str, Any]) -> None:
        """Take a table, another meaning of a column, or take a column away."""
        fault, number = "", table.get("number", -1)
        if not isinstance(number, int):
            self._draw(fault="the page sent a message that is no table; load it again")
            return
        try:
            if "content" in table:
                fault = self._add(str(table["name"]), str(table["content"]))
            elif table.get("remove"):
                self._laid.pop(number, None)
            elif number in self._laid and table.get("quantity") in self._laid[number].choices:
                self._laid[number] = replace(self._laid[number], quantity=table["quantity"])
        except InputError as error:
            fault = " ".join(error.faults)
        self._draw(fault=fault)

    def _add(self, name: str, content: str) -> str:
        if self._explored is None:
            return f"{name}: is laid over a history; there must be one first"
        try:
            table = base64.b64decode(content, validate=True)
        except binascii.Error:
            return f"{name}: has not arrived whole"
        columns = read_table(table, name, self._explored.case)
        self._laid.update((next(self._numbers), column) for column in columns)
        return ""

    # -- what is seen ------------------------------------------------------------------------------

    def _draw(self, n: int | None = None, fault: str = "") -> None:
        """Draw what is computed, and tell its numbers.

        Parameters
        ----------
        n : of the request that is answered.
        fault : of a table.
        """
        explored = self._explored
        if explored is None:
            laid = {"laid": [], "laid_fault": fault}
            answer = {"n": n, "faults": self._faults, "wrong": self._wrong()}
            self._tell({**answer, **(laid if fault else {})})
            return
        request, result, faults = self._wanted, explored.result, [fault] if fault else []
        good, columns = [], []
        for number, column in self._laid.items():
            off = None
            try:
                off = column.off(result, column.values(explored.case, result))
                good.append(column)
                faults += column.assumptions
            except InputError as error:
                faults += error.faults
            columns.append({"number": number, **_column(column, off)})
        menu = request["menu"] if request["menu"] in MENU else _START["menu"]
        references = {
            name: stored.result
            for name, (_, stored) in self._references.items()
            if stored is not None
        }
        compared = {
            name: reference for name, reference in references.items() if reference is not result
        }
        drawing = Drawing(result, compared, explored.case, float(request["instant"]), menu, good)
        numbers = key_numbers(result)
        self._tell(
            {
                "n": n, "faults": self._faults,
                # those that cannot be computed stay as the user has them
                "controls": {} if self._faults else _states(explored.controls.values()),
                "doubts": [with_signs(doubt.text) for doubt in result.doubts],
                "summary": with_signs(result.summary()), "case": explored.text,
                # sliders that move wait for no drawing
                "rig": "" if request["moving"] else rig_address(explored.case),
                "wrong": self._wrong(), "compared": list(references),
                "numbers": _beside(key_rows, numbers, references),
                "answers": _beside(
                    lambda numbers: [(t.label, t.value, t.unit) for t in answers(numbers)],
                    numbers, references,
                ),
                "chosen": drawing.chosen_time, "charts": drawing.columns(), "laid": columns,
                "laid_fault": ". ".join(dict.fromkeys(faults)), "seconds": self._seconds,
            }
        )  # fmt: skip

    def _wrong(self) -> dict[str, str]:
        """Return the faults of numbers that were moved, by their names."""
        controls = self._exploration.controls
        moved = [controls[name] for name in self._wanted["values"] if name in controls]
        return {
            control.name: fault
            for control in moved
            for fault in self._faults
            if control.name in fault or control.path in fault
        }

    def _tell(self, answer: dict[str, Any]) -> None:
        self._talk.answer = json.dumps(answer)


def _beside(
    rows_of: Callable[[list[KeyNumber]], list[tuple[str, str, str]]],
    numbers: list[KeyNumber],
    references: Mapping[str, Result],
) -> list[tuple[str, ...]]:
    """Return rows of name, value, unit, and the values of other histories."""
    beside = [
        {name: value for name, value, _ in rows_of(key_numbers(reference))}
        for reference in references.values()
    ]
    return [(*row, *(values.get(row[0], "") for values in beside)) for row in rows_of(numbers)]


def _message(text: str) -> dict[str, Any]:
    """Return a message of the page; an empty one if it is none."""
    try:
        message = json.loads(text)
    except (ValueError, RecursionError):
        return {}
    return message if isinstance(message, dict) else {}


def _request_fault(request: dict[str, Any]) -> str:
    """Return the fault of a request, "" for none."""
    values, instant = request.get("values"), request.get("instant", -1.0)
    good = (
        _are_texts(values)
        and is_number(request.get("n"))
        and is_number(instant)
        and 0.0 <= float(instant) <= 1.0
        and isinstance(request.get("menu"), str)
        and _are_texts(request.setdefault("pinned", None) or {})
    )
    request.setdefault("moving", False)
    return "" if good else _BAD_REQUEST


def _are_texts(values: Any) -> bool:
    return isinstance(values, dict) and all(isinstance(text, str) for text in values.values())


def _column(column: MeasuredColumn, off: float | None) -> dict[str, Any]:
    """Return the entries of the page about a column that is laid over it."""
    far = ""
    if off is not None:
        kind = column.quantity.partition(".")[0]
        cubic = "mm\N{SUPERSCRIPT THREE}", 1.0
        units = {**DISPLAY_UNITS, "volume": cubic, "mass": cubic}
        unit, factor = units.get(kind, ("\N{MICRO SIGN}m", 1e3))
        far = f"{factor * off:.3g} {unit}"
    return {
        "file": column.file, "column": column.column, "quantity": column.quantity,
        "unit": in_signs(column.unit), "choices": list(column.choices), "readings": len(column.x),
        "off": far,
    }  # fmt: skip


def _states(controls: Any) -> dict[str, dict[str, Any]]:
    """Return how controls stand, by name."""
    return {
        c.name: {"text": c.text, "value": c.value, "low": c.low, "high": c.high, "step": c.step}
        for c in controls
    }


@cache
def _template() -> jinja2.Template:
    surroundings = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined)
    surroundings.filters["in_signs"] = in_signs
    return surroundings.from_string(_part("explore.html"))


def _part(name: str, room: str = "ringwear_par.explorer", folder: str = "parts") -> str:
    return (files(room) / folder / name).read_text(encoding="utf-8")


def _variables(exploration: Exploration, title: str, hosts: Sequence[str]) -> dict[str, Any]:
    """Return the values of the template, beside those of bokeh."""

    def group(control: Control) -> str:
        return control.group

    return {
        "case_name": title, "case_title": exploration.title, "version": __version__,
        "sockets": " ".join(f"ws://{host}" for host in hosts),
        "groups": [
            (name, name.startswith(_FOLDED), list(controls))
            for name, controls in groupby(exploration.controls.values(), group)
        ],
        "menu": {name: label for name, label in MENU.items()
                 if name != "through" or exploration.layered},
        "start": _START, "largest": LARGEST,
        "style": Markup(_part("page.css", "ringwear_par.reports", "page")
                        + _part("explore.css")),
        "script": Markup(_part("explore.js")),
    }  # fmt: skip
