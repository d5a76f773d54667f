"""``rw.surrogate``: Gaussian processes of a sweep's responses over its varied keys; Sobol' indices.

scikit-learn finds a length of each key (Matern 5/2) for a response, its square root and its
logarithm; the form with the smallest error in left-out cases is taken. That error follows from one
inverse, without other fits (C. E. Rasmussen and C. K. I. Williams, "Gaussian Processes for Machine
Learning", 2006, section 5.4.2). Single cases that are left out of a grid say nothing about what
lies between the values of a key: whole values of a key are left out, too.
"""

import logging
import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray, IntArray
from ringwear_par.errors import InputError, legible
from ringwear_par.results.variables import LAYER_HISTORIES
from ringwear_par.studies.end_values import end_value_of
from ringwear_par.studies.ensemble import Ensemble, read_ensemble
from ringwear_par.studies.factors import Factor

log = logging.getLogger(__name__)

#: largest error of a good surrogate, as a part of the response's spread: others are not drawn
GOOD = 0.1
#: seed of all random choices: the same results give the same figure
SEED = 1
#: most cases that are interpolated, and most that lengths are found from: a response takes some
#: 0.5 s, and 5e4 points a second are evaluated at least
_MOST, _MOST_FITTED = 500, 150
#: share that errors at a left-out value of a key count: the gap there is twice as wide as in the
#: design, and where a response has kinks errors grow with the width
_GAP = 0.5
#: decimals of coordinates to which values of a key count as the same
_DIGITS = 6
#: points that are evaluated together
_CHUNK = 1000
#: values along a key, and points over the other keys for the mean at each
_ALONG, _OTHERS = 41, 256
#: points of each of the two samples of Sobol' indices: sampling errors are below 0.01
_DRAWS = 4096

#: the forms of a response: function and inverse
_FORMS: dict[str, tuple[Any, Any]] = {
    "itself": (np.asarray, np.asarray),
    "square root": (np.sqrt, lambda table: np.square(np.maximum(table, 0.0))),
    "logarithm": (np.log, lambda table: np.exp(np.minimum(table, 700.0))),
}


@dataclass(frozen=True)
class Response:
    """A response as a Gaussian process of its form."""

    #: key of the table of forms
    form: str
    #: scikit-learn's regressor of the form, (cases, columns)
    process: Any
    #: root mean square of the distance from the mean over the cases
    spread: float
    #: of a case's values, whose product is the number of columns
    shape: tuple[int, ...]
    #: between which it can be
    limits: tuple[float, float]
    #: root mean square of errors in left-out cases: in the response's unit, and of the form
    error: float = 0.0
    form_error: float = 0.0

    @property
    def relative_error(self) -> float:
        """The error as a part of the spread, 0 where nothing varies."""
        return self.error / self.spread if self.spread else 0.0

    def back(self, table: FloatArray) -> FloatArray:
        """Return the response from values of its form."""
        return np.clip(_FORMS[self.form][1](table), *self.limits)

    def shifted(self, values: FloatArray, errors: float) -> FloatArray:
        """Return values of the response, shifted by a number of errors of its form."""
        return self.back(_FORMS[self.form][0](values) + errors * self.form_error)

    def at(self, points: FloatArray, *, deviations: bool = False) -> FloatArray:
        """Return values, or standard deviations, (points, columns) at points.

        A standard deviation is half of what lies between one of the form below and above.
        """
        parts = []
        for chunk in np.array_split(points, 1 + len(points) // _CHUNK):
            if deviations:
                mean, width = self.process.predict(chunk, return_std=True)
                parts.append(0.5 * (self.back(mean + width) - self.back(mean - width)))
            else:
                parts.append(self.back(self.process.predict(chunk)))
        return np.concatenate(parts).reshape(len(points), math.prod(self.shape))


@dataclass(frozen=True)
class Surrogate:
    """Gaussian processes over the varied keys of a sweep, see ``surrogate``."""

    #: the varied keys in which cases differ
    factors: tuple[Factor, ...]
    #: (cases that are interpolated, coordinates)
    points: FloatArray
    #: by name
    responses: dict[str, Response]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the responses."""
        return tuple(self.responses)

    @property
    def error(self) -> dict[str, float]:
        """Error (root mean square) of each response in left-out cases, in its unit."""
        return {name: response.error for name, response in self.responses.items()}

    @property
    def relative_error(self) -> dict[str, float]:
        """Error of each response as a part of its spread over the cases."""
        return {name: response.relative_error for name, response in self.responses.items()}

    @property
    def good(self) -> list[str]:
        """Names of the responses that vary and have small errors."""
        return [name for name, error in self.relative_error.items() if 0.0 < error <= GOOD]

    @property
    def ranges(self) -> dict[str, tuple[Any, ...]]:
        """Lowest and highest value of each varied key; all values of one that is a text."""
        return {factor.name: factor.texts or (factor.low, factor.high) for factor in self.factors}

    def predict(
        self, values: Mapping[str, Any], names: Sequence[str] | None = None,
        *, deviations: bool = False,
    ) -> dict[str, FloatArray]:  # fmt: skip
        """Return responses by name.

        Parameters
        ----------
        values : of every varied key: numbers or arrays, which go together as numpy's do; a text for
            a key that is no number.
        names : of the responses; None for all.
        deviations : return their standard deviations instead.

        Returns
        -------
        dict : arrays of the values' common shape, followed by further axes of a response.

        Raises
        ------
        InputError : a value outside the range of the study's cases, a key that is missing or not
            varied, an unknown response.
        """
        wanted = self.names if names is None else tuple(names)
        for name in wanted:
            if name not in self.responses:
                raise InputError(
                    f"surrogate: {legible(str(name))}: unknown response; must be one of "
                    f"{', '.join(self.names)}"
                )
        known = ", ".join(self.ranges)
        for key in {**values, **self.ranges}:
            if key not in self.ranges or key not in values:
                reason = "is missing" if key in self.ranges else "is not varied"
                raise InputError(f"surrogate: {legible(str(key))}: {reason}; keys: {known}")
        try:
            columns = np.broadcast_arrays(*(f.read(values[f.name]) for f in self.factors))
        except ValueError as error:
            raise InputError(f"surrogate: arrays that do not go together: {error}") from None
        points = self._points([column.ravel() for column in columns])
        answers = {}
        for name in wanted:
            response = self.responses[name]
            table = response.at(points, deviations=deviations)
            answers[name] = table.reshape((*columns[0].shape, *response.shape))
        return answers

    def _points(self, columns: Sequence[Any]) -> FloatArray:
        """Return points from the values of each factor."""
        return np.hstack([f.coordinates(c) for f, c in zip(self.factors, columns, strict=True)])

    def at(self, name: str, shares: FloatArray) -> FloatArray:
        """Return a number, (n,), at shares (n, factors) from 0 to 1 of what varies."""
        points = self._points([f.at(c) for f, c in zip(self.factors, shares.T, strict=True)])
        return self.responses[name].at(points)[:, 0]

    def mean_along(self, key: str, name: str) -> tuple[FloatArray, FloatArray]:
        """Return values of a key, and the mean of a number over the other keys at each."""
        from scipy.stats import qmc  # slow to import

        (i,) = (i for i, factor in enumerate(self.factors) if factor.name == key)
        texts = len(self.factors[i].texts)
        shares = (np.arange(texts) + 0.5) / texts if texts else np.linspace(0.0, 1.0, _ALONG)
        others = qmc.Sobol(len(self.factors), seed=SEED).random(_OTHERS)
        points = np.repeat(others[None], len(shares), axis=0)
        points[:, :, i] = shares[:, None]
        values = self.at(name, points.reshape(-1, len(self.factors)))
        return self.factors[i].at(shares), values.reshape(len(shares), -1).mean(axis=1)

    def __repr__(self) -> str:
        shares = {n: share_words(e) for n, e in self.relative_error.items() if e}
        return (
            f"<Surrogate of {len(self.points)} cases over {', '.join(self.ranges)}; errors in "
            f"left-out cases, of the spread: {', '.join(f'{n} {e}' for n, e in shares.items())}>"
        )


def share_words(relative_error: float) -> str:
    """Return an error in percent of the spread."""
    return f"{100.0 * relative_error:.2g} %"


@dataclass(frozen=True)
class Indices:
    """Sobol' indices of an output."""

    #: name of a final value
    output: str
    #: what varies
    keys: tuple[str, ...]
    #: (keys,) share of the variance by each alone, and by each with all others
    first: FloatArray
    total: FloatArray


def sobol_indices(made: Surrogate, name: str) -> Indices:
    """Return the Sobol' indices of a response that is a number.

    Keys vary evenly, or their logarithms where they go by them, and independently of each other,
    whatever the design was (estimators: A. Saltelli et al., Computer Physics Communications 181
    (2010) 259; M. Jansen, ibid. 117 (1999) 35).
    """
    from scipy.stats import qmc  # slow to import

    count = len(made.factors)
    one, other = np.split(qmc.Sobol(2 * count, seed=SEED).random(_DRAWS), 2, axis=1)
    mixed = np.where(np.eye(count, dtype=bool)[:, None], other, one)
    of_one, of_other = made.at(name, one), made.at(name, other)
    change = made.at(name, mixed.reshape(-1, count)).reshape(count, -1) - of_one
    variance = np.var(np.concatenate([of_one, of_other]))
    first = np.mean((of_other - of_other.mean()) * change, axis=1) / variance
    total = 0.5 * np.mean(change**2, axis=1) / variance
    return Indices(name, tuple(made.ranges), first, total)


def surrogate(
    folder: Ensemble | Path | str,
    responses: Sequence[str] | Mapping[str, Any] | None = None,
) -> Surrogate:
    """Return a surrogate of a sweep's responses over its varied keys. Not collective.

    Cases that are not done, or have no number for a varied key, are left out; of many, 500 are
    chosen at random. Ranges are those of each key alone: where keys of a list vary together, errors
    far from all cases are unknown.

    Parameters
    ----------
    folder : of the sweep, or its results.h5.
    responses : names of final values; or arrays (cases, ...) by name, such as a profile or values
        at times of ``rw.open_ensemble(folder)``; None for all final values that all cases have, but
        for places and numbers that follow from others.

    Returns
    -------
    Surrogate : ``.predict(keys)``, and its measured ``.error`` by name of the response.

    Raises
    ------
    InputError : scikit-learn is not installed; too few cases are done, their keys vary together; a
        response that cases do not have; the folder holds no results.
    """
    if find_spec("sklearn") is None:
        raise InputError(
            "a surrogate needs scikit-learn, which is not installed: "
            'pip install "ringwear-par[surrogate]"'
        )
    ensemble = folder if isinstance(folder, Ensemble) else read_ensemble(Path(folder))
    factors, points, cases = _cases(ensemble)
    final = ensemble.final
    if responses is None:
        finite = (n for n, v in final.items() if np.isfinite(v[cases]).all())
        responses = [name for name in finite if end_value_of(name)[0].smooth]
    given = responses if isinstance(responses, Mapping) else {n: final.get(n) for n in responses}
    numbers, fitted = sum(not factor.texts for factor in factors), {}
    for name, values in given.items():
        array = np.asarray(values, dtype=float)
        if array.shape[:1] != done_cases(ensemble).shape or not np.isfinite(array[cases]).all():
            raise InputError(
                f"surrogate: {legible(str(name))}: must be the name of a final value, or an array "
                f"({len(ensemble.ids)}, ...), finite in all cases that are done"
            )
        fitted[name] = fit_response(points, numbers, name, array[cases])
    made = Surrogate(factors, points, fitted)
    coarse = [f"{n} {share_words(e)}" for n, e in made.relative_error.items() if e > GOOD]
    if coarse:
        log.warning(
            "surrogate: errors in left-out cases, of the spread, which more cases would make "
            "smaller: %s", "; ".join(coarse),
        )  # fmt: skip
    return made


def done_cases(ensemble: Ensemble) -> BoolArray:
    """Return whether each case is done."""
    return np.array(ensemble.status) == "done"


def chosen_cases(cases: IntArray, most: int) -> IntArray:
    """Return the cases, or so many of them chosen at random, increasing."""
    if len(cases) <= most:
        return cases
    return np.sort(np.random.default_rng(SEED).choice(cases, most, replace=False))


def _cases(ensemble: Ensemble) -> tuple[tuple[Factor, ...], FloatArray, IntArray]:
    """Return what varies, numbers first, the points of the cases to be interpolated, the cases."""
    rows = done_cases(ensemble)
    numbers = [values for values in ensemble.varied.values() if values.dtype.kind == "f"]
    for values in numbers:
        rows &= np.isfinite(values) | ~np.isfinite(values[rows]).any()
    cases = chosen_cases(np.flatnonzero(rows), _MOST)
    factors = [Factor.of(ensemble, name, cases) for name in ensemble.varied]
    factors = [factor for factor in factors if factor.differs]
    factors.sort(key=lambda factor: bool(factor.texts))
    needed = 4 * (1 + sum(max(1, len(factor.texts)) for factor in factors))
    if factors and len(cases) >= needed:
        points = np.hstack([factor.coordinates(factor.values) for factor in factors])
        first = np.sort(np.unique(np.round(points, _DIGITS), axis=0, return_index=True)[1])
        points, cases = points[first], cases[first]
    if not factors or len(cases) < needed or factors[0].texts:
        raise InputError(
            f"{ensemble.path}: {len(cases)} cases are done and differ, in {len(factors)} keys; a "
            f"surrogate needs a key that is a number, and {needed} cases at least"
        )
    plain = points[:, : sum(not factor.texts for factor in factors)]
    if np.linalg.matrix_rank(plain - plain.mean(axis=0), tol=1e-6) < plain.shape[1]:
        keys = ", ".join(factor.name for factor in factors if not factor.texts)
        raise InputError(
            f"{ensemble.path}: {keys} vary together, or nearly so; a surrogate needs cases in "
            "which each varies by itself"
        )
    return tuple(factors), points, cases


def fit_response(points: FloatArray, numbers: int, name: str, values: FloatArray) -> Response:
    """Return the response (cases, ...) at points, in the form with the smallest error.

    The first ``numbers`` coordinates are those of keys that are numbers.
    """
    flat = values.reshape(len(values), -1)
    low = float(flat.min())
    limits = 0.0 if low >= 0.0 else -math.inf, 1.0 if name in LAYER_HISTORIES else math.inf
    spread = _rms(flat - flat.mean(axis=0))
    varies = spread > 1e-12 * float(np.abs(flat).max())
    possible = {
        "itself": True,
        "square root": varies and low >= 0.0,
        "logarithm": varies and low > 0.0,
    }
    responses = []
    for form in (form for form in _FORMS if possible[form]):
        process = _process(points, _FORMS[form][0](flat), varies)
        response = Response(form, process, varies * spread, values.shape[1:], limits)
        responses.append(_measured(response, points[:, :numbers], flat))
    return min(responses, key=lambda response: response.error)


def _process(points: FloatArray, table: FloatArray, varies: bool) -> Any:
    """Return the Gaussian process through a table, its lengths found from some of the cases."""
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import ConstantKernel, Matern, WhiteKernel

    lengths = Matern(np.ones(points.shape[1]), (0.05, 100.0), nu=2.5)
    kernel = ConstantKernel(1.0) * lengths + WhiteKernel(1e-8, (1e-12, 1e-2))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a length at its bound is that of a key without influence
        if varies:
            some = chosen_cases(np.arange(len(points)), _MOST_FITTED)
            found = GaussianProcessRegressor(kernel, normalize_y=True).fit(
                points[some], table[some]
            )
            kernel = found.kernel_
        process = GaussianProcessRegressor(kernel, optimizer=None, normalize_y=True)
        return process.fit(points, table)


def _measured(response: Response, numbers: FloatArray, flat: FloatArray) -> Response:
    """Return a response with its errors: the largest of those of single cases and of values.

    Parameters
    ----------
    numbers : (cases, keys) coordinates of the keys that are numbers.
    flat : (cases, columns) the response.
    """
    process, table = response.process, _FORMS[response.form][0](flat)
    inverse = np.linalg.inv(process.L_ @ process.L_.T)
    weights = process.alpha_.reshape(len(flat), -1) * table.std(axis=0)
    left_out = [(1.0, np.full(len(flat), True), weights / np.diag(inverse)[:, None])]
    for column in np.round(numbers, _DIGITS).T:
        values = np.unique(column)
        inner = (column > values[0]) & (column < values[-1])
        if 2 < len(values) <= 0.5 * len(column):
            wrong = np.zeros_like(weights)
            for value in values[1:-1]:
                out = column == value
                wrong[out] = np.linalg.solve(inverse[np.ix_(out, out)], weights[out])
            left_out.append((_GAP, inner, wrong[inner]))
    errors = [
        (share * _rms(response.back(table[rows] - wrong) - flat[rows]), share * _rms(wrong))
        for share, rows, wrong in left_out
    ]
    error, form_error = np.max(errors, axis=0).tolist()
    return replace(response, error=error, form_error=form_error)


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))
