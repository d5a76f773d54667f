"""The figure of a measurement: records, block means and the part that numbers are of."""

from collections.abc import Iterator

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from ringwear_par.arrays import FloatArray
from ringwear_par.measuring.analysis.budget import Estimate
from ringwear_par.measuring.analysis.numbers import TestNumbers, friction_readings
from ringwear_par.measuring.analysis.steady_part import Blocks
from ringwear_par.measuring.measure_numbers import estimate_text
from ringwear_par.measuring.measure_result import MeasureResult
from ringwear_par.pictures.matplotlib import panel_grid
from ringwear_par.pictures.panels import GREY, Axis, Band, Curve, Panel, Points
from ringwear_par.pictures.style import COLOURS, STYLE, NotebookFigure
from ringwear_par.results.key_numbers import time_unit

#: inches of a panel, and of a legend above them all
_WIDTH, _HEIGHT, _LEGEND = 3.6, 2.1, 0.35
#: of the range of a record that is left above and below it
_ROOM = 0.05
#: of the largest reading, of a record that is flat
_FLAT = 1e-3
#: of the usual time between block means: where they are further apart nothing was read
_GAP = 3.0
_MICROMETRE = "\N{MICRO SIGN}m"


def plot(result: MeasureResult) -> Figure:
    """Return a row a test: depth and friction over time, with the steady part and its numbers."""
    rows = [list(panels(test)) for test in result.tests]
    size = _WIDTH * max(map(len, rows)), _HEIGHT * len(rows) + _LEGEND
    with matplotlib.rc_context(STYLE):
        chart = NotebookFigure(figsize=size, layout="constrained")
        panel_grid(chart, rows)
    return chart


def panels(test: TestNumbers) -> Iterator[Panel]:
    """Yield the panels of a test: its depth, its friction coefficient, as far as they were read."""
    record = test.test.record
    if record.wear is not None and test.wear_blocks is not None and test.wear_rate is not None:
        rate = test.wear_rate
        start = record.wear[np.isfinite(record.wear)][0]
        words = estimate_text(3.6e6 * rate.value, 3.6e6 * rate.u, f"{_MICROMETRE}/h")
        blocks = Blocks(test.wear_blocks.time, 1e3 * (test.wear_blocks.value - start))
        yield _panel(
            test, 1e3 * (record.wear - start), blocks, rate, 1e3 * rate.value,
            f"worn depth ({_MICROMETRE})", words,
        )  # fmt: skip
    readings = friction_readings(test.test)
    if readings is not None and test.friction_blocks is not None and test.friction is not None:
        friction = test.friction
        words = f"\N{GREEK SMALL LETTER MU} = {estimate_text(friction.value, friction.u)}"
        yield _panel(
            test, readings, test.friction_blocks, friction, 0.0, "friction coefficient", words
        )


def _panel(
    test: TestNumbers,
    readings: FloatArray,
    blocks: Blocks,
    estimate: Estimate,
    slope: float,
    label: str,
    words: str,
) -> Panel:
    """Return the panel of a channel.

    Parameters
    ----------
    readings : (n,) of the record, in the unit of ``label``.
    slope : per s, of the line over the part.
    words : the number that it tells.
    """
    record, part = test.test.record, test.part
    unit, seconds = time_unit(record.end)
    read = readings[np.isfinite(readings)]
    largest = float(np.abs(read).max())
    room = max(_ROOM * float(np.ptp(read)), _FLAT * largest) or 1.0
    low, high = float(read.min()) - room, float(read.max()) + room
    inside = blocks.time >= part.start
    time, level = blocks.time[inside], float(blocks.value[inside].mean())
    ends = np.array([part.start, record.end])
    line = level + slope * (ends - float(time.mean()))
    if slope == 0.0:
        line = np.full(2, estimate.value)
    name = "last third, not steady" if not part.steady else "steady part"
    shade = COLOURS[1] if not part.steady else COLOURS[2]
    return Panel(
        Axis(f"time ({unit})", ends=(0.0, record.end / seconds)), Axis(label, ends=(low, high)),
        f"{test.name}: {words}",
        bands=[
            Band(ends / seconds, np.full(2, low), np.full(2, high), name, ("", ""), shade, 0.15)
        ],
        points=[Points(record.time / seconds, readings, "readings", GREY, 1.8, opacity=0.4)],
        curves=[
            Curve(*_with_gaps(blocks, seconds), "block means", COLOURS[0], width=1.2),
            Curve(ends / seconds, line, "rate, or mean level", COLOURS[4], dash=1, width=2.0),
        ],
    )  # fmt: skip


def _with_gaps(blocks: Blocks, seconds: float) -> tuple[FloatArray, FloatArray]:
    """Return times, in a unit of so many seconds, and values, with a gap where nothing was read."""
    steps = np.diff(blocks.time)
    gaps = np.flatnonzero(steps > _GAP * np.median(steps)) + 1
    return np.insert(blocks.time, gaps, np.nan) / seconds, np.insert(blocks.value, gaps, np.nan)
