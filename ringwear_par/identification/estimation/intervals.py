"""Linear intervals: covariance, one-sided limits at bounds, keys that are not identified."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.stats import norm

from ringwear_par.arrays import FloatArray
from ringwear_par.identification.definition.problem import FittedParameter
from ringwear_par.identification.estimation.misfit import Evaluation, Misfit
from ringwear_par.identification.model.noise import information_share

Verdict = Literal["identified", "at bound", "not identified"]

#: eigenvalue of the information matrix with a unit diagonal below which nothing is known of a
#: direction
_UNINFORMED = 1e-10
#: factor on the eigenvalue of such a direction up to which others are as weak
_AS_WEAK = 10.0
#: share of the largest component of a direction above which keys are mentioned
_MENTIONED = 0.15
#: largest half width of an interval of a logarithm
_WIDEST_LOG = 1.5
#: correlation with keys of which nothing is known above which nothing is known of a key either
_FULLY_CORRELATED = 0.999
#: share of a prior's sd above which an sd says no more than the prior
_MERE_PRIOR = 0.95
#: sd from its bound within which an unknown is at it
_NEAR = 1e-3


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


def information_rows(misfit: Misfit, evaluation: Evaluation, priors: bool = True) -> FloatArray:
    """Return rows (n + priors, u) that make the Fisher information of the unknowns, ``R' R``.

    Those of the priors of keys are 0 without ``priors``.
    """
    m, share = len(misfit.problem.parameters), information_share(misfit.problem.settings.loss)
    of_priors = evaluation.jacobian[misfit.n :].copy()
    if not priors:
        of_priors[[j < m for j, _ in misfit.priors]] = 0.0
    return np.concatenate([np.sqrt(share) * evaluation.noise_jacobian, of_priors])


@dataclass(frozen=True, eq=False)
class Spectrum:
    """The eigenvalues and eigenvectors of an information matrix."""

    #: (u,) square roots of its diagonal, 1 for none
    size: FloatArray
    #: eigenvalues, increasing, and eigenvectors of the matrix with a unit diagonal
    values: FloatArray
    vectors: FloatArray

    @classmethod
    def of(cls, rows: FloatArray) -> "Spectrum":
        """Return the spectrum of the information of rows (r, u)."""
        matrix = rows.T @ rows
        diagonal = np.sqrt(np.diag(matrix))
        size = np.where(diagonal > 0, diagonal, 1.0)
        values, vectors = np.linalg.eigh(matrix / np.outer(size, size))
        return cls(size, np.maximum(values, 0.0), vectors)

    @property
    def covariance(self) -> FloatArray:
        """(u, u) inverse; infinite variances of what nothing is known of."""
        determined = self.values > _UNINFORMED
        part = self.vectors[:, determined] / np.sqrt(self.values[determined]) / self.size[:, None]
        covariance: FloatArray = part @ part.T
        lost = (np.abs(self.vectors[:, ~determined]) > 1e-3).any(axis=1)
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
    whole = Spectrum.of(information_rows(misfit, evaluation))
    covariance = whole.covariance
    alone = Spectrum.of(information_rows(misfit, evaluation, priors=False))
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
    level = misfit.problem.settings.level
    two_sided, one_sided = (float(norm.ppf(p)) for p in (0.5 + 0.5 * level, level))
    parameters = misfit.problem.parameters
    vague = [
        j
        for j, (parameter, sd) in enumerate(zip(parameters, sds, strict=False))
        if np.isfinite(sd) and is_vague(parameter, two_sided * sd)
    ]
    estimated = []
    for j, (parameter, sd) in enumerate(zip(parameters, sds.tolist(), strict=False)):
        ends = x[j] - two_sided * sd, x[j] + two_sided * sd
        verdict, interval = judged(parameter, x[j], free[j], sd, ends, one_sided * sd)
        if vague and _follows(finite, j, vague):
            verdict, interval = "not identified", (None, None)
        natural = sd * parameter.slope(values[j]) if math.isfinite(sd) else None
        words = direction(misfit, alone, j) if verdict == "not identified" else ""
        estimate = float(values[j])
        estimated.append(
            ParameterEstimate(parameter.key, estimate, natural, interval, verdict, words)
        )
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


def judged(
    parameter: FittedParameter,
    x: float,
    free: float,
    sd: float,
    ends: tuple[float, float],
    one_sided: float,
) -> tuple[Verdict, tuple[float | None, float | None]]:
    """Return the verdict on an unknown x, and limits of its value; None for none.

    Parameters
    ----------
    free : where it would be without bounds.
    ends : of its interval there; the half width of a one-sided interval is ``one_sided``.
    """
    half, slope = 0.5 * (ends[1] - ends[0]), parameter.slope(parameter.value(x))
    if is_vague(parameter, half) or is_mere_prior(parameter, sd * slope):
        return "not identified", (None, None)
    low, high = map(parameter.unknown, parameter.bounds)
    for bound, sign in ((low, 1.0), (high, -1.0)):
        if sign * (x - bound) <= _NEAR * sd:
            # what lies beyond the bound counts as far as the bound is from there
            beyond = max(sign * (bound - free), 0.0)
            limit = bound + sign * (math.hypot(beyond, one_sided) - beyond)
            end = parameter.value(limit) if math.isfinite(limit) else None
            return "at bound", (None, end) if sign > 0.0 else (end, None)
    return "identified", (
        parameter.value(ends[0]) if ends[0] > low else None,
        parameter.value(ends[1]) if ends[1] < high else None,
    )


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
    opposed = [name_of(names[i]) for i in taking if i != j]
    listed = [", ".join(opposed[:-1]), opposed[-1]] if opposed[1:] else opposed
    return f"{mine} against {' and '.join(listed)}"


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
