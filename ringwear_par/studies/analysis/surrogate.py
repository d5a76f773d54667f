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
from ringwear_par.studies.analysis.predictions import COARSE, Surrogate
from ringwear_par.studies.analysis.regression import Part, fit_responses, places_between
from ringwear_par.studies.analysis.responses import chosen_cases, done_cases, read_responses
from ringwear_par.studies.storage.end_values import MAIN_END_VALUES
from ringwear_par.studies.storage.ensemble import Ensemble, read_ensemble

if TYPE_CHECKING:
    import xarray

log = logging.getLogger(__name__)

#: most cases that are interpolated
_MOST = 1000
#: cases nearer to each other than this part of all ranges are one
_DIGITS = 6
#: the design's own ends count as covered where a case is so near, as a part of the range
_NEAR = 0.1
#: keys whose ranges the study does not tell go by logarithms where they span so much, unevenly
_LOG_KEY = 20.0
#: most responses that a message names
_NAMED = 3


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
    return Surrogate(texts, parts, int(ensemble.in_study.sum()), int(done.sum()))


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
