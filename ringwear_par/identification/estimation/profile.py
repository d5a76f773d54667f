"""Likelihood profiles: how the best fit worsens as one parameter is held elsewhere.

Their limits need no linear model: a parameter is as far from its estimate as the sum of squares
allows when all other unknowns make the best of it.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.stats import chi2

from ringwear_par.arrays import FloatArray
from ringwear_par.identification.estimation.intervals import (
    ParameterEstimate,
    is_mere_prior,
    is_vague,
)
from ringwear_par.identification.estimation.minimise import Optimum, minimise
from ringwear_par.identification.estimation.misfit import Misfit
from ringwear_par.identification.model.histories import HistoryError
from ringwear_par.identification.model.rounds import WaitFor, side_by_side

#: of the root of the growth of the sum of squares, at which a limit is found
_CLOSE = 0.01
#: points on a side; where readings are limits nothing says how far away these are
_MOST_POINTS, _MOST_OF_LIMITS = 8, 24
#: decrease of the sum of squares that means a better optimum, not what a minimiser leaves
_BETTER = 1e-2


#: of the wanted root: less is no response, as of readings that are but limits
_FLAT = 0.05
#: of the width of the bounds: first step of a key of which readings give but limits
_FIRST_STEP = 0.05


@dataclass(frozen=True, eq=False)
class Profiles:
    """Likelihood profiles and their limits."""

    #: with their limits.
    estimates: tuple[ParameterEstimate, ...]
    #: for each key (2, points): values of the parameter, increasing, and what twice the objective
    #: grows by.
    tables: Mapping[str, FloatArray]
    #: (u, u) of the unknowns; of keys that limits bound on both sides by the width of the interval.
    covariance: FloatArray
    #: keys of which a limit is not as close as it should be.
    inexact_limits: tuple[str, ...] = ()
    #: (u,) unknowns on the way that are better than the optimum; None: there are none.
    better: FloatArray | None = None


class _Limit(NamedTuple):
    """The unknown at a limit, None for no limit; whether it is as close as it should be."""

    at: float | None
    close: bool = True
    better: Optimum | None = None


def likelihood_profiles(
    misfit: Misfit,
    optimum: Optimum,
    estimates: Sequence[ParameterEstimate],
    covariance: FloatArray,
) -> Profiles:
    """Return likelihood profiles, or the linear estimates where the settings ask for none.

    All limits are searched side by side, from the covariance (u, u) on. Not collective.
    """
    level = misfit.problem.settings.level
    limited, known, covariance = list(estimates), covariance.copy(), covariance.copy()
    keys: list[int] = []
    for j, estimate in enumerate(estimates):
        if estimate.verdict != "identified" and misfit.censored.any():
            # limits alone may bound it on one side, far from where it is
            keys.append(j)
            covariance[j] = covariance[:, j] = 0.0
            covariance[j, j] = (_FIRST_STEP * (misfit.upper[j] - misfit.lower[j])) ** 2
        elif estimate.verdict != "not identified":
            keys += [j] * ("profile" in misfit.problem.settings.intervals)
    if not keys:
        return Profiles(tuple(estimates), {}, known)
    tables: dict[int, dict[float, float]] = {}
    searched = []
    two_sided = math.sqrt(float(chi2.ppf(level, 1)))
    for j in keys:
        estimate = estimates[j]
        tables[j] = {float(optimum.x[j]): 0.0}
        one_sided = estimate.verdict != "identified"
        root = math.sqrt(float(chi2.ppf(2.0 * level - 1.0, 1))) if one_sided else two_sided
        searched += [
            (j, side, root)
            for side in (0, 1)
            if estimate.verdict != "at bound" or estimate.interval[side] is not None
        ]
    limits: dict[tuple[int, int], _Limit] = {}

    def ends_of(j: int) -> list[float | None]:
        return [limits[j, side].at if (j, side) in limits else None for side in (0, 1)]

    while searched:
        searches = [
            partial(_limit, misfit, optimum, covariance, j, (-1.0, 1.0)[side], root, tables[j])
            for j, side, root in searched
        ]
        of_searches = side_by_side(searches, misfit.responses.compute)
        better = [search.better for search in of_searches if search.better is not None]
        if better:
            best = min(better, key=lambda candidate: candidate.evaluation.objective)
            return Profiles(tuple(estimates), {}, known, better=best.x)
        limits |= {
            (j, side): limit for (j, side, _), limit in zip(searched, of_searches, strict=True)
        }
        # an interval with two ends has them at another level than one with one end
        searched = [
            (j, side, two_sided)
            for j, side, root in searched
            if root < two_sided and None not in ends_of(j)
        ]
    inexact_limits = {j for (j, _), limit in limits.items() if not limit.close}
    profiles = {}
    for j, points in tables.items():
        parameter = misfit.problem.parameters[j]
        ends = ends_of(j)
        low, high = (None if end is None else parameter.value(end) for end in ends)
        if limited[j].verdict == "not identified":
            if ends == [None, None]:
                continue
            known[j], known[:, j], known[j, j] = 0.0, 0.0, math.inf
            limited[j] = replace(limited[j], verdict="at bound", direction="", sd=None)
            if low is not None and high is not None:
                half = 0.5 * (parameter.unknown(high) - parameter.unknown(low))
                sd = half / two_sided * parameter.slope(parameter.value(optimum.x[j]))
                if is_vague(parameter, half) or is_mere_prior(parameter, sd):
                    limited[j] = estimates[j]
                    continue
                known[j, j] = (half / two_sided) ** 2
                limited[j] = replace(limited[j], verdict="identified", sd=sd)
        limited[j] = replace(limited[j], interval=(low, high))
        table = np.array(sorted(points.items())).T
        table[0] = [parameter.value(u) for u in table[0]]
        profiles[parameter.key] = table
    inexact = tuple(misfit.problem.keys[j] for j in sorted(inexact_limits))
    return Profiles(tuple(limited), profiles, known, inexact)


def _limit(
    misfit: Misfit,
    optimum: Optimum,
    covariance: FloatArray,
    j: int,
    side: float,
    wanted: float,
    points: dict[float, float],
    wait_for: WaitFor,
) -> _Limit:
    """Return the unknown below (side -1) or above (1) at which the root of the growth is wanted."""
    # the root grows nearly linearly, so that secants find it
    bounds = misfit.lower, misfit.upper
    sd = math.sqrt(covariance[j, j])
    centre, end = float(optimum.x[j]), float(bounds[0][j] if side < 0 else bounds[1][j])
    # how the others follow where the model is linear
    follow = np.where(np.isfinite(covariance[:, j]), covariance[:, j], 0.0) / covariance[j, j]
    least = optimum.evaluation.objective
    inner, outer = (0.0, 0.0), (math.inf, math.inf)
    step, x = wanted * sd, optimum.x
    before = centre
    for _ in range(_MOST_OF_LIMITS if misfit.censored.any() else _MOST_POINTS):
        at = centre + side * step
        at = max(at, end) if side < 0 else min(at, end)
        start = x + follow * (at - before)
        start[j] = at
        try:
            best = minimise(misfit, np.clip(start, *bounds), wait_for, fixed=j)
        except HistoryError:  # too far: no case by the rules of a law, or worn through
            outer = abs(at - centre), math.inf
            if outer[0] - inner[0] < _CLOSE * outer[0]:
                break
            step = 0.5 * (inner[0] + outer[0])
            continue
        growth = 2.0 * (best.evaluation.objective - least)
        if growth < -_BETTER:
            return _Limit(None, better=best)
        points[at] = growth = max(growth, 0.0)
        root, step, x, before = math.sqrt(growth), abs(at - centre), best.x, at
        if abs(root - wanted) <= _CLOSE * wanted:
            return _Limit(at)
        if root < wanted:
            if at == end:
                return _Limit(None)
            inner = step, root
        else:
            outer = step, root
        if math.isinf(outer[0]):
            step = step * min(wanted / max(root, 0.1 * wanted), 4.0)
        elif math.isinf(outer[1]) or (inner[0] > 0.0 and inner[1] < _FLAT * wanted):
            step = 0.5 * (inner[0] + outer[0])
        else:
            share = (wanted - inner[1]) / (outer[1] - inner[1])
            step = inner[0] + (outer[0] - inner[0]) * min(max(share, 0.05), 0.95)
    beyond = math.isfinite(outer[0]) and math.isinf(outer[1])  # trials there never gave residuals
    if (
        beyond and inner[0] > 0.0 and inner[1] < _FLAT * wanted
    ):  # until there nothing speaks against it
        return _Limit(None)
    return _Limit(None if beyond else centre + side * step, close=False)
