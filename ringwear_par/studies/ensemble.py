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
from ringwear_par.errors import InputError, counted
from ringwear_par.files.text import shortened, toml_value
from ringwear_par.results.files import reading
from ringwear_par.results.variables import (
    EDGE_ELEMENT,
    HISTORIES,
    LABORATORY_NUMBERS,
    LARGEST_STRESS,
    LAYER,
    LAYER_HISTORIES,
    LAYER_PROFILES,
    LAYER_STRESS,
    LAYER_VOLUMES,
    LINE,
    POINT,
    POINT_STRESS,
    POINTS,
    PROFILES,
    TIMES_THROUGH,
    UPPER_LAYER,
    Variable,
)

if TYPE_CHECKING:
    import xarray

#: files of a sweep, and what the first one says of itself
RESULTS, TABLE = "results.h5", "cases.csv"
SOFTWARE, FILE_KIND = "ringwear-par sweep", "a results file of ringwear sweep"
#: a key without a range in the study goes by its logarithm if uneven values span so large a ratio
_LOG_KEY = 20.0

# -- variables of cases ----------------------------------------------------------------------------

#: at the stored states that stress is computed for
STRESS = {**LARGEST_STRESS, **LAYER_STRESS, **POINT_STRESS}
#: along the contact line, at each stored state or at the last one
FIELDS = {**PROFILES, **LAYER_PROFILES}
#: a number of each case, or one a point
OF_A_CASE = {
    **TIMES_THROUGH, **POINTS,
    **{
        name: replace(
            number, dimensions=("case",), meaning=f"{number.meaning}, at the last stored step"
        )
        for name, number in LABORATORY_NUMBERS.items()
    },
}  # fmt: skip
#: of a case's history; all but ``HISTORIES`` are of some cases only, padded with NaN in the others
STORED = {
    **HISTORIES, **LAYER_HISTORIES, **LAYER_VOLUMES, **STRESS, **LINE, **FIELDS, **OF_A_CASE,
}  # fmt: skip
#: about each case
OF_CASES = {
    variable.name: variable
    for variable in (
        Variable("case", ("case",), "1", "case, by its content"),
        Variable("number", ("case",), "1", "number of the case in the design", integer=True),
        Variable("status", ("case",), "1", "done, failed or incomplete"),
        Variable("error", ("case",), "1", "why the case failed"),
        Variable(
            "flags", ("case",), "1",
            "what makes the answer doubtful or ended the case early, separated by commas",
        ),
        Variable("seconds", ("case",), "s", "wall time of the case"),
        Variable(
            "imbalance", ("case",), "1",
            "worst error of the balances of force, energy and contact of its steps",
        ),
        Variable("steps_stored", ("case",), "1", "number of stored steps", integer=True),
        Variable("elements", ("case",), "1", "number of contact elements", integer=True),
    )
}  # fmt: skip

#: axes other than those of steps and elements, and their coordinates
AXES = {axis.name: axis for axis in (LAYER, UPPER_LAYER, POINT)}
#: replaces a layer's number, since cases of a sweep may have other numbers of layers
BODY = "body"


def axis_of(variable: Variable) -> str:
    """Return the axis of a variable other than steps and elements, "" where it has none."""
    return next((name for name in variable.dimensions if name in AXES), "")


def has_layers(variable: Variable) -> bool:
    """Tell whether a variable runs over layers; the last number is of the body itself."""
    return axis_of(variable) in (LAYER.name, UPPER_LAYER.name)


# -- end values ------------------------------------------------------------------------------------

#: end values that all cases have
MAIN_END_VALUES = ("penetration", "worn_volume_lower", "worn_volume_upper")
#: the variable that is finite at the states with stress
STRESS_STATES = "max_mises"


@dataclass(frozen=True)
class EndValue:
    """A number of each case, or of each of its layers or points, each a column of ``cases.csv``."""

    #: in the table
    name: str
    #: name of the variable that it is taken of
    source: str
    #: the variable of the results file
    stored: Variable
    #: whether surrogates answer for it: places of the largest stress jump, numbers of laboratories
    #: follow from others
    smooth: bool

    def of(self, tables: Mapping[str, Any]) -> FloatArray:
        """Return the values of cases, (cases,) or (cases, layers or points), NaN without any.

        Of their variables, (cases, ...) by name: the last stored row, of stress the last that has
        some; of fields the least along the contact line.
        """
        there = np.isfinite(tables[STRESS_STATES if self.source in STRESS else "time"])
        rows = tables[self.source]
        axes = STORED[self.source].dimensions
        if "step" in axes and rows.ndim == len({"case", *axes}):
            last = there.shape[1] - 1 - there[:, ::-1].argmax(axis=1)
            rows = rows[np.arange(len(rows)), last]
        if self.source in FIELDS:
            rows = np.fmin.reduce(rows, axis=-1)
        rows = rows.copy()
        rows[~there.any(axis=1)] = np.nan
        return rows


def _end_value(source: Variable) -> EndValue:
    """Return the end value of a variable by what kind it is of."""
    name, meaning, smooth = source.name, source.meaning, True
    axes = ("case", axis_of(source)) if axis_of(source) else ("case",)
    if name in OF_A_CASE:
        return EndValue(
            name, name, replace(source, dimensions=axes), name not in LABORATORY_NUMBERS
        )
    when = "at the last stored step"
    stored = f"final_{name}"
    if name in STRESS:
        when, smooth = "at the last time that it is stored of", source.unit == "MPa"
    elif name in FIELDS:
        name, stored, meaning = f"least_{name}", f"final_least_{name}", f"least {meaning}"
    variable = Variable(stored, axes, source.unit, f"{meaning}, {when}")
    return EndValue(name, source.name, variable, smooth)


_BY_BODY = zip(
    *(table.values() for table in (LAYER_VOLUMES, LAYER_HISTORIES, TIMES_THROUGH, LAYER_PROFILES)),
    strict=True,
)
_SOURCES = (
    *(HISTORIES[name] for name in MAIN_END_VALUES),
    *(OF_A_CASE[name] for name in LABORATORY_NUMBERS),
    *(variable for of_a_body in _BY_BODY for variable in of_a_body),
    *STRESS.values(),
)
#: in the order of the table
END_VALUES = {end_value.name: end_value for end_value in map(_end_value, _SOURCES)}
#: all variables of results by name, but varied keys
VARIABLES = {
    **STORED, EDGE_ELEMENT.name: EDGE_ELEMENT,
    **{end_value.stored.name: end_value.stored for end_value in END_VALUES.values()}, **OF_CASES,
}  # fmt: skip


def end_value_of(name: str) -> tuple[EndValue, str]:
    """Return the end value that a column is of, and its entry, "" where it has but one."""
    source, _, entry = name.partition("[")
    return END_VALUES[source], entry.removesuffix("]")


def entries(end_value: EndValue, values: FloatArray) -> dict[str, FloatArray]:
    """Return numbers of cases by their names, the last axis of those that have one taken apart."""
    if not axis_of(end_value.stored):
        return {end_value.name: values}
    names = [str(i) for i in range(values.shape[-1])]
    if has_layers(end_value.stored):
        names[-1] = BODY
    return {f"{end_value.name}[{name}]": values[..., i] for i, name in enumerate(names)}


def entry_words(end_value: EndValue, entry: str) -> str:
    """Return the words for one of the numbers of an end value with layers or points."""
    axis = axis_of(end_value.stored).removesuffix("_upper")
    return "the body itself" if entry == BODY else f"{axis} {entry}"


def meaning_of(name: str) -> str:
    """Return what a column of the table is."""
    end_value, entry = end_value_of(name)
    meaning = end_value.stored.meaning
    return f"{meaning}; {entry_words(end_value, entry)}" if entry else meaning


# -- reading ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Ensemble:
    """A sweep's results without their histories, which ``histories`` reads."""

    #: of results.h5
    path: Path
    #: (cases,) str
    ids: tuple[str, ...]
    status: tuple[str, ...]
    error: tuple[str, ...]
    #: (cases,) float
    seconds: FloatArray
    #: (cases,) int
    steps_stored: IntArray
    #: values by varied key, (cases,) float, or str where they are not numbers
    varied: dict[str, Any]
    #: their units, "" for none
    units: dict[str, str]
    #: last stored values by name, (cases,) float, see ``finals``; NaN where nothing is stored
    final: dict[str, FloatArray]
    #: of the file: ``method`` of the design, ``study``, its base ``case``, ``status``, versions
    attributes: dict[str, Any]
    #: keys that the design varies by ranges: whether by logarithms, and the ends
    spacings: dict[str, tuple[bool, tuple[float, float]]]
    #: reasons to doubt the answer of a case, separated by commas, (cases,)
    flags: tuple[str, ...]

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
    if not path.exists():
        raise InputError(
            f"{path}: does not exist; must be written by ringwear sweep, which goes on where it "
            "was interrupted"
        )
    with reading(path, SOFTWARE, FILE_KIND) as file:
        attributes = dict(file.attrs)
        ids, status, error, flags = (
            tuple(file[name].asstr()[:]) for name in ("case", "status", "error", "flags")
        )
        varied, units, spacings = {}, {}, {}
        for name in attributes["coordinates"].split():
            key, about = file[name], file[name].attrs
            varied[name] = key[:] if key.dtype.kind == "f" else key.asstr()[:]
            units[name] = "" if about["units"] == "1" else about["units"]
            if "spacing" in about:
                spacings[name] = about["spacing"] == "log", (about["low"], about["high"])
        final: dict[str, FloatArray] = dict.fromkeys(MAIN_END_VALUES, np.full(len(ids), np.nan))
        for end_value in END_VALUES.values():
            if end_value.stored.name in file:
                final |= entries(end_value, file[end_value.stored.name][:])
        return Ensemble(
            path, ids, status, error, file["seconds"][:], file["steps_stored"][:], varied, units,
            final, attributes, spacings, flags,
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
