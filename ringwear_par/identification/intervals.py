"""What the readings tell of each parameter: covariance, one-sided limits, and what they do not."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.stats import chi2, norm

from ringwear_par.arrays import FloatArray
from ringwear_par.identification.least_squares import NU, Evaluation, LeastSquares
from ringwear_par.identification.problem import Loss

Verdict = Literal["identified", "at bound", "not identified"]

#: of the information matrix with a unit diagonal: below it nothing is known of a direction
_NOTHING = 1e-10
#: components of a direction that are told
_TOLD = 0.15
#: largest half interval of a logarithm
_WIDEST_LOG = 1.5
#: correlation at which what is not known of one key is not known of the other
_ONE = 0.999
#: of a prior's sd: more is but the prior
_MERE_PRIOR = 0.95


@dataclass(frozen=True)
class ParameterEstimate:
    """A fitted key.

    Parameters
    ----------
    estimate, sd : in the case's unit; sd None where there is none to speak of.
    interval : None on a side that is not limited.
    verdict : whether the readings tell it.
    direction : what they tell instead, "" where they tell it.
    """

    key: str
    estimate: float
    sd: float | None
    interval: tuple[float | None, float | None]
    verdict: Verdict
    direction: str = ""


def share_of_loss(loss: Loss) -> float:
    """Return what readings tell under a loss, of what they would with Gaussian noise."""
    return (NU + 1.0) / (NU + 3.0) if loss == "student" else 1.0


def information(squares: LeastSquares, found: Evaluation, priors: bool = True) -> FloatArray:
    """Return the Fisher information (u, u) of the unknowns.

    Parameters
    ----------
    priors : whether those of the fitted keys count; those of nuisances always do.
    """
    share = share_of_loss(squares.problem.settings.loss)
    matrix: FloatArray = share * found.noise_jacobian.T @ found.noise_jacobian
    m = len(squares.problem.parameters)
    for row, (j, _) in enumerate(squares.priors, start=squares.n):
        if priors or j >= m:
            matrix[j, j] += found.jacobian[row, j] ** 2
    return matrix


@dataclass(frozen=True, eq=False)
class Spectrum:
    """An information matrix taken apart.

    Parameters
    ----------
    size : (u,) square roots of its diagonal, 1 for none.
    values, vectors : eigenvalues, increasing, and eigenvectors of the matrix with a unit diagonal.
    """

    size: FloatArray
    values: FloatArray
    vectors: FloatArray

    @classmethod
    def of(cls, matrix: FloatArray) -> "Spectrum":
        """Take a matrix (u, u) apart."""
        diagonal = np.sqrt(np.diag(matrix))
        size = np.where(diagonal > 0, diagonal, 1.0)
        values, vectors = np.linalg.eigh(matrix / np.outer(size, size))
        return cls(size, np.maximum(values, 0.0), vectors)

    @property
    def covariance(self) -> FloatArray:
        """(u, u) inverse; infinite variances of what nothing is known of."""
        known = self.values > _NOTHING
        part = self.vectors[:, known] / np.sqrt(self.values[known]) / self.size[:, None]
        covariance: FloatArray = part @ part.T
        lost = (np.abs(self.vectors[:, ~known]) > 1e-3).any(axis=1)
        covariance[lost, lost] = np.inf
        return covariance

    def weakest(self, unknown: int) -> FloatArray:
        """Return the weakest direction (u,) that an unknown takes part in, components at most 1."""
        share = self.vectors[unknown] ** 2 / np.maximum(self.values, _NOTHING)
        vector = self.vectors[:, int(np.argmax(share))]
        return vector / np.abs(vector).max()


def estimates(
    squares: LeastSquares, x: FloatArray, found: Evaluation
) -> tuple[tuple[ParameterEstimate, ...], FloatArray]:
    """Return what is known of each fitted key, and the covariance (u, u) of the unknowns."""
    whole = Spectrum.of(information(squares, found))
    covariance = whole.covariance
    alone = Spectrum.of(information(squares, found, priors=False))
    finite = np.where(np.isfinite(covariance), covariance, 0.0)
    free = x - finite @ found.jacobian.T @ found.residuals  # where no bound is in the way
    values = squares.values(x)
    sds = np.sqrt(np.diag(covariance))
    judged = [_judged(squares, j, x[j], free[j], float(sds[j])) for j in range(len(values))]
    vague = [j for j in range(len(values)) if _vague(squares, j, float(sds[j]))]
    told = []
    for j, (verdict, limits, sd) in enumerate(judged):
        if any(abs(finite[i, j]) > _ONE * sds[i] * sds[j] for i in vague):
            verdict, limits = "not identified", (None, None)
        parameter = squares.problem.parameters[j]
        natural = None if sd is None else sd * parameter.slope(values[j])
        low, high = (
            None if limit is None or not math.isfinite(limit) else parameter.value(limit)
            for limit in limits
        )
        unclear = verdict == "not identified"
        told.append(
            ParameterEstimate(
                parameter.key, float(values[j]), natural, (low, high), verdict,
                direction(squares, alone, j) if unclear else "",
            )
        )  # fmt: skip
    return tuple(told), covariance


def _vague(squares: LeastSquares, j: int, sd: float) -> bool:
    """Tell whether the interval of an unknown is wider than its bounds, or than one may be."""
    level = squares.problem.settings.level
    half = float(norm.ppf(0.5 + 0.5 * level)) * sd
    widest = 0.5 * (squares.upper[j] - squares.lower[j])
    if squares.problem.parameters[j].log:
        widest = min(widest, _WIDEST_LOG)
    return not half <= widest


def _judged(
    squares: LeastSquares, j: int, x: float, free: float, sd: float
) -> tuple[Verdict, tuple[float | None, float | None], float | None]:
    """Return the verdict on an unknown, its limits, and its sd."""
    parameter, level = squares.problem.parameters[j], squares.problem.settings.level
    low, high = squares.lower[j], squares.upper[j]
    half = float(norm.ppf(0.5 + 0.5 * level)) * sd
    prior = parameter.prior
    mere = prior is not None and sd * parameter.slope(parameter.value(x)) > _MERE_PRIOR * prior.sd
    if _vague(squares, j, sd) or mere:
        return "not identified", (None, None), sd if math.isfinite(sd) else None
    near = 1e-3 * sd
    if x - low <= near or high - x <= near:
        quantile = float(chi2.ppf(2.0 * level - 1.0, 1)) * sd * sd
        if x - low <= near:
            centre = min(free, low)
            return "at bound", (None, centre + math.sqrt((low - centre) ** 2 + quantile)), sd
        centre = max(free, high)
        return "at bound", (centre - math.sqrt((high - centre) ** 2 + quantile), None), sd
    below, above = x - half, x + half
    return "identified", (below if below > low else None, above if above < high else None), sd


def direction(squares: LeastSquares, spectrum: Spectrum, j: int) -> str:
    """Return in words what the readings tell instead of an unknown.

    Parameters
    ----------
    spectrum : of the information of the readings.
    """
    names, parameters = squares.names, squares.problem.parameters
    weak = spectrum.weakest(j)
    taking = [i for i in range(len(names)) if abs(weak[i]) > _TOLD]
    keys = [i for i in taking if i < len(parameters)]
    others = [i for i in taking if i >= len(parameters)]
    if taking == [j]:
        return f"the readings hardly respond to {names[j]}"
    if not others and all(parameters[i].log for i in keys):
        return f"only {_product(squares, keys, weak / spectrum.size)}"
    mine = str(names[j])
    rest = [told(names[i]) for i in taking if i != j]
    return f"{mine} against {' and '.join([', '.join(rest[:-1]), rest[-1]] if rest[1:] else rest)}"


def _product(squares: LeastSquares, keys: Sequence[int], shift: FloatArray) -> str:
    """Return the product of powers of keys that does not change along a shift of logarithms."""
    names = sorted(keys, key=lambda i: str(squares.names[i]))
    if len(names) > 2:
        return f"products of {', '.join(str(squares.names[i]) for i in names)}"
    a, b = names
    power = -shift[a] / shift[b]  # a * b^power does not change
    sign, power = ("x", power) if power > 0 else ("/", -power)
    exponent = "" if abs(power - 1.0) < 0.05 else f"^{power:.2g}"
    return f"{squares.names[a]} {sign} {squares.names[b]}{exponent}"


def told(name: str | tuple[str, str, str]) -> str:
    """Return what messages call an unknown."""
    if isinstance(name, str):
        return name
    experiment, series, kind = name
    return f"{kind} of {series} ({experiment})"
