#!/usr/bin/env python
"""Compare what ``ringwear follow`` says of a specimen with an ensemble sampler's posterior.

    python scripts/follow_check.py FIT.toml [--steps 6000]    # needs emcee; a minute

The last test of the fit file is followed after a fit of the others, in one go. Beside it emcee
samples two posteriors, with a dense covariance of all readings of a test that is written here anew:
that of the last specimen, with what the fit of the others knows as its prior, which is what a bank
is to tell; and the joint one of the whole fit file, of the material's keys, the sizes of scatter
and random wear with their priors, and each specimen's values. Nothing is linearised in that: it
also differs where the fit's own linear model of the keys does. For fit files with "fit" scatter
of one key or process of one body, white noise, and nuisances offset and drift.
"""

import argparse
import json
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import emcee
import numpy as np
from mpi4py import MPI
from scipy.special import logsumexp

import ringwear_par as rw
from ringwear_par.arrays import FloatArray
from ringwear_par.identification.definition.fit_file import read_fit
from ringwear_par.identification.definition.problem import Problem
from ringwear_par.identification.fit import fit_problem
from ringwear_par.identification.fitted_values import fitted_values
from ringwear_par.identification.model.readings import Reader
from ringwear_par.identification.model.rounds import Rounds
from ringwear_par.monitoring.follow import run_follow
from ringwear_par.monitoring.histories import SpecimenHistories, planned
from ringwear_par.prediction.draws import NEXT, log_densities
from ringwear_par.results.execution.stop_signals import StopSignals

#: draws of keys about a fit's material, in its sd, that histories are interpolated between
DRAWS, REACH = 2000, 3.5
#: variance of a nuisance of which nothing is known, in units of the data
FREE = 1e4
WALKERS, SEED = 64, 0


class DenseTest:
    """The log likelihood of a test's readings at unknowns of its keys."""

    def __init__(self, problem: Problem, number: int, unknowns: FloatArray) -> None:
        test = problem.experiments[number]
        one = replace(problem, experiments=(test,))
        with StopSignals() as signals:
            plan = replace(one, experiments=(planned(test),))
            self.histories = SpecimenHistories(one, Rounds(plan, MPI.COMM_SELF, signals))
            self.histories.prepare(unknowns)
        assert self.histories.error is not None
        modes, reader = self.histories.modes(), Reader(test)
        self.modes = reader.read(modes)
        area = test.case.area
        wear = replace(modes, approach=modes.volume[0] / area)
        depth = [replace(s, quantity="approach") for s in test.series]
        self.depths = Reader(replace(test, series=tuple(depth))).read(wear)
        self.data = np.concatenate([s.value for s in test.series])
        self.noise = np.diag(np.concatenate([s.sd for s in test.series]) ** 2)
        first = 0
        for s in test.series:
            rows = slice(first, first + s.n)
            for nuisance in s.nuisances:
                column = np.zeros(len(self.data))
                column[rows] = {"offset": np.ones(s.n), "drift": s.x / test.case.time.end}[
                    nuisance.kind
                ]
                sd = FREE if nuisance.prior is None else nuisance.prior.sd
                self.noise += (s.factor * sd) ** 2 * np.outer(column, column)
            first = rows.stop

    def of(self, modes: FloatArray, unknowns: FloatArray) -> FloatArray:
        """Return readings of modes (n, 1 + r) are at unknowns (p, m), (p, n)."""
        return modes[:, 0] + self.histories.coordinates(unknowns) @ modes[:, 1:].T

    def __call__(self, unknowns: FloatArray, sizes: FloatArray) -> FloatArray:
        """Return it (p,) for unknowns (p, m) and sizes (p,) of random wear, mm; -inf far away."""
        rest = self.of(self.modes, unknowns) - self.data
        logs = np.full(len(rest), -np.inf)
        known = np.flatnonzero(np.isfinite(rest).all(axis=1))
        if not sizes.any():
            inverse = np.linalg.inv(self.noise)
            logs[known] = -0.5 * np.einsum("pi,ij,pj->p", rest[known], inverse, rest[known])
            return logs
        step = np.eye(unknowns.shape[1])[0] * 1e-3  # the first key is a wear rate's logarithm
        slope = self.of(self.modes, unknowns + step) - self.of(self.modes, unknowns - step)
        slope /= 2e-3
        depth = self.of(self.depths, unknowns)
        for p in known[np.isfinite(slope[known]).all(axis=1)]:
            answer = slope[p] / depth[p]
            kernel = np.outer(answer, answer) * np.minimum.outer(depth[p], depth[p])
            factor = np.linalg.cholesky(self.noise + sizes[p] * kernel)
            white = np.linalg.solve(factor, rest[p])
            logs[p] = -0.5 * white @ white - np.log(np.diag(factor)).sum()
        return logs


def half_t(size: FloatArray, scale: float) -> FloatArray:
    """Return the log density of a size, 4 degrees of freedom, and of its logarithm."""
    return -2.5 * np.log1p((size / scale) ** 2 / 4.0) + np.log(size)


def main() -> None:
    """Follow the last test of a fit file, and sample the posterior of all."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("fit", type=Path)
    parser.add_argument("--steps", type=int, default=6000)
    parser.add_argument("--given", action="store_true", help="sample the first posterior only")
    arguments = parser.parse_args()
    problem, rng = read_fit(arguments.fit), np.random.default_rng(SEED)
    with tempfile.TemporaryDirectory() as folder:
        run_follow(arguments.fit, Path(folder) / "follow", MPI.COMM_SELF, once=True)
        followed = json.loads((Path(folder) / "follow" / "follow.json").read_text())
    fit = rw.fit(arguments.fit)
    m, tests = len(problem.keys), len(problem.experiments)
    scattering = [j for j, p in enumerate(problem.parameters) if p.scatter is not None]
    low, high = problem.unknown_bounds
    sd = np.sqrt(np.diag(fit.covariance)[:m])
    for key in scattering:
        sd[key] = max(sd[key], 0.25)
    about = fit.x[:m] + sd * rng.uniform(-REACH, REACH, (DRAWS, m))
    dense = [DenseTest(problem, i, np.clip(about, low, high)) for i in range(tests)]
    scatters = bool(scattering)
    deepest = 0.0 if fit.material is None or scatters else float(fit.material.wear.depths[0])

    def report(chain: FloatArray, worth: float) -> None:
        for j, key in enumerate(problem.keys):
            values = np.array([problem.parameters[j].value(u) for u in chain[:, j]])
            of, spread = followed["keys"][key], values.std()
            ends = np.quantile(values, (0.025, 0.5, 0.975))
            theirs = (of["interval"][0], of["estimate"], of["interval"][1])
            print(f"{key}: sd {spread:.4g}; emcee is worth {worth:.0f} draws, the bank "
                  f"{followed['effective_count']:.0f}")  # fmt: skip
            for name, one, other in zip(
                ("low end", "median", "high end"), ends, theirs, strict=True
            ):
                off = (other - one) / spread
                print(f"  {name}: emcee {one:.4g}, follow {other:.4g} ({off:+.3f} sd)")

    def sampled(
        log_probability: Callable[[FloatArray], FloatArray], start: FloatArray
    ) -> tuple[FloatArray, float]:
        moves = [(emcee.moves.DEMove(), 0.8), (emcee.moves.DESnookerMove(), 0.2)]
        shape = (WALKERS, start.shape[1])
        sampler = emcee.EnsembleSampler(*shape, log_probability, moves=moves, vectorize=True)
        sampler.random_state = np.random.RandomState(SEED).get_state()
        sampler.run_mcmc(start, arguments.steps, skip_initial_state_check=True)
        past = arguments.steps // 5
        times = sampler.get_autocorr_time(discard=past, quiet=True)
        chain = sampler.get_chain(discard=past, flat=True)
        return chain, len(chain) / float(times.max())

    rest = replace(problem, experiments=problem.experiments[:-1])
    values = fitted_values(fit_problem(rest, MPI.COMM_SELF))
    parts, place = np.arange(len(values.weights)), problem.experiments[-1].groups[0]
    of = place if place in values.specimens else NEXT
    wearing = values.sizes.max(axis=1)
    by_size = [parts[wearing == size] for size in np.unique(wearing)]

    def given_fit(points: FloatArray) -> FloatArray:
        inside = ((points >= low) & (points <= high)).all(axis=1)
        prior, logs = log_densities(values, of, points), []
        for some in by_size:
            size = np.full(len(points), wearing[some[0]])
            logs.append(logsumexp(prior[:, some], axis=1) + dense[-1](points, size))
        total = logsumexp(np.array(logs), axis=0)
        return np.where(inside & np.isfinite(total), total, -np.inf)

    begin = np.clip(fit.x[:m] + 0.1 * sd * rng.standard_normal((WALKERS, m)), low, high)
    print("given the fit of the other tests")
    report(*sampled(given_fit, begin))
    if arguments.given:
        return

    def split(points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        keys, size = points[:, :m], np.exp(points[:, m])
        return keys, size, points[:, m + 1 :]

    def log_probability(points: FloatArray) -> FloatArray:
        keys, size, deviations = split(points)
        inside = ((keys >= low) & (keys <= high)).all(axis=1) & (size < 5.0)
        logs = half_t(size, 0.3 if scatters else 0.1) - 0.5 * (deviations**2).sum(axis=1)
        for i in range(tests):
            at = keys.copy()
            if scatters:
                at[:, scattering[0]] += size * deviations[:, i]
            logs = logs + dense[i](at, size**2 * deepest)
        return np.where(inside & np.isfinite(logs), logs, -np.inf)

    dimension = m + 1 + tests * scatters
    start = np.zeros((WALKERS, dimension))
    start[:, :m] = np.clip(fit.x[:m] + 0.1 * sd * rng.standard_normal((WALKERS, m)), low, high)
    start[:, m] = np.log(0.15 if scatters else 0.05) + 0.1 * rng.standard_normal(WALKERS)
    if scatters:
        key = scattering[0]
        own = fit.material.test_unknowns[:, key][None] - start[:, [key]]
        start[:, m + 1 :] = own / np.exp(start[:, [m]])
    chain, worth = sampled(log_probability, start)
    keys, size, deviations = split(chain)
    if scatters:
        keys = keys.copy()
        keys[:, scattering[0]] += size * deviations[:, -1]
    print("of all tests together")
    report(keys, worth)


if __name__ == "__main__":
    main()
