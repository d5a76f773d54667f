"""``rw.surrogate``: the regressions of a sweep's responses.

They go over the varied keys, see ``regression``, by logarithms where the study varies them so.
"""

import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.errors import InputError, legible
from ringwear_par.files.text import shortened, toml_value
from ringwear_par.studies.analysis.regression import Part, fit_responses, places_between
from ringwear_par.studies.analysis.responses import (
    DEPTHS,
    LARGEST,
    chosen_cases,
    done_cases,
    read_responses,
)
from ringwear_par.studies.end_values import MAIN_END_VALUES, end_value_of
from ringwear_par.studies.ensemble import Ensemble, read_ensemble

if TYPE_CHECKING:
    import xarray

#: leave-out errors above this part of a response's spread are called coarse
COARSE = 0.1
#: and above this part responses are not drawn
USELESS = 0.2
_ROUNDING = 1e-9
#: %, below which errors are those of rounding
_EXACT = 1e-6
log = logging.getLogger(__name__)

#: most cases that are interpolated
_MOST = 1000
#: decimals of the shares of ranges to which cases count as the same
_DIGITS = 6
#: the design's own ends count as covered where a case is so near, as a part of the range
_NEAR = 0.1
#: keys without ranges in the study have logarithmic places where their values, unevenly spaced,
#: span so large a ratio
_LOG_KEY = 20.0
#: most responses that a message names
_NAMED = 3


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


def surrogate(
    ensemble: "xarray.Dataset | Ensemble | Path | str", times: Sequence[float] | None = None
) -> Surrogate:
    """Return regressions of a sweep's responses over its varied keys. Not collective.

    Responses are ``penetration``, ``worn_volume_lower``, ``worn_volume_upper``, the numbers of
    layers and of stress that all cases have, at times those that are stored at all steps, and,
    where profiles are stored, the largest depths of wear ``largest_wear_lower``,
    ``largest_wear_upper`` and, where all cases have the same contact elements, the profiles
    ``wear_lower``, ``wear_upper``. At times these four need profiles of all stored steps
    (``output.profiles = "all"``). Cases that are not done are left out; of many, 1,000 are chosen
    at random.

    Keys that are no numbers get a surrogate for each combination of their values. Ranges are those
    of each key alone: where keys of a list vary together, errors far from all cases are unknown.

    Parameters
    ----------
    ensemble : the folder of a sweep, its results.h5, or what ``rw.open_ensemble`` returns of it.
    times : s, of the responses; None for the last step. Between stored states they are on a
        straight line: ``output.times`` in the base case is better.

    Returns
    -------
    Surrogate : ``.predict(keys)``, and its measured ``.error`` by name of the response.

    Raises
    ------
    InputError : too few cases are done, their keys vary together, a time that not all cases have;
        the folder holds no results.
    """
    source = _ensemble(ensemble)
    regressions = _fit(source, None if times is None else _times(times))
    _warn_of_coarse(regressions)
    return regressions


def _warn_of_coarse(regressions: Surrogate) -> None:
    """Log which responses are met too coarsely, the worst of them by name."""
    errors = regressions.relative_error
    coarse = sorted((n for n in errors if errors[n] > COARSE), key=lambda n: -errors[n])
    if not coarse:
        return
    named = ", ".join(f"{name} {100.0 * errors[name]:.0f} %" for name in coarse[:_NAMED])
    more = len(coarse) - _NAMED
    log.warning(
        "surrogate: leave-out errors above %g %% of the spread, which more cases would make "
        "smaller: %s%s", 100.0 * COARSE, named,
        f" and {more} more (all in relative_error of rw.surrogate)" if more > 0 else "",
    )  # fmt: skip


def _ensemble(ensemble: Any) -> Ensemble:
    if isinstance(ensemble, Ensemble):
        return ensemble
    if isinstance(ensemble, Path | str):
        return read_ensemble(Path(ensemble))
    source = getattr(ensemble, "encoding", {}).get("source")
    if source is None:
        raise InputError(
            f"ensemble: a {type(ensemble).__name__} without a file; must be the folder of a sweep, "
            "its results.h5 or what open_ensemble returns"
        )
    whole = read_ensemble(Path(source).parent)
    if ensemble.sizes.get("case") != len(whole.ids):
        raise InputError(
            f"{whole.path}: some of its cases were selected; must be all that open_ensemble returns"
        )
    return whole


def _times(times: Sequence[float]) -> FloatArray:
    try:
        instants = np.array(times, dtype=float)
    except (TypeError, ValueError):
        instants = np.empty(0)
    if instants.ndim != 1 or not len(instants) or not np.isfinite(instants).all():
        raise InputError(f"times = {legible(str(times))}: must be a list of numbers, s")
    return instants


def _fit(ensemble: Ensemble, times: FloatArray | None) -> Surrogate:
    """Return the surrogate of all cases that are done, a part for each combination of texts."""
    done = done_cases(ensemble) & (ensemble.steps_stored > 1)
    done &= np.isfinite([ensemble.final[name] for name in MAIN_END_VALUES]).all(axis=0)
    designed = ensemble.spacings
    texts: list[str] = []
    numbers: list[str] = []
    for name, values in ensemble.varied.items():
        if len(np.unique(values[done].astype(str))) > 1:
            (numbers if values.dtype.kind == "f" else texts).append(name)
    groups: dict[tuple[str, ...], list[int]] = {}
    for row in np.flatnonzero(done).tolist():
        groups.setdefault(tuple(ensemble.varied[name][row] for name in texts), []).append(row)
    parts, few = [], ""
    for combination, rows in sorted(groups.items(), key=lambda group: -len(group[1])):
        cases = np.array(rows)
        keys = [k for k in numbers if len(np.unique(_known(ensemble.varied[k][cases]))) > 1]
        for key in keys:
            cases = cases[np.isfinite(ensemble.varied[key][cases])]
        needed = _needed(keys)
        if not keys or len(cases) < needed:
            few = few or (
                f"{ensemble.path}: {len(cases)} cases are done "
                + (f"in the largest of {len(groups)} groups of the same texts " if texts else "")
                + (f"and vary {len(keys)} keys; a surrogate needs {needed} of them at least"
                   if keys else "and no number varies; a surrogate needs one that does")
            )  # fmt: skip
            continue
        chosen = chosen_cases(cases, max(_MOST // len(groups), needed))
        parts.append(_part(ensemble, combination, keys, designed, chosen, times))
    if not parts:
        raise InputError(few or f"{ensemble.path}: no case is done; a surrogate needs some")
    return Surrogate(texts, parts, len(ensemble.ids), int(done.sum()))


def _needed(keys: Sequence[str]) -> int:
    return 4 * (len(keys) + 1)


def _known(values: FloatArray) -> FloatArray:
    return values[np.isfinite(values)]


def _part(
    ensemble: Ensemble, texts: Sequence[str], keys: Sequence[str],
    designed: Mapping[str, tuple[bool, tuple[float, float]]], cases: IntArray,
    times: FloatArray | None,
) -> Part:  # fmt: skip
    """Return the surrogate of some cases, increasing."""
    x = np.stack([ensemble.varied[key][cases] for key in keys], axis=1)
    low, high = x.min(axis=0), x.max(axis=0)
    logarithmic = np.zeros(len(keys), dtype=bool)
    for i, name in enumerate(keys):
        evenly = np.median(x[:, i]) > 0.3 * (low[i] + high[i])
        by_log, ends = designed.get(name, (not evenly and high[i] > _LOG_KEY * low[i], ()))
        logarithmic[i] = by_log and low[i] > 0.0
        if ends:
            key = slice(i, i + 1)
            near = places_between(np.array(ends)[:, None], low[key], high[key], logarithmic[key])
            near = near[:, 0]
            if -_NEAR <= near[0] <= 0.0:
                low[i] = ends[0]
            if 1.0 <= near[1] <= 1.0 + _NEAR:
                high[i] = ends[1]
    points = places_between(x, low, high, logarithmic)
    first = np.sort(np.unique(np.round(points, _DIGITS), axis=0, return_index=True)[1])
    points, cases = points[first], cases[first]
    if len(points) < _needed(keys):
        raise InputError(
            f"{ensemble.path}: {len(points)} cases differ, in {len(keys)} keys; a surrogate needs "
            f"{_needed(keys)} of them at least"
        )
    values = read_responses(ensemble, cases, times)
    try:
        if np.linalg.matrix_rank(np.insert(points, 0, 1.0, axis=1), tol=1e-6) <= len(keys):
            raise np.linalg.LinAlgError
        stretches, responses = fit_responses(points, values)
    except np.linalg.LinAlgError:
        raise InputError(
            f"{ensemble.path}: {', '.join(keys)} vary together, or nearly so; a surrogate needs "
            "cases in which each varies by itself"
        ) from None
    return Part(tuple(texts), tuple(keys), low, high, logarithmic, points, stretches, responses)
