"""``rw.surrogate``: Gaussian processes of a sweep's responses over its varied keys; Sobol' indices.

scikit-learn finds a length of each key (Matern 5/2) for a response, its square root and its
logarithm; the form with the smallest error in left-out cases is taken. That error follows from one
inverse, without other fits (C. E. Rasmussen and C. K. I. Williams, "Gaussian Processes for Machine
Learning", 2006, section 5.4.2). Single cases that are left out of a grid say nothing about what
lies between the values of a key: there all cases of a value are left out together, too.
"""

import logging
import math
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray, IntArray
from ringwear_par.errors import InputError, legible
from ringwear_par.results.variables import LAYER_HISTORIES
from ringwear_par.studies.ensemble import Ensemble, Factor, factors_of, is_smooth, read_ensemble

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


def chosen_cases(cases: IntArray, most: int) -> IntArray:
    """Return the cases, or so many of them chosen at random, increasing."""
    if len(cases) <= most:
        return cases
    return np.sort(np.random.default_rng(SEED).choice(cases, most, replace=False))


# -- responses -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Response:
    """A response as a Gaussian process of its form."""

    #: key of the table of forms
    form: str
    #: scikit-learn's regressor of the form, (cases, columns)
    process: Any
    #: root mean square of the distance from the mean over the cases, and of errors in left-out ones
    spread: float
    error: float
    #: of a case's values, whose product is the number of columns
    shape: tuple[int, ...]
    #: between which it can be
    limits: tuple[float, float]

    @property
    def relative_error(self) -> float:
        """The error as a part of the spread, 0 where nothing varies."""
        return self.error / self.spread if self.spread else 0.0

    def at(self, points: FloatArray, *, deviations: bool = False) -> FloatArray:
        """Return values, or standard deviations, (points, columns) at points.

        A standard deviation is half of what lies between one of the form below and above.
        """

        def values(table: FloatArray) -> FloatArray:
            return np.clip(_FORMS[self.form][1](table), *self.limits)

        parts = []
        for chunk in np.array_split(points, 1 + len(points) // _CHUNK):
            if deviations:
                mean, width = self.process.predict(chunk, return_std=True)
                parts.append(0.5 * (values(mean + width) - values(mean - width)))
            else:
                parts.append(values(self.process.predict(chunk)))
        return np.concatenate(parts).reshape(len(points), math.prod(self.shape))


def _fitted(
    name: str, values: FloatArray, points: FloatArray, columns: Sequence[FloatArray]
) -> Response:
    """Return the response (cases, ...) at points, in the form with the smallest error.

    Errors are those of ``_errors`` by columns.
    """
    flat = values.reshape(len(values), -1)
    low, shape = float(flat.min()), values.shape[1:]
    limits = 0.0 if low >= 0.0 else -math.inf, 1.0 if name in LAYER_HISTORIES else math.inf
    spread = _rms(flat - flat.mean(axis=0))
    if spread <= 1e-12 * float(np.abs(flat).max()):
        return Response("itself", _process(points, flat, False), 0.0, 0.0, shape, limits)
    responses = []
    for form in ["itself", *["square root"] * (low >= 0.0), *["logarithm"] * (low > 0.0)]:
        function, back = _FORMS[form]
        table = function(flat)
        process = _process(points, table, True)
        error = max(
            share * _rms(np.clip(back(table[rows] - wrong), *limits) - flat[rows])
            for rows, share, wrong in _errors(process, table, columns)
        )
        responses.append(Response(form, process, spread, error, shape, limits))
    return min(responses, key=lambda response: response.error)


def _process(points: FloatArray, table: FloatArray, varies: bool) -> Any:
    """Return the Gaussian process through a table, its lengths found from some of the cases."""
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import ConstantKernel, Matern, WhiteKernel

    lengths = Matern(np.ones(points.shape[1]), (0.05, 100.0), nu=2.5)
    noise = WhiteKernel(1e-8, (1e-9, 1e-2))  # less and a kernel may not be positive definite
    kernel = ConstantKernel(1.0, (1e-3, 1e3)) * lengths + noise
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a length at its bound is that of a key without influence
        if varies:
            some = chosen_cases(np.arange(len(points)), _MOST_FITTED)
            fitted = GaussianProcessRegressor(kernel, normalize_y=True)
            kernel = fitted.fit(points[some], table[some]).kernel_
        process = GaussianProcessRegressor(kernel, optimizer=None, normalize_y=True)
        return process.fit(points, table)


def _errors(
    process: Any, table: FloatArray, columns: Sequence[FloatArray]
) -> Iterator[tuple[BoolArray, float, FloatArray]]:
    """Yield cases that have been left out, the share that their errors count, the errors.

    Cases of the same value of a column (cases,) are left out together, but for the first and the
    last value, beyond which there is nothing.
    """
    inverse = np.linalg.inv(process.L_ @ process.L_.T)
    weights = process.alpha_.reshape(len(table), -1) * table.std(axis=0)
    for column in columns:
        values, wrong = np.unique(column), np.zeros_like(weights)
        for value in values[1:-1]:
            out = column == value
            wrong[out] = np.linalg.solve(inverse[np.ix_(out, out)], weights[out])
        rows = (column > values[0]) & (column < values[-1])
        yield rows, 1.0 if len(values) == len(column) else _GAP, wrong[rows]


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


# -- surrogates ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Surrogate:
    """Gaussian processes over the varied keys of a sweep, see ``surrogate``."""

    #: the varied keys in which cases differ, and responses by name
    factors: tuple[Factor, ...]
    responses: dict[str, Response]
    #: number of cases that are interpolated
    cases: int

    @property
    def error(self) -> dict[str, float]:
        """Error (root mean square) of each response in left-out cases, in its unit."""
        return {name: response.error for name, response in self.responses.items()}

    @property
    def relative_error(self) -> dict[str, float]:
        """Error of each response as a part of its spread over the cases."""
        return {name: response.relative_error for name, response in self.responses.items()}

    @property
    def ranges(self) -> dict[str, tuple[Any, ...]]:
        """Lowest and highest value of each varied key; all values of one that is a text."""
        return {factor.name: factor.texts or (factor.low, factor.high) for factor in self.factors}

    def predict(
        self, values: Mapping[str, Any], *, deviations: bool = False
    ) -> dict[str, FloatArray]:
        """Return all responses by name.

        Parameters
        ----------
        values : of every varied key: numbers or arrays, which go together as numpy's do; a text for
            a key that is no number.
        deviations : return their standard deviations instead.

        Returns
        -------
        dict : arrays of the values' common shape, followed by further axes of a response.

        Raises
        ------
        InputError : a value outside the range of the study's cases, a key that is missing or not
            varied.
        """
        if wrong := values.keys() ^ self.ranges.keys():
            raise InputError(
                f"surrogate: {', '.join(sorted(map(legible, wrong)))}: keys must be those that "
                f"vary, {', '.join(self.ranges)}"
            )
        columns = np.broadcast_arrays(*(f.read(values[f.name]) for f in self.factors))
        points, shape = _points(self.factors, [c.ravel() for c in columns]), columns[0].shape
        return {
            name: response.at(points, deviations=deviations).reshape((*shape, *response.shape))
            for name, response in self.responses.items()
        }

    def at(self, name: str, shares: FloatArray) -> FloatArray:
        """Return a number, (n,), at shares (n, factors) from 0 to 1 of what varies."""
        columns = [f.at(c) for f, c in zip(self.factors, shares.T, strict=True)]
        return self.responses[name].at(_points(self.factors, columns))[:, 0]

    def mean_along(self, key: str, name: str) -> tuple[FloatArray, FloatArray]:
        """Return values of a key, and the mean of a number over the other keys at each."""
        i = [*self.ranges].index(key)
        texts = len(self.factors[i].texts)
        shares = (np.arange(texts) + 0.5) / texts if texts else np.linspace(0.0, 1.0, _ALONG)
        points = np.repeat(_sobol(len(self.factors), _OTHERS)[None], len(shares), axis=0)
        points[:, :, i] = shares[:, None]
        values = self.at(name, points.reshape(-1, len(self.factors)))
        return self.factors[i].at(shares), values.reshape(len(shares), -1).mean(axis=1)

    def sobol_indices(self, name: str) -> tuple[FloatArray, FloatArray]:
        """Return first-order and total Sobol' indices, (factors,), of a response that is a number.

        Keys vary evenly, or their logarithms where they go by them, and independently of each
        other, whatever the design was (estimators: A. Saltelli et al., Computer Physics
        Communications 181 (2010) 259; M. Jansen, ibid. 117 (1999) 35).
        """
        count = len(self.factors)
        one, other = np.split(_sobol(2 * count, _DRAWS), 2, axis=1)
        mixed = np.where(np.eye(count, dtype=bool)[:, None], other, one)
        of_one, of_other = self.at(name, one), self.at(name, other)
        change = self.at(name, mixed.reshape(-1, count)).reshape(count, -1) - of_one
        variance = np.var(np.concatenate([of_one, of_other]))
        first = np.mean((of_other - of_other.mean()) * change, axis=1) / variance
        return first, 0.5 * np.mean(change**2, axis=1) / variance

    def __repr__(self) -> str:
        shares = (
            f"{name} {percent(error)}" for name, error in self.relative_error.items() if error
        )
        return (
            f"<Surrogate of {self.cases} cases over {', '.join(self.ranges)}; errors in "
            f"left-out cases, of the spread: {', '.join(shares)}>"
        )


def _points(factors: Sequence[Factor], columns: Sequence[Any]) -> FloatArray:
    """Return points from the values of each factor."""
    return np.hstack([f.coordinates(c) for f, c in zip(factors, columns, strict=True)])


def _sobol(keys: int, count: int) -> FloatArray:
    from scipy.stats import qmc  # slow to import

    points: FloatArray = qmc.Sobol(keys, seed=SEED).random(count)
    return points


def percent(relative_error: float) -> str:
    """Return an error in percent of the spread."""
    return f"{100.0 * relative_error:.2g} %"


def surrogate(
    folder: Ensemble | Path | str, responses: Sequence[str] | Mapping[str, Any] | None = None
) -> Surrogate:
    """Return a surrogate of a sweep's responses over its varied keys. Not collective.

    Of many cases that are done 500 are chosen at random. Ranges are those of each key alone: where
    keys of a list vary together, errors far from all cases are unknown.

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
    factors, points, numbers, cases = _cases(ensemble)
    columns = [np.arange(len(cases), dtype=float)]  # whose values are single cases
    columns += [c for c in np.round(numbers, _DIGITS).T if 2 < len(np.unique(c)) <= 0.5 * len(c)]
    final = ensemble.final
    if responses is None:
        responses = [n for n, v in final.items() if is_smooth(n) and np.isfinite(v[cases]).all()]
    arrays = responses if isinstance(responses, Mapping) else {n: final.get(n) for n in responses}
    fitted = {}
    for name, values in arrays.items():
        array = np.asarray(values, dtype=float)
        if array.shape[:1] != (len(ensemble.ids),) or not np.isfinite(array[cases]).all():
            raise InputError(
                f"surrogate: {legible(str(name))}: must be the name of a final value, or an array "
                f"({len(ensemble.ids)}, ...), finite in all cases that are done"
            )
        fitted[name] = _fitted(name, array[cases], points, columns)
    made = Surrogate(factors, fitted, len(cases))
    if max(made.relative_error.values(), default=0.0) > GOOD:
        log.warning("more cases would make errors smaller: %r", made)
    return made


def _cases(ensemble: Ensemble) -> tuple[tuple[Factor, ...], FloatArray, FloatArray, IntArray]:
    """Return what varies, numbers first; of cases to be interpolated points, numbers, indices."""
    cases = chosen_cases(np.flatnonzero(ensemble.done), _MOST)
    differing = [f for f in factors_of(ensemble, cases) if f.differs] if len(cases) else []
    factors = sorted(differing, key=lambda factor: bool(factor.texts))
    needed = 4 * (1 + sum(max(1, len(factor.texts)) for factor in factors))
    points = np.hstack([np.empty((len(cases), 0)), *(f.coordinates(f.values) for f in factors)])
    first = np.sort(np.unique(np.round(points, _DIGITS), axis=0, return_index=True)[1])
    points, cases = points[first], cases[first]
    numbers = points[:, : sum(not factor.texts for factor in factors)]
    rank = np.linalg.matrix_rank(numbers - numbers.mean(axis=0), tol=1e-6) if len(cases) else 0
    if len(cases) < needed or not rank or rank < numbers.shape[1]:
        keys = ", ".join(factor.name for factor in factors) or "none"
        raise InputError(
            f"{ensemble.path}: {len(cases)} cases are done and differ, in keys: {keys}; a "
            f"surrogate needs {needed} cases at least, and a key that is a number, no two of which "
            "vary together"
        )
    return tuple(factors), points, numbers, cases
