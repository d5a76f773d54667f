"""A prediction in a few lines, and the panel of its band."""

from ringwear_par.arrays import FloatArray
from ringwear_par.errors import warning_lines
from ringwear_par.pictures.panel import Axis, Band, Curve, Panel
from ringwear_par.pictures.style import COLOURS
from ringwear_par.prediction.prediction import Prediction, depth_words
from ringwear_par.results.key_numbers import time_unit, time_words
from ringwear_par.results.variables import DISPLAY_UNITS, HISTORIES

#: of which the summary tells the end, and what it calls them
_ENDS = {
    "penetration": "penetration", "worn_volume_lower": "volume worn off lower",
    "worn_volume_upper": "volume worn off upper", "torque": "torque",
}  # fmt: skip


def summary(prediction: Prediction) -> str:
    """Return the outcome as the command prints it: at the end of the case first."""
    end, lines = float(prediction.time[-1]), []
    for name, words in _ENDS.items():
        low, _, median, _, high = prediction.quantiles(name)[:, -1]
        if high == 0.0 and name != "penetration":
            continue
        unit, factor = DISPLAY_UNITS.get(name, (HISTORIES[name].unit, 1.0))
        unit = unit.replace("\N{MICRO SIGN}", "u")
        first, last, middle = (f"{factor * value:.4g}" for value in (low, high, median))
        spread = "" if first == last else f"  from {first} to {last} {unit}"
        lines.append(f"{words}  {middle} {unit}{spread}")
    lines[0] = f"{lines[0]} (95 %, {prediction.whose}, after {time_words(end, end)})"
    if prediction.depth is not None:
        when = prediction.time_to(prediction.depth)
        lines.append(f"{depth_words(prediction.depth)}: {when.words(end)}")
    lines.append(f"{len(prediction.values)} draws: {'; '.join(prediction.sources)}")
    if prediction.failed:
        lines.append(f"{prediction.failed} draws were left out: they have no history")
    room = 10 - len(lines)
    return "\n".join([*lines, *warning_lines(doubt.text for doubt in prediction.doubts[:room])])


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
