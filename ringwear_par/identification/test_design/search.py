"""The best tests to make together, from the information of single tests, which adds."""

import itertools
from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.identification.definition.problem import Problem
from ringwear_par.identification.test_design.candidates import Candidate
from ringwear_par.identification.test_design.information import PriorInformation, widths

#: information that counts as none: by the widths of bounds, and relative to the largest
_UNINFORMED, _ROUND_OFF = 1e-9, 1e-13
#: pairs of candidates whose scores are computed together
_AT_ONCE = 20_000
#: designs that are listed, and rounds of exchange in their search
_LISTED, _ROUNDS = 10, 20
#: number of best exchanges of two tests that are tried as designs
_NEAR = 200


@dataclass(frozen=True, eq=False)
class Design:
    """Tests to make together, and what they would tell."""

    #: their candidates, by number.
    tests: tuple[int, ...]
    #: by the criterion, larger is better.
    score: float
    #: (m,) predicted standard deviations of the keys' values, as far as they are what they seem.
    sd: FloatArray
    #: (2, m) smallest and largest over the draws.
    range: FloatArray
    #: (m, m).
    correlation: FloatArray


class Search:
    """Looks for the best tests by the information (d, c, m, m) of candidates, at each draw."""

    def __init__(
        self,
        problem: Problem,
        prior: PriorInformation,
        information: FloatArray,
        tests: Sequence[Candidate],
    ) -> None:
        self._space = problem.design
        self._slopes = problem.slopes(prior.nominal.tolist())
        self._seconds = np.array([test.seconds for test in tests])
        self._kinds = [test.kind for test in tests]
        self._widths = widths(problem)
        scale = np.outer(self._widths, self._widths)
        # over the widths of bounds, and never singular
        self._before = prior.information * scale
        self._floor = _UNINFORMED * np.eye(len(self._widths))
        self._information = information * scale

    def best(self, count: int) -> list[Design]:
        """Return the best designs of so many tests."""
        every = np.stack(np.triu_indices(len(self._seconds)), axis=1)
        if count == 1:
            every = np.arange(len(self._seconds))[:, None]
        spent, limit = self._seconds[every].sum(axis=1), self._space.time_limit
        if count <= 2:
            return self._best_designs(every[spent <= limit])
        left = limit - float(self._seconds.min()) * (count - 2)
        # from the best pair with the shortest others on, two are exchanged at a time; the
        # candidates of the last exchanges are listed as well
        admissible = every[spent <= left]
        start = admissible[int(self._scores(admissible).argmax())]
        tests = np.append(start, [int(self._seconds.argmin())] * (count - 2))
        score = self._score(self._information[:, tests].sum(axis=1)[:, None])[0]
        for _ in range(_ROUNDS):
            before, near = score, []
            for i, j in itertools.combinations(range(count), 2):
                remaining = np.delete(tests, [i, j])
                rest = self._information[:, remaining].sum(axis=1)
                room = limit - self._seconds[remaining].sum()
                admissible = every[spent <= room]
                scores = self._scores(admissible, rest)
                first = admissible[np.argsort(-scores, kind="stable")[:_NEAR]]
                near.append(np.column_stack([np.tile(remaining, (len(first), 1)), first]))
                changed = np.append(remaining, first[0])
                new = self._score(self._information[:, changed].sum(axis=1)[:, None])[0]
                if new > score:
                    tests, score = changed, new
            if score <= before:
                break
        return self._best_designs(
            np.unique(np.sort([tests, *np.concatenate(near)], axis=1), axis=0)
        )

    def _scores(self, tests: IntArray, rest: FloatArray | None = None) -> FloatArray:
        """Return the score of each row of tests, (rows, count)."""
        scores = []
        for first in range(0, len(tests), _AT_ONCE):
            part = tests[first : first + _AT_ONCE]
            whole = np.sum([self._information[:, column] for column in part.T], axis=0)
            scores.append(self._score(whole if rest is None else whole + rest[:, None]))
        return np.concatenate(scores)

    def _score(self, information: FloatArray) -> FloatArray:
        """Return the mean over draws of the criterion of information (d, rows, m, m)."""
        after = information + self._before + self._floor
        if self._space.criterion == "A":
            scores = -np.trace(_inverse(after), axis1=-2, axis2=-1)
        else:
            scores = 0.5 * np.linalg.slogdet(after)[1]
            if self._space.criterion == "eig":
                scores = scores - 0.5 * np.linalg.slogdet(self._before)[1]
        return scores.mean(axis=0)

    def _best_designs(self, tests: IntArray) -> list[Design]:
        scores = self._scores(tests)
        designs: dict[Hashable, Design] = {}
        for i in np.argsort(-scores, kind="stable").tolist():
            # of tests at the same loads those with the best durations and instants are listed
            kind = tuple(sorted(self._kinds[test] for test in tests[i]))
            if kind not in designs:
                whole = self._information[:, tests[i]].sum(axis=1)
                designs[kind] = self._design_of(tuple(tests[i].tolist()), whole, float(scores[i]))
            if len(designs) == _LISTED:
                break
        return list(designs.values())

    def design_of_file(self, information: FloatArray) -> Design:
        """Return the design of tests of information (d, tests, m, m) together."""
        whole = information.sum(axis=1) * np.outer(self._widths, self._widths)
        return self._design_of((), whole, float(self._score(whole[:, None])[0]))

    def _design_of(self, tests: tuple[int, ...], whole: FloatArray, score: float) -> Design:
        covariance = _inverse(whole + self._before + self._floor)
        spread = self._natural(covariance)
        nominal = covariance[0]
        root = np.sqrt(np.diag(nominal))
        return Design(
            tests, score, spread[0], np.stack([spread.min(axis=0), spread.max(axis=0)]),
            nominal / np.outer(root, root),
        )  # fmt: skip

    def _natural(self, covariance: FloatArray) -> FloatArray:
        """Return standard deviations (..., m) of values; infinite beyond the bounds' widths."""
        share = np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))
        return np.where(share < 1.0, share * self._widths * self._slopes, np.inf)

    def singles(self) -> tuple[FloatArray, FloatArray]:
        """Return predicted standard deviations after each candidate alone, (c, m), and scores."""
        alone = _inverse(self._information[0] + self._before + self._floor)
        return self._natural(alone), self._score(self._information)

    def pairs(self) -> tuple[FloatArray, FloatArray]:
        """Return predicted sd (c, c, m) after two candidates; scores (c, c), -inf over budget."""
        information, c = self._information[0], len(self._seconds)
        rows = [
            self._natural(_inverse(information + matrix + self._before + self._floor))
            for matrix in information
        ]
        upper = np.stack(np.triu_indices(c), axis=1)
        scores = np.full((c, c), -np.inf)
        limit = self._space.time_limit
        upper = upper[self._seconds[upper].sum(axis=1) <= limit]
        scores[upper[:, 0], upper[:, 1]] = scores[upper[:, 1], upper[:, 0]] = self._scores(upper)
        return np.array(rows), scores


def _inverse(information: FloatArray) -> FloatArray:
    """Return the inverse (..., m, m), lost directions as large as round-off has it."""
    values, vectors = np.linalg.eigh(information)
    values = np.maximum(values, np.maximum(_UNINFORMED, _ROUND_OFF * values[..., -1:]))
    return (vectors / values[..., None, :]) @ np.swapaxes(vectors, -1, -2)
