"""The page of a case with sliders, of widgets of Bokeh, and the histories that it shows."""

import base64
from collections.abc import Mapping
from contextlib import suppress
from html import escape
from typing import Any

import numpy as np
from bokeh.layouts import column, row
from bokeh.models import (
    Button,
    ColumnDataSource,
    CustomJS,
    Div,
    FileInput,
    Select,
    Slider,
    TextInput,
)
from mpi4py import MPI

from ringwear_par.cases.case import Case
from ringwear_par.cases.files.keys import override, read_keys
from ringwear_par.cases.files.reading import make_case
from ringwear_par.cases.units import in_signs, with_signs
from ringwear_par.errors import InputError, RingwearError
from ringwear_par.explorer import charts
from ringwear_par.explorer.numbers import Number, numbers_of
from ringwear_par.explorer.readings import Readings, read_readings
from ringwear_par.history.refusals import check_case
from ringwear_par.pictures.run_panels import HISTORY_PANELS
from ringwear_par.reports.report import html_text
from ringwear_par.reports.run_page import answers, run_page
from ringwear_par.results.key_numbers import key_numbers, time_words
from ringwear_par.results.result import FailedResult, Result
from ringwear_par.studies.many import simulate_all

#: about how many states of fixed steps are kept: more would not be seen
_STATES = 400
#: ms within which moves of a slider are one
_PAUSE = 30
CASE_FILE, PINNED = "case file", "pinned"
_SAVE = """const link = document.createElement("a");
link.href = URL.createObjectURL(new Blob([file.data.text[0]]));
link.download = file.data.name[0];
link.click();"""


def history_of(case: Case, comm: MPI.Comm) -> Result:
    """Return the history of a case with all profiles and without stresses.

    Times of output stay: steps end there.

    Raises
    ------
    ComputationError : it fails.
    """
    changes: dict[str, Any] = {
        "output.fields": None, "output.profiles": None, "output.boundary": None, "stress": None,
    }  # fmt: skip
    if not case.output.times:
        every = 1 if case.time.adaptive else max(1, case.time.steps // _STATES)
        changes["output.every"] = every
    (result,) = simulate_all([case.replace(changes)], comm)
    if isinstance(result, FailedResult):
        raise result.error
    return result


class Explorer:
    """The page of one visitor: widgets, charts, and the histories that they show.

    Parameters
    ----------
    base, result : the case as its file has it, and its history, see ``history_of``.
    name : of the file.
    comm : communicator of one rank.
    """

    def __init__(self, base: Case, result: Result, name: str, comm: MPI.Comm) -> None:
        self._comm, self._name = comm, name
        self._keys = read_keys(base.text)
        self.numbers = {number.name: number for number in numbers_of(self._keys)}
        #: texts of numbers that were moved, by name
        self.moved: dict[str, str] = {}
        self.case, self.result = base, result
        self.others: dict[str, Result] = {CASE_FILE: self.result}
        self.readings: list[Readings] = []
        self._widgets: dict[str, tuple[Slider, TextInput]] = {}
        self._document: Any = None
        self._computing: Any = None
        self._make_widgets()
        self.draw()

    # -- histories ---------------------------------------------------------------------------------

    def compute(self) -> None:
        """Compute the history of the present numbers, and draw it; else say why it cannot be."""
        self._computing = None
        try:
            keys = override(self._keys, {name: _raw(number) for name, number in self.moved.items()})
            case = make_case(keys, self._name)
            check_case(case, 1, self._name)
            self.case, self.result = case, history_of(case, self._comm)
        except RingwearError as error:
            last = "The charts still show the last case that could be computed."
            self.status.text = f"{_list(str(error).splitlines(), '#b34700')}{last}"
            return
        self.status.text = ""
        self.draw()

    def move(self, name: str, text: str) -> None:
        """Change a number; moves that follow at once are one."""
        self.moved[name] = text
        if self._document is None:
            self.compute()
        elif self._computing is None:
            self.status.text = "Computing \N{HORIZONTAL ELLIPSIS}"
            self._computing = self._document.add_timeout_callback(self.compute, _PAUSE)

    def reset(self) -> None:
        """Go back to the numbers of the case file."""
        for name in [*self.moved]:
            number, (slider, field) = self.numbers[name], self._widgets[name]
            slider.value, field.value = number.position(number.value), f"{number.value:.10g}"
        self.moved.clear()
        if self._computing is not None:  # the widgets have asked for it
            self._document.remove_timeout_callback(self._computing)
        self.compute()

    def pin(self) -> None:
        """Keep the present history to compare with, or no longer the one that is kept."""
        if self.others.pop(PINNED, None) is None:
            self.others[PINNED] = self.result
        self._pin.label = "Unpin" if PINNED in self.others else "Pin"
        self.draw()

    def lay(self, content: bytes, name: str) -> None:
        """Draw the readings of a table in the charts, in the place of those before."""
        body = "upper" if self.case.wear_lower is None and self.case.wear_upper else "lower"
        try:
            self.readings = read_readings(content, name, body)
            self._about_readings.text = ""
        except InputError as error:
            self.readings = []
            self._about_readings.text = _list(error.faults, "#b34700")
        for panel in [one.panel for one in self.readings if one.panel in self._menu.options]:
            self._menu.value = panel
        self.draw()

    # -- the page ----------------------------------------------------------------------------------

    def open(self, document: Any) -> None:
        """Fill a document of bokeh."""
        self._document = document
        document.title = f"{self._name} \N{EN DASH} ringwear explore"
        for root in (self.layout, self._file):
            document.add_root(root)

    def _make_widgets(self) -> None:
        """Make the widgets of the page, and its layout."""
        self.status, self.table = Div(name="status"), Div(name="numbers")
        self.text = Div(sizing_mode="stretch_width")
        self.charts = {name: charts.Chart() for name in ("wear", "pressure", "left", "right")}
        self._instant = Slider(title="Time of the thick line, share of the end", start=0, end=1,
                               step=0.005, value=1, show_value=False,
                               sizing_mode="stretch_width")  # fmt: skip
        options = [name for name in HISTORY_PANELS if name != "penetration"]
        if not self.result.layers:
            options.remove("through")
        self._menu = Select(title="Second chart over time", value="volume", options=options)
        for widget in (self._instant, self._menu):
            widget.on_change("value", lambda _, __, ___: self.draw())
        self._file = ColumnDataSource({"name": [], "text": []})
        self._file.js_on_change("data", CustomJS(args={"file": self._file}, code=_SAVE))
        buttons = []
        for label, function in (
            ("Reset", self.reset), ("Pin", self.pin),
            ("Save case", lambda: self._save("explored.toml", self.case.text)),
            ("Save page", lambda: self._save("report.html", html_text(run_page(self.result)))),
        ):  # fmt: skip
            buttons.append(Button(label=label, width=75))
            buttons[-1].on_click(function)
        self._pin = buttons[1]
        table, self._about_readings = FileInput(accept=".csv,.txt,.tsv,.dat"), Div()
        # its name comes after its content
        table.on_change("value", lambda _, __, new: self._document.add_next_tick_callback(
            lambda: self.lay(base64.b64decode(new), table.filename)))  # fmt: skip
        controls: list[Any] = [Div(text=f"<h2>{escape(self._name)}</h2>"), row(*buttons)]
        controls += [self.status, self.table]
        groups = dict.fromkeys(number.group for number in self.numbers.values())
        for group in groups:
            controls.append(Div(text=f"<b>{group}</b>"))
            controls += [self._slider(n) for n in self.numbers.values() if n.group == group]
        figures = [chart.figure for chart in self.charts.values()]
        hint = Div(
            text="<b>Measurements</b>: a CSV file with a column of times (time_s) or radii (r_mm) "
            "and others such as penetration_um, torque_Nm, depth_lower_um"
        )
        self.layout = row(
            column(*controls, width=350),
            column(
                row(self._instant, self._menu, sizing_mode="stretch_width"),
                row(*figures[:2], sizing_mode="stretch_width"),
                row(*figures[2:], sizing_mode="stretch_width"),
                hint, table, self._about_readings, self.text, sizing_mode="stretch_width",
                margin=(0, 30, 0, 10),
            ),
            sizing_mode="stretch_width",
        )  # fmt: skip

    def _slider(self, number: Number) -> Any:
        """Return the slider of a number, and the field beside it for any value."""
        slider = Slider(
            title=number.label, show_value=False, width=230, value=number.position(number.value),
            start=number.position(number.low), end=number.position(number.high), step=number.step,
        )  # fmt: skip
        field = TextInput(
            name=number.name, value=f"{number.value:.10g}", width=90, align="end"
        )  # fmt: skip
        self._widgets[number.name] = slider, field

        def stands_there() -> bool:
            """Whether the slider is where the field says, up to its step."""
            value = number.read(field.value)
            return value is not None and abs(number.position(value) - slider.value) < number.step

        def slid(_: str, __: float, new: float) -> None:
            if not stands_there():
                field.value = number.text(new)

        def typed(_: str, __: str, new: str) -> None:
            value = number.read(new)
            if value is not None and not stands_there():
                at = number.position(value)
                slider.update(start=min(slider.start, at), end=max(slider.end, at), value=at)
            self.move(number.name, new)

        slider.on_change("value", slid)
        field.on_change("value", typed)
        return row(slider, field)

    def _save(self, name: str, text: str) -> None:
        """Have the browser save a file."""
        self._file.data = {"name": [name], "text": [text]}

    def draw(self) -> None:
        """Draw the histories, and write their numbers."""
        result, time = self.result, self.result.histories["time"]
        others = {name: other for name, other in self.others.items() if other is not result}
        at = int(np.abs(time - self._instant.value * time[-1]).argmin())
        self._instant.title = f"Time of the thick line: {time_words(time[at], float(time[-1]))}"
        self.charts["wear"].show(charts.wear(result, others, at, self.readings))
        self.charts["pressure"].show(charts.pressure(result, at))
        self.charts["left"].show(charts.history(result, others, "penetration", self.readings))
        self.charts["right"].show(charts.history(result, others, self._menu.value, self.readings))
        self.table.text = _numbers_table(result, others)
        if self.readings:
            self._about_readings.text = _list(
                [f"{one.name}: {len(one.x)} readings, {one.distance(result):.3g} (root mean "
                 "square, in mm, N mm or mm\N{SUPERSCRIPT THREE}) from the curve"
                 for one in self.readings]
            )  # fmt: skip
        self.text.text = (
            f"{_list([with_signs(doubt.text) for doubt in result.doubts], '#b34700')}"
            f"<h3>Summary</h3><pre>{escape(with_signs(result.summary()))}</pre>"
            f"<h3>The case file, as it stands</h3><pre>{escape(self.case.text)}</pre>"
        )


def _raw(text: str) -> Any:
    """Return the raw value of a text: a number, or a text with its unit."""
    for number in (int, float):
        with suppress(ValueError):
            return number(text)
    return text


def _list(lines: Any, colour: str = "inherit") -> str:
    items = "".join(f"<li>{escape(line)}</li>" for line in lines)
    return f"<ul style='color: {colour}'>{items}</ul>" if items else ""


def _numbers_table(result: Result, others: Mapping[str, Result]) -> str:
    """Return the table of the key numbers of a history and of others."""
    columns = [answers(key_numbers(one)) for one in (result, *others.values())]
    values = [{tile.label: tile.value for tile in tiles} for tiles in columns]
    heads = "".join(f"<th>{name}" for name in ("at the end", "", "now", *others))
    rows = "".join(
        f"<tr><td>{escape(tile.label)}<td>{in_signs(tile.unit)}"
        + "".join(f"<td align='right'>{of.get(tile.label, '')}" for of in values)
        for tile in columns[0]
    )
    return f"<table style='font-size: 13px'><tr>{heads}{rows}</table>"
