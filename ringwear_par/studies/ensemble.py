"""The results of a sweep: what is stored of its cases, how they are read, its varied keys.

End values are columns of ``cases.csv``, variables ``final_...`` of ``results.h5``, and what figures
show and surrogates answer for.
"""

import math
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray, IntArray
from ringwear_par.cases.schema import quantity_label
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.errors import InputError, counted
from ringwear_par.files.text import shortened, toml_value
from ringwear_par.results import variables
from ringwear_par.results.files import reading
from ringwear_par.results.variables import HISTORIES, LABORATORY_NUMBERS, Variable

if TYPE_CHECKING:
    import xarray

#: files of a sweep, and what the first one says of itself
RESULTS, TABLE = "results.h5", "cases.csv"
SOFTWARE, FILE_KIND = "ringwear-par sweep", "a results file of ringwear sweep"
#: a key without a range in the study goes by its logarithm if uneven values span so large a ratio
_LOG_KEY = 20.0

# -- variables of cases ----------------------------------------------------------------------------

#: at the stored states that stress is computed for
STRESS = {**variables.LARGEST_STRESS, **variables.LAYER_STRESS, **variables.POINT_STRESS}
#: numbers that follow from a history, at its end
_NUMBERS = {
    name: replace(number, dimensions=(), meaning=f"{number.meaning}, at the last stored step")
    for name, number in LABORATORY_NUMBERS.items()
}
#: of a case's history; all but ``HISTORIES`` are of some cases only, padded with NaN in the others
STORED = {
    name: replace(variable, dimensions=("case", *variable.dimensions))
    for table in (
        HISTORIES, variables.LAYERS, STRESS, variables.LINE, variables.PROFILES, variables.EDGE,
        variables.TIMES_THROUGH, variables.POINTS, _NUMBERS,
    )
    for name, variable in table.items()
}  # fmt: skip
#: replaces a layer's number, since cases of a sweep may have other numbers of layers
BODY = "body"


# -- end values ------------------------------------------------------------------------------------

#: end values that all cases have
MAIN_END_VALUES = ("penetration", "worn_volume_lower", "worn_volume_upper")
#: the variable that is finite at the states with stress
STRESS_STATES = "max_mises"


def _stored_end_value(source: Variable) -> tuple[str, Variable]:
    """Return the column of ``cases.csv`` for a variable at the end, and what results store."""
    name, meaning = source.name, source.meaning
    if "step" not in source.dimensions:
        return name, source
    axes = tuple(axis for axis in source.dimensions if axis not in ("step", "element"))
    if name in variables.FIELDS:
        name, meaning = f"least_{name}", f"least {meaning}"
    when = "time that it is stored of" if name in STRESS else "stored step"
    return name, Variable(f"final_{name}", axes, source.unit, f"{meaning}, at the last {when}")


_OF_LAYERS = (
    ("worn_volume", "_layers"), ("share_through", ""), ("time_through", ""), ("layer_left", "")
)  # fmt: skip
#: numbers of each case, or of each of its layers or points: columns of ``cases.csv`` in their
#: order, and the variables of results that have them
END_VALUES = dict(
    _stored_end_value(STORED[name])
    for name in (
        *MAIN_END_VALUES, *LABORATORY_NUMBERS,
        *(f"{number}_{body}{of}" for body in BODIES for number, of in _OF_LAYERS), *STRESS,
    )
)  # fmt: skip
#: all variables of results by name, but varied keys
VARIABLES = {
    **STORED, **{variable.name: variable for variable in END_VALUES.values()}, **variables.OF_CASES
}  # fmt: skip


def end_values(tables: Mapping[str, Any]) -> dict[str, FloatArray]:
    """Return the end values, (cases,) or (cases, layers or points), NaN without any.

    Of variables, (cases, ...) by name: the last stored row, of stress the last that has some; of
    fields the least along the contact line.
    """
    ends = {}
    for name, variable in END_VALUES.items():
        source = name.removeprefix("least_")
        if source not in tables or variable.name in tables:
            continue
        there = np.isfinite(tables[STRESS_STATES if source in STRESS else "time"])
        rows, axes = tables[source], STORED[source].dimensions
        if "step" in axes and rows.ndim == len(axes):
            last = there.shape[1] - 1 - there[:, ::-1].argmax(axis=1)
            rows = rows[np.arange(len(rows)), last]
        least = source in variables.FIELDS
        ends[variable.name] = np.fmin.reduce(rows, axis=-1) if least else rows.copy()
        ends[variable.name][~there.any(axis=1)] = np.nan
    return ends


def end_value_of(name: str) -> tuple[str, Variable, str]:
    """Return the end value of a column, its variable, and words for the layer or point, or ""."""
    column, _, entry = name.removesuffix("]").partition("[")
    variable = END_VALUES[column]
    if not entry:
        return column, variable, ""
    axis = variable.dimensions[-1].removesuffix("_upper")
    words = "the body itself" if entry == BODY else f"{axis} {entry}"
    return column, replace(variable, meaning=f"{variable.meaning}; {words}"), words


def columns_of(name: str, values: FloatArray) -> dict[str, FloatArray]:
    """Return the columns of an end value: one, or one for each layer or point."""
    variable = END_VALUES[name]
    if len(variable.dimensions) < 2:
        return {name: values}
    entries: list[Any] = [*range(values.shape[-1])]
    if variable.dimensions[-1].startswith("layer"):
        entries[-1] = BODY
    return {f"{name}[{entry}]": values[..., i] for i, entry in enumerate(entries)}


def is_smooth(name: str) -> bool:
    """Tell whether a column is no place of the largest stress, which jumps, and no rate."""
    column, variable, _ = end_value_of(name)
    return column not in LABORATORY_NUMBERS and (column not in STRESS or variable.unit == "MPa")


# -- reading ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Ensemble:
    """A sweep's results without their histories, which ``histories`` reads.

    Of each case, (cases,): its id, status, error, flags (reasons to doubt it, separated by commas),
    wall time (s) and number of stored steps.
    """

    #: of results.h5
    path: Path
    ids: tuple[str, ...]
    status: tuple[str, ...]
    error: tuple[str, ...]
    flags: tuple[str, ...]
    seconds: FloatArray
    steps_stored: IntArray
    #: values by varied key, (cases,) float, or str where they are not numbers, and units, or ""
    varied: dict[str, Any]
    units: dict[str, str]
    #: end values by column of ``cases.csv``, (cases,) float; NaN where nothing is stored
    final: dict[str, FloatArray]
    #: of the file: ``method`` of the design, ``study``, its base ``case``, ``status``, versions
    attributes: dict[str, Any]
    #: keys that the design varies by ranges: whether by logarithms, and the ends
    spacings: dict[str, tuple[bool, tuple[float, float]]]

    @cached_property
    def done(self) -> BoolArray:
        """(cases,) which cases are done."""
        return np.array(self.status) == "done"

    def histories(self, name: str, cases: IntArray) -> FloatArray:
        """Read the histories of some cases (increasing numbers), (len(cases), steps, ...)."""
        with reading(self.path, SOFTWARE, FILE_KIND) as file:
            values: FloatArray = file[name][cases]
            return values


def read_ensemble(folder: Path) -> Ensemble:
    """Read a sweep's results, by its folder or results.h5; InputError for none. Not collective."""
    path = folder if folder.name == RESULTS and folder.is_file() else folder / RESULTS
    with reading(path, SOFTWARE, FILE_KIND) as file:
        ids, status, error, flags = (
            tuple(file[name].asstr()[:]) for name in ("case", "status", "error", "flags")
        )
        varied, units, spacings = {}, {}, {}
        for name in file.attrs["coordinates"].split():
            key, about = file[name], file[name].attrs
            varied[name] = key[:] if key.dtype.kind == "f" else key.asstr()[:]
            units[name] = "" if about["units"] == "1" else about["units"]
            if "spacing" in about:
                spacings[name] = about["spacing"] == "log", (about["low"], about["high"])
        final: dict[str, FloatArray] = {}
        for name, variable in END_VALUES.items():
            if variable.name in file:
                final |= columns_of(name, file[variable.name][:])
            elif name in MAIN_END_VALUES:  # no case has an end
                final[name] = np.full(len(ids), np.nan)
        return Ensemble(
            path, ids, status, error, flags, file["seconds"][:], file["steps_stored"][:], varied,
            units, final, dict(file.attrs), spacings,
        )  # fmt: skip


def open_ensemble(folder: Path | str) -> "xarray.Dataset":
    """Open the results of a sweep in xarray; arrays are read when they are used. Not collective.

    Dimensions case, step and element, each varied key a coordinate on ``case``. Close it, or use it
    in a ``with`` block, before the sweep goes on.

    Parameters
    ----------
    folder : of the sweep, or its results.h5.

    Returns
    -------
    xarray.Dataset : variables as of results, with the units in their attributes.

    Raises
    ------
    InputError : the folder holds none.
    """
    import xarray

    return xarray.open_dataset(read_ensemble(Path(folder)).path, engine="h5netcdf")


def count_flags(flags: Iterable[str]) -> str:
    """Return a sentence on how many cases are flagged, and for which reasons."""
    flagged = [text for text in flags if text]
    counts = Counter(flag for text in flagged for flag in text.split(", ")).most_common()
    words = ", ".join(f"{flag.replace('_', ' ')} ({n})" for flag, n in counts)
    return f"{counted(len(flagged), 'case')} flagged: {words}; see flags in {TABLE}"


# -- factors: the varied keys ----------------------------------------------------------------------


@dataclass(frozen=True)
class Factor:
    """A varied key: one coordinate from 0 to 1, or one that is 0 or 1 for each of its texts."""

    #: of the key
    name: str
    unit: str
    #: (cases,) numbers in the case's unit, or numbers of texts
    values: FloatArray
    #: the texts of a key that is no number
    texts: tuple[str, ...] = ()
    #: the range of a number, and whether it goes by its logarithm
    low: float = math.nan
    high: float = math.nan
    logarithmic: bool = False

    @property
    def label(self) -> str:
        """What it is called, with its unit."""
        return quantity_label(self.name, self.unit)

    @property
    def differs(self) -> bool:
        """Whether cases differ in it."""
        return len(np.unique(self.values)) > 1

    def coordinates(self, values: FloatArray) -> FloatArray:
        """Return coordinates (values, 1 or texts) of values (values,)."""
        if self.texts:
            return np.eye(len(self.texts))[values.astype(int)]
        if self.logarithmic:
            return np.log(values[:, None] / self.low) / math.log(self.high / self.low)
        return (values[:, None] - self.low) / (self.high - self.low)

    def at(self, shares: FloatArray) -> FloatArray:
        """Return values at shares from 0 to 1 of the range, or of the list of texts."""
        if self.texts:
            return np.floor(shares * len(self.texts))
        if self.logarithmic:
            return self.low * (self.high / self.low) ** shares
        return self.low + (self.high - self.low) * shares

    def read(self, value: Any) -> FloatArray:
        """Return a value as ``values`` has it, or an array; InputError for what no case has."""
        if self.texts:
            text = value if isinstance(value, str) else toml_value(value)
            if text in self.texts:
                return np.array(float(self.texts.index(text)))
            rule = f"one of {', '.join(map(shortened, self.texts))}"
        else:
            numbers = np.asarray(value, dtype=float)
            slack = 1e-9 * max(abs(self.low), abs(self.high))
            if ((numbers >= self.low - slack) & (numbers <= self.high + slack)).all():
                return np.clip(numbers, self.low, self.high)
            rule = f"from {self.low:.9g} to {self.high:.9g}, as in the study's cases"
        raise InputError(f"surrogate: {self.name} = {shortened(value)}: must be {rule}")


def factors_of(ensemble: Ensemble, cases: IntArray) -> list[Factor]:
    """Return the varied keys of some cases that are done, with the study's ranges if all are."""
    factors = []
    for name, column in ensemble.varied.items():
        values, unit = column[cases], ensemble.units[name]
        if column.dtype.kind != "f":
            texts = tuple(dict.fromkeys(map(str, column[ensemble.done])))
            numbers = np.array([float(texts.index(str(text))) for text in values])
            factors.append(Factor(name, unit, numbers, texts))
            continue
        low, high = float(values.min()), float(values.max())
        uneven = bool(np.median(values) < 0.3 * (low + high) and high >= _LOG_KEY * low)
        by_log, ends = ensemble.spacings.get(name, (uneven, (low, high)))
        if low < high and ensemble.done.all():
            low, high = ends
        factors.append(Factor(name, unit, values, (), low, high, by_log and low > 0.0))
    return factors
