"""The folder of a prediction: all draws, the picture of their band, the numbers."""

from collections.abc import Callable
from pathlib import Path

from matplotlib.figure import Figure

from ringwear_par.arrays import FloatArray
from ringwear_par.files.folders import (
    BAND,
    DRAWS,
    PREDICTION,
    check_folder,
    json_bytes,
    new_files,
    write_contents,
)
from ringwear_par.files.writing import announce_replacement, closing_line
from ringwear_par.pictures.matplotlib import panel_figure
from ringwear_par.pictures.panel import Axis, Band, Curve, Panel
from ringwear_par.pictures.style import COLOURS, picture
from ringwear_par.prediction.prediction import Prediction
from ringwear_par.results.key_numbers import time_unit
from ringwear_par.results.storage.hdf5 import atomic_hdf5, write_variable
from ringwear_par.results.variables import DISPLAY_UNITS

FILES = (DRAWS, BAND, PREDICTION)
#: inches of the figure
_SIZE = (4.6, 3.4)


def prepare(folder: Path) -> None:
    """Refuse a folder that cannot be written, and say where its outcome is replaced. On one rank.

    Raises
    ------
    InputError, ComputationError : the folder or the disk.
    """
    check_folder(folder, FILES, "predict")
    announce_replacement(folder / PREDICTION)


def files_line(folder: Path) -> str:
    """Return the line about the files of a folder, and about the command to type next."""
    return closing_line(folder, FILES)


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
            PREDICTION: lambda: json_bytes(prediction.to_dict()),
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
