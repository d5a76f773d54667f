"""The posterior of a material in pieces, where histories are not linear over all that is known.

A fit is linear about its estimate. What scatters, each test tells well for itself; but a key that
all tests share, as p0, may be known so little that others bend along it. The posterior is therefore
also made of pieces: each is multiplied by a normal density about another value of the shared keys,
and tests are linearised there anew. The densities are so near to each other that their sum is the
same everywhere, so that the sum of the pieces is the posterior itself.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.identification.estimation.misfit import Evaluation, Misfit
from ringwear_par.identification.model.histories import HistoryError
from ringwear_par.identification.scatter.linearisation import Linearisation
from ringwear_par.identification.scatter.material import Material, Piece
from ringwear_par.identification.scatter.posterior import ScatterPosterior
from ringwear_par.identification.scatter.search import (
    integrated,
    levels_of,
    loss_beyond_squares,
    models_at_shares,
    prior_of_keys,
)

#: in sd of the posterior: sd of a piece, and distance between pieces, whose sum is then even to
#: 3e-4
_WIDTH, _APART = 0.45, 0.675
#: logarithm of the probability over the largest above which the neighbours of a piece are computed
_PROBABLE = -7.0
#: most keys along which pieces lie: three would need more pieces than are allowed
_MOST_SHARED = 2
#: weight of pieces whose tests still move up to which the others are good enough
_UNSETTLED = 0.01
#: weight of pieces without histories from which a warning tells of it, and up to which others do
_NOTABLE, _MOST_LOST = 0.001, 0.5
#: texts of warnings
_LINEAR = "predictions and running tests draw linearly about the estimate"
_LEAVE_OUT = "predictions and running tests leave out"
#: most pieces; most rounds until tests settle, and sd that they may still move
_MOST, _ROUNDS, _STILL = 80, 5, 0.05


@dataclass(frozen=True, eq=False)
class _Place:
    """Where tests are linearised for a piece, and the piece."""

    #: (shared,) of the keys that do not scatter
    centre: FloatArray
    #: (tests, m) unknowns of the keys, their farthest last move in sd
    test_unknowns: FloatArray
    moved: float
    posterior: ScatterPosterior
    #: of the piece, but for a constant; as linear as the whole where there is no history
    log_mass: float
    has_histories: bool = True


def posterior_in_pieces(misfit: Misfit, material: Material) -> tuple[tuple[Piece, ...], str]:
    """Return the pieces of a material's posterior, and what is wrong with them. Not collective.

    ``()`` where all keys scatter, wear is random, there would be too many of them, or tests do not
    settle of pieces that weigh.
    """
    pieces = _Pieces(misfit, material)
    if not 0 < len(pieces.shared) <= _MOST_SHARED or material.wear.shares or not material.converged:
        return (), ""
    done: dict[tuple[int, ...], _Place] = {}
    wanted = pieces.first()
    while wanted and len(done) + len(wanted) <= _MOST:
        done |= pieces.at(wanted)
        least = max(place.log_mass for place in done.values()) + _PROBABLE
        neighbours = {
            (*number[:axis], number[axis] + step, *number[axis + 1 :])
            for number, place in done.items()
            if place.has_histories and place.log_mass > least
            for axis in range(len(number))
            for step in (-1, 1)
        }
        wanted = [number for number in sorted(neighbours - {*done}) if pieces.may_be(number)]
    if wanted:
        return (), f"{_LINEAR}: more than {_MOST} pieces are needed"
    if not done:
        return (), ""
    places = list(done.values())
    logs = np.array([place.log_mass for place in places])
    weights = np.exp(logs - logs.max())
    weights /= weights.sum()
    lost = float(weights[[not place.has_histories for place in places]].sum())
    off = float(weights[[place.has_histories and place.moved > _STILL for place in places]].sum())
    if off + lost > _MOST_LOST or off > _UNSETTLED:
        reason = "there are no histories" if lost > off else "tests do not settle"
        return (), f"{_LINEAR}: {reason} for {100.0 * max(off, lost):.2g} % of what is known"
    text = f"{_LEAVE_OUT} {100.0 * lost:.2g} % of what is known: there are no histories"
    return tuple(
        Piece(place.posterior, weight, place.test_unknowns)
        for place, weight in zip(places, (weights / (1.0 - lost)).tolist(), strict=True)
        if place.has_histories
    ), text if lost > _NOTABLE else ""


class _Pieces:
    """Makes pieces about points of a lattice over the keys that do not scatter.

    Attributes
    ----------
    shared : their places among the free keys.
    """

    def __init__(self, misfit: Misfit, material: Material) -> None:
        problem = misfit.problem
        self._misfit, self._material, self._m = misfit, material, len(problem.parameters)
        self._free = [*material.mixed.free]
        self._low, self._high = misfit.lower[: self._m], misfit.upper[: self._m]
        levels, self._scatters, _ = levels_of(problem, None)
        self._levels = material.mixed.posterior.model.levels
        scattering = {level.key for level in self._levels}
        self.shared = [p for p in range(len(self._free) * bool(levels)) if p not in scattering]
        posterior = material.mixed.posterior
        self._mean = (posterior.weights @ posterior.means_of())[self.shared]
        self._sd = np.sqrt(np.diag(posterior.covariance()))[self.shared]

    def first(self) -> list[tuple[int, ...]]:
        """Return the points at which the linear posterior is probable."""
        covariance = self._material.mixed.posterior.covariance()[np.ix_(self.shared, self.shared)]
        scaled = covariance / np.outer(self._sd, self._sd)
        inverse = np.linalg.inv(scaled + _WIDTH**2 * np.eye(len(self.shared)))
        reach = range(-7, 8)
        numbers = itertools.product(reach, repeat=len(self.shared))
        near = ((number, _APART * np.array(number, dtype=float)) for number in numbers)
        return [
            number for number, at in near
            if -0.5 * at @ inverse @ at > _PROBABLE and self.may_be(number)
        ]  # fmt: skip

    def may_be(self, number: tuple[int, ...]) -> bool:
        """Tell whether a piece reaches into the bounds of its keys."""
        keys, margin = np.array(self._free)[self.shared], 3.0 * _WIDTH * self._sd
        centre = self._centre(number)
        return bool(
            ((centre > self._low[keys] - margin) & (centre < self._high[keys] + margin)).all()
        )

    def at(self, numbers: Sequence[tuple[int, ...]]) -> dict[tuple[int, ...], _Place]:
        """Return the pieces about points."""
        material, misfit = self._material, self._misfit
        linear = Linearisation(
            misfit, material.best_fit.evaluation, material.best_fit.x, material.test_unknowns
        )
        places = {
            number: self._solved(
                self._centre(number), linear, material.best_fit.evaluation, material.best_fit.x,
                material.test_unknowns,
            )
            for number in numbers
        }  # fmt: skip
        for _ in range(_ROUNDS):
            moving = {n: p for n, p in places.items() if p.has_histories and p.moved > _STILL}
            tests = [
                misfit.values_of_tests(material.best_fit.x, p.test_unknowns)
                for p in moving.values()
            ]
            misfit.responses.prepare([pair for values in tests for pair in enumerate(values)])
            for number, place in moving.items():
                places[number] = self._relinearised(place)
        return places

    def _centre(self, number: tuple[int, ...]) -> FloatArray:
        centre: FloatArray = self._mean + _APART * self._sd * np.array(number)
        return centre

    def _relinearised(self, place: _Place) -> _Place:
        misfit, x = self._misfit, self._material.best_fit.x.copy()
        keys = np.array(self._free)[self.shared]
        x[keys] = np.clip(place.centre, self._low[keys], self._high[keys])
        try:
            x = misfit.with_best_nuisances(misfit.values(x), place.test_unknowns)
            evaluation = misfit.evaluate(x, place.test_unknowns)
        except HistoryError:
            return replace(place, has_histories=False)
        linear = Linearisation(misfit, evaluation, x, place.test_unknowns)
        return self._solved(place.centre, linear, evaluation, x, place.test_unknowns)

    def _solved(
        self,
        centre: FloatArray,
        linear: Linearisation,
        evaluation: Evaluation,
        x: FloatArray,
        test_unknowns: FloatArray,
    ) -> _Place:
        """Return the piece of tests as they are linearised."""
        problem, material, free = self._misfit.problem, self._material, self._free
        precision, mean = (part[free] for part in prior_of_keys(problem.parameters, x))
        piece, shared = (_WIDTH * self._sd) ** -2, self.shared
        product = precision[shared] + piece
        # of the product of the prior and the normal density of the piece
        loss = precision[shared] * piece / product * (mean[shared] - centre) ** 2
        mean[shared] = (precision[shared] * mean[shared] + piece * centre) / product
        precision[shared] = product
        at_bounds = {j: float(material.best_fit.x[j]) for j in range(self._m) if j not in free}
        models = partial(
            models_at_shares, linear, material.wear, at_bounds, self._levels, (precision, mean)
        )
        posterior = integrated(problem.name, models, self._scatters, ())
        updated, moved = test_unknowns.copy(), 0.0
        for test in range(len(updated)):
            unknowns = posterior.weights @ posterior.means_of(test)
            new = np.clip(unknowns, self._low[free], self._high[free])
            sds = np.sqrt(np.diag(posterior.covariance(test, test)))
            moved = max(moved, float(np.abs((new - updated[test, free]) / sds).max()))
            updated[test, free] = new
        log_mass = posterior.log_mass - 0.5 * (
            float(loss.sum()) + loss_beyond_squares(self._misfit, evaluation)
        )
        return _Place(centre, updated, moved, posterior, log_mass)
