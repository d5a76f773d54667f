"""Verdicts that hold only if another key is at its bound."""

from collections.abc import Collection, Sequence

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.errors import ValidityWarning
from ringwear_par.identification.estimation.intervals import ParameterEstimate

#: of the sd with another key free, below which an interval depends on the bound of that
_NARROWED = 0.5


def growths_of_sd(
    covariance: FloatArray, at_bounds: Collection[int]
) -> dict[tuple[int, int], float]:
    """Return by how much the sd of an unknown is larger where one at its bound is free: (j, i).

    Parameters
    ----------
    covariance : (m, m) of all unknowns, as if there were no bounds.
    at_bounds : numbers of those at their bounds; the others of them stay there.
    """

    def sd(j: int, fixed: Sequence[int]) -> float:
        across = covariance[j, fixed]
        known = across @ np.linalg.pinv(covariance[np.ix_(fixed, fixed)], hermitian=True) @ across
        return float(np.sqrt(max(covariance[j, j] - known, 0.0)))

    growths = {}
    for j in set(range(len(covariance))) - set(at_bounds):
        narrow = sd(j, list(at_bounds))
        for i in at_bounds:
            wide = sd(j, [other for other in at_bounds if other != i])
            growths[j, i] = wide / narrow if narrow > 0.0 else 1.0
    return growths


def conditional_verdicts(
    estimates: Sequence[ParameterEstimate],
    covariance: FloatArray,
    narrowed: Collection[str],
    keys_at_bound: Collection[str],
) -> list[ValidityWarning]:
    """Return warnings about keys that are identified only while others are at their bounds.

    Parameters
    ----------
    covariance : (m, m) of the keys' unknowns, as if there were no bounds.
    narrowed : keys whose intervals are those with the others within their bounds.
    keys_at_bound : those whose estimate is one; others may have a limit on one side only.
    """
    known = [j for j in range(len(estimates)) if np.isfinite(covariance[j, j])]
    at_bounds = [
        j for j in known if estimates[j].verdict == "at bound" and estimates[j].key in keys_at_bound
    ]
    warnings = []
    part = covariance[np.ix_(known, known)]
    growths = growths_of_sd(part, [known.index(i) for i in at_bounds])
    for (place, bound), growth in sorted(growths.items()):
        one, other = estimates[known[place]], estimates[known[bound]]
        if one.verdict != "identified" or one.key not in narrowed or _NARROWED * growth <= 1.0:
            continue
        text = (
            f"{one.key} is identified only if {other.key} = {other.estimate:g}, its bound: with "
            f"that free its sd is {growth:.2g} times as large"
        )
        keys, values = (one.key, other.key), {"growth_of_sd": growth}
        warnings.append(ValidityWarning("conditional-verdict", text, keys, (), values))
    return warnings
