"""Predictions between the cases of a sweep, by regressions of its responses over varied keys."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.errors import InputError, legible
from ringwear_par.files.text import shortened, toml_value
from ringwear_par.studies.analysis.regression import Part
from ringwear_par.studies.analysis.responses import DEPTHS, LARGEST
from ringwear_par.studies.storage.end_values import end_value_of

#: leave-out errors above this part of a response's spread are called coarse
COARSE = 0.1
#: and above this part responses are not drawn
USELESS = 0.2
_ROUNDING = 1e-9
#: %, below which errors are those of rounding
_EXACT = 1e-6


class Surrogate:
    """Regressions over the varied keys of a sweep, see ``surrogate``.

    Parameters
    ----------
    text_keys : the varied keys that are no numbers.
    parts : one for each combination of their values, the one of most cases first.
    cases : of the study.
    done : those of them that are done.
    """

    def __init__(
        self, text_keys: Sequence[str], parts: Sequence[Part], cases: int, done: int
    ) -> None:
        self.text_keys, self.parts = tuple(text_keys), tuple(parts)
        self.cases, self.done = cases, done

    @property
    def used(self) -> int:
        """Number of cases that are interpolated."""
        return sum(len(part.points) for part in self.parts)

    @property
    def names(self) -> tuple[str, ...]:
        """Responses that all parts have: final ones, or those at the times chosen."""
        first, *rest = self.parts
        return tuple(n for n in first.responses if all(n in part.responses for part in rest))

    @property
    def error(self) -> dict[str, float]:
        """Leave-out error (root mean square) of each response, in its unit."""
        return {n: max(part.responses[n].error for part in self.parts) for n in self.names}

    @property
    def relative_error(self) -> dict[str, float]:
        """Leave-out error of each response as a part of its spread over the cases."""
        return {n: max(part.responses[n].relative_error for part in self.parts) for n in self.names}

    @property
    def ranges(self) -> dict[str, tuple[Any, ...]]:
        """Lowest and highest value of each varied key; all values of one that is a text."""
        ranges: dict[str, tuple[Any, ...]] = {
            key: tuple(dict.fromkeys(part.texts[i] for part in self.parts))
            for i, key in enumerate(self.text_keys)
        }
        for part in self.parts:
            for key, low, high in zip(part.keys, part.low, part.high, strict=True):
                known = ranges.get(key, (low, high))
                ranges[key] = float(min(low, known[0])), float(max(high, known[1]))
        return ranges

    def predict(
        self, values: Mapping[str, Any], names: Sequence[str] | None = None
    ) -> dict[str, FloatArray]:
        """Return responses by name, all where no names are given.

        Values are of every varied key: numbers or arrays, which go together as numpy's do; a text
        of a key that is no number. Arrays have the values' common shape, followed by an axis of
        times or elements where a response has one.

        Raises
        ------
        InputError : a value outside the range of the study's cases, a key that is missing or not
            varied, an unknown response.
        """
        wanted = self.names if names is None else tuple(names)
        unknown = [name for name in wanted if name not in self.names]
        if unknown:
            reason = "unknown response"
            if unknown[0] in (*DEPTHS, *LARGEST):
                reason = (
                    'needs stored profiles, of all steps (output.profiles = "all") where there are '
                    "times, and of the same contact elements"
                )
            raise InputError(
                f"surrogate: {legible(str(unknown[0]))}: {reason}; must be one of "
                f"{', '.join(self.names)}"
            )
        part = self._part(values)
        arrays = {key: _numbers(key, values[key]) for key in part.keys}
        try:
            columns = np.broadcast_arrays(*arrays.values())
        except ValueError:
            shapes = ", ".join(f"{key} {array.shape}" for key, array in arrays.items())
            raise InputError(
                f"surrogate: arrays of different shapes: {shapes}; must be one, or single numbers"
            ) from None
        for key, column, low, high in zip(part.keys, columns, part.low, part.high, strict=True):
            inside = (column >= low - _ROUNDING * abs(low)) & (
                column <= high + _ROUNDING * abs(high)
            )
            if not inside.all():
                raise InputError(
                    f"surrogate: {key} = {column[~inside].flat[0]:.9g}: must be from {low:.9g} to "
                    f"{high:.9g}, as in the study's cases; nothing is extrapolated"
                )
        shape = columns[0].shape
        x = np.stack([column.ravel() for column in columns], axis=1)
        responses = part.at(part.places_of(np.clip(x, part.low, part.high)), wanted)
        return {
            name: array.reshape((*shape, *part.responses[name].shape))
            for name, array in responses.items()
        }

    def _part(self, values: Mapping[str, Any]) -> Part:
        """Return the part that values are of, all of whose keys they must have."""
        texts = []
        for key in self.text_keys:
            if key not in values:
                raise InputError(f"surrogate: {key} is missing; must be {self._allowed(key)}")
            texts.append(_as_text(values[key]))
        parts = [part for part in self.parts if list(part.texts) == texts]
        if not parts:
            combination = ", ".join(
                f"{k} = {shortened(t)}" for k, t in zip(self.text_keys, texts, strict=True)
            )
            allowed = "; ".join(", ".join(map(shortened, part.texts)) for part in self.parts)
            raise InputError(
                f"surrogate: {combination}: must be as in the study's cases: {allowed}"
            )
        missing = [key for key in parts[0].keys if key not in values]
        if missing:
            raise InputError(
                f"surrogate: {missing[0]} is missing; must be {self._allowed(missing[0])}"
            )
        known = (*self.text_keys, *parts[0].keys)
        for key in values:
            if key not in known:
                raise InputError(
                    f"surrogate: {legible(str(key))}: is not varied; must be one of "
                    f"{', '.join(known)}"
                )
        return parts[0]

    def _allowed(self, key: str) -> str:
        ends = self.ranges[key]
        if key in self.text_keys:
            return f"one of {', '.join(map(shortened, ends))}"
        return f"from {ends[0]:.9g} to {ends[1]:.9g}"

    def __repr__(self) -> str:
        over = dict.fromkeys(self.text_keys)
        for part in self.parts:
            over.update(dict.fromkeys(part.keys))
        errors, relative = self.error, self.relative_error
        words = (
            f"{name} {errors[name]:.2g} {unit_of(name)} ({share_words(relative[name])})"
            for name in self.names
            if relative[name] > 0.0
        )
        return (
            f"<Surrogate of {self.used} of {self.cases} cases over {', '.join(over)}; leave-out "
            f"errors (of the spread): {', '.join(words)}>"
        )


def share_words(relative_error: float) -> str:
    """Return a leave-out error in percent of the spread, with a word where it is coarse."""
    percent = 100.0 * relative_error
    if percent < _EXACT:
        return f"< {_EXACT:g} %"
    number = f"{percent:.2g}" if percent < 10.0 else f"{percent:.0f}"
    return f"{number} %{', coarse' if relative_error > COARSE else ''}"


def _numbers(key: str, value: Any) -> FloatArray:
    try:
        return np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        raise InputError(
            f"surrogate: {key} = {shortened(value)}: must be a number, or an array of them"
        ) from None


def _as_text(value: Any) -> str:
    """Return a value of a varied key that is no number as results have it."""
    if value is None:
        return ""
    return value if isinstance(value, str) else toml_value(value)


def unit_of(name: str) -> str:
    """Return the unit of a response."""
    return "mm" if name in (*DEPTHS, *LARGEST) else end_value_of(name)[0].stored.unit
