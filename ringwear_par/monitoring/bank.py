"""A bank of histories: draws of what is known of a specimen, weighed by the readings of its test.

Readings are compared as fits do it: noise, nuisances and the random part of wear are integrated,
linearised at the most probable history, where a loss weighs readings too. A weight is prior times
likelihood over the density from which a draw was made. Where few draws have all the weight, the
likelihood is tempered until enough of them count, and all are drawn anew from a Student's t about
these (population Monte Carlo: Cappe, Guillin, Marin and Robert, J. Comput. Graph. Stat. 13 (2004)
907-929).
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import logsumexp
from scipy.stats import multivariate_t

from ringwear_par.arrays import BoolArray, FloatArray, IntArray
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.identification.definition.problem import Problem, body_of_wear
from ringwear_par.identification.estimation.misfit import Misfit
from ringwear_par.identification.fitted_values import FittedValues
from ringwear_par.identification.model.histories import Histories
from ringwear_par.identification.model.readings import Reader
from ringwear_par.identification.scatter.likelihood import LinearisedTest, reduce_test
from ringwear_par.identification.scatter.linearisation import Linearisation
from ringwear_par.monitoring.histories import SpecimenHistories
from ringwear_par.prediction.draws import draw_parts, log_densities

#: share of the draws: fewer effective ones are drawn anew
_LEAST_EFFECTIVE = 0.1
#: share of the draws that are effective after tempering
_TEMPERED_EFFECTIVE = 0.2
#: most rounds of tempering, and halvings until the exponent is found
_ROUNDS, _HALVINGS = 12, 40
#: sd, by which the mean may be off where readings are linearised
_MOST_OFF_SD = 0.3
#: of the distribution of new draws: degrees of freedom, factor of covariances, share of all sizes
#: of random wear
_DEGREES, _WIDER, _PRIOR_SHARE = 8.0, 1.3, 0.1
#: numbers that are made at once
_CHUNK = 1_000_000


@dataclass(frozen=True, eq=False)
class BankDraws:
    """Draws of a specimen's keys."""

    #: (draws, m) of the keys
    unknowns: FloatArray
    #: (draws,) of the mixture that is known of them
    part: IntArray
    #: (draws,) logarithm of the prior's density over that of the draws
    log_prior_over_proposal: FloatArray
    #: (draws, modes) of their histories
    coordinates: FloatArray


Linearised = tuple[LinearisedTest, Misfit, FloatArray]


def rows_of(test: LinearisedTest, chosen: BoolArray | IntArray) -> LinearisedTest:
    """Return a test with some of its readings: a mask (n,), or numbers in their order."""
    return replace(
        test, readings=test.readings[chosen], jacobian=test.jacobian[chosen],
        nuisances=test.nuisances[chosen],
        process=tuple(kernel[np.ix_(chosen, chosen)] for kernel in test.process),
    )  # fmt: skip


def normalised(logs: FloatArray) -> FloatArray:
    """Return weights that sum to 1 of their logarithms (draws,)."""
    weights: FloatArray = np.exp(logs - logsumexp(logs))
    return weights


def effective_count(weights: FloatArray) -> float:
    """Return how many draws of equal weights some weights (draws,) are worth."""
    return float(1.0 / (weights @ weights))


def are_too_few(weights: FloatArray) -> bool:
    """Tell whether too few draws have the weights (draws,)."""
    return effective_count(weights) < _LEAST_EFFECTIVE * len(weights)


class Bank:
    """Draws of a specimen with their histories.

    Parameters
    ----------
    known : what is known of the keys before the test.
    specimen : whom the test is of: the next specimen, or one of the fit.
    problem : of the running test.
    rounds : computes its histories.
    draws, seed : number of the draws, and their seed.

    Attributes
    ----------
    prior_covariance : (m, m) of the unknowns before the test.
    redraws : how often draws were made anew.
    log_evidence : logarithm of the probability density of the last readings but for a constant of
        theirs, the same under all laws.
    """

    def __init__(
        self,
        known: FittedValues,
        specimen: str,
        problem: Problem,
        rounds: Histories,
        draws: int,
        seed: int,
    ) -> None:
        self._known, self._specimen, self.problem = known, specimen, problem
        self._random = np.random.default_rng(seed)
        self.histories = SpecimenHistories(problem, rounds)
        self._rounds = rounds
        values, part, self._share_inside = draw_parts(known, specimen, draws, self._random)
        unknowns = np.where(known.logarithmic, np.log(values), values)
        self.histories.prepare(unknowns)
        coordinates = self.histories.coordinates(unknowns)
        self.draws = BankDraws(unknowns, part, np.zeros(draws), coordinates)
        self.redraws, self.log_evidence = 0, 0.0
        self._linearised: tuple[Problem, Linearised] | None = None
        wearing = [BODIES.index(body_of_wear(key)) for key in problem.settings.process]
        self._sizes, self._of_part = np.unique(known.sizes[:, wearing], axis=0, return_inverse=True)
        equal = np.full(draws, 1.0 / draws)
        self.prior_covariance = _moments(unknowns, equal)[1]
        self._linearise_at(equal)

    @property
    def values(self) -> FloatArray:
        """(draws, m) of the keys."""
        columns = zip(self.problem.parameters, self.draws.unknowns.T, strict=True)
        return np.column_stack(
            [np.clip(np.exp(u) if key.log else u, *key.bounds) for key, u in columns]
        )

    def sizes(self, weights: FloatArray) -> FloatArray:
        """Return the means (bodies,) mm of the process noise."""
        sizes: FloatArray = weights @ self._sizes[self._of_part.ravel()[self.draws.part]]
        return sizes

    def linearised(self, problem: Problem) -> Linearised:
        """Return a test, its misfit and the unknowns (u,) at which it is linearised.

        The unknowns of the linearised test are the coordinates of histories.

        Parameters
        ----------
        problem : of the running test, with its readings so far, or with others.
        """
        if self._linearised is not None and self._linearised[0] is problem:
            return self._linearised[1]
        test, at = problem.experiments[0], self._reference
        misfit = Misfit(problem, self._rounds)
        response = self.histories.at(at, test)
        misfit.responses.stored[0, problem.values(at).tobytes()] = response
        x = misfit.with_best_nuisances(problem.values(at), at[None])
        evaluation = misfit.evaluate(x, at[None])
        linearisation = Linearisation(misfit, evaluation, x, at[None])
        (linear,) = linearisation.tests
        modes = Reader(test).read(self.histories.modes())
        modes[:, 0] = response[:, 0] - modes[:, 0]  # above their mean
        rows = linearisation.roots[:, None] * misfit.whitened(modes)
        readings = linear.readings - linear.jacobian @ at + rows[:, 0]
        linearised = replace(linear, readings=readings, jacobian=rows[:, 1:]), misfit, x
        self._linearised = problem, linearised
        return linearised

    def update(self, problem: Problem, chosen: BoolArray) -> FloatArray:
        """Return the weights by readings; draws are made anew where few have all the weight.

        Parameters
        ----------
        chosen : (n,) which of the problem's readings count.
        """
        for round_number in range(_ROUNDS + 1):
            test = rows_of(self.linearised(problem)[0], chosen)
            likelihood = self._log_likelihood(test)
            logs = self._logs(likelihood)
            weights = normalised(logs)
            self.log_evidence = float(logsumexp(logs)) - np.log(len(logs))
            if round_number == _ROUNDS:
                break
            if are_too_few(weights):
                tempered = normalised(self._logs(self._exponent(likelihood) * likelihood))
                self._linearise_at(tempered)
                self._draw_anew(tempered)
                self.redraws += 1
            elif problem.settings.loss != "gaussian" and self._is_off(weights):
                self._linearise_at(weights)  # which weighs readings otherwise
            else:
                break
        if self._is_off(weights):
            self._linearise_at(weights)
        return weights

    def _is_off(self, weights: FloatArray) -> bool:
        """Tell whether readings are linearised far from the mean of the draws."""
        mean, covariance = _moments(self.draws.unknowns, weights)
        off = np.abs(mean - self._reference)
        return bool((off > _MOST_OFF_SD * np.sqrt(np.diag(covariance))).any())

    def _logs(self, likelihood: FloatArray) -> FloatArray:
        logs = self.draws.log_prior_over_proposal + likelihood
        return np.where(np.isfinite(logs), logs, -np.inf)

    def _log_likelihood(self, test: LinearisedTest) -> FloatArray:
        """Return the logarithm (draws,) of the likelihood of each draw; NaN without a history."""
        sizes = self._sizes if self._sizes.shape[1] else None
        number = self._of_part.ravel()[self.draws.part]
        coordinates, logs = self.draws.coordinates, np.empty(len(number))
        for size, reduced in enumerate(reduce_test(test, sizes)):
            chosen = slice(None) if sizes is None else number == size
            c = coordinates[chosen]
            square = ((c @ reduced.information - 2.0 * reduced.score) * c).sum(axis=1)
            rest = reduced.square + reduced.log_volume + reduced.log_nuisances
            logs[chosen] = -0.5 * (square + rest)
        return logs

    def _exponent(self, likelihood: FloatArray) -> float:
        """Return the power of the likelihood at which enough draws count."""
        low, high = 0.0, 1.0
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            weights = normalised(self._logs(middle * likelihood))
            enough = effective_count(weights) >= _TEMPERED_EFFECTIVE * len(weights)
            low, high = (middle, high) if enough else (low, middle)
        return low

    def _draw_anew(self, weights: FloatArray) -> None:
        """Replace all draws, by some from about those that have weight."""
        count, random = len(weights), self._random
        mean, covariance = _moments(self.draws.unknowns, weights)
        factor = np.linalg.cholesky(_WIDER * covariance)
        scale = np.sqrt(_DEGREES / random.chisquare(_DEGREES, count))
        normal = random.standard_normal((count, len(mean)))
        unknowns = mean + scale[:, None] * (normal @ factor.T)
        low, high = self.problem.unknown_bounds
        inside = ((unknowns >= low) & (unknowns <= high)).all(axis=1)
        density = multivariate_t(mean, _WIDER * covariance, _DEGREES).logpdf(unknowns)
        part, ratio = self._parts_at(unknowns, weights)
        ratio -= density + np.log(self._share_inside)
        unknowns = np.clip(unknowns, low, high)
        if self.histories.error is None:  # polynomials may do where draws are nearer
            self.histories.prepare(unknowns)
        coordinates = self.histories.coordinates(unknowns)
        ratio = np.where(inside, ratio, -np.inf)
        self.draws = BankDraws(unknowns, part, ratio, coordinates)
        self._linearised = None  # histories may have other modes

    def _parts_at(self, unknowns: FloatArray, weights: FloatArray) -> tuple[IntArray, FloatArray]:
        """Draw a part of the mixture for each of some unknowns (draws, m).

        Parts are as probable as they are there before the test, but for sizes of random wear:
        these by the weights of the draws so far. Also returned are the logarithms of their density
        over the probability of the draw, (draws,).
        """
        known, group = self._known, self._of_part.ravel()
        of_sizes = np.bincount(group[self.draws.part], weights, len(self._sizes))
        before = np.bincount(group, known.weights)
        of_sizes = (1.0 - _PRIOR_SHARE) * of_sizes + _PRIOR_SHARE * before
        preferred = np.log(of_sizes / before)[group]
        parts, ratios = [], []
        for some in np.array_split(unknowns, 1 + unknowns.size * len(group) // _CHUNK):
            logs = log_densities(known, self._specimen, some)
            proposed = logs + preferred
            proposed -= logsumexp(proposed, axis=1, keepdims=True)
            bound = self._random.random((len(some), 1))
            part = (np.cumsum(np.exp(proposed), axis=1) < bound).sum(axis=1)
            part = np.minimum(part, len(group) - 1)[:, None]
            ratios.append(np.take_along_axis(logs - proposed, part, axis=1)[:, 0])
            parts.append(part[:, 0])
        return np.concatenate(parts), np.concatenate(ratios)

    def _linearise_at(self, weights: FloatArray) -> None:
        """Linearise readings at the mean of the draws from now on."""
        self._reference: FloatArray = weights @ self.draws.unknowns
        self._linearised = None


def _moments(points: FloatArray, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return mean (m,) and covariance (m, m) of weighed points."""
    mean = weights @ points
    rest = points - mean
    return mean, (weights[:, None] * rest).T @ rest


def quantiles(values: FloatArray, weights: FloatArray, probabilities: Any) -> FloatArray:
    """Return quantiles of weighed values (draws,)."""
    order = np.argsort(values)
    centred = np.cumsum(weights[order]) - 0.5 * weights[order]
    between: FloatArray = np.interp(probabilities, centred, values[order])
    return between
