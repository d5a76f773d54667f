"""A prediction: histories of a case at draws of what a fit knows, their bands and their folder."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.errors import InputError, ValidityWarning, legible, warning_lines
from ringwear_par.files import folders
from ringwear_par.pictures.matplotlib import panel_figure
from ringwear_par.pictures.panel import Axis, Band, Curve, Panel
from ringwear_par.pictures.style import COLOURS, picture
from ringwear_par.results.files import atomic_hdf5, write_variable
from ringwear_par.results.key_numbers import time_unit, time_words
from ringwear_par.results.result import Outcome
from ringwear_par.results.variables import (
    DISPLAY_UNITS,
    HISTORIES,
    SOFTWARE,
    Variable,
    axis,
    to_dataset,
)
from ringwear_par.version import versions

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure

FILES = (folders.PREDICTION, folders.DRAWS, folders.BAND)
#: histories that are predicted; the summary has the ends of all but two
QUANTITIES = (
    "penetration", "approach", "force", "torque", "worn_volume_lower", "worn_volume_upper",
)  # fmt: skip
_CONDITIONS = ("approach", "force")
#: probabilities of the ends of the intervals of 95 and 50 %, and of the median
PROBABILITIES = (0.025, 0.25, 0.5, 0.75, 0.975)


def tails(level: float) -> tuple[float, float, float]:
    """Return the probabilities of the ends of intervals, and of the median between them."""
    return 0.5 - 0.5 * level, 0.5, 0.5 + 0.5 * level


class TimeTo(NamedTuple):
    """When a depth is reached, s; None where that is after the end of the case."""

    #: half of the draws reach it by then
    median: float | None
    interval: tuple[float | None, float | None]
    #: share of the draws that reach it before the end
    reached: float
    #: mm
    depth: float

    @classmethod
    def of(
        cls, time: FloatArray, depths: FloatArray, depth: float, level: float = 0.95
    ) -> "TimeTo":
        """Return when depths (draws, steps) first reach one, by lines between steps at time."""
        deepest = np.maximum.accumulate(depths, axis=1)
        times = [np.interp(depth, reached, time, right=np.inf) for reached in deepest]
        ends = np.quantile(times, tails(level), method="inverted_cdf").tolist()
        low, median, high = (None if np.isinf(end) else end for end in ends)
        return cls(median, (low, high), float(np.isfinite(times).mean()), depth)

    def line(self, end: float) -> str:
        """Return it in words, of a test until ``end`` (s)."""
        middle, low, high = (
            "after the end" if time is None else time_words(time, end)
            for time in (self.median, *self.interval)
        )
        spread = "" if low == high else f" (from {low} to {high})"
        return f"{1e3 * self.depth:g} um of penetration: {middle}{spread}"


@dataclass(frozen=True, eq=False)
class Prediction(Outcome):
    """Histories of a case, one a draw."""

    #: ``of`` whom it is ("next specimen", "material", a specimen), ``whose`` it is in words, what
    #: messages call the ``fit``, the TOML text of the ``case``, and the ``seed`` of the draws
    about: Mapping[str, Any]
    #: of the fit, with their units
    keys: Mapping[str, str]
    #: (draws, m) of the keys
    values: FloatArray
    #: what speaks against the numbers
    doubts: tuple[ValidityWarning, ...]
    #: (steps,) s, and histories (draws, steps) by name, see ``QUANTITIES``
    time: FloatArray
    histories: Mapping[str, FloatArray]
    #: draws that were left out, as their histories could not be computed
    failed: int = 0
    #: mm of penetration, whose time the summary says; None: none
    depth: float | None = None

    def quantiles(
        self, quantity: str = "penetration", probabilities: Sequence[float] = PROBABILITIES
    ) -> FloatArray:
        """Return quantiles over the draws, (probabilities, steps), in the history's unit.

        Parameters
        ----------
        quantity : one of ``QUANTITIES``.
        probabilities : between 0 and 1; by default 2.5, 25, 50, 75 and 97.5 %.

        Raises
        ------
        InputError : there is no such quantity.
        """
        if quantity not in self.histories:
            raise InputError(f"quantity = {quantity!r}: must be one of {', '.join(self.histories)}")
        levels: FloatArray = np.quantile(self.histories[quantity], probabilities, axis=0)
        return levels

    def time_to(self, depth: float) -> TimeTo:
        """Return when the penetration reaches a depth, mm, first.

        Linear between steps. Draws that do not reach it count as later than the end of the case.
        InputError of a depth that is not positive.
        """
        if not depth > 0.0:
            raise InputError(f"depth = {depth!r}: must be > 0 mm")
        return TimeTo.of(self.time, self.histories["penetration"], depth)

    def to_dict(self) -> dict[str, Any]:
        """Return the contents of prediction.json."""
        depth = None if self.depth is None else self.time_to(self.depth)._asdict()
        return {
            **self.about, "draws": len(self.values), "failed": self.failed, "keys": dict(self.keys),
            "probabilities": [*PROBABILITIES], "time": self.time.tolist(),
            "quantiles": {
                name: {"unit": HISTORIES[name].unit, "values": self.quantiles(name).T.tolist()}
                for name in self.histories
            },
            "depth": depth, "doubts": [doubt.to_dict() for doubt in self.doubts],
            "summary": self.summary().splitlines(), "versions": versions(),
        }  # fmt: skip

    def summary(self) -> str:
        """Return the outcome as the command prints it: at the end of the case first."""
        end, lines = float(self.time[-1]), []
        for name, values in self.histories.items():
            ends = np.quantile(values[:, -1], (0.025, 0.5, 0.975))
            if name in _CONDITIONS or (ends[-1] == 0.0 and name != "penetration"):
                continue
            unit, factor = DISPLAY_UNITS.get(name, (HISTORIES[name].unit, 1.0))
            unit = unit.replace("\N{MICRO SIGN}", "u")
            first, middle, last = (f"{factor * value:.4g}" for value in ends)
            spread = "" if first == last else f"  from {first} to {last} {unit}"
            lines.append(f"{name.replace('_', ' ')}  {middle} {unit}{spread}")
        lines[0] += f" (95 %, {self.about['whose']}, after {time_words(end, end)})"
        if self.depth is not None:
            lines.append(self.time_to(self.depth).line(end))
        failed = f"; {self.failed} more have no history" * bool(self.failed)
        lines.append(f"{len(self.values)} draws of {legible(self.about['fit'])}{failed}")
        return "\n".join([*lines, *warning_lines(doubt.text for doubt in self.doubts)])

    def plot(self) -> "Figure":
        """Return the figure of the band over time."""
        return panel_figure([[band_panel(self.to_dict())]], (4.6, 3.4))

    def save(self, path: str | Path) -> None:
        """Write all files into a folder; prediction.json, which says that it is whole, the last.

        Raises
        ------
        InputError, ComputationError : the folder or the disk.
        """
        folder = Path(path)
        contents = {
            folders.BAND: lambda: picture(self.plot, str(folder / folders.BAND)),
            folders.PREDICTION: lambda: folders.json_bytes(self.to_dict()),
        }
        with folders.new_files(folder, FILES, "predict"):
            with atomic_hdf5(folder / folders.DRAWS) as file:
                file.attrs.update({"software": SOFTWARE, **self.about, **versions()})
                for variable, values in self._variables():
                    write_variable(file, variable, values)
            folders.write_contents(folder, contents)

    def to_xarray(self) -> "xarray.Dataset":
        """Return all draws over (draw, step)."""
        return to_dataset([*self._variables()], {**self.about, **versions()}, ["time"])

    def _variables(self) -> Iterator[tuple[Variable, Any]]:
        """Yield all variables with their values, the dimensions first."""
        for name, count in (("draw", len(self.values)), ("step", len(self.time))):
            yield axis(name), np.arange(count)
        yield Variable("time", ("step",), "s", "time"), self.time
        for name, values in self.histories.items():
            yield replace(HISTORIES[name], dimensions=("draw", "step")), values
        for (key, unit), values in zip(self.keys.items(), self.values.T, strict=True):
            yield Variable(key, ("draw",), unit, "value of the fitted key"), values


def band_panel(content: Mapping[str, Any]) -> Panel:
    """Return the panel of the contents of prediction.json: penetration, bands of 50 and 95 %."""
    time, (unit, factor) = np.array(content["time"]), DISPLAY_UNITS["penetration"]
    quantiles = factor * np.array(content["quantiles"]["penetration"]["values"]).T
    axis, names = Axis(f"penetration ({unit})", zero=True), {"95 %": 0.18, "50 %": 0.35}
    return over_time(axis, content["whose"], time, float(time[-1]), quantiles, names)


def over_time(
    axis: Axis,
    title: str,
    time: FloatArray,
    end: float,
    quantiles: FloatArray,
    bands: Mapping[str, float],
) -> Panel:
    """Return the panel of a median and bands about it.

    Parameters
    ----------
    time : (t,) s, of a test until ``end``.
    quantiles : (2 bands + 1, t), the lowest first.
    bands : opacities by name, the widest first.
    """
    unit, seconds = time_unit(end)
    drawn = [
        Band(time / seconds, quantiles[i], quantiles[-1 - i], name, opacity=opacity)
        for i, (name, opacity) in enumerate(bands.items())
    ]
    median = Curve(time / seconds, quantiles[len(bands)], "median", COLOURS[1])
    return Panel(Axis(f"time ({unit})", zero=True), axis, title, curves=[median], bands=drawn)
