"""When readings to come tell enough, when a depth is reached, and whether readings fit in."""

from dataclasses import replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.stats import chi2, norm

from ringwear_par.arrays import BoolArray, FloatArray
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.identification.definition.problem import Problem, Series, body_of_wear
from ringwear_par.identification.scatter.likelihood import LinearisedTest, uncorrelated
from ringwear_par.identification.scatter.linearisation import projected_precision
from ringwear_par.monitoring.bank import Bank, rows_of
from ringwear_par.prediction.prediction import times_at

#: most readings of a record that are planned to the end, and times at which intervals are looked at
_PLANNED, _TIMES = 300, 60
#: over what readings say: nothing is known of a free nuisance before
_VAGUE = 1e-8
#: draws for the time to a depth, and their seed
_DRAWS, _SEED = 2000, 1


def times_of(problem: Problem) -> FloatArray:
    """Return the times (n,) s of all readings of a running test."""
    return np.concatenate([series.x for series in problem.experiments[0].series])


def surprise(
    bank: Bank, test: LinearisedTest, weights: FloatArray, old: BoolArray, new: BoolArray
) -> float:
    """Return how probable it is that new readings are so far from what old ones lead to expect.

    Parameters
    ----------
    weights : (draws,) by the old readings; old, new : (n,) which they are.
    """
    covariance = np.eye(len(test.readings))
    for size, kernel in zip(bank.sizes(weights), test.process, strict=True):
        covariance += size * kernel
    columns = test.nuisances
    known = test.prior_rows.T @ test.prior_rows + _VAGUE * np.diag(
        (columns**2).sum(axis=0) + _VAGUE
    )
    expected = np.linalg.solve(known, test.prior_rows.T @ test.prior_values)
    covariance += columns @ np.linalg.solve(known, columns.T)
    has_history = np.isfinite(bank.draws.coordinates).all(axis=1)
    coordinates, share = bank.draws.coordinates[has_history], weights[has_history]
    mean = share @ coordinates
    spread = (share[:, None] * (coordinates - mean)).T @ (coordinates - mean)
    rest = test.readings - test.jacobian @ mean - columns @ expected
    gain = cho_solve(
        cho_factor(covariance[np.ix_(old, old)], lower=True), covariance[np.ix_(old, new)]
    )
    jacobian = test.jacobian[new] - gain.T @ test.jacobian[old]
    variance = covariance[np.ix_(new, new)] - covariance[np.ix_(new, old)] @ gain
    variance += jacobian @ spread @ jacobian.T
    off = rest[new] - gain.T @ rest[old]
    return float(chi2.sf(off @ np.linalg.solve(variance, off), len(off)))


def widths(
    bank: Bank, problem: Problem, weights: FloatArray, key: int, level: float, now: float
) -> tuple[FloatArray, FloatArray]:
    """Return times from now to the end, s, and the relative half width of a key's interval there.

    Records go on at their rate; histories are linearised in the keys.

    Parameters
    ----------
    key : its number.
    now : s, of the last reading that counts.
    """
    (experiment,), end = problem.experiments, problem.experiments[0].case.time.end
    series = tuple(_to_end(record, end) for record in experiment.series)
    plan = replace(problem, experiments=(replace(experiment, series=series),))
    times = times_of(plan)
    order = np.argsort(times, kind="stable")
    test = rows_of(bank.linearised(plan)[0], order)
    slopes = _slopes(bank, weights)
    alone = uncorrelated(test, bank.sizes(weights))[0]
    rows, m = np.column_stack([alone.jacobian @ slopes, alone.nuisances]), slopes.shape[1]
    prior = np.zeros((rows.shape[1], rows.shape[1]))
    prior[:m, :m] = np.linalg.inv(bank.prior_covariance)
    prior[m:, m:] = test.prior_rows.T @ test.prior_rows
    at = np.linspace(now, end, _TIMES)
    sds = []
    for time in at:
        before = rows[: int(np.searchsorted(times[order], time, side="right"))]
        information = prior + before.T @ before
        sds.append(np.sqrt(np.linalg.pinv(information, hermitian=True)[key, key]))
    half = float(norm.ppf(0.5 + 0.5 * level)) * np.array(sds)
    if problem.parameters[key].log:
        return at, np.sinh(half)
    return at, half / abs(float(weights @ bank.draws.unknowns[:, key]))


def _to_end(series: Series, end: float) -> Series:
    """Return a record that goes on at its rate to the end of the test; what is read once stays."""
    if series.n < 2 or series.x[-1] >= end:
        return series
    apart = float(np.median(np.diff(series.x)))
    count = min(int(end / apart), _PLANNED)
    x = end * np.arange(1, count + 1) / max(count, 1)
    # fewer readings stand for all; those of correlated noise tell no more where they are many
    fewer = 1.0 if series.correlation_time else np.sqrt(apart / (end / max(count, 1)))
    return replace(
        series, x=x, value=np.zeros(count), sd=np.full(count, series.sd[-1] * fewer), lines=None
    )


def _slopes(bank: Bank, weights: FloatArray) -> FloatArray:
    """Return derivatives (modes, m) of the coordinates of histories with respect to unknowns."""
    has_history = np.isfinite(bank.draws.coordinates).all(axis=1) & (weights > 0.0)
    root = np.sqrt(weights[has_history])[:, None]
    unknowns = bank.draws.unknowns[has_history] - weights @ bank.draws.unknowns
    columns = np.column_stack([unknowns, np.ones(len(unknowns))])
    coordinates = bank.draws.coordinates[has_history]
    solution = np.linalg.lstsq(root * columns, root * coordinates, rcond=None)[0]
    slopes: FloatArray = solution[:-1].T
    return slopes


def time_to(
    bank: Bank, problem: Problem, weights: FloatArray, depth: float, counted: BoolArray
) -> FloatArray:
    """Return times (draws,) at which this specimen's penetration reaches a depth, mm; inf: later.

    Wear that is random goes on from what the readings tell of it.

    Parameters
    ----------
    counted : (n,) which of the readings do.
    """
    random, case = np.random.default_rng(_SEED), problem.experiments[0].case
    chosen = random.choice(len(weights), _DRAWS, p=weights)
    coordinates = bank.draws.coordinates[chosen]
    modes, time = bank.histories.modes(), bank.histories.time
    approach = modes.approach - modes.approach[0]
    depths = approach[:, 0] + coordinates @ approach[:, 1:].T
    if not problem.settings.process:
        return times_at(time, depths, depth)
    whole, misfit, x = bank.linearised(problem)
    test = rows_of(whole, counted)
    now = float(times_of(problem)[counted].max(initial=0.0))
    sizes = bank.sizes(weights)
    precision = projected_precision(test, sizes, np.zeros((coordinates.shape[1],) * 2))
    n = len(test.readings)
    rest = np.column_stack([np.tile(test.readings, (_DRAWS, 1)) - coordinates @ test.jacobian.T,
                            np.tile(test.prior_values, (_DRAWS, 1))])  # fmt: skip
    answers, worn = misfit.clocks(x)
    for number, (key, size) in enumerate(zip(problem.settings.process, sizes, strict=True)):
        body = BODIES.index(body_of_wear(key))
        mean_depth = (
            modes.volume[body, :, 0] + coordinates @ modes.volume[body, :, 1:].T
        ) / case.area
        across = np.zeros(n + len(test.prior_values))
        across[:n] = size * misfit.whitened(answers[:, number] * worn[:, number])[counted]
        at_now = np.array([np.interp(now, time, row) for row in mean_depth])
        excess = rest @ (precision @ across)
        variance = np.maximum(size * at_now - across @ precision @ across, 0.0)
        excess += np.sqrt(variance) * random.standard_normal(_DRAWS)
        increments = np.diff(
            np.maximum(mean_depth, at_now[:, None]), axis=1, prepend=at_now[:, None]
        )
        steps = np.sqrt(size * np.maximum(increments, 0.0)) * random.standard_normal(
            increments.shape
        )
        share = np.minimum(time / now, 1.0) if now > 0.0 else np.ones(len(time))
        depths = depths + share * excess[:, None] + np.cumsum(steps, axis=1)
    return times_at(time, depths, depth)
