"""How probable the readings are under a law, whatever its numbers: the evidence of a fit.

The likelihood is integrated over keys and nuisances by Laplace's approximation at the estimate:
exact where the model is linear over its intervals. With scatter or random wear, sizes are
integrated over their grid as well. A key without a prior is uniform within its bounds, or its
logarithm is where the scale is logarithmic, so that wide bounds make a law less probable. Free
nuisances count alike under all laws of the same readings: of evidences only differences mean
anything.
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from ringwear_par.identification.fit_result import FitResult


def log_evidence(fit: "FitResult") -> float | None:
    """Return the logarithm of the evidence, but for a constant of the readings.

    None where it is not that easily known: a key is not identified or at its bound, noise is fitted
    or not normal, readings are limits.
    """
    misfit, m = fit.misfit, len(fit.parameters)
    problem = misfit.problem
    rough = problem.settings.loss != "gaussian" or misfit.censored.any() or fit.noise_fitted
    if rough or any(one.verdict != "identified" for one in fit.parameters):
        return None
    low, high = problem.unknown_bounds
    prior = 0.0
    for one, unknown, width in zip(problem.parameters, fit.x, high - low, strict=False):
        if one.prior is None:
            prior -= float(np.log(width))
        else:  # a density of values, its square is among the readings'
            prior += float(np.log(one.slope(one.value(unknown)) / one.prior.sd))
            prior -= 0.5 * float(np.log(2.0 * np.pi))
    if fit.material is not None:
        constant = 0.5 * (m - misfit.n) * np.log(2.0 * np.pi)
        return fit.material.posterior.log_mass + prior + float(constant)
    acting = ~misfit.idle
    covariance = fit.covariance[np.ix_(acting, acting)]
    if not np.isfinite(covariance).all():
        return None
    # keys with nuisances; those that are free, or have priors, are the same under all laws
    volume = 0.5 * (np.linalg.slogdet(covariance)[1] + m * np.log(2.0 * np.pi))
    rest = fit.evaluation.residuals[misfit.n :]
    return float(misfit.log_likelihood(fit.evaluation) - 0.5 * rest @ rest + volume + prior)


def probabilities(evidences: Mapping[str, float | None]) -> dict[str, float]:
    """Return the probability of each law whose evidence is known, as if all were equal before."""
    known = {name: value for name, value in evidences.items() if value is not None}
    if not known:
        return {}
    shares = np.exp(np.array([*known.values()]) - max(known.values()))
    return dict(zip(known, (shares / shares.sum()).tolist(), strict=True))
