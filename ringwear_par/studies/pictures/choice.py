"""Choice of what is drawn of a sweep: cases, outputs, keys, and how cases lie along each key."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.cases.schema import quantity_label, quantity_name
from ringwear_par.errors import InputError, counted
from ringwear_par.files.text import parse_value, shortened
from ringwear_par.pictures.style import in_words, number_text
from ringwear_par.studies.analysis.regression import Part, untested
from ringwear_par.studies.analysis.responses import done_cases
from ringwear_par.studies.analysis.sensitivity import Indices
from ringwear_par.studies.analysis.surrogate import USELESS, Surrogate, share_words
from ringwear_par.studies.definition.designs import SAMPLED
from ringwear_par.studies.end_values import display_of, figure_columns
from ringwear_par.studies.ensemble import Ensemble

#: most keys that are drawn: with more the figure cannot be read
_MOST_KEYS = 8
#: most curves with a legend
_MOST_CURVES = 8
#: largest over smallest value above which an axis is logarithmic: of values, of keys
LOG_VALUE, _LOG_KEY = 100.0, 20.0
#: values of a key along which medians of cases are drawn
_MOST_LEVELS = 50
#: share of the cases that curves of a list show at least; the others are points
_SHARE = 0.25


def spans(values: FloatArray, ratio: float) -> bool:
    """Tell whether values ask for a logarithmic axis."""
    finite = values[np.isfinite(values)]
    return bool(len(finite) and finite.min() > 0.0 and finite.max() >= ratio * finite.min())


@dataclass(frozen=True)
class Key:
    """A varied key of the cases drawn."""

    #: of the key
    name: str
    #: (cases,) numbers, or codes of categories; NaN where there is none
    values: FloatArray
    #: in words
    categories: tuple[str, ...]
    #: whether the design spaces it by logarithms; None: it has no spacing
    by_log: bool | None = None
    #: of the values, "" for none, and how much it is in the case's unit
    unit: str = ""
    scale: float = 1.0

    @classmethod
    def of(
        cls, name: str, column: Any, by_log: bool | None = None, unit: tuple[str, float] = ("", 1.0)
    ) -> "Key":
        """Return a varied key of numbers or texts, its unit with the factor to the column's."""
        if column.dtype.kind == "f":
            return cls(name, column / unit[1], (), by_log, *unit)
        texts = list(dict.fromkeys(column))
        codes = {text: float(i) for i, text in enumerate(texts)}
        values = np.array([codes[text] for text in column])
        return cls(name, values, tuple(_categories(texts)))

    @property
    def label(self) -> str:
        """What it is called, with its unit."""
        return quantity_label(self.name, self.unit)

    @property
    def differs(self) -> bool:
        """Whether cases differ in it."""
        return len(np.unique(self.values)) > 1

    @property
    def logarithmic(self) -> bool:
        """Whether its axis is."""
        if self.by_log is not None and self.differs and spans(self.values, 1.0):
            return self.by_log
        if self.categories or not spans(self.values, _LOG_KEY):
            return False
        known = self.values[np.isfinite(self.values)]  # spread evenly, they stay on a plain axis
        return bool(np.median(known) < 0.3 * (known.min() + known.max()))

    def words(self) -> list[str]:
        """Return the value in each case, as short as its values stay apart."""
        if self.categories:
            return [self.categories[int(code)] for code in self.values]
        values = [float(value) for value in self.values]
        distinct = len(set(values))
        for digits in range(3, 18):
            words = [number_text(v, digits) if math.isfinite(v) else "none" for v in values]
            if len(set(words)) >= distinct:
                break
        return words


def raw_words(text: str) -> str:
    """Return a raw value of a key, as studies store it, in few words."""
    return in_words(parse_value(text)) if text else "none"


def _categories(texts: Sequence[str]) -> list[str]:
    """Return raw values in few words, numbered where these are the same."""
    words = [raw_words(text) for text in texts]
    numbers = [words[: i + 1].count(word) for i, word in enumerate(words)]
    return [
        f"{word} ({number})" if words.count(word) > 1 else word
        for word, number in zip(words, numbers, strict=True)
    ]


@dataclass(frozen=True)
class Arrangement:
    """How cases lie along a key."""

    #: the key
    key: Key
    #: "curves" where its values repeat with the same others, "levels" where there are more cases at
    #: each of its values, or else "scatter"
    kind: str
    #: cases of each curve, along the key
    curves: tuple[IntArray, ...] = ()
    #: cases that are on none
    points: IntArray | None = None
    #: of the curves; () if there is but one
    labels: tuple[str, ...] = ()
    #: what the labels are of
    title: str = ""

    @classmethod
    def of(cls, key: Key, other_keys: Sequence[Key], method: str) -> "Arrangement":
        """Return how the cases of a design lie along a key: on curves as far as values repeat."""
        known = np.flatnonzero(np.isfinite(key.values))
        x = key.values[known]
        if method in SAMPLED or not len(x):
            return cls(key, "scatter")
        differing = [k for k in other_keys if len(np.unique(k.values[known])) > 1]
        groups = np.zeros(len(x), dtype=int)
        if differing:
            codes = [np.unique(k.values[known], return_inverse=True)[1] for k in differing]
            groups = np.unique(np.stack(codes, axis=1), axis=0, return_inverse=True)[1].reshape(-1)
        sizes = np.bincount(groups)
        repeat = sizes > 1
        chosen = np.flatnonzero(repeat if repeat.any() else sizes)
        enough = repeat.any() and sizes[repeat].sum() >= _SHARE * len(x)
        if len(chosen) > _MOST_CURVES or not (enough or method == "grid"):
            levels = len(np.unique(x))
            repeats = method == "grid" or (len(x) >= 3 * levels and levels <= _MOST_LEVELS)
            return cls(key, "levels" if repeats else "scatter")
        order = np.argsort(x, kind="stable")
        curves = [known[order[groups[order] == group]] for group in chosen]
        words = [k.words() for k in differing]
        labels = [", ".join(w[curve[0]] for w in words) for curve in curves] if words else []
        title = ",\n".join(k.label for k in differing)
        points = known[~np.isin(groups, chosen)]
        return cls(key, "curves", tuple(curves), points, tuple(labels), title)


@dataclass(frozen=True)
class Responses:
    """What is drawn of a sweep's surrogate, which is that of its part of most cases."""

    #: of the sweep
    surrogate: Surrogate
    #: outputs that vary and are met well enough
    names: tuple[str, ...]
    #: those that vary and are not
    coarse: tuple[str, ...]
    #: numbers of the part's keys over which they are drawn, by name
    keys: dict[str, int]

    @classmethod
    def of(
        cls, surrogate: Surrogate | None, outputs: Sequence[str], keys: Sequence[str]
    ) -> "Responses | None":
        """Return the responses to be drawn over some keys; None if nothing varies."""
        if surrogate is None:
            return None
        part = surrogate.parts[0]
        errors = {n: part.responses[n].relative_error for n in outputs if n in part.responses}
        names = tuple(name for name, error in errors.items() if 0.0 < error <= USELESS)
        coarse = tuple(name for name, error in errors.items() if error > USELESS)
        over = {key: i for i, key in enumerate(part.keys) if key in keys}
        return cls(surrogate, names, coarse, over) if (names or coarse) and over else None

    @property
    def part(self) -> Part:
        """The part that is drawn."""
        return self.surrogate.parts[0]

    @property
    def remarks(self) -> tuple[str, ...]:
        """What the surrogate is of, how good it is, and what is not drawn for its errors."""
        part = self.part
        source = f"surrogate of {len(part.points)} cases"
        if part.texts:
            texts = zip(self.surrogate.text_keys, part.texts, strict=True)
            source += " with " + ", ".join(
                f"{quantity_name(key)} = {shortened(text)}" for key, text in texts
            )
        remarks = [source]
        if self.names:
            remarks = [f"{source}; keys vary evenly over their ranges"]
            remarks.append(f"leave-out errors, of the spread: {self._errors(self.names)}")
        if self.coarse:
            remarks.append(
                f"not drawn, for leave-out errors above {100.0 * USELESS:.0f} % of the spread: "
                f"{self._errors(self.coarse)}; more cases, or more values of keys that have few, "
                "make these smaller"
            )
        two_values = [quantity_name(part.keys[i]) for i in untested(part.points)]
        if two_values and self.names:
            remarks.append(f"no case tests it between the two values of {', '.join(two_values)}")
        return tuple(remarks)

    def _errors(self, names: Sequence[str]) -> str:
        responses = self.part.responses
        return "; ".join(
            f"{display_of(name).name} {share_words(responses[name].relative_error)}"
            for name in names
        )


@dataclass(frozen=True)
class Choice:
    """What is drawn of a sweep."""

    #: numbers of those that are done
    cases: IntArray
    #: names of final values
    outputs: list[str]
    #: the varied keys of the largest indices, and how cases lie along each
    keys: list[Key]
    arrangements: list[Arrangement]
    #: of the surrogate; None: nothing of it is drawn, or there is none
    responses: Responses | None
    #: how many cases and keys, in words
    counts: str


def choose(ensemble: Ensemble, surrogate: Surrogate | None, indices: Sequence[Indices]) -> Choice:
    """Return the choice of what is drawn of a sweep; refuse one without a case. Not collective."""
    cases, counts = np.flatnonzero(done_cases(ensemble)), _counts(ensemble)
    if not len(cases):
        raise InputError(
            f"{ensemble.path}: has no case that is done ({counts}); must have one at least"
        )
    outputs = figure_columns(ensemble.final, cases)
    varied = [
        Key.of(name, values[cases], ensemble.spacings.get(name, (None,))[0], ensemble.unit(name))
        for name, values in ensemble.varied.items()
    ]
    varied = [key for key in varied if key.differs] or varied
    names = most_important([key.name for key in varied], indices, _MOST_KEYS)
    keys = [key for key in varied if key.name in names]
    method = str(ensemble.attributes.get("method"))
    arrangements = [
        Arrangement.of(key, [k for k in varied if k is not key], method) for key in keys
    ]
    if len(keys) < len(varied):
        reason = "of the largest indices" if indices else "the first"
        counts += f"; {len(keys)} of {len(varied)} keys, {reason}"
    responses = Responses.of(surrogate, outputs, names)
    return Choice(cases, outputs, keys, arrangements, responses, counts)


def most_important(keys: Sequence[str], indices: Sequence[Indices], most: int) -> list[str]:
    """Return so many keys of the largest indices, in their order; without indices the first."""
    weights = dict.fromkeys(keys, 2.0 if indices else 0.0)  # of texts, which have none
    for number, output_indices in enumerate(indices):
        for key, value in zip(output_indices.keys, output_indices.influence.tolist(), strict=True):
            if key in weights:
                weights[key] = max(value, weights[key] if number else value)
    chosen = sorted(keys, key=lambda key: -weights[key])[:most]
    return [key for key in keys if key in chosen]


def _counts(ensemble: Ensemble) -> str:
    """Return in words how many cases there are, and how many of them are not drawn."""
    status = np.array(ensemble.status)
    words = [counted(len(status), "case")]
    for word in ("failed", "incomplete"):
        count = int((status == word).sum())
        if count:
            words.append(f"{count} {word}")
    return ", ".join(words)
