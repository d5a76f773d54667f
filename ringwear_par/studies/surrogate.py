"""``rw.surrogate``: what answers for a sweep's cases, from the results to a file beside them.

Its regressions, see ``regression``, go over the varied keys, by logarithms where the study varies
them so.
"""

import hashlib
import json
import logging
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.cases.text import shortened, toml_value
from ringwear_par.errors import InputError, RingwearError, legible
from ringwear_par.results.hdf5 import atomic_hdf5
from ringwear_par.results.reading import read_array, read_number, read_text, reading
from ringwear_par.results.variables import HISTORIES, Variable
from ringwear_par.studies.ensemble import Ensemble, read_ensemble
from ringwear_par.studies.regression import Part, Response, fitted, forms_for, places_between
from ringwear_par.studies.results_file import FINAL
from ringwear_par.studies.sensitivity import chosen_cases, done_cases
from ringwear_par.studies.variations import read_variations
from ringwear_par.textfiles import parse_toml

if TYPE_CHECKING:
    import xarray

log = logging.getLogger(__name__)

SURROGATE = "surrogate.h5"
#: profiles of wear, and their largest values
_DEPTHS = ("wear_lower", "wear_upper")
_LARGEST = tuple(f"largest_{name}" for name in _DEPTHS)
_SOFTWARE, _WHAT = "ringwear-par surrogate 1", "a surrogate of a sweep"
#: leave-out errors above this part of a response's spread are called coarse
COARSE = 0.1
#: most cases that are interpolated
_MOST = 1000
#: cases nearer to each other than this part of all ranges are one
_DIGITS = 6
#: the design's own ends count as covered where a case is so near, as a part of the range
_NEAR = 0.1
_ROUNDING = 1e-9
#: %, below which errors are those of rounding
_EXACT = 1e-6
#: keys whose ranges the study does not tell go by logarithms where they span so much, unevenly
_LOG_KEY = 20.0
#: stored states whose profiles are read at once
_STATES = 4000


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
        """Responses: final ones, or those at the times asked for."""
        first, *others = self.parts
        return tuple(n for n in first.responses if all(n in part.responses for part in others))

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
        found: dict[str, tuple[Any, ...]] = {
            key: tuple(dict.fromkeys(part.texts[i] for part in self.parts))
            for i, key in enumerate(self.text_keys)
        }
        for part in self.parts:
            for key, low, high in zip(part.keys, part.low, part.high, strict=True):
                there = found.get(key, (low, high))
                found[key] = float(min(low, there[0])), float(max(high, there[1]))
        return found

    def predict(
        self, values: Mapping[str, Any], names: Sequence[str] | None = None
    ) -> dict[str, FloatArray]:
        """Return responses by name.

        Parameters
        ----------
        values : of every varied key: numbers or arrays, which go together as numpy's do; a text of
            a key that is no number.
        names : of the responses wanted, None for all.

        Returns
        -------
        Arrays of the values' common shape, followed by an axis of times or elements where a
        response has one.

        Raises
        ------
        InputError : a value outside the range of the study's cases, a key that is missing or not
            varied, an unknown response.
        """
        wanted = self.names if names is None else tuple(names)
        unknown = [name for name in wanted if name not in self.names]
        if unknown:
            why = "unknown response"
            if unknown[0] in (*_DEPTHS, *_LARGEST):
                why = (
                    'needs stored profiles, of all steps (output.profiles = "all") where there are '
                    "times, and of the same contact elements"
                )
            raise InputError(
                f"surrogate: {legible(str(unknown[0]))}: {why}; must be one of "
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
        found = part.at(part.places_of(np.clip(x, part.low, part.high)), wanted)
        return {
            name: array.reshape((*shape, *part.responses[name].shape))
            for name, array in found.items()
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
            said = ", ".join(
                f"{k} = {shortened(t)}" for k, t in zip(self.text_keys, texts, strict=True)
            )
            allowed = "; ".join(", ".join(map(shortened, part.texts)) for part in self.parts)
            raise InputError(f"surrogate: {said}: must be as in the study's cases: {allowed}")
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
        told = (
            f"{name} {errors[name]:.2g} {_unit(name)} ({told_share(relative[name])})"
            for name in self.names
            if relative[name] > 0.0
        )
        return (
            f"<Surrogate of {self.used} of {self.cases} cases over {', '.join(over)}; leave-out "
            f"errors (of the spread): {', '.join(told)}>"
        )


def told_share(relative_error: float) -> str:
    """Return a leave-out error in percent of the spread, with a word where it is coarse."""
    percent = 100.0 * relative_error
    if percent < _EXACT:
        return f"< {_EXACT:g} %"
    told = f"{percent:.2g}" if percent < 10.0 else f"{percent:.0f}"
    return f"{told} %{', coarse' if relative_error > COARSE else ''}"


def surrogate(
    ensemble: "xarray.Dataset | Ensemble | Path | str", times: Sequence[float] | None = None
) -> Surrogate:
    """Return regressions of a sweep's responses over its varied keys. Not collective.

    Responses are ``penetration``, ``worn_volume_lower``, ``worn_volume_upper`` and, where profiles
    are stored, the largest depths of wear ``largest_wear_lower``, ``largest_wear_upper`` and, where
    all cases have the same contact elements, the profiles ``wear_lower``, ``wear_upper``. At times
    these four need profiles of all stored steps (``output.profiles = "all"``). Cases that are not
    done are left out; of many, 1,000 are chosen at random. The surrogate is kept beside the
    results, as ``surrogate.h5``, and is made again once these have changed.

    Keys that are no numbers get a surrogate for each combination of their values. Ranges are those
    of each key alone: where keys of a list vary together, what no case is near is not told.

    Parameters
    ----------
    ensemble : the folder of a sweep, its results.h5, or what ``rw.open_ensemble`` returns of it.
    times : s, of the responses; None for the last step. Between stored states they are on a
        straight line: ``output.times`` in the base case is better.

    Raises
    ------
    InputError : too few cases are done, their keys vary together, a time that not all cases have;
        the folder holds no results.
    """
    found = _ensemble(ensemble)
    asked = None if times is None else _times(times)
    identity, path = _identity(found, asked), found.path.with_name(SURROGATE)
    if path.exists():
        try:
            kept = _read(path, identity)
        except InputError as error:
            log.warning("%s; it is made again", error)
        else:
            if kept is not None:
                _tell(kept)
                return kept
    made = _made(found, asked)
    try:
        _write(path, made, identity)
    except (OSError, RingwearError) as error:
        log.warning("%s: the surrogate is not kept: %s", path, error)
    _tell(made)
    return made


def _tell(made: Surrogate) -> None:
    for name, relative in made.relative_error.items():
        if relative > COARSE:
            log.warning(
                "surrogate: the leave-out error of %s is %.0f %% of its spread; more cases would "
                "make it smaller", name, 100.0 * relative,
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
    found = read_ensemble(Path(source).parent)
    if ensemble.sizes.get("case") != len(found.ids):
        raise InputError(
            f"{found.path}: some of its cases were selected; must be all that open_ensemble returns"
        )
    return found


def _times(times: Sequence[float]) -> FloatArray:
    try:
        asked = np.array(times, dtype=float)
    except (TypeError, ValueError):
        asked = np.empty(0)
    if asked.ndim != 1 or not len(asked) or not np.isfinite(asked).all():
        raise InputError(f"times = {legible(str(times))}: must be a list of numbers, s")
    return asked


def _identity(ensemble: Ensemble, times: FloatArray | None) -> str:
    """Return what tells these results, and times, from others."""
    found = hashlib.sha256()
    numbers = [ensemble.in_study, ensemble.steps_stored, *ensemble.final.values()]
    words = [ensemble.ids, ensemble.status, tuple(ensemble.varied)]
    for values in ensemble.varied.values():
        (numbers if values.dtype.kind == "f" else words).append(values)
    if times is not None:
        numbers.append(times)
    for texts in (*words, [str(ensemble.attributes.get("study"))]):
        found.update("\0".join(texts).encode() + b"\n")
    for array in numbers:
        found.update(np.ascontiguousarray(array).tobytes())
    return found.hexdigest()


def _made(ensemble: Ensemble, times: FloatArray | None) -> Surrogate:
    done = done_cases(ensemble) & (ensemble.steps_stored > 1)
    done &= np.isfinite(list(ensemble.final.values())).all(axis=0)
    logarithmic = _spacings(ensemble)
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
        parts.append(_part(ensemble, combination, keys, logarithmic, chosen, times))
    if not parts:
        raise InputError(few or f"{ensemble.path}: no case is done; a surrogate needs some")
    return Surrogate(texts, parts, int(ensemble.in_study.sum()), int(done.sum()))


def _needed(keys: Sequence[str]) -> int:
    return 4 * (len(keys) + 1)


def _known(values: FloatArray) -> FloatArray:
    return values[np.isfinite(values)]


def _spacings(ensemble: Ensemble) -> dict[str, tuple[bool, tuple[float, float]]]:
    """Return of the keys that the design varies by ranges: whether by logarithms, and the ends."""
    try:
        tables = parse_toml(read_text(ensemble.attributes["study"]), "study")
    except (InputError, KeyError, ValueError):
        return {}
    vary, design = tables.get("vary"), tables.get("design", {})
    if not isinstance(vary, dict) or not isinstance(design, dict):
        return {}
    varied = read_variations("study", vary, str(design.get("method", "grid")), [])
    return {
        each.name: (each.spacing == "log", (each.values[0], each.values[1]))
        for each in varied
        if each.spacing != "values"
    }


def _part(
    ensemble: Ensemble, texts: Sequence[str], keys: Sequence[str],
    designed: Mapping[str, tuple[bool, tuple[float, float]]], cases: IntArray,
    times: FloatArray | None,
) -> Part:  # fmt: skip
    """Return the surrogate of some cases, increasing."""
    x = np.stack([ensemble.varied[key][cases] for key in keys], axis=1)
    low, high = x.min(axis=0), x.max(axis=0)
    logarithmic = np.zeros(len(keys), dtype=bool)
    for i, key in enumerate(keys):
        evenly = np.median(x[:, i]) > 0.3 * (low[i] + high[i])
        by_log, ends = designed.get(key, (not evenly and high[i] > _LOG_KEY * low[i], ()))
        logarithmic[i] = by_log and low[i] > 0.0
        if ends:
            one = slice(i, i + 1)
            near = places_between(np.array(ends)[:, None], low[one], high[one], logarithmic[one])[
                :, 0
            ]
            if -_NEAR <= near[0] <= 0.0:
                low[i] = ends[0]
            if 1.0 <= near[1] <= 1.0 + _NEAR:
                high[i] = ends[1]
    points = places_between(x, low, high, logarithmic)
    _, apart = np.unique(np.round(points, _DIGITS), axis=0, return_index=True)
    points, cases = points[np.sort(apart)], cases[np.sort(apart)]
    if len(points) < _needed(keys):
        raise InputError(
            f"{ensemble.path}: {len(points)} cases differ, in {len(keys)} keys; a surrogate needs "
            f"{_needed(keys)} of them at least"
        )
    values = _responses(ensemble, cases, times)
    try:
        if np.linalg.matrix_rank(np.insert(points, 0, 1.0, axis=1), tol=1e-6) <= len(keys):
            raise np.linalg.LinAlgError
        stretches, responses = fitted(points, values)
    except np.linalg.LinAlgError:
        raise InputError(
            f"{ensemble.path}: {', '.join(keys)} vary together, or nearly so; a surrogate needs "
            "cases in which each varies by itself"
        ) from None
    return Part(tuple(texts), tuple(keys), low, high, logarithmic, points, stretches, responses)


def _responses(
    ensemble: Ensemble, cases: IntArray, times: FloatArray | None
) -> dict[str, FloatArray]:
    """Return values (cases, ...) of the responses that all the cases have."""
    block = max(1, _STATES // int(ensemble.steps_stored.max()))
    parts = [cases[start : start + block] for start in range(0, len(cases), block)]
    read = [dict(_read_responses(ensemble, part, times)) for part in parts]
    values = {name: np.concatenate([each[name] for each in read]) for name in read[0]}
    mid_points = ensemble.profiles("r", cases)
    same = mid_points is not None and np.ptp(mid_points, axis=0).max() <= 1e-9
    for name, largest in zip(_DEPTHS, _LARGEST, strict=True):
        wear = values.pop(name, None)
        if wear is not None and np.isfinite(wear).any(axis=-1).all():
            values[largest] = np.nanmax(wear, axis=-1)
            if same and np.isfinite(wear).all():
                values[name] = wear
    return values


def _read_responses(
    ensemble: Ensemble, cases: IntArray, times: FloatArray | None
) -> Iterator[tuple[str, FloatArray]]:
    """Yield final values and profiles of some cases, or those at times."""
    stored = ensemble.steps_stored[cases]
    if times is None:
        states = None
        for name in FINAL:
            yield name, ensemble.final[name][cases]
    else:
        states = _States(ensemble.histories("time", cases), stored, times)
        for name in FINAL:
            yield name, states.of(ensemble.histories(name, cases))
    for name in _DEPTHS:
        table = ensemble.profiles(name, cases)
        if table is None or (table.ndim == 2 and states is not None):
            continue
        if states is not None:
            yield name, states.of(table)
        else:
            yield name, table if table.ndim == 2 else table[np.arange(len(table)), stored - 1]


class _States:
    """Stored states around some times of each case, and values between them.

    Parameters
    ----------
    time : (cases, steps), NaN behind the stored ones.
    stored : (cases,) number of stored states, two at least.
    at : (times,).

    Raises
    ------
    InputError : a case does not last so long.
    """

    def __init__(self, time: FloatArray, stored: IntArray, at: FloatArray) -> None:
        self._cases = np.arange(len(time))[:, None]
        end = float(time[self._cases[:, 0], stored - 1].min())
        outside = at[(at < 0.0) | (at > end * (1.0 + 1e-9))]
        if len(outside):
            raise InputError(
                f"times = {outside[0]:.9g}: must be from 0 to {end:.9g} s, where a case ends"
            )
        self._after = np.array([
            np.clip(np.searchsorted(t[:n], at), 1, n - 1)
            for t, n in zip(time, stored, strict=True)
        ])  # fmt: skip
        before, after = time[self._cases, self._after - 1], time[self._cases, self._after]
        self._share = np.clip((at - before) / (after - before), 0.0, 1.0)

    def of(self, table: FloatArray) -> FloatArray:
        """Return values (cases, times, ...) of a table (cases, steps, ...)."""
        share = self._share.reshape(*self._share.shape, *(1,) * (table.ndim - 2))
        before = table[self._cases, self._after - 1]
        return before + share * (table[self._cases, self._after] - before)


# -- file ------------------------------------------------------------------------------------------


def _write(path: Path, made: Surrogate, identity: str) -> None:
    with atomic_hdf5(path) as (file, _):
        file.attrs.update({
            "software": _SOFTWARE, "results": identity, "cases": made.cases, "done": made.done,
            "text_keys": json.dumps(made.text_keys), "parts": len(made.parts),
        })  # fmt: skip
        for number, part in enumerate(made.parts):
            group = file.create_group(f"part_{number}")
            group.attrs.update(keys=json.dumps(part.keys), texts=json.dumps(part.texts))
            for name in _OF_KEYS:
                group[name] = getattr(part, name).astype(float)
            group["points"] = part.points
            for name, response in part.responses.items():
                group[name] = response.values
                group[name].attrs.update(
                    form=response.form, error=response.error, form_error=response.form_error,
                    shape=json.dumps(response.shape), units=_unit(name),
                )  # fmt: skip
            group.attrs["responses"] = json.dumps(list(part.responses))


_OF_KEYS = ("low", "high", "logarithmic", "stretches")


def _read(path: Path, identity: str) -> Surrogate | None:
    """Return a surrogate that was kept; None if it is one of other results.

    Raises
    ------
    InputError : the file is damaged.
    """
    with reading(path, _SOFTWARE, _WHAT) as file:
        if read_text(file.attrs["results"]) != identity:
            return None
        parts = []
        for number in range(int(read_number(file.attrs["parts"]))):
            group = file[f"part_{number}"]
            keys = _words(group.attrs["keys"])
            sizes = {"key": len(keys)}
            low, high, logarithmic, stretches = (
                _finite(group, name, ("key",), sizes) for name in _OF_KEYS
            )
            points = _finite(group, "points", ("case", "key"), sizes)
            responses = {}
            for name in _words(group.attrs["responses"]):
                about = group[name].attrs
                response = Response(
                    _finite(group, name, ("case", f"column of {name}"), sizes),
                    read_text(about["form"]), float(read_number(about["error"])),
                    float(read_number(about["form_error"])),
                    tuple(map(int, json.loads(read_text(about["shape"])))),
                )  # fmt: skip
                if response.form not in forms_for(response.values):
                    raise ValueError(name)
                response.values.reshape(-1, *response.shape)
                responses[name] = response
            texts, by_log = _words(group.attrs["texts"]), logarithmic > 0.0
            if not (low < high).all() or not (low[by_log] > 0.0).all():
                raise ValueError("low")
            parts.append(Part(texts, keys, low, high, by_log, points, stretches, responses))
        return Surrogate(
            _words(file.attrs["text_keys"]), parts, int(read_number(file.attrs["cases"])),
            int(read_number(file.attrs["done"])),
        )  # fmt: skip


def _words(value: Any) -> tuple[str, ...]:
    return tuple(map(read_text, json.loads(read_text(value))))


def _finite(group: Any, name: str, dimensions: tuple[str, ...], sizes: dict[str, int]) -> Any:
    array = read_array(group, Variable(name, dimensions, "", ""), sizes)
    if not np.isfinite(array).all():
        raise ValueError(name)
    return array


def _numbers(key: str, value: Any) -> FloatArray:
    try:
        return np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        raise InputError(
            f"surrogate: {key} = {legible(str(value))}: must be a number, or an array of them"
        ) from None


def _as_text(value: Any) -> str:
    """Return a value of a varied key that is no number as results have it."""
    if value is None:
        return ""
    return value if isinstance(value, str) else toml_value(value)


def _unit(name: str) -> str:
    return HISTORIES[name].unit if name in HISTORIES else "mm"
