"""Factors: the varied keys of a sweep's cases, as surrogates and pictures need them."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray, IntArray
from ringwear_par.cases.schema import quantity_label
from ringwear_par.errors import InputError
from ringwear_par.files.text import parse_value, shortened, toml_value
from ringwear_par.pictures.style import in_words, number_text
from ringwear_par.studies.ensemble import Ensemble

#: a key without a range in the study goes by its logarithm if uneven values span so large a ratio
_LOG_KEY = 20.0


def done_cases(ensemble: Ensemble) -> BoolArray:
    """Return whether each case is done."""
    return np.array(ensemble.status) == "done"


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

    @classmethod
    def of(cls, ensemble: Ensemble, name: str, cases: IntArray) -> "Factor":
        """Return a varied key of cases that are done, with the study's range if all are."""
        column, unit = ensemble.varied[name][cases], ensemble.units[name]
        if column.dtype.kind != "f":
            texts = tuple(dict.fromkeys(map(str, ensemble.varied[name][done_cases(ensemble)])))
            return cls(name, unit, np.array([float(texts.index(str(t))) for t in column]), texts)
        low, high = float(column.min()), float(column.max())
        uneven = bool(np.median(column) < 0.3 * (low + high) and high >= _LOG_KEY * low)
        by_log, ends = ensemble.spacings.get(name, (uneven, (low, high)))
        if low < high and done_cases(ensemble).all():
            low, high = ends
        return cls(name, unit, column, (), low, high, by_log and low > 0.0)

    @property
    def label(self) -> str:
        """What it is called, with its unit."""
        return quantity_label(self.name, self.unit)

    @property
    def categories(self) -> tuple[str, ...]:
        """The texts in few words, numbered where these would be the same."""
        words = [raw_words(text) for text in self.texts]
        same = len(set(words)) < len(words)
        return tuple(f"{word} ({n})" if same else word for n, word in enumerate(words, 1))

    @property
    def differs(self) -> bool:
        """Whether cases differ in it."""
        return len(np.unique(self.values)) > 1

    def words(self) -> list[str]:
        """Return the value in each case, as short as its values stay apart."""
        if self.texts:
            return [self.categories[int(number)] for number in self.values]
        words, count = list[str](), len(np.unique(self.values))
        for digits in range(3, 18):
            words = [number_text(value, digits) for value in self.values]
            if len(set(words)) == count:
                break
        return words

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


def raw_words(text: str) -> str:
    """Return a raw value of a key, as studies store it, in few words."""
    return in_words(parse_value(text)) if text else "none"
