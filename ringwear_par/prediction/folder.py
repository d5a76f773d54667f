"""A prediction in a few lines, and its folder: numbers, all draws, the picture of its band."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from ringwear_par.arrays import FloatArray
from ringwear_par.errors import warning_lines
from ringwear_par.files.folders import (
    BAND,
    DRAWS,
    PREDICTION,
    json_bytes,
    new_files,
    write_contents,
)
from ringwear_par.pictures.matplotlib import panel_figure
from ringwear_par.pictures.panel import Axis, Band, Curve, Panel
from ringwear_par.pictures.style import COLOURS, picture
from ringwear_par.prediction.prediction import PROBABILITIES, Prediction, depth_words
from ringwear_par.results.key_numbers import time_unit, time_words
from ringwear_par.results.storage.hdf5 import atomic_hdf5, write_variable
from ringwear_par.results.variables import DISPLAY_UNITS, HISTORIES

FILES = (DRAWS, BAND, PREDICTION)
#: inches of the figure
_SIZE = (4.6, 3.4)
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


def to_dict(prediction: Prediction) -> dict[str, Any]:
    """Return the contents of prediction.json."""
    depth = prediction.depth
    return {
        "of": prediction.of,
        "whose": prediction.whose,
        "fit": prediction.fit,
        "draws": len(prediction.values),
        "failed": prediction.failed,
        "seed": prediction.seed,
        "keys": dict(prediction.keys),
        "drawn_from": list(prediction.sources),
        "probabilities": list(PROBABILITIES),
        "time": prediction.time.tolist(),
        "quantiles": {
            name: {"unit": HISTORIES[name].unit, "values": prediction.quantiles(name).T.tolist()}
            for name in prediction.histories
        },
        "depth": None if depth is None else {"depth": depth, **prediction.time_to(depth)._asdict()},
        "summary": summary(prediction).splitlines(),
        "doubts": [doubt.to_dict() for doubt in prediction.doubts],
        "case": prediction.case,
        "versions": dict(prediction.versions),
    }


def save(prediction: Prediction, folder: Path) -> None:
    """Write all files; prediction.json, which says that it is whole, the last. On one rank.

    Raises
    ------
    InputError, ComputationError : the folder or the disk.
    """
    with new_files(folder, FILES, "predict"):
        with atomic_hdf5(folder / DRAWS) as file:
            file.attrs.update(prediction.attributes)
            for variable, values in prediction.variables():
                write_variable(file, variable, values)
        contents: dict[str, Callable[[], bytes | None]] = {
            BAND: lambda: picture(prediction.plot, str(folder / BAND)),
            PREDICTION: lambda: json_bytes(to_dict(prediction)),
        }
        write_contents(folder, contents)


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
