"""What the readings of a running test say so far: in text, as a page."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from ringwear_par.cases.units import in_signs, with_signs
from ringwear_par.errors import counted, warning_lines
from ringwear_par.identification.summary import users_numbers
from ringwear_par.pictures.panel import Axis, Band, Curve, Panel
from ringwear_par.pictures.style import COLOURS
from ringwear_par.prediction.prediction import depth_line
from ringwear_par.reports import blocks
from ringwear_par.results.key_numbers import time_unit, time_words

#: s, after which a browser loads the page of a running test again
_REFRESH = 10


def lines_of(answer: Mapping[str, Any]) -> list[str]:
    """Return the contents of follow.json in lines of text, its warnings last."""
    goal, end, level = answer["goal"], answer["end"], f"{100 * answer['level']:g} %"
    time = f"{time_words(answer['time'], end)} of {time_words(end, end)}"
    lines = [f"{answer['test']}: {counted(answer['readings'], 'reading')} to {time}"]
    for key, entry in answer["keys"].items():
        numbers, unit = users_numbers(entry)
        (low, high), (first, last) = numbers["interval"], numbers["before"]
        estimate = f"{numbers['estimate']:.3g} {unit}".rstrip()
        lines.append(
            f"  {key}  {estimate} of this specimen  from {low:.3g} to {high:.3g} ({level}, "
            f"+-{entry['percent']:.2g} %; before the test {first:.3g} to {last:.3g})"
        )
    expected = f", +-{goal['at_end']:.2g} % is expected there" if goal["time"] is None else ""
    lines.append(f"  {goal['key']} to +-{goal['percent']:g} %: {_left(answer)}{expected}")
    if answer["depth"] is not None:
        lines.append(f"  {depth_line(answer['depth'], end)}")
    return [*lines, *warning_lines(_warnings(answer))]


def _warnings(answer: Mapping[str, Any]) -> list[str]:
    if (alarm := answer["alarm"]) is None:
        return answer["doubts"]
    sentence = (
        f"alarm: readings leave the predicted band from {time_words(alarm['time'], answer['end'])} "
        f"on (p = {alarm['probability']:.1g}): a transition, a layer worn through, or the rig; all "
        "numbers are of the readings before"
    )
    return [sentence, *answer["doubts"]]


def _left(answer: Mapping[str, Any]) -> str:
    """Return how long it takes to the goal, in words."""
    if (time := answer["goal"]["time"]) is None:
        return "not before the end"
    left = time - answer["time"]
    return "reached" if left <= 0.0 else f"in {time_words(left, answer['end'])}"


def page_of(answer: Mapping[str, Any], record: Panel | None) -> blocks.Page:
    """Return the page, which a browser loads anew while the test runs.

    Parameters
    ----------
    record : the readings with their band; None: there is none.
    """
    unit, seconds = time_unit(answer["end"])
    goal, warnings = answer["goal"], _warnings(answer)
    key, level = answer["keys"][goal["key"]], f"{100 * answer['level']:g} %"
    numbers, unit_of_key = users_numbers(key)
    time, *ends = np.array(answer["trace"]).T
    time, (low, median, high) = time / seconds, np.array(ends) / numbers["scale"]
    of_key = Panel(
        Axis(f"time ({unit})"), Axis(f"{goal['key']} ({in_signs(unit_of_key or '1')})"),
        "by the readings until then",
        curves=[Curve(time, median, "median", COLOURS[1], marked=True)],
        bands=[Band(time, low, high, level, ("low", "high"))],
    )  # fmt: skip
    charts = [
        blocks.Chart("key", of_key, f"{goal['key']} and its interval over the time of the test")
    ]
    if record is not None:
        words = "Readings, and histories of this specimen"
        charts.append(blocks.Chart("record", record, words))
    fine, until = answer["alarm"] is None, time_words(answer["time"], answer["end"])
    tiles = [
        blocks.Tile(goal["key"], f"{numbers['estimate']:.3g}", in_signs(unit_of_key),
                    with_signs(f"+-{key['percent']:.2g} %")),
        blocks.Tile(with_signs(f"to +-{goal['percent']:g} %"), _left(answer)),
        blocks.Tile("readings", "as expected" if fine else "alarm",
                    note=f"{answer['readings']} to {until}", good=fine),
    ]  # fmt: skip
    lines = lines_of(answer)[: -len(warnings) or None]
    summary: list[blocks.Block] = [
        blocks.Tiles(tiles),
        blocks.Lines([with_signs(line) for line in lines]),
    ]
    summary += [blocks.Lines(warnings, warning=True)] * bool(warnings)
    software = blocks.software(answer["versions"])
    sections = [
        blocks.Section("Summary", summary), blocks.Section("Over time", [blocks.Charts(charts)]),
        blocks.Section("How to reproduce", [software]),
    ]  # fmt: skip
    refresh = 0 if answer["ended"] else _REFRESH
    return blocks.Page("Running test", answer["test"], sections, refresh=refresh)
