"""What the readings of a running test say so far: in text, as a page."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from ringwear_par.cases.units import in_signs, with_signs
from ringwear_par.errors import counted
from ringwear_par.identification.summary import users_numbers
from ringwear_par.pictures.panel import Axis, Band, Curve, Panel
from ringwear_par.pictures.style import COLOURS
from ringwear_par.prediction.prediction import TimeTo, depth_words
from ringwear_par.reports import blocks
from ringwear_par.results.key_numbers import time_unit, time_words

#: contents of follow.json
Answer = Mapping[str, Any]
#: s, after which a browser loads the page of a running test again
_REFRESH = 10


def lines_of(answer: Answer) -> list[str]:
    """Return an answer in lines of text, without warnings."""
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
        depth, *when = answer["depth"].values()
        lines.append(f"  {depth_words(depth)}: {TimeTo(*when).words(end)}")
    if answer["laws"]:
        shares = [
            f"{law} {_percent(now)} (before the test {_percent(before)})"
            for law, (before, now) in answer["laws"].items()
        ]
        lines.append(f"  probability of laws: {', '.join(shares)}")
    return lines


def warnings_of(answer: Answer) -> list[str]:
    """Return what speaks against the numbers, the alarm first."""
    alarm, words = answer["alarm"], []
    if alarm is not None:
        words = [
            "alarm: readings leave the predicted band from "
            f"{time_words(alarm['time'], answer['end'])} on (p = {alarm['probability']:.1g}): a "
            "transition, a layer worn through, or the rig; all numbers are of the readings before"
        ]
    return [*words, *answer["doubts"]]


def _left(answer: Answer) -> str:
    """Return how long it takes to the goal, in words."""
    if (time := answer["goal"]["time"]) is None:
        return "not before the end"
    left = time - answer["time"]
    return "reached" if left <= 0.0 else f"in {time_words(left, answer['end'])}"


def _percent(probability: float) -> str:
    return "< 0.1 %" if probability < 1e-3 else f"{100.0 * probability:.3g} %"


def page_of(
    answer: Answer, record: Panel | None, command: str, versions: Mapping[str, str]
) -> blocks.Page:
    """Return the page, which a browser loads anew while the test runs.

    Parameters
    ----------
    record : the readings with their band; None: there is none.
    """
    unit, seconds = time_unit(answer["end"])
    goal, key, warnings = answer["goal"], answer["keys"][answer["goal"]["key"]], warnings_of(answer)
    axis, level = Axis(f"time ({unit})"), f"{100 * answer['level']:g} %"
    numbers, unit_of_key = users_numbers(key)
    time, low, median, high, *shares = np.array(answer["trace"]).T
    time, scale = time / seconds, numbers["scale"]
    of_key = Panel(
        axis, Axis(f"{goal['key']} ({in_signs(unit_of_key or '1')})"),
        "by the readings until then",
        curves=[Curve(time, median / scale, "median", COLOURS[1], marked=True)],
        bands=[Band(time, low / scale, high / scale, level, ("low", "high"))],
    )  # fmt: skip
    charts = [
        blocks.Chart("key", of_key, f"{goal['key']} and its interval over the time of the test")
    ]
    if answer["laws"]:
        curves = [
            Curve(time, (100.0 * share).round(1), law, COLOURS[i % len(COLOURS)],
                  i // len(COLOURS), marked=True)
            for i, (law, share) in enumerate(zip(answer["laws"], shares, strict=True))
        ]  # fmt: skip
        of_laws = Axis("probability of the law (%)", (-3.0, 103.0))
        panel = Panel(axis, of_laws, "laws, by the readings until then", curves=curves)
        words = "Probability of each law over the time of the test"
        charts.append(blocks.Chart("laws", panel, words))
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
    lines = blocks.Lines([with_signs(line) for line in lines_of(answer)])
    summary: list[blocks.Lines | blocks.Tiles] = [blocks.Tiles(tiles), lines]
    summary += [blocks.Lines(warnings, warning=True)] * bool(warnings)
    source, software = blocks.Source("Command", command), blocks.software(dict(versions))
    sections = [
        blocks.Section("Summary", summary),
        blocks.Section("Over time", [blocks.Charts(charts)]),
        blocks.Section("How to reproduce", [source, software]),
    ]
    refresh = 0 if answer["ended"] else _REFRESH
    return blocks.Page("Running test", answer["test"], sections, refresh=refresh)
