"""The figure of a prediction: the penetration over time, its median and its bands."""

from matplotlib.figure import Figure

from ringwear_par.arrays import FloatArray
from ringwear_par.pictures.matplotlib import panel_figure
from ringwear_par.pictures.panel import Axis, Band, Curve, Panel
from ringwear_par.pictures.style import COLOURS
from ringwear_par.prediction.prediction import Prediction
from ringwear_par.results.key_numbers import time_unit
from ringwear_par.results.variables import DISPLAY_UNITS

#: inches of the figure
_SIZE = (4.6, 3.4)


def panel(time: FloatArray, quantiles: FloatArray, of: str) -> Panel:
    """Return the panel of the penetration: median, bands of 50 and 95 % of the draws.

    Parameters
    ----------
    time : (steps,) float, s.
    quantiles : (5, steps) float, mm, at ``PROBABILITIES``.
    of : title.
    """
    unit, seconds = time_unit(float(time[-1]))
    depth, factor = DISPLAY_UNITS["penetration"]
    low, lower, median, upper, high = factor * quantiles
    time = time / seconds
    return Panel(
        Axis(f"time ({unit})", zero=True), Axis(f"penetration ({depth})", zero=True), of,
        curves=[Curve(time, median, "median", COLOURS[1], width=1.8)],
        bands=[
            Band(time, low, high, "95 %", ("2.5 %", "97.5 %"), COLOURS[0], 0.18),
            Band(time, lower, upper, "50 %", ("25 %", "75 %"), COLOURS[0], 0.35),
        ],
    )  # fmt: skip


def plot(prediction: Prediction) -> Figure:
    """Return the figure of ``panel``."""
    band = panel(prediction.time, prediction.quantiles(), prediction.whose)
    return panel_figure([[band]], _SIZE)
