"""The results of a sweep, to be looked at: with xarray, or variable by variable; its varied keys."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray, IntArray
from ringwear_par.cases.schema import quantity_label
from ringwear_par.errors import InputError, counted
from ringwear_par.files.text import shortened, toml_value
from ringwear_par.results.hdf5 import reading
from ringwear_par.studies.end_values import END_VALUES, MAIN_END_VALUES, entries

if TYPE_CHECKING:
    import xarray

#: files of a sweep, and what the first one says of itself
RESULTS, TABLE = "results.h5", "cases.csv"
SOFTWARE, FILE_KIND = "ringwear-par sweep", "a results file of ringwear sweep"
_SEPARATOR = ", "
#: a key without a range in the study goes by its logarithm if uneven values span so large a ratio
_LOG_KEY = 20.0


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
    #: reasons to doubt the answer of a case, (cases,)
    flags: tuple[tuple[str, ...], ...]

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
        if missing := {"method", "study", "case", "status", "ranks"} - attributes.keys():
            raise ValueError(missing)
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
            final, attributes, spacings, tuple(map(split_flags, flags)),
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


def join_flags(flags: Sequence[str]) -> str:
    """Return the flags of a case as files store them."""
    return _SEPARATOR.join(flags)


def split_flags(text: str) -> tuple[str, ...]:
    """Return the flags that a file stores of a case."""
    return tuple(text.split(_SEPARATOR)) if text else ()


def count_flags(flagged: Mapping[tuple[str, ...], int]) -> str:
    """Return a sentence on how many cases are flagged, and for which reasons."""
    counts: Counter[str] = Counter()
    for flags, n in flagged.items():
        counts.update(dict.fromkeys(flags, n))
    words = ", ".join(f"{flag.replace('_', ' ')} ({n})" for flag, n in counts.most_common())
    total = sum(flagged.values())
    return f"{counted(total, 'case')} flagged: {words}; see flags in {TABLE}"


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
