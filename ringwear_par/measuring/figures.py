"""The figure of a measurement: records, block means and the part that numbers are of."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from ringwear_par.arrays import FloatArray
from ringwear_par.measuring.measure_numbers import entry_text
from ringwear_par.pictures.matplotlib import panel_figure
from ringwear_par.pictures.panel import GREY, Axis, Band, Curve, Panel, Points
from ringwear_par.pictures.style import COLOURS
from ringwear_par.results.key_numbers import time_unit

#: inches of a panel, and of a legend above them all
_WIDTH, _HEIGHT, _LEGEND = 4.0, 2.1, 0.35
#: share of the range of a record that is left above and below it
_ROOM = 0.05
#: share of the largest reading: the least range of an axis, for records that are flat
_FLAT = 1e-3
#: usual times between block means: where they are further apart nothing was read
_GAP = 3.0
_MICROMETRE = "\N{MICRO SIGN}m"


def plot(tests: Mapping[str, Any]) -> Figure:
    """Return a row a test: depth and friction over time, with the steady part and its numbers."""
    rows = [[*panels(name, entry).values()] for name, entry in tests.items()]
    return panel_figure(rows, (_WIDTH * max(map(len, rows)), _HEIGHT * len(rows) + _LEGEND))


def panels(name: str, entry: Mapping[str, Any]) -> dict[str, Panel]:
    """Return the panels of a test by channel: depth and friction, if they were read.

    Parameters
    ----------
    entry : of the test, as in measure.json.
    """
    channels, charts = entry["channels"], {}
    if "wear" in channels:
        wear, rate = channels["wear"], entry["wear_rate"]
        start = wear["readings"][0]
        readings, means = (1e3 * (np.array(wear[n]) - start) for n in ("readings", "block_means"))
        words = f"{name}: {entry_text(rate, 3.6e6, f'{_MICROMETRE}/h')}"
        charts["wear"] = _panel(
            entry, wear, readings, means, 1e3 * rate["value"], f"worn depth ({_MICROMETRE})", words
        )
    if "friction" in channels:
        friction = channels["friction"]
        readings, means = (np.array(friction[n]) for n in ("readings", "block_means"))
        words = f"{name}: \N{GREEK SMALL LETTER MU} = {entry_text(entry['friction'])}"
        charts["friction"] = _panel(
            entry, friction, readings, means, 0.0, "friction coefficient", words
        )
    return charts


def _panel(
    entry: Mapping[str, Any],
    channel: Mapping[str, Any],
    readings: FloatArray,
    means: FloatArray,
    slope: float,
    label: str,
    title: str,
) -> Panel:
    """Return the panel of a channel.

    Parameters
    ----------
    readings, means : in the unit of ``label``.
    slope : per s, of the line over the part; 0: it is level.
    """
    end, start = float(entry["end"]), float(entry["steady_from"]["value"])
    unit, seconds = time_unit(end)
    room = max(_ROOM * float(np.ptp(readings)), _FLAT * float(np.abs(readings).max())) or 1.0
    low, high = float(readings.min()) - room, float(readings.max()) + room
    time = np.array(channel["block_time"])
    inside = time >= start
    ends = np.array([start, end])
    line = means[inside].mean() + slope * (ends - time[inside].mean())
    if slope == 0.0:
        line = np.full(2, entry["friction"]["value"])
    steady = entry["steady"]
    name = "steady part" if steady else "last third, not steady"
    limits = np.full(2, low), np.full(2, high)
    return Panel(
        Axis(f"time ({unit})", ends=(0.0, end / seconds)), Axis(label, ends=(low, high)), title,
        bands=[Band(ends / seconds, *limits, name, COLOURS[2 if steady else 1], 0.15)],
        points=[
            Points(np.array(channel["time"]) / seconds, readings, "readings", GREY, 2.0)
        ],
        curves=[
            Curve(*_with_gaps(time, means, seconds), "block means", COLOURS[0], width=1.2),
            Curve(ends / seconds, line, "rate, or mean level", COLOURS[4], dash=1, width=2.0),
        ],
    )  # fmt: skip


def _with_gaps(
    time: FloatArray, values: FloatArray, seconds: float
) -> tuple[FloatArray, FloatArray]:
    """Return times, in a unit of so many seconds, and values, with a gap where nothing was read."""
    steps = np.diff(time)
    gaps = np.flatnonzero(steps > _GAP * np.median(steps)) + 1
    return np.insert(time, gaps, np.nan) / seconds, np.insert(values, gaps, np.nan)
