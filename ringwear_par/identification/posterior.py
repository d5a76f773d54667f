"""What the fitted keys may be, given all readings: samples of their posterior distribution.

Drawn by an ensemble of walkers (emcee: Foreman-Mackey et al., Publ. Astron. Soc. Pac. 125 (2013)
306-312; moves of differential evolution), whose histories step side by side. Before any reading a
key has the distribution of its prior within its bounds; one without a prior is uniform there, or
its logarithm where the scale is logarithmic. Nuisances are those that fit each sample best: as they
are linear, that is the same as integrating over them where noise is Gaussian and they have no
bounds. Noise that is fitted stays what it is at the optimum: that it is not known better adds
nothing to the spread of the samples.
"""

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from scipy.optimize import lsq_linear

from ringwear_par.arrays import FloatArray
from ringwear_par.errors import InputError
from ringwear_par.identification.chain import Keeper, Walk
from ringwear_par.identification.histories import Histories
from ringwear_par.identification.least_squares import NU, LeastSquares
from ringwear_par.identification.problem import reflected
from ringwear_par.parallel import together
from ringwear_par.results.progress import PROGRESS_SECONDS

log = logging.getLogger(__name__)

#: most walkers, steps that they make at least, and the seed of all
_WALKERS, _STEPS, _SEED = 128, 16, 0
#: steps that are thrown away: walkers start from the covariance, or from the bounds where that is
#: wider
_BURN = 12
#: rounds of reweighting where the loss is not Gaussian
_REWEIGHTED = 20
#: change of residuals over their noise at which they are done
_SAME = 1e-4
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


def require_emcee() -> None:
    """Refuse to go on without emcee.

    Raises
    ------
    InputError : it is not installed.
    """
    try:
        import emcee  # noqa: F401
    except ImportError as error:
        raise InputError(
            'fit: intervals: "posterior" needs emcee: pip install emcee, or leave it out'
        ) from error


def sample_posterior(
    squares: LeastSquares,
    histories: Histories,
    x: FloatArray,
    covariance: FloatArray,
    comm: MPI.Intracomm,
    stop: Callable[[], bool],
    keeper: Keeper,
) -> Posterior | None:
    """Return samples of the fitted keys; None if ``stop`` says so. Collective, the same on all.

    Parameters
    ----------
    x, covariance : (u,) and (u, u) of the unknowns at the optimum.
    keeper : of the walk, which goes on where it was stopped; that of the first rank counts.

    Raises
    ------
    RingwearError : what went wrong on any of the ranks, on all.
    """
    import emcee

    settings, m = squares.problem.settings, len(squares.problem.parameters)
    low, high = squares.lower[:m], squares.upper[:m]
    marginal = _Marginal(squares)

    def log_probability(points: FloatArray) -> FloatArray:
        """Return (w,) of unknowns (w, m)."""
        found = {}
        with together(comm):  # before the others wait for what this rank has found
            inside = np.flatnonzero(((points >= low) & (points <= high)).all(axis=1))
            own = inside[comm.rank :: comm.size]
            values = np.array([squares.values(points[i]) for i in own]).reshape(len(own), m)
            for i, value, readings in zip(
                own, values, histories.responses(values, derivatives=False), strict=True
            ):
                if not isinstance(readings, Exception):
                    found[int(i)] = marginal(value, readings[:, 0])
        scores = np.full(len(points), -np.inf)
        for part in comm.allgather(found):
            scores[list(part)] = list(part.values())
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
    moves = [(emcee.moves.DEMove(), 0.8), (emcee.moves.DESnookerMove(), 0.2)]
    sampler = emcee.EnsembleSampler(walkers, m, log_probability, moves=moves, vectorize=True)
    sampler.log_prob_fn = log_probability  # what emcee wraps it in prints all of its errors
    sampler.random_state = np.random.RandomState(_SEED).get_state()
    steps = _BURN + -(-settings.samples // walkers)
    walk = comm.bcast(keeper.read() if comm.rank == 0 else None)
    if walk is not None and walk.steps.shape[1:] == start.shape and len(walk.steps) <= steps:
        start = emcee.State(
            walk.steps[-1], log_prob=walk.log_prob, random_state=walk.random_state, copy=True
        )
    else:
        walk = Walk(np.zeros((0, walkers, m)), np.zeros(walkers), 0, ())

    def walked() -> Walk:
        """Return the whole walk."""
        parts = np.concatenate([walk.steps, sampler.get_chain()])
        last, so_far = sampler.get_last_sample(), int(sampler.backend.accepted.sum())
        return Walk(parts, last.log_prob, walk.accepted + so_far, last.random_state)

    before, told = len(walk.steps), time.perf_counter()
    for step, _ in enumerate(
        sampler.sample(start, iterations=steps - before, skip_initial_state_check=True), before
    ):
        stopped = comm.allreduce(int(stop()), op=MPI.MAX)
        if comm.rank == 0 and (stopped or keeper.due):
            keeper.write(walked())
        if stopped:
            return None
        if comm.rank == 0 and time.perf_counter() - told > PROGRESS_SECONDS:
            told = time.perf_counter()
            log.info("posterior: %d of %d steps of %d walkers", step + 1, steps, walkers)
    whole_walk = walked() if before < steps else walk
    chain = whole_walk.steps[_BURN:]
    # means over walkers scatter by the correlation time of their steps
    scatter, whole = chain.mean(axis=0).var(axis=0, ddof=1), chain.reshape(-1, m).var(axis=0)
    times = np.maximum(len(chain) * scatter / np.where(whole > 0.0, whole, 1.0), 1.0)
    values = np.array([squares.values(row) for row in chain.reshape(-1, m)])
    return Posterior(
        values, whole_walk.accepted / (steps * walkers), float(len(values) / np.max(times))
    )


class _Marginal:
    """The logarithm of the probability of readings, but for a constant, over best nuisances."""

    def __init__(self, squares: LeastSquares) -> None:
        self._squares = squares
        problem, m = squares.problem, len(squares.problem.parameters)
        self._student = problem.settings.loss == "student"
        self._low, self._high = squares.lower[m:], squares.upper[m:]
        self._free = not np.isfinite([self._low, self._high]).any()
        count = len(self._low)
        own = [(j - m, prior) for j, prior in squares.priors if j >= m]
        self._prior_rows, self._prior_values = np.zeros((len(own), count)), np.zeros(len(own))
        for row, (j, prior) in enumerate(own):
            self._prior_rows[row, j] = 1.0 / prior.sd
            self._prior_values[row] = prior.mean / prior.sd
        self._priors = [(j, prior) for j, prior in squares.priors if j < m]
        self._columns = squares.whitened(squares.nuisance_columns)
        # without weights that change it is the same for all samples
        ones = np.ones(squares.n)
        self._inverse = None if self._student or not self._free else self._inverted(ones)

    def __call__(self, values: FloatArray, readings: FloatArray) -> float:
        """Return it for values (m,) of the keys and the model's readings (n,)."""
        bare = self._squares.whitened(readings - self._squares.data)
        weights = np.ones(len(bare))
        noise, rest = bare, -self._prior_values
        for _ in range(_REWEIGHTED if self._student else 1):
            if not len(self._low):
                break
            nuisances, before = self._nuisances(bare, np.sqrt(weights)), noise
            noise = bare + self._columns @ nuisances
            rest = self._prior_rows @ nuisances - self._prior_values
            if np.abs(noise - before).max() < _SAME:
                break
            weights = (NU + 1.0) / (NU + noise * noise)
        square = noise @ noise
        if self._student:
            square = (NU + 1.0) * np.log1p(noise * noise / NU).sum()
        square += rest @ rest
        square += sum(((values[j] - prior.mean) / prior.sd) ** 2 for j, prior in self._priors)
        # priors are densities of values, those sought here of unknowns
        slopes = self._squares.slopes(values)
        return float(sum(np.log(slopes[j]) for j, _ in self._priors) - 0.5 * square)

    def _nuisances(self, bare: FloatArray, roots: FloatArray) -> FloatArray:
        right = np.concatenate([-roots * bare, self._prior_values])
        if self._free:
            inverse = self._inverted(roots) if self._inverse is None else self._inverse
            return inverse @ right
        columns, size = self._scaled(roots)
        limits = (self._low * size, self._high * size)
        nuisances: FloatArray = lsq_linear(columns, right, limits).x / size
        return nuisances

    def _inverted(self, roots: FloatArray) -> FloatArray:
        """Return what gives the best nuisances, none of those that do nothing."""
        columns, size = self._scaled(roots)
        inverse: FloatArray = np.linalg.pinv(columns, rcond=1e-12) / size[:, None]
        return inverse

    def _scaled(self, roots: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the columns of nuisances and priors with norm 1, and their norms."""
        columns = np.concatenate([roots[:, None] * self._columns, self._prior_rows])
        size = np.linalg.norm(columns, axis=0)
        size[size == 0.0] = 1.0
        return columns / size, size
