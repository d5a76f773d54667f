"""A prediction: histories of a case at draws of what a fit knows."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.units import number_in
from ringwear_par.cases.values import RejectedError
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.errors import InputError, ValidityWarning, legible
from ringwear_par.files.folders import (
    BAND,
    DRAWS,
    PREDICTION,
    json_bytes,
    new_files,
    write_contents,
)  # fmt: skip
from ringwear_par.results.hdf5 import atomic_hdf5, write_variable
from ringwear_par.results.key_numbers import time_words
from ringwear_par.results.result import Outcome
from ringwear_par.results.variables import HISTORIES, SOFTWARE, Variable, to_dataset
from ringwear_par.version import versions

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure

FILES = (DRAWS, BAND, PREDICTION)
#: inches of the figure
_SIZE = (4.6, 3.4)
#: histories that are predicted
QUANTITIES = (
    "penetration", "approach", "force", "torque", "worn_volume_lower", "worn_volume_upper",
)  # fmt: skip
#: probabilities of the ends of the intervals of 95 and 50 %, and of the median
PROBABILITIES = (0.025, 0.25, 0.5, 0.75, 0.975)


class TimeTo(NamedTuple):
    """When a depth is reached, s; None where that is after the end of the case."""

    #: half of the draws reach it by then
    median: float | None
    #: holds 95 % of them
    interval: tuple[float | None, float | None]
    #: share of the draws that reach it before the end
    reached: float

    @classmethod
    def of(cls, times: FloatArray, level: float = 0.95) -> "TimeTo":
        """Return median, interval and share of times (draws,), inf where after the end."""
        tail = 0.5 * (1.0 - level)
        low, median, high = (
            None if np.isinf(t) else float(t)
            for t in np.quantile(times, (tail, 0.5, 1.0 - tail), method="inverted_cdf")
        )
        return cls(median, (low, high), float(np.isfinite(times).mean()))

    def words(self, end: float) -> str:
        """Return median and interval in words, of a test that ends at a time, s."""
        middle, low, high = (
            "after the end" if time is None else time_words(time, end)
            for time in (self.median, *self.interval)
        )
        return middle if low == high else f"{middle} (from {low} to {high})"


def read_depth(text: str, faults: list[str]) -> float:
    """Return a depth, mm, as a command is given it with its unit; NaN, and a fault, if none."""
    with suppress(RejectedError):
        if (depth := number_in(text, "mm")) > 0.0:
            return depth
    faults.append(f"--depth = {legible(text)}: must be a length > 0, such as '20 um'")
    return np.nan


def depth_words(depth: float) -> str:
    """Return a depth (mm) of penetration in words."""
    return f"{1e3 * depth:g} um of penetration"


def times_at(time: FloatArray, depths: FloatArray, depth: float) -> FloatArray:
    """Return the times (draws,) at which depths (draws, steps) first reach one; inf: never.

    Linear between steps, whose ends are at ``time`` (steps,).
    """
    reached = depths >= depth
    after = np.argmax(reached, axis=1)
    draws = np.arange(len(after))
    high, low = (depths[draws, np.maximum(k, 0)] for k in (after, after - 1))
    share = np.divide(depth - low, high - low, out=np.ones_like(high), where=high > low)
    before = time[np.maximum(after - 1, 0)]
    times = before + share * (time[after] - before)
    return np.where(reached.any(axis=1), times, np.inf)


@dataclass(frozen=True, eq=False)
class Prediction(Outcome):
    """Histories of a case, one a draw."""

    #: "next specimen", "material" or the name of a specimen; what messages call the fit
    of: str
    fit: str
    #: TOML text of the case
    case: str
    seed: int
    #: of the fit, with their units
    keys: Mapping[str, str]
    #: (draws, m) of the keys
    values: FloatArray
    #: (draws, 2) mm, of the random wear of lower and upper; 0: none
    sizes: FloatArray
    #: sentences about what was drawn, and what speaks against the numbers
    sources: tuple[str, ...]
    doubts: tuple[ValidityWarning, ...]
    #: (steps,) s, and histories (draws, steps) by name, see ``QUANTITIES``
    time: FloatArray = field(default_factory=lambda: np.zeros(0))
    histories: Mapping[str, FloatArray] = field(default_factory=dict)
    #: draws that were left out, as their histories could not be computed
    failed: int = 0
    versions: Mapping[str, str] = field(default_factory=versions)
    #: mm of penetration, whose time the summary tells; None: none
    depth: float | None = None

    def __repr__(self) -> str:
        return f"<Prediction of {self.of}: {len(self.values)} draws>"

    @property
    def whose(self) -> str:
        """Of whom the band is: without scatter, a fit knows of no other specimens than its own."""
        known = all(doubt.code != "no-scatter" for doubt in self.doubts)
        return self.of if known else "the specimens tested"

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

        Raises
        ------
        InputError : a depth that is not positive.
        """
        if not depth > 0.0:
            raise InputError(f"depth = {depth!r}: must be > 0 mm")
        return TimeTo.of(times_at(self.time, self.histories["penetration"], depth))

    def variables(self) -> list[tuple[Variable, Any]]:
        """Return all variables with their values: histories over (draw, step), values over draw."""
        axes = [
            Variable(name, (name,), "1", f"number of the {name}", integer=True)
            for name in ("draw", "step")
        ]
        variables: list[tuple[Variable, Any]] = [
            (axes[0], np.arange(len(self.values))), (axes[1], np.arange(len(self.time))),
            (Variable("time", ("step",), "s", "time"), self.time),
        ]  # fmt: skip
        for name, values in self.histories.items():
            variables.append((replace(HISTORIES[name], dimensions=("draw", "step")), values))
        for (key, unit), values in zip(self.keys.items(), self.values.T, strict=True):
            variables.append((Variable(key, ("draw",), unit, "value of the fitted key"), values))
        for body, sizes in zip(BODIES, self.sizes.T, strict=True):
            if sizes.any():
                name, meaning = f"process.wear.{body}", "size of the random wear"
                variables.append((Variable(name, ("draw",), "mm", meaning), sizes))
        return variables

    def summary(self) -> str:
        """Return it in a few lines, as the command prints it."""
        from ringwear_par.prediction.folder import summary

        return summary(self)

    def to_dict(self) -> dict[str, Any]:
        """Return the contents of prediction.json."""
        depth = self.depth
        return {
            "of": self.of,
            "whose": self.whose,
            "fit": self.fit,
            "draws": len(self.values),
            "failed": self.failed,
            "seed": self.seed,
            "keys": dict(self.keys),
            "drawn_from": list(self.sources),
            "probabilities": list(PROBABILITIES),
            "time": self.time.tolist(),
            "quantiles": {
                name: {"unit": HISTORIES[name].unit, "values": self.quantiles(name).T.tolist()}
                for name in self.histories
            },
            "depth": None if depth is None else {"depth": depth, **self.time_to(depth)._asdict()},
            "summary": self.summary().splitlines(),
            "doubts": [doubt.to_dict() for doubt in self.doubts],
            "case": self.case,
            "versions": dict(self.versions),
        }

    def save(self, path: str | Path) -> None:
        """Write the files of its folder; prediction.json, which says that it is whole, the last.

        Raises
        ------
        InputError, ComputationError : the folder or the disk.
        """
        from ringwear_par.pictures.style import picture

        folder = Path(path)
        with new_files(folder, FILES, "predict"):
            with atomic_hdf5(folder / DRAWS) as file:
                file.attrs.update(self.attributes)
                for variable, values in self.variables():
                    write_variable(file, variable, values)
            contents: dict[str, Callable[[], bytes | None]] = {
                BAND: lambda: picture(self.plot, str(folder / BAND)),
                PREDICTION: lambda: json_bytes(self.to_dict()),
            }
            write_contents(folder, contents)

    def plot(self) -> "Figure":
        """Return the figure of its band."""
        from ringwear_par.pictures.matplotlib import panel_figure
        from ringwear_par.prediction.folder import panel

        return panel_figure([[panel(self.time, self.quantiles(), self.whose)]], _SIZE)

    def to_xarray(self) -> "xarray.Dataset":
        """Return all draws over (draw, step).

        Raises
        ------
        InputError : xarray is not installed.
        """
        return to_dataset(self.variables(), self.attributes, ["time"])

    @property
    def attributes(self) -> dict[str, Any]:
        """What files say of it."""
        about = {"of": self.of, "fit": self.fit, "case": self.case, "seed": self.seed}
        return {"software": SOFTWARE, **about, **self.versions}
