"""Draws of a density by emcee, from draws of a nearby one; the integral of a density."""

from collections.abc import Callable
from functools import partial
from typing import Any

import emcee
import numpy as np
from scipy.stats import multivariate_t

from ringwear_par.arrays import FloatArray

#: walkers, for each dimension and most: many are in all parts of a density, where they hardly move
_A_DIMENSION, _WALKERS = 128, 1024
#: steps between two looks; between two states that are kept; most of all
_STEPS, _THIN, _MOST_STEPS = 50, 5, 6000
#: steps of a density that only leads to the next one
_LEADING = 40
#: share of the draws that must count for a density that is drawn from them
_COUNT = 0.25
#: most draws that are kept
_KEPT = 20_000
#: draws for an integral
_EVIDENCE_DRAWS = 8192


def _nearby(draws: FloatArray, seed: int) -> Any:
    """Return a t distribution, a little wider than draws (s, d)."""
    covariance = 1.4 * np.cov(draws.T).reshape(draws.shape[1], -1)
    return multivariate_t(draws.mean(axis=0), covariance, df=6, allow_singular=True, seed=seed)


class _Differences(emcee.moves.RedBlueMove):  # type: ignore[misc]
    """Moves by differences of other walkers, of changing length (ter Braak 2006)."""

    def get_proposal(
        self, s: FloatArray, c: list[FloatArray], random: np.random.RandomState
    ) -> tuple[FloatArray, FloatArray]:
        """Return where walkers (w, d) are to go, with the logs of factors (w,)."""
        others, (count, d) = np.concatenate(c), s.shape
        a, b = others[random.randint(len(others), size=(2, count))]
        length = 2.38 / np.sqrt(2.0 * d) * np.exp(0.3 * random.standard_normal((count, 1)))
        return s + length * (a - b), np.zeros(count)


def draw(
    log_p: Callable[..., FloatArray],
    draws: FloatArray,
    old: FloatArray,
    most: float,
    random: np.random.Generator,
    want: float = 0.0,
) -> tuple[FloatArray, FloatArray, float]:
    """Return draws (s, d) with the likelihood to a power, their log p, and their effective number.

    They come from draws of another density in steps, after each of which a quarter still counts.

    Parameters
    ----------
    log_p : of theta (s, d) and a power of the likelihood.
    old : (s,) log density of the draws where they come from.
    want : effective number that is wanted at the end; 0: they only lead to others.
    """
    power, effective = 0.0, 0.0
    while power < most:
        prior, full = log_p(draws, 0.0), log_p(draws, 1.0)
        good, counting = np.isfinite(full), -1.0
        for trial in power + (most - power) * 0.8 ** np.arange(100):
            logs = np.full(len(draws), -np.inf)
            logs[good] = (1.0 - trial) * prior[good] + trial * full[good] - old[good]
            w = np.exp(logs - logs.max())
            if (count := float(w.sum() ** 2 / (w @ w))) > counting:
                counting, power_of_most, weights = count, float(trial), w
            if count > _COUNT * len(draws):
                break
        power = power_of_most
        # each as often as its weight says, to one
        walkers = min(_A_DIMENSION * draws.shape[1], _WALKERS)
        places = (random.random() + np.arange(walkers)) / walkers
        chosen = np.searchsorted(np.cumsum(weights / weights.sum()), places)
        start = draws[np.minimum(chosen, len(draws) - 1)]
        at_power = partial(log_p, power=power)
        draws, old, effective = sample(at_power, start, random, want * (power >= most))
    return draws, old, effective


def sample(
    log_p: Callable[[FloatArray], FloatArray],
    start: FloatArray,
    random: np.random.Generator,
    want: float,
) -> tuple[FloatArray, FloatArray, float]:
    """Return draws (s, d) of a density, their log p, and how many independent ones they are worth.

    By independent moves to anywhere about the start, differential evolution (ter Braak 2006) and
    stretch moves (Goodman and Weare 2010). Walkers are side by side, one state after another.

    Parameters
    ----------
    start : (walkers, d) draws of about this density.
    want : effective number; 0: a few steps are enough.
    """
    (walkers, d), seed = start.shape, int(random.integers(2**31))
    nearby = _nearby(start, seed + 1)

    def anywhere(x: FloatArray, _: np.random.RandomState) -> tuple[FloatArray, FloatArray]:
        new = nearby.rvs(len(x)).reshape(x.shape)
        return new, nearby.logpdf(x) - nearby.logpdf(new)

    moves = [
        (emcee.moves.MHMove(anywhere), 0.4), (_Differences(), 0.45),
        (emcee.moves.StretchMove(), 0.15),
    ]  # fmt: skip
    sampler = emcee.EnsembleSampler(walkers, d, log_p, moves=moves, vectorize=True)
    sampler.random_state = np.random.RandomState(seed).get_state()
    state = emcee.State(start)
    steps = _STEPS if want else _LEADING
    while True:
        state = sampler.run_mcmc(state, steps, skip_initial_state_check=True)
        chain = sampler.get_chain()[_THIN - 1 :: _THIN]
        time = correlation_time(chain)
        first = min(int(2.0 * time), len(chain) // 2)
        effective = (len(chain) - first) * walkers / max(time, 1.0)
        if effective > want or not want or sampler.iteration >= _MOST_STEPS:
            break
    logs = sampler.get_log_prob()[_THIN - 1 :: _THIN]
    every = max(1, int(time / 4.0), (len(chain) - first) * walkers // _KEPT)
    draws = chain[first::every].reshape(-1, d)
    return draws, logs[first::every].reshape(-1), effective


def correlation_time(chain: FloatArray) -> float:
    """Return after how many states the walkers of a chain (states, walkers, d) forget theirs.

    The largest integrated autocorrelation time of all d (Sokal's window, as emcee has it).
    """
    n = len(chain)
    f = np.fft.rfft(chain - chain.mean(axis=(0, 1)), 2 * n, axis=0)
    by_lag = np.fft.irfft(np.square(np.abs(f)), axis=0)[:n].mean(axis=1)
    times = 2.0 * np.cumsum(by_lag / np.maximum(by_lag[0], 1e-300), axis=0) - 1.0
    beyond = np.arange(n)[:, None] > 5.0 * times
    window = np.where(beyond.any(axis=0), beyond.argmax(axis=0), n - 1)
    return float(times[window, np.arange(chain.shape[2])].max())


def log_evidence(
    log_p: Callable[[FloatArray], FloatArray], draws: FloatArray
) -> tuple[float, float]:
    """Return the log of the integral of a density and its error, from another about its draws."""
    density = _nearby(draws, 0)
    points = density.rvs(_EVIDENCE_DRAWS).reshape(-1, draws.shape[1])
    logs = log_p(points) - density.logpdf(points)
    weights = np.exp(logs - logs.max())
    error = weights.std() / weights.mean() / np.sqrt(len(weights))
    return float(logs.max() + np.log(weights.mean())), float(error)
