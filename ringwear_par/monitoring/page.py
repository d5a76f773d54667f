"""The page of a running test: a browser loads it anew while the test runs."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.units import in_signs, with_signs
from ringwear_par.identification.definition.problem import Series, records
from ringwear_par.identification.summary import users_numbers
from ringwear_par.monitoring.answer import PREDICTED
from ringwear_par.monitoring.follower import Follower, Specimen
from ringwear_par.pictures.panel import Axis, Band, Curve, Panel, Points
from ringwear_par.pictures.style import COLOURS
from ringwear_par.reports import blocks
from ringwear_par.results.key_numbers import time_unit
from ringwear_par.results.variables import DISPLAY_UNITS

#: quantities of records that are drawn; s, after which a browser loads the page anew
_DRAWN, _REFRESH = ("penetration", "approach", "torque"), 10


def page_of(answer: Mapping[str, Any], follower: Follower, specimen: Specimen) -> blocks.Page:
    """Return the page of an answer, by the draws of the specimen that it is made of."""
    key = answer["goal"]["key"]
    numbers, unit = users_numbers(answer["keys"][key])
    time, *ends = np.array(answer["trace"]).T
    axis, words = Axis(f"{key} ({in_signs(unit or '1')})"), "by the readings until then"
    panel = _panel(answer, axis, words, time, np.array(ends) / numbers["scale"], marked=True)
    charts = [blocks.chart(panel, f"{key} and its interval over the time of the test")]
    known = [one for one in records(specimen.test.series) if one[0].quantity in _DRAWN]
    for series, part in known[:1]:
        panel = _record(answer, follower, specimen, series, part)
        charts.append(blocks.chart(panel, panel.title))
    summary = [blocks.Lines([*map(with_signs, answer["summary"])])]
    if answer["doubts"]:
        summary.append(blocks.Lines([*map(with_signs, answer["doubts"])], warning=True))
    sections = [
        blocks.Section("Summary", summary),
        blocks.Section("Over time", [blocks.Pictures(charts)]),
    ]
    refresh = 0 if answer["ended"] else _REFRESH
    return blocks.Page("Running test", answer["test"], sections, refresh=refresh)


def _record(
    answer: Mapping[str, Any], follower: Follower, specimen: Specimen, series: Series, part: slice
) -> Panel:
    """Return the panel of a record, whose readings are a part of the test's."""
    tail, seconds = 0.5 * (1.0 - answer["level"]), time_unit(answer["end"])[1]
    steps = specimen.some(PREDICTED).v @ follower.columns[follower.places[series.name]].T
    middle = follower.readings(specimen, specimen.test).mean(axis=0)
    added = specimen.likelihood.nuisance_draws(middle[None])[0][0, part]
    symbol, factor = DISPLAY_UNITS.get(series.quantity, ("N mm", 1.0))
    values, name = factor * (series.value - added), "readings, less offset and drift"
    axis = Axis(f"{series.quantity} ({symbol})", zero=True)
    ends = factor * np.quantile(steps, [tail, 0.5, 1.0 - tail], axis=0)
    panel = _panel(answer, axis, "readings, and histories of this specimen", follower.time, ends)
    return replace(panel, points=[Points(series.x / seconds, values, name)])


def _panel(
    answer: Mapping[str, Any],
    axis: Axis,
    words: str,
    time: FloatArray,
    ends: FloatArray,
    *,
    marked: bool = False,
) -> Panel:
    """Return the panel of a median and its band (3, t) over time (t,) s."""
    (unit, seconds), (low, median, high) = time_unit(answer["end"]), ends
    time = time / seconds
    return Panel(
        Axis(f"time ({unit})"), axis, words,
        curves=[Curve(time, median, "median", COLOURS[1], marked=marked)],
        bands=[Band(time, low, high, f"{100 * answer['level']:g} %")],
    )  # fmt: skip
