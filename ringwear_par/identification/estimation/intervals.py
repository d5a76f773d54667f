"""Linear intervals: covariance, one-sided limits at bounds, keys that are not identified."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.stats import chi2, norm

from ringwear_par.arrays import FloatArray
from ringwear_par.identification.definition.problem import FittedParameter
from ringwear_par.identification.estimation.misfit import Evaluation, Misfit
from ringwear_par.identification.model.noise import information_share

Verdict = Literal["identified", "at bound", "not identified"]

#: of the information matrix with a unit diagonal: below it nothing is known of a direction
_UNINFORMED = 1e-10
#: of such a direction: others up to it are as weak
_AS_WEAK = 10.0
#: share of the largest component of a direction from which on keys are mentioned
_MENTIONED = 0.15
#: largest half interval of a logarithm
_WIDEST_LOG = 1.5
#: correlation with keys of which nothing is known, from which on a key counts as such too
_FULLY_CORRELATED = 0.999
#: share of a prior's sd: an sd above it says no more than the prior
_MERE_PRIOR = 0.95


@dataclass(frozen=True)
class ParameterEstimate:
    """A fitted key."""

    key: str
    #: in the case's unit; sd None where there is none to speak of.
    estimate: float
    sd: float | None
    #: None on a side that is not limited.
    interval: tuple[float | None, float | None]
    #: whether the readings determine it.
    verdict: Verdict
    #: what they determine instead, "" where they determine the key.
    direction: str = ""


def information(misfit: Misfit, evaluation: Evaluation, priors: bool = True) -> FloatArray:
    """Return the Fisher information (u, u) of the unknowns, priors of nuisances always counted."""
    share = information_share(misfit.problem.settings.loss)
    matrix: FloatArray = share * evaluation.noise_jacobian.T @ evaluation.noise_jacobian
    m = len(misfit.problem.parameters)
    for row, (j, _) in enumerate(misfit.priors, start=misfit.n):
        if priors or j >= m:
            matrix[j, j] += evaluation.jacobian[row, j] ** 2
    return matrix


def without_nuisances(matrix: FloatArray, m: int) -> FloatArray:
    """Return the information (m, m) of the first m unknowns alone, of that of all (u, u)."""
    size = np.sqrt(np.diag(matrix))
    size = np.where(size > 0.0, size, 1.0)
    scaled = matrix / np.outer(size, size)
    rest = scaled[:m, m:] @ np.linalg.pinv(scaled[m:, m:], rcond=_UNINFORMED, hermitian=True)
    alone: FloatArray = scaled[:m, :m] - rest @ scaled[m:, :m]
    return 0.5 * (alone + alone.T) * np.outer(size[:m], size[:m])


@dataclass(frozen=True, eq=False)
class Spectrum:
    """The eigenvalues and eigenvectors of an information matrix."""

    #: (u,) square roots of its diagonal, 1 for none
    size: FloatArray
    #: eigenvalues, increasing, and eigenvectors of the matrix with a unit diagonal
    values: FloatArray
    vectors: FloatArray

    @classmethod
    def of(cls, matrix: FloatArray) -> "Spectrum":
        """Return the spectrum of a matrix (u, u)."""
        diagonal = np.sqrt(np.diag(matrix))
        size = np.where(diagonal > 0, diagonal, 1.0)
        values, vectors = np.linalg.eigh(matrix / np.outer(size, size))
        return cls(size, np.maximum(values, 0.0), vectors)

    @property
    def covariance(self) -> FloatArray:
        """(u, u) inverse; infinite variances of what nothing is known of."""
        known = self.values > _UNINFORMED
        part = self.vectors[:, known] / np.sqrt(self.values[known]) / self.size[:, None]
        covariance: FloatArray = part @ part.T
        lost = (np.abs(self.vectors[:, ~known]) > 1e-3).any(axis=1)
        covariance[lost, lost] = np.inf
        return covariance

    def weakest(self, unknown: int) -> FloatArray:
        """Return the projector (u, u) on directions as weak as an unknown's weakest."""
        share = self.vectors[unknown] ** 2 / np.maximum(self.values, _UNINFORMED)
        value = max(float(self.values[int(np.argmax(share))]), _UNINFORMED)
        part = self.vectors[:, self.values <= _AS_WEAK * value]
        return part @ part.T


def estimates(
    misfit: Misfit, x: FloatArray, evaluation: Evaluation
) -> tuple[tuple[ParameterEstimate, ...], FloatArray]:
    """Return the estimate of each fitted key, and the covariance (u, u) of the unknowns.

    Limits alone have no normal distribution: only a likelihood profile tells what they say.
    """
    whole = Spectrum.of(information(misfit, evaluation))
    covariance = whole.covariance
    alone = Spectrum.of(information(misfit, evaluation, priors=False))
    finite = np.where(np.isfinite(covariance), covariance, 0.0)
    free = x - finite @ evaluation.jacobian.T @ evaluation.residuals  # where no bound is in the way
    values = misfit.values(x)
    if misfit.censored.all():
        m = len(values)
        covariance[:m], covariance[:, :m] = 0.0, 0.0
        covariance[range(m), range(m)] = np.inf
        return tuple(
            ParameterEstimate(
                key, value, None, (None, None), "not identified", "all readings are limits"
            )
            for key, value in zip(misfit.problem.keys, values.tolist(), strict=True)
        ), covariance
    sds = np.sqrt(np.diag(covariance))
    verdicts = [_judged(misfit, j, x[j], free[j], float(sds[j])) for j in range(len(values))]
    vague = [
        j for j, sd in enumerate(sds[: len(values)]) if np.isfinite(sd) and _vague(misfit, j, sd)
    ]
    estimated = []
    for j, (verdict, limits, sd) in enumerate(verdicts):
        if vague and _follows(finite, j, vague):
            verdict, limits = "not identified", (None, None)
        parameter = misfit.problem.parameters[j]
        natural = None if sd is None else sd * parameter.slope(values[j])
        low, high = (
            None if limit is None or not math.isfinite(limit) else parameter.value(limit)
            for limit in limits
        )
        unclear = verdict == "not identified"
        estimated.append(
            ParameterEstimate(
                parameter.key, float(values[j]), natural, (low, high), verdict,
                direction(misfit, alone, j) if unclear else "",
            )
        )  # fmt: skip
    return tuple(estimated), covariance


def _follows(covariance: FloatArray, j: int, vague: Sequence[int]) -> bool:
    """Tell whether an unknown would be known if all of some others were."""
    part = covariance[np.ix_([j, *vague], [j, *vague])]
    sds = np.sqrt(np.diag(part))
    part = part / np.outer(*[np.where(sds > 0.0, sds, 1.0)] * 2)
    explained = (
        part[0, 1:] @ np.linalg.pinv(part[1:, 1:], rcond=_UNINFORMED, hermitian=True) @ part[1:, 0]
    )
    return bool(explained > _FULLY_CORRELATED**2)


def _vague(misfit: Misfit, j: int, sd: float) -> bool:
    """Tell whether the interval of an unknown of some sd is too wide, see ``is_vague``."""
    level = misfit.problem.settings.level
    return is_vague(misfit.problem.parameters[j], float(norm.ppf(0.5 + 0.5 * level)) * sd)


def is_mere_prior(parameter: FittedParameter, sd: float) -> bool:
    """Tell whether a value is known no better (sd) than by its prior alone."""
    return parameter.prior is not None and sd > _MERE_PRIOR * parameter.prior.sd


def is_vague(parameter: FittedParameter, half_width: float) -> bool:
    """Tell whether the interval of an unknown is wider than its bounds, or than one may be."""
    low, high = map(parameter.unknown, parameter.bounds)
    widest = 0.5 * (high - low)
    if parameter.log:
        widest = min(widest, _WIDEST_LOG)
    return not half_width <= widest


def _judged(
    misfit: Misfit, j: int, x: float, free: float, sd: float
) -> tuple[Verdict, tuple[float | None, float | None], float | None]:
    """Return the verdict on an unknown, its limits, and its sd."""
    parameter, level = misfit.problem.parameters[j], misfit.problem.settings.level
    low, high = misfit.lower[j], misfit.upper[j]
    half = float(norm.ppf(0.5 + 0.5 * level)) * sd
    mere = is_mere_prior(parameter, sd * parameter.slope(parameter.value(x)))
    if _vague(misfit, j, sd) or mere:
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


def direction(misfit: Misfit, spectrum: Spectrum, j: int) -> str:
    """Return in words what the readings, by their spectrum, determine instead of an unknown."""
    names, parameters = misfit.names, misfit.problem.parameters
    weak = spectrum.weakest(j)
    taking = np.flatnonzero(np.abs(weak[j]) > _MENTIONED * np.abs(weak[j]).max()).tolist()
    keys = [i for i in taking if i < len(parameters)]
    if taking == [j]:
        return f"the readings hardly respond to {names[j]}"
    if taking == keys and all(parameters[i].log for i in keys):
        values, vectors = np.linalg.eigh(weak[np.ix_(keys, keys)])
        strong = vectors[:, values < 0.5]
        if strong.shape[1] == 1:
            return f"only {_product(misfit, keys, strong[:, 0] * spectrum.size[keys])}"
        return f"only products of {', '.join(sorted(str(names[i]) for i in keys))}"
    mine = str(names[j])
    rest = [name_of(names[i]) for i in taking if i != j]
    return f"{mine} against {' and '.join([', '.join(rest[:-1]), rest[-1]] if rest[1:] else rest)}"


def _product(misfit: Misfit, keys: Sequence[int], powers: FloatArray) -> str:
    """Return the product of powers of keys, that of the first by name being 1."""
    named = sorted((str(misfit.names[i]), float(p)) for i, p in zip(keys, powers, strict=True))
    words = [named[0][0]]
    for name, power in named[1:]:
        power /= named[0][1]
        exponent = "" if abs(abs(power) - 1.0) < 0.05 else f"^{abs(power):.2g}"
        words.append(f"{'x' if power > 0 else '/'} {name}{exponent}")
    return " ".join(words)


def name_of(name: str | tuple[str, str, str]) -> str:
    """Return the name of an unknown in messages."""
    if isinstance(name, str):
        return name
    experiment, series, kind = name
    return f"{kind} of {series} ({experiment})"
