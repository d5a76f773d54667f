"""Regressions over places between the ends of keys, with the error that they make.

Each response is interpolated by cubic radial functions and a linear polynomial (SciPy's
``RBFInterpolator``) over the keys, stretched such that cases that are left out are met best. Of the
response itself, its roots or its logarithm that is taken with which they are met best: wear grows
with powers of the keys, and stays near zero where pressures hardly pass a threshold.

Of grids, cases left out by lot say nothing of the values between those of a key: there, whole
values are left out, too. Where a key has few values, cubic functions swing between them by the
distance of these over the range of another key: stretches keep that below one.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray, IntArray
from ringwear_par.studies.analysis.responses import SEED, upper_limit

if TYPE_CHECKING:
    from scipy.interpolate import RBFInterpolator

#: most cases from which stretches of the keys are found
_MOST_STRETCHED = 150
#: decimals of the places of keys to which values of a key count as the same
_DIGITS = 6
#: share of the width of a gap that counts in errors: values that are left out of a key leave a gap
#: twice as wide as those of the design, and where a response has kinks errors grow with the width
_HOLE = 0.5
#: parts that are left out in turn, for the errors and for the search for stretches
_FOLDS, _FEW_FOLDS = 10, 4
#: places along a key, and points over the other keys at each, of a mean over these
_PLACES, _OTHER_POINTS = 41, 2**8


def _square(values: FloatArray) -> FloatArray:
    return np.square(np.maximum(values, 0.0))


#: the function of a response that is interpolated, and its inverse
_FORMS: dict[str, tuple[Any, Any]] = {
    "logarithm": (np.log, np.exp),
    "cube root": (np.cbrt, lambda values: values**3),
    "square root": (np.sqrt, _square),
    "itself": (np.asarray, np.asarray),
}


@dataclass(frozen=True)
class Response:
    """A response in the cases of a part, and how well it is met where they are left out."""

    #: (cases, columns), one column a time, or an element of a profile
    values: FloatArray
    #: which function of it is interpolated, a name in the table of forms
    form: str
    #: root mean square of leave-out errors, in the response's unit
    error: float
    #: root mean square of leave-out errors of its form
    form_error: float
    #: of a case's values, whose product is the number of columns: () of one number
    shape: tuple[int, ...]
    #: above which it cannot be
    limit: float = math.inf

    @cached_property
    def spread(self) -> float:
        """Root mean square of the distance from the mean, in the response's unit."""
        return _rms(self.values - self.values.mean(axis=0))

    @property
    def relative_error(self) -> float:
        """Leave-out error as a part of the spread, 0 of what does not vary."""
        varies = self.spread > 1e-12 * float(np.abs(self.values).max())
        return self.error / self.spread if varies else 0.0

    def shifted(self, values: FloatArray, errors: float) -> FloatArray:
        """Return values of the response, shifted by a number of leave-out errors of its form."""
        shifted = _FORMS[self.form][0](values) + errors * self.form_error
        return self.back(shifted)

    def back(self, table: FloatArray) -> FloatArray:
        """Return the response from its form, where it can be."""
        return _back(table, self.form, self.values, self.limit)


@dataclass(frozen=True)
class Part:
    """The surrogate of the cases that share all texts."""

    #: values of the varied keys that are no numbers
    texts: tuple[str, ...]
    #: the varied keys that are numbers and differ
    keys: tuple[str, ...]
    #: (keys,) ends of their ranges
    low: FloatArray
    high: FloatArray
    #: (keys,) whether a key goes by its logarithm
    logarithmic: BoolArray
    #: (cases, keys) places between the ends, about 0 to 1
    points: FloatArray
    #: (keys,) what they are multiplied by
    stretches: FloatArray
    #: by name
    responses: dict[str, Response]

    def values_at(self, key: int, places: FloatArray) -> FloatArray:
        """Return the values of a key at places from 0 to 1 of its range."""
        low, high = self.low[key], self.high[key]
        if self.logarithmic[key]:
            return low * (high / low) ** places
        return low + (high - low) * places

    def places_of(self, values: FloatArray) -> FloatArray:
        """Return places from 0 to 1 of values of the keys (..., keys)."""
        return places_between(values, self.low, self.high, self.logarithmic)

    def at(self, points: FloatArray, names: Sequence[str]) -> dict[str, FloatArray]:
        """Return responses (len(points), columns) at points (., keys) from 0 to 1."""
        table = self._interpolator(tuple(names))(points * self.stretches)
        ends = np.cumsum([self.responses[name].values.shape[1] for name in names])
        columns = np.split(table, ends[:-1], axis=1)
        return {n: self.responses[n].back(c) for n, c in zip(names, columns, strict=True)}

    def mean_along(
        self, key: int, name: str
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return values of a key, the mean of a response there, and it -+ 2 leave-out errors.

        The mean is over the ranges of the other keys.
        """
        from scipy.stats import qmc  # slow to import

        places, response = np.linspace(0.0, 1.0, _PLACES), self.responses[name]
        other_keys = qmc.Sobol(len(self.keys), seed=SEED).random(_OTHER_POINTS)
        points = np.repeat(other_keys[None], len(places), axis=0)
        points[:, :, key] = places[:, None]
        values = self.at(points.reshape(-1, len(self.keys)), (name,))[name]
        mean = values.reshape(len(places), -1).mean(axis=1)
        low, high = (response.shifted(mean, by) for by in (-2.0, 2.0))
        return self.values_at(key, places), mean, low, high

    def _interpolator(self, names: tuple[str, ...]) -> "RBFInterpolator":
        if names not in self._interpolators:
            table = [_FORMS[self.responses[n].form][0](self.responses[n].values) for n in names]
            self._interpolators[names] = _interpolator(
                self.points * self.stretches, np.concatenate(table, axis=1)
            )
        return self._interpolators[names]

    @cached_property
    def _interpolators(self) -> dict[tuple[str, ...], "RBFInterpolator"]:
        return {}


def places_between(
    values: FloatArray, low: FloatArray, high: FloatArray, logarithmic: BoolArray
) -> FloatArray:
    """Return where values (..., keys) are between the ends: 0 to 1."""
    places = np.empty(values.shape)
    for i, by_log in enumerate(logarithmic):
        if by_log:
            places[..., i] = np.log(values[..., i] / low[i]) / math.log(high[i] / low[i])
        else:
            places[..., i] = (values[..., i] - low[i]) / (high[i] - low[i])
    return places


def _interpolator(points: FloatArray, table: FloatArray) -> "RBFInterpolator":
    from scipy.interpolate import RBFInterpolator  # slow to import

    return RBFInterpolator(points, table, kernel="cubic", degree=1)


def _left_out(
    points: FloatArray, table: FloatArray, folds: Sequence[BoolArray]
) -> tuple[FloatArray, IntArray]:
    """Return rows of a table as interpolated where their fold is left out, and their cases."""
    rows = [_interpolator(points[~out], table[~out])(points[out]) for out in folds]
    return np.concatenate(rows), np.concatenate([np.flatnonzero(out) for out in folds])


def _by_lot(count: int, parts: int) -> list[BoolArray]:
    """Return which cases are left out, in turn."""
    parts = min(parts, count)
    part_numbers = np.random.default_rng(SEED).permutation(count) % parts
    return [part_numbers == part for part in range(parts)]


def _by_value(points: FloatArray, parts: int) -> list[list[BoolArray]]:
    """Return, for each key whose values repeat, which of those between its ends are left out."""
    by_key = []
    for column in np.round(points, _DIGITS).T:
        values = np.unique(column)
        if 2 * len(values) > len(points):
            continue
        inner = values[1:-1]
        folds = [np.isin(column, inner[i::parts]) for i in range(min(parts, len(inner)))]
        folds = [out for out in folds if _suffice(points[~out])]
        if folds:
            by_key.append(folds)
    return by_key


def _suffice(points: FloatArray) -> bool:
    """Tell whether points determine a linear polynomial, and more."""
    count, keys = points.shape
    return count > keys + 1 and bool(
        np.linalg.matrix_rank(np.insert(points, 0, 1.0, axis=1), tol=1e-6) > keys
    )


def untested(points: FloatArray) -> list[int]:
    """Return the keys that have two values only: no case tests the surrogate between them."""
    return [i for i, column in enumerate(np.round(points, _DIGITS).T) if len(set(column)) < 3]


def fit_responses(
    points: FloatArray, values: Mapping[str, FloatArray]
) -> tuple[FloatArray, dict[str, Response]]:
    """Return the stretches of the keys, and the responses with their leave-out errors.

    These are the largest of those of cases left out by lot, and half of those of values of each
    key. Few cases are left out of the choice of stretches and forms, too. That of many hardly
    depends on the tenth that is left out, and would take long; so would it for values of keys.
    """
    flat = {name: array.reshape(len(array), -1) for name, array in values.items()}
    chosen = _chosen(points, flat)
    errors = dict.fromkeys(flat, (0.0, 0.0))
    sets = [_by_lot(len(points), _FOLDS), *_by_value(points, _FOLDS)]
    for number, folds in enumerate(sets):
        anew = not number and len(points) <= _MOST_STRETCHED
        for name, (error, form_error) in _errors(points, flat, folds, chosen, anew=anew).items():
            share = _HOLE if number else 1.0
            errors[name] = max(errors[name], (share * error, share * form_error))
    stretches, forms = chosen
    return stretches, {
        name: Response(array, forms[name], *errors[name], values[name].shape[1:], upper_limit(name))
        for name, array in flat.items()
    }


def _errors(
    points: FloatArray, values: Mapping[str, FloatArray], folds: Sequence[BoolArray],
    chosen: tuple[FloatArray, dict[str, str]], *, anew: bool,
) -> dict[str, tuple[float, float]]:  # fmt: skip
    """Return the errors of responses that are left out in turn, and those of their forms.

    With the chosen stretches and forms, or others chosen anew without each fold; errors of forms
    are of those above.
    """
    left_out: dict[str, list[FloatArray]] = {name: [] for name in values}
    form_errors: dict[str, list[FloatArray]] = {name: [] for name in values}
    for out in folds:
        rest = {name: array[~out] for name, array in values.items()}
        stretches, forms = _chosen(points[~out], rest) if anew else chosen
        stretches = _limited(stretches, points[~out])
        for name, array in rest.items():
            interpolator = _interpolator(points[~out] * stretches, _FORMS[forms[name]][0](array))
            table = interpolator(points[out] * stretches)
            predicted, expected = (
                _back(table, forms[name], array, upper_limit(name)),
                values[name][out],
            )
            left_out[name].append(predicted - expected)
            form, _ = _FORMS[chosen[1][name]]
            with np.errstate(divide="ignore"):  # logarithms, where others were chosen meanwhile
                differences = form(predicted) - form(expected)
            form_errors[name].append(differences[np.isfinite(differences)])
    return {
        name: (_rms(np.concatenate(left_out[name])), _rms(np.concatenate(form_errors[name])))
        for name in values
    }


def _chosen(
    points: FloatArray, values: Mapping[str, FloatArray]
) -> tuple[FloatArray, dict[str, str]]:
    """Return the stretches of the keys, and the forms, with the least leave-out errors."""
    stretches = np.ones(points.shape[1])
    if len(stretches) > 1:
        from scipy.optimize import minimize  # slow to import

        some = np.random.default_rng(SEED).permutation(len(points))[:_MOST_STRETCHED]
        few, at = {name: array[some] for name, array in values.items()}, points[some]
        table = np.concatenate(
            [_evened(_FORMS[form][0](few[name])) for name, form in _best_forms(at, few).items()],
            axis=1,
        )
        folds = _folds(at)

        def error(logarithms: FloatArray) -> float:
            rows, cases = _left_out(at * _stretched(logarithms, at), table, folds)
            return _rms(rows - table[cases])

        best = minimize(
            error, np.zeros_like(stretches), method="Nelder-Mead",
            options={
                "initial_simplex": np.vstack([0.0 * stretches, np.eye(len(stretches))]),
                "maxfev": 25 * len(stretches), "xatol": 0.05,
            },
        )  # fmt: skip
        stretches = _stretched(best.x, points)
    return stretches, _best_forms(points * stretches, values)


def _folds(points: FloatArray) -> list[BoolArray]:
    """Return which cases are left out in turn by a search."""
    by_value = _by_value(points, _FEW_FOLDS)
    return [*_by_lot(len(points), _FEW_FOLDS), *(out for folds in by_value for out in folds)]


def _stretched(logarithms: FloatArray, points: FloatArray) -> FloatArray:
    """Return stretches of points whose product is about 1: cubic functions know no length."""
    stretches: FloatArray = np.exp(np.clip(logarithms - logarithms.mean(), -4.0, 4.0))
    return _limited(stretches, points)


def _limited(stretches: FloatArray, points: FloatArray) -> FloatArray:
    """Return stretches with which no hole in a key is wider than the range of another one."""
    values = [np.unique(column) for column in points.T]
    holes = [np.diff(v).max() / np.ptp(v) if len(v) > 1 else 1.0 for v in values]
    return np.minimum(stretches, stretches.min() / np.array(holes))


def _evened(table: FloatArray) -> FloatArray:
    """Return the columns of a response such that every response weighs the same, or none."""
    spread = _rms(table - table.mean(axis=0))
    varies = spread > 1e-12 * float(np.abs(table).max())
    return table / (math.sqrt(table.shape[1]) * spread) if varies else 0.0 * table


def _best_forms(points: FloatArray, values: Mapping[str, FloatArray]) -> dict[str, str]:
    """Return the form of each response with the least leave-out error."""
    tried = [(name, form) for name, array in values.items() for form in _forms_for(array)]
    tables = [_FORMS[form][0](values[name]) for name, form in tried]
    rows, cases = _left_out(points, np.concatenate(tables, axis=1), _folds(points))
    best: dict[str, tuple[float, str]] = {}
    columns = np.split(rows, np.cumsum([table.shape[1] for table in tables])[:-1], axis=1)
    for (name, form), table in zip(tried, columns, strict=True):
        predicted = _back(table, form, values[name], upper_limit(name))
        error = _rms(predicted - values[name][cases])
        best[name] = min(best.get(name, (math.inf, form)), (error, form))
    return {name: form for name, (_, form) in best.items()}


def _back(table: FloatArray, form: str, values: FloatArray, limit: float) -> FloatArray:
    """Return a response from its form; not negative where no case is."""
    with np.errstate(over="ignore"):
        response = _FORMS[form][1](table)
    return np.clip(response, 0.0 if values.min() >= 0.0 else -math.inf, limit)


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0


def _forms_for(array: FloatArray) -> list[str]:
    """Return the forms that a response has."""
    least = float(array.min())
    possible = {"logarithm": least > 0.0, "square root": least >= 0.0}
    return [form for form in _FORMS if possible.get(form, True)]
