"""Factors: the varied keys of a sweep's cases, as surrogates and pictures need them."""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.cases.schema import quantity_label
from ringwear_par.errors import InputError
from ringwear_par.files.text import parse_value, shortened, toml_value
from ringwear_par.pictures.style import in_words, number_text
from ringwear_par.studies.ensemble import Ensemble

#: a key without a range in the study goes by its logarithm if uneven values span so large a ratio
_LOG_KEY = 20.0
#: ends of a key's range in the study count as covered with a case so near, as a part of the range
_NEAR = 0.1


@dataclass(frozen=True)
class Factor:
    """A varied key: one coordinate from 0 to 1, or one that is 0 or 1 for each of its texts."""

    #: of the key
    name: str
    #: (cases,) numbers in the case's unit, NaN where there is none, or numbers of texts
    values: FloatArray
    #: the texts of a key that is no number
    texts: tuple[str, ...] = ()
    #: the range of a number, and whether it goes by its logarithm
    low: float = math.nan
    high: float = math.nan
    logarithmic: bool = False
    #: in which the study writes its values, "" for none, and how much it is in the case's
    unit: str = ""
    scale: float = 1.0

    @classmethod
    def of(cls, ensemble: Ensemble, name: str, cases: IntArray | slice = slice(None)) -> "Factor":
        """Return a varied key of some cases, with the study's range and spacing if it has one."""
        column = ensemble.varied[name][cases]
        if column.dtype.kind != "f":
            texts = tuple(dict.fromkeys(map(str, column)))
            return cls(name, np.array([float(texts.index(str(text))) for text in column]), texts)
        known = column[np.isfinite(column)]
        if not len(known):
            return cls(name, column)
        low, high = float(known.min()), float(known.max())
        uneven = bool(np.median(known) < 0.3 * (low + high) and high >= _LOG_KEY * low)
        by_log, ends = ensemble.spacings.get(name, (uneven, (low, high)))
        factor = cls(name, column, (), low, high, by_log and low > 0.0, *ensemble.unit(name))
        if low == high:
            return factor
        first, last = factor.coordinates(np.array(ends))[:, 0]
        return replace(
            factor, low=ends[0] if -_NEAR <= first <= 0.0 else low,
            high=ends[1] if 1.0 <= last <= 1.0 + _NEAR else high,
        )  # fmt: skip

    @property
    def label(self) -> str:
        """What it is called, with its unit."""
        return quantity_label(self.name, self.unit)

    @property
    def categories(self) -> tuple[str, ...]:
        """The texts in few words, numbered where these would be the same."""
        words = [raw_words(text) for text in self.texts]
        if len(set(words)) < len(words):
            words = [f"{word} ({number})" for number, word in enumerate(words, 1)]
        return tuple(words)

    @property
    def differs(self) -> bool:
        """Whether cases differ in it."""
        return len(np.unique(self.values)) > 1

    def words(self) -> list[str]:
        """Return the value in each case, as short as its values stay apart."""
        if self.texts:
            return [self.categories[int(number)] for number in self.values]
        values = self.values / self.scale
        for digits in range(3, 18):
            words = [number_text(v, digits) if math.isfinite(v) else "none" for v in values]
            if len(set(words)) >= len(np.unique(values)):
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
            text = value if isinstance(value, str) else "" if value is None else toml_value(value)
            if text in self.texts:
                return np.array(float(self.texts.index(text)))
            words = ", ".join(map(shortened, self.texts))
            raise InputError(f"surrogate: {self.name} = {shortened(text)}: must be one of {words}")
        words = f"must be from {self.low:.9g} to {self.high:.9g}, as in the study's cases"
        try:
            numbers = np.asarray(value, dtype=float)
        except (TypeError, ValueError):
            raise InputError(f"surrogate: {self.name} = {shortened(value)}: {words}") from None
        slack = 1e-9 * max(abs(self.low), abs(self.high))
        outside = numbers[~((numbers >= self.low - slack) & (numbers <= self.high + slack))]
        if outside.size:
            raise InputError(f"surrogate: {self.name} = {outside.flat[0]:.9g}: {words}")
        return np.clip(numbers, self.low, self.high)


def raw_words(text: str) -> str:
    """Return a raw value of a key, as studies store it, in few words."""
    return in_words(parse_value(text)) if text else "none"
