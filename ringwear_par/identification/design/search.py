"""The best tests to make together, from the information of single tests, which adds."""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.identification.definition.problem import Problem
from ringwear_par.identification.design.candidates import Candidate
from ringwear_par.identification.design.information import Before

#: designs that are listed
_LISTED = 10
#: pairs whose scores are computed together
_AT_ONCE = 50_000
#: share of the sd that bounds alone leave, below which a key of which nothing else was known is
#: identified
_IDENTIFIED = 0.5


@dataclass(frozen=True, eq=False)
class Design:
    """Tests to make together, and what they would tell."""

    #: their candidates, by number
    tests: tuple[int, ...]
    #: by the criterion, larger is better
    score: float
    #: bits, information on all keys: one bit halves one sd
    gain: float
    #: (m,) predicted standard deviations of the keys' values; infinite: not identified
    sd: FloatArray
    #: (m, m)
    correlation: FloatArray


@dataclass(frozen=True, eq=False)
class Candidates:
    """All tests that could be made, with what is needed to compare any of them together."""

    problem: Problem
    #: what is known before
    before: Before
    #: (c,) that have histories
    tests: Sequence[Candidate]
    #: (c, d, m, m) information in each about the unknowns of the material, at each draw
    information: FloatArray

    @cached_property
    def _precision(self) -> FloatArray:
        return np.linalg.inv(self.before.covariance)

    def scores(self, tests: IntArray) -> FloatArray:
        """Return the score (rows,) of tests (rows, count) together; -inf beyond the time.

        Larger is better. Of "D" the logarithm of how much smaller the ellipsoid becomes, of "A"
        minus the mean variance, over the widths of bounds; means over the draws.
        """
        seconds = np.array([test.seconds for test in self.tests])
        scores = np.full(len(tests), -np.inf)
        within = np.flatnonzero(seconds[tests].sum(axis=1) <= self.problem.design.time_limit)
        for rows in np.array_split(within, len(within) // _AT_ONCE + 1):
            scores[rows] = self._score(sum(self.information[column] for column in tests[rows].T))
        return scores

    def _gain(self, information: FloatArray) -> FloatArray:
        logs = np.linalg.slogdet(self._precision + information)[1]
        gain: FloatArray = 0.5 * (logs.mean(axis=-1) - np.linalg.slogdet(self._precision)[1])
        return gain

    def _score(self, information: FloatArray) -> FloatArray:
        if self.problem.design.criterion == "D":
            return self._gain(information)
        low, high = self.problem.unknown_bounds
        return -np.square(_sd(self._covariance(information)) / (high - low)).mean(axis=-1)

    def _covariance(self, information: FloatArray) -> FloatArray:
        """Return covariances (..., m, m) of unknowns after information (..., d, m, m)."""
        covariance: FloatArray = np.linalg.inv(self._precision + information).mean(axis=-3)
        return covariance

    def design(self, information: FloatArray, tests: Sequence[int] = ()) -> Design:
        """Return the design of tests that have information (d, m, m) together."""
        covariance = self._covariance(information)
        score, gain, sd = float(self._score(information)), self._gain(information), _sd(covariance)
        correlation = covariance / np.outer(sd, sd)
        return Design((*tests,), score, float(gain / np.log(2.0)), self.sds(information), correlation)

    def sds(self, information: FloatArray) -> FloatArray:
        """Return predicted standard deviations (..., m) of values by information (..., d, m, m)."""
        sd, before = _sd(self._covariance(information)), _sd(self.before.covariance)
        identified = ~self.before.unknown | (sd < _IDENTIFIED * before)
        return np.where(identified, sd * self.problem.slopes(self.before.values), np.inf)

    def best(self, count: int) -> IntArray:
        """Return the tests (rows, count) that were compared together, the best first.

        All of one or two. Of more, tests are added to the best pair that leaves time for them, then
        each is exchanged, until none is better.
        """
        every = np.arange(len(self.tests))
        tests = every[:, None] if count == 1 else np.column_stack(np.triu_indices(len(every)))
        if count > 2:
            shortest = min(every, key=lambda i: self.tests[i].seconds)
            filled = np.column_stack([tests, np.full((len(tests), count - 2), shortest)])
            chosen = filled[self.scores(filled).argmax()]
            looked, best, score = [chosen[None]], -np.inf, -1e300
            while score > best:
                best = score
                for place in [*range(2, count), 0, 1]:
                    tried = np.tile(chosen, (len(every), 1))
                    tried[:, place] = every
                    scores = self.scores(tried)
                    chosen, score = tried[scores.argmax()], scores.max()
                    looked.append(tried)
            tests = np.unique(np.sort(np.concatenate(looked), axis=1), axis=0)
        scores = self.scores(tests)
        order = np.argsort(-scores, kind="stable")
        return tests[order[scores[order] > -np.inf]]

    def listed(self, tests: IntArray) -> list[int]:
        """Return the rows of the best designs that differ in more than durations and instants."""
        kinds: dict[Hashable, int] = {}
        for row, numbers in enumerate(tests.tolist()):
            kinds.setdefault(tuple(sorted(self.tests[i].kind for i in numbers)), row)
            if len(kinds) == _LISTED:
                break
        return list(kinds.values())


def _sd(covariance: FloatArray) -> FloatArray:
    """Return the standard deviations (..., m) of covariances (..., m, m)."""
    sd: FloatArray = np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))
    return sd
