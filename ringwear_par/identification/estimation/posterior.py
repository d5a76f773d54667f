"""The likelihood of all readings at values of the fitted keys, and samples of their posterior.

Samples are drawn by an ensemble of walkers (emcee: Foreman-Mackey et al., Publ. Astron. Soc. Pac.
125 (2013) 306-312; moves of differential evolution), whose histories step side by side. Before any
reading a key has the distribution of its prior within its bounds; one without a prior is uniform
there, or its logarithm where the scale is logarithmic. Nuisances are those that fit each sample
best: as they are linear, that is the same as integrating over them where noise is Gaussian and they
have no bounds. Noise that is fitted stays what it is at the optimum: that it is not known better
adds nothing to the spread of the samples.
"""

import logging
import time
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.files.writing import atomic_write
from ringwear_par.identification.definition.problem import reflected
from ringwear_par.identification.estimation.misfit import Misfit
from ringwear_par.identification.model.noise import (
    NuisanceProjection,
    bounded_solution,
    prior_rows,
    student_loss,
    student_weights,
)
from ringwear_par.identification.model.rounds import Rounds, StoppedError

#: rounds of reweighting where the loss is not Gaussian
_REWEIGHTED = 20
#: change of residuals, over their noise, at which reweighting ends
_SAME = 1e-4
log = logging.getLogger(__name__)

#: most walkers, steps that they make at least, and the seed of all
_WALKERS, _STEPS, _SEED = 128, 16, 0
#: steps that are thrown away: walkers start from the covariance, or from the bounds where that is
#: wider
_BURN = 12
#: how often the way to the optimum is halved where a walker's start is no case
_NEARER = 40
#: s between two times that the chain is stored
STORE_SECONDS = 10.0
#: effective samples below which quantiles mean little
_FEW = 200.0


class MarginalLikelihood:
    """The logarithm of the probability of readings, but for a constant.

    Thermal growth is linearised at unknowns x (u,).
    """

    def __init__(self, misfit: Misfit, x: FloatArray) -> None:
        self._misfit = misfit
        problem, m = misfit.problem, len(misfit.problem.parameters)
        self._student = problem.settings.loss == "student"
        self._low, self._high = misfit.lower[m:], misfit.upper[m:]
        nuisance_priors = [(j - m, prior) for j, prior in misfit.priors if j >= m]
        self._prior_rows, self._prior_values = prior_rows(nuisance_priors, len(self._low))
        self._priors = [(j, prior) for j, prior in misfit.priors if j < m]
        columns = misfit.nuisance_derivatives(x)
        self._data = misfit.data - (misfit.nuisance_readings(x) - columns @ x[m:])
        self._columns = misfit.whitened(columns)
        self._projection: NuisanceProjection | None = None
        if not self._student and np.isinf([self._low, self._high]).all():
            # without bounds, or weights that change, it is the same for all samples
            stacked = np.concatenate([self._columns, self._prior_rows])
            self._projection = NuisanceProjection(stacked)

    def __call__(self, values: FloatArray, readings: FloatArray) -> float:
        """Return that logarithm at values (m,) of the keys and readings (n,) of the model."""
        unadjusted = self._misfit.whitened(readings - self._data)
        weights = np.ones(len(unadjusted))
        noise, rest = unadjusted, -self._prior_values
        for _ in range(_REWEIGHTED if self._student else 1):
            if not len(self._low):
                break
            nuisances, before = self._nuisances(unadjusted, np.sqrt(weights)), noise
            noise = unadjusted + self._columns @ nuisances
            rest = self._prior_rows @ nuisances - self._prior_values
            if np.abs(noise - before).max() < _SAME:
                break
            weights = student_weights(noise)
        square = noise @ noise
        if self._student:
            square = student_loss(noise).sum()
        square += rest @ rest
        square += sum(((values[j] - prior.mean) / prior.sd) ** 2 for j, prior in self._priors)
        # priors are densities of values, and here densities of unknowns are needed
        slopes = self._misfit.problem.slopes(values)
        return float(sum(np.log(slopes[j]) for j, _ in self._priors) - 0.5 * square)

    def _nuisances(self, unadjusted: FloatArray, roots: FloatArray) -> FloatArray:
        right = np.concatenate([-roots * unadjusted, self._prior_values])
        if self._projection is not None:
            return self._projection.solution(right)
        columns = np.concatenate([roots[:, None] * self._columns, self._prior_rows])
        return bounded_solution(columns, right, self._low, self._high)


@dataclass(frozen=True, eq=False)
class Posterior:
    """Samples of the fitted keys."""

    #: (s, m) values.
    samples: FloatArray
    #: of the walkers' moves.
    acceptance: float
    #: how many independent samples they are worth, by the slowest key.
    effective: float

    @property
    def few(self) -> bool:
        """Whether the samples are worth too few for their quantiles to mean much."""
        return self.effective < _FEW

    def interval(self, level: float) -> FloatArray:
        """Return (2, m) ends of the central intervals."""
        return np.quantile(self.samples, [0.5 - 0.5 * level, 0.5 + 0.5 * level], axis=0)


def sample_posterior(
    misfit: Misfit,
    histories: Rounds,
    x: FloatArray,
    covariance: FloatArray,
    path: Path | None,
) -> Posterior:
    """Return samples of the fitted keys, from the optimum x and its covariance on. Not collective.

    The chain is stored in the file, and continues where it was stopped by a signal (StoppedError).
    """
    import emcee

    settings, m = misfit.problem.settings, len(misfit.problem.parameters)
    low, high = misfit.lower[:m], misfit.upper[:m]
    marginal = MarginalLikelihood(misfit, x)

    def log_probability(points: FloatArray) -> FloatArray:
        """Return log probabilities (w,) of unknowns (w, m)."""
        scores = np.full(len(points), -np.inf)
        inside = np.flatnonzero(((points >= low) & (points <= high)).all(axis=1))
        values = np.array([misfit.values(point) for point in points[inside]]).reshape(-1, m)
        responses = histories.responses(values, misfit.responses.steps, derivatives=False)
        for i, value, readings in zip(inside, values, responses, strict=True):
            if not isinstance(readings, Exception):
                scores[i] = marginal(value, readings[:, 0])
        return scores

    walkers = max(min(_WALKERS, 2 * (settings.samples // (2 * _STEPS))), 16, 4 * m)
    steps = _BURN + -(-settings.samples // walkers)
    moves = [(emcee.moves.DEMove(), 0.8), (emcee.moves.DESnookerMove(), 0.2)]
    key = misfit.problem.key
    backend, stored_histories = _stored_chain(path, key, (walkers, m))
    sampler = emcee.EnsembleSampler(
        walkers, m, log_probability, moves=moves, vectorize=True, backend=backend
    )
    sampler.log_prob_fn = log_probability  # what emcee wraps it in prints all of its errors
    count_before = histories.count
    histories.count += stored_histories
    before = sampler.iteration
    if before:
        start = sampler.get_last_sample()
    else:
        sampler.random_state = np.random.RandomState(_SEED).get_state()
        start = _start(misfit, x, covariance, walkers)
    stored_at = time.perf_counter()
    walk = sampler.sample(start, iterations=steps - before, skip_initial_state_check=True)
    try:
        for step, _ in enumerate(walk, before + 1):
            histories.tell(f"posterior: {step} of {steps} steps of {walkers} walkers")
            if time.perf_counter() - stored_at > STORE_SECONDS:
                _store_chain(path, key, backend, histories.count - count_before)
                stored_at = time.perf_counter()
    except StoppedError:
        _store_chain(path, key, backend, histories.count - count_before)
        raise
    chain = sampler.get_chain(discard=_BURN)
    # means over walkers scatter by the correlation time of their steps
    scatter, whole = chain.mean(axis=0).var(axis=0, ddof=1), chain.reshape(-1, m).var(axis=0)
    times = np.maximum(len(chain) * scatter / np.where(whole > 0.0, whole, 1.0), 1.0)
    values = np.array([misfit.values(row) for row in chain.reshape(-1, m)])
    accepted = int(sampler.backend.accepted.sum())
    return Posterior(values, accepted / (steps * walkers), float(len(values) / np.max(times)))


def _start(misfit: Misfit, x: FloatArray, covariance: FloatArray, walkers: int) -> FloatArray:
    """Return unknowns (walkers, m) around the optimum, all of them cases by the laws' rules."""
    m = len(misfit.problem.parameters)
    low, high = misfit.lower[:m], misfit.upper[:m]
    spread = np.sqrt(np.minimum(np.diag(covariance)[:m], ((high - low) / 4.0) ** 2))
    known = np.isfinite(covariance[:m, :m]).all()
    root = np.linalg.cholesky(covariance[:m, :m] + 1e-12 * np.diag(spread**2)) if known else None
    drawn = np.random.default_rng(_SEED).standard_normal((walkers, m))
    shifts = drawn * spread if root is None else drawn @ root.T
    wide = np.abs(shifts) > high - low
    start = reflected(x[:m] + np.where(wide, drawn * spread, shifts), low, high)
    for _ in range(_NEARER):  # towards the optimum, which is a case
        out = ~misfit.responses.allowed(start)
        start[out] = 0.5 * (start[out] + x[:m])
    return start


def _stored_chain(path: Path | None, key: str, shape: tuple[int, int]) -> tuple[Any, int]:
    """Return emcee's store, with the chain in a file if that is of this problem, and histories."""
    import emcee

    backend = emcee.backends.Backend()
    backend.reset(*shape)
    if path is None:
        return backend, 0
    try:
        with np.load(path) as file:
            chain = file["chain"]
            if str(file["key"]) != key or chain.shape[1:] != shape or not len(chain):
                return backend, 0
            state = ("MT19937", file["random"], *file["place"].tolist(), float(file["gauss"]))
            np.random.RandomState().set_state(state)  # refuses a damaged one
            stored = {name: file[name] for name in ("log_prob", "accepted")}
            histories = int(file["histories"])
    except (OSError, ValueError, TypeError, KeyError, EOFError, zipfile.BadZipFile):
        return backend, 0
    backend.chain, backend.random_state, backend.iteration = chain, state, len(chain)
    backend.log_prob, backend.accepted = stored["log_prob"], stored["accepted"]
    return backend, histories


def _store_chain(path: Path | None, key: str, backend: Any, histories: int) -> None:
    """Store a chain; a full disk only costs the restart."""
    if path is None or not backend.iteration:
        return
    done = slice(backend.iteration)
    _, random, place, has_gauss, gauss = backend.random_state
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_write(path) as temporary, temporary.open("wb") as file:
            np.savez(
                file, key=key, chain=backend.chain[done], log_prob=backend.log_prob[done],
                accepted=backend.accepted, histories=histories, random=random,
                place=[place, has_gauss], gauss=gauss,
            )  # fmt: skip
    except OSError as error:
        log.warning("%s: cannot be written: %s", path, error.strerror or error)
