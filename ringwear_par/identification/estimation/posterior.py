"""What the fitted keys may be, given all readings: samples of their posterior distribution.

Drawn by an ensemble of walkers (emcee: Foreman-Mackey et al., Publ. Astron. Soc. Pac. 125 (2013)
306-312; moves of differential evolution), whose histories step side by side. Before any reading a
key has the distribution of its prior within its bounds; one without a prior is uniform there, or
its logarithm where the scale is logarithmic. Nuisances are those that fit each sample best: as they
are linear, that is the same as integrating over them where noise is Gaussian and they have no
bounds. Noise that is fitted stays what it is at the optimum: that it is not known better adds
nothing to the spread of the samples.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.identification.definition.problem import reflected
from ringwear_par.identification.estimation.chain import Keeper, Walk
from ringwear_par.identification.estimation.least_squares import LeastSquares
from ringwear_par.identification.estimation.marginal import Marginal
from ringwear_par.identification.model.lockstep import StoppedError
from ringwear_par.identification.model.rounds import Rounds

#: most walkers, steps that they make at least, and the seed of all
_WALKERS, _STEPS, _SEED = 128, 16, 0
#: steps that are thrown away: walkers start from the covariance, or from the bounds where that is
#: wider
_BURN = 12
#: how often the way to the optimum is halved where a walker's start is no case
_NEARER = 40
#: effective samples below which quantiles mean little
FEW = 200.0


@dataclass(frozen=True, eq=False)
class Posterior:
    """Samples of the fitted keys.

    Parameters
    ----------
    samples : (s, m) values.
    acceptance : of the walkers' moves.
    effective : how many independent samples they are worth, by the slowest key.
    """

    samples: FloatArray
    acceptance: float
    effective: float

    def interval(self, level: float) -> FloatArray:
        """Return (2, m) ends of the central intervals."""
        ends: FloatArray = np.quantile(self.samples, [0.5 - 0.5 * level, 0.5 + 0.5 * level], axis=0)
        return ends


def missing_for(intervals: Sequence[str]) -> str:
    """Return what intervals of a fit need that is not installed, "" for nothing; import nothing."""
    if "posterior" not in intervals or find_spec("emcee") is not None:
        return ""
    return 'fit.intervals: "posterior" needs emcee: pip install emcee, or leave it out'


def sample_posterior(
    squares: LeastSquares,
    histories: Rounds,
    x: FloatArray,
    covariance: FloatArray,
    keeper: Keeper,
) -> Posterior:
    """Return samples of the fitted keys. Not collective.

    Parameters
    ----------
    x, covariance : (u,) and (u, u) of the unknowns at the optimum.
    keeper : of the walk, which goes on where it was stopped.

    Raises
    ------
    StoppedError : a signal; the walk is kept.
    """
    import emcee

    settings, m = squares.problem.settings, len(squares.problem.parameters)
    low, high = squares.lower[:m], squares.upper[:m]
    marginal = Marginal(squares)

    def log_probability(points: FloatArray) -> FloatArray:
        """Return (w,) of unknowns (w, m)."""
        scores = np.full(len(points), -np.inf)
        inside = np.flatnonzero(((points >= low) & (points <= high)).all(axis=1))
        values = np.array([squares.values(point) for point in points[inside]]).reshape(-1, m)
        found = histories.responses(values, squares.steps, derivatives=False)
        for i, value, readings in zip(inside, values, found, strict=True):
            if not isinstance(readings, Exception):
                scores[i] = marginal(value, readings[:, 0])
        return scores

    random = np.random.default_rng(_SEED)
    spread = np.sqrt(np.minimum(np.diag(covariance)[:m], ((high - low) / 4.0) ** 2))
    known = np.isfinite(covariance[:m, :m]).all()
    root = np.linalg.cholesky(covariance[:m, :m] + 1e-12 * np.diag(spread**2)) if known else None
    walkers = max(min(_WALKERS, 2 * (settings.samples // (2 * _STEPS))), 16, 4 * m)
    drawn = random.standard_normal((walkers, m))
    moved = drawn * spread if root is None else drawn @ root.T
    wide = np.abs(moved) > high - low
    start = reflected(x[:m] + np.where(wide, drawn * spread, moved), low, high)
    for _ in range(_NEARER):  # towards the optimum, which is a case by all rules of the laws
        out = ~squares.allowed(start)
        start[out] = 0.5 * (start[out] + x[:m])
    moves = [(emcee.moves.DEMove(), 0.8), (emcee.moves.DESnookerMove(), 0.2)]
    sampler = emcee.EnsembleSampler(walkers, m, log_probability, moves=moves, vectorize=True)
    sampler.log_prob_fn = log_probability  # what emcee wraps it in prints all of its errors
    sampler.random_state = np.random.RandomState(_SEED).get_state()
    steps = _BURN + -(-settings.samples // walkers)
    walk = keeper.read()
    if walk is not None and walk.steps.shape[1:] == start.shape and len(walk.steps) <= steps:
        start = emcee.State(
            walk.steps[-1], log_prob=walk.log_prob, random_state=walk.random_state, copy=True
        )
    else:
        walk = Walk(np.zeros((0, walkers, m)), np.zeros(walkers), 0, 0, ())
    histories.count += walk.histories
    others = histories.count - walk.histories

    def walked() -> Walk:
        """Return the whole walk."""
        parts = np.concatenate([walk.steps, sampler.get_chain()])
        last, so_far = sampler.get_last_sample(), int(sampler.backend.accepted.sum())
        return Walk(
            parts, last.log_prob, walk.accepted + so_far, histories.count - others,
            last.random_state,
        )  # fmt: skip

    before = len(walk.steps)
    try:
        for step, _ in enumerate(
            sampler.sample(start, iterations=steps - before, skip_initial_state_check=True), before
        ):
            if keeper.due:
                keeper.write(walked())
            histories.tell(f"posterior: {step + 1} of {steps} steps of {walkers} walkers")
    except StoppedError:
        if sampler.iteration > 0:
            keeper.write(walked())
        raise
    whole_walk = walked() if before < steps else walk
    chain = whole_walk.steps[_BURN:]
    # means over walkers scatter by the correlation time of their steps
    scatter, whole = chain.mean(axis=0).var(axis=0, ddof=1), chain.reshape(-1, m).var(axis=0)
    times = np.maximum(len(chain) * scatter / np.where(whole > 0.0, whole, 1.0), 1.0)
    values = np.array([squares.values(row) for row in chain.reshape(-1, m)])
    return Posterior(
        values, whole_walk.accepted / (steps * walkers), float(len(values) / np.max(times))
    )
