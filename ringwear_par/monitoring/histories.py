"""Histories of a specimen at many draws of the fitted keys, as few modes.

Some of the draws are stepped side by side to the end of the test. What is read of them between two
steps is linear in their values at steps, and these differ by a few modes, whose coordinates are
smooth in the keys: polynomials tell those of all other draws. Where they do not, as where layers
are worn through, all draws are stepped.
"""

import itertools
import logging
from dataclasses import replace
from functools import cache

import numpy as np
from numpy.polynomial.chebyshev import chebvander

from ringwear_par.arrays import FloatArray
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.errors import ComputationError, legible
from ringwear_par.identification.definition.problem import (
    BASE,
    Experiment,
    Problem,
    Series,
    body_of_wear,
)
from ringwear_par.identification.definition.reading_kinds import Trajectory
from ringwear_par.identification.model.histories import Histories, HistoryError, step_times
from ringwear_par.identification.model.readings import Reader

log = logging.getLogger(__name__)

#: draws that are stepped for polynomials, and of these those that test them
_STEPPED, _TESTS = 1000, 100
#: of the spread of the draws, by which polynomials may be off (root of the mean square)
_CLOSE = 1e-4
#: most terms of the polynomials, and their highest degree
_TERMS, _DEGREE = 150, 12
#: of the largest singular value: modes below it are round-off
_SMALL = 1e-6
#: of the draws that are stepped, most without a history
_MOST_FAILED = 0.1


def planned(problem: Problem) -> Problem:
    """Return a problem of one test whose readings are all of a history, at the ends of steps."""
    (test,) = problem.experiments
    case = test.case
    times = np.append(0.0, step_times(test))
    quantities: list[str] = ["approach", "torque", "volume.lower", "volume.upper"]
    layered = (bool(ring.layers) and None not in ring.densities for ring in case.rings)
    masses: list[str] = ["mass.lower", "mass.upper"]
    quantities += itertools.compress(masses, layered)
    series = [
        Series(q, q, times, np.zeros(len(times)), np.ones(len(times)),
               unit=BASE[q.partition(".")[0]], density=None if q in masses else 1.0)
        for q in quantities
    ]  # fmt: skip
    return replace(problem, experiments=(replace(test, series=tuple(series)),))


class SpecimenHistories:
    """Histories of one test at any values of the fitted keys.

    On the first rank, within ``Rounds.lead`` where all ranks share them.

    Parameters
    ----------
    problem : of the one test, whose keys are drawn.
    rounds : computes histories of its ``planned`` test.
    """

    def __init__(self, problem: Problem, rounds: Histories) -> None:
        self._problem, self._rounds = problem, rounds
        (self._test,) = planned(problem).experiments
        self.time = self._test.series[0].x
        #: rms error of polynomials over the spread of the draws; None: all draws are stepped
        self.error: float | None = None
        #: values of the keys of the last history with derivatives, and its readings
        self._last: tuple[FloatArray, FloatArray] | None = None

    def prepare(self, unknowns: FloatArray) -> None:
        """Find modes and polynomials from the first of some draws, (draws, m)."""
        log.info(
            "computing %d histories of %s", min(len(unknowns), _STEPPED),
            legible(self._test.name),
        )  # fmt: skip
        stepped = self._stepped(unknowns[:_STEPPED])
        good = np.isfinite(stepped).all(axis=1)
        if np.count_nonzero(~good) > _MOST_FAILED * len(stepped):
            raise ComputationError(
                f"{self._problem.name}: {np.count_nonzero(~good)} of {len(stepped)} draws have no "
                "history"
            )
        stepped, at = stepped[good], unknowns[:_STEPPED][good]
        self._mean = stepped.mean(axis=0)
        spread = (stepped - self._mean).reshape(len(stepped), -1, len(self.time)).std(axis=(0, 2))
        scale = np.repeat(np.where(spread > 0.0, spread, 1.0), len(self.time))
        left, values, modes = np.linalg.svd((stepped - self._mean) / scale, full_matrices=False)
        large = values > _SMALL * values[0]
        self._modes, self._inverse = modes[large] * scale, modes[large].T / scale[:, None]
        self._low, self._high = unknowns.min(axis=0), unknowns.max(axis=0)
        coordinates, learned = left[:, large] * values[large], len(stepped) - _TESTS
        terms = self._terms(at)
        if learned < terms.shape[1]:
            self.error = None
            return
        self._polynomials = np.linalg.lstsq(terms[:learned], coordinates[:learned], rcond=None)[0]
        off = terms[learned:] @ self._polynomials - coordinates[learned:]
        self.error = float(np.sqrt((off**2).sum() / _TESTS / (values**2).sum() * len(stepped)))
        if self.error > _CLOSE:
            self.error = None

    def coordinates(self, unknowns: FloatArray) -> FloatArray:
        """Return the coordinates (draws, modes) of histories; NaN where there is none."""
        if self.error is None:
            return (self._stepped(unknowns) - self._mean) @ self._inverse
        inside = ((unknowns >= self._low) & (unknowns <= self._high)).all(axis=1)
        coordinates = self._terms(unknowns) @ self._polynomials
        coordinates[~inside] = np.nan
        return coordinates

    def modes(self) -> Trajectory:
        """Return the mean of the histories and, as its derivatives, the modes."""
        return self._trajectory(np.column_stack([self._mean, self._modes.T]))

    def at(self, unknowns: FloatArray, test: Experiment) -> FloatArray:
        """Return the readings of a test at unknowns (m,), as ``Histories.read`` has them."""
        problem, values = self._problem, self._problem.values(unknowns)
        if self._last is None or not np.array_equal(self._last[0], values):
            read = self._rounds.read(values[None], [(0, 0)])[0]
            if isinstance(read, HistoryError):
                raise read
            self._last = values, read
        read = self._last[1]
        clocks = [BODIES.index(body_of_wear(key)) for key in problem.settings.process]
        columns = read[:, : 1 + len(values) + len(clocks)]
        return Reader(test, clocks).read(self._trajectory(columns))

    def _stepped(self, unknowns: FloatArray) -> FloatArray:
        """Return all readings (draws, n) of the planned test; NaN where there is no history."""
        values = np.array([self._problem.values(u) for u in unknowns])
        pairs = [(i, 0) for i in range(len(values))]
        rows = self._rounds.read(values, pairs, derivatives=False)
        lost = np.full(self._test.n, np.nan)
        return np.array([lost if isinstance(row, HistoryError) else row[:, 0] for row in rows])

    def _terms(self, unknowns: FloatArray) -> FloatArray:
        """Return the terms (draws, terms) of polynomials of the unknowns."""
        m, width = unknowns.shape[1], self._high - self._low
        at = 2.0 * (unknowns - self._low) / np.where(width > 0.0, width, 1.0) - 1.0
        degree = max(
            (d for d in range(_DEGREE + 1) if len(_degrees(m, d)) <= _TERMS), default=0
        )  # fmt: skip
        of_keys = [chebvander(column, degree) for column in at.T]
        terms = np.ones((len(at), len(_degrees(m, degree))))
        for key, powers in enumerate(_degrees(m, degree).T):
            terms *= of_keys[key][:, powers]
        return terms

    def _trajectory(self, columns: FloatArray) -> Trajectory:
        """Return the trajectory of columns (n, q) of readings of the planned test."""
        parts = np.split(columns, len(self._test.series))
        fields: dict[str, FloatArray] = {
            s.name: p for s, p in zip(self._test.series, parts, strict=True)
        }
        unknown = np.full((len(self.time), columns.shape[1]), np.nan)
        volume, mass = (
            np.stack([fields.get(f"{quantity}.{body}", unknown) for body in BODIES])
            for quantity in ("volume", "mass")
        )
        no_profile = np.zeros((2, len(self.time), 0, columns.shape[1]))
        return Trajectory(self.time, fields["approach"], fields["torque"], volume, no_profile,
                          mass, unknown[:2])  # fmt: skip


@cache
def _degrees(keys: int, degree: int) -> FloatArray:
    """Return the degrees (terms, keys) in each key of all terms up to a degree."""
    every = itertools.product(range(degree + 1), repeat=keys)
    return np.array([powers for powers in every if sum(powers) <= degree])
