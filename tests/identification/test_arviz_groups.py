"""Fits as ArviZ has them, and their evidence: against a covariance that is written here anew."""

import numpy as np
import pytest
from laboratory import CASE, END, TRUTH, fit_tables, history, one_test, penetration, record
from mpi4py import MPI
from scipy.optimize import minimize_scalar
from scipy.special import logsumexp
from scipy.stats import multivariate_normal
from scipy.stats import t as student_t

import ringwear_par as rw
from ringwear_par.identification.summary import probabilities

KEY = "wear.lower.k"
#: s, of the noise; variance of a nuisance that is free, in mm^2
CORRELATION, FREE = 3.0, 1.0


@pytest.fixture(scope="module")
def fit(tmp_path_factory):
    """A fit with scatter, random wear, correlated noise, a free offset and a drift with a prior."""
    folder, rng, experiments = tmp_path_factory.mktemp("fit"), np.random.default_rng(5), []
    for number, factor in enumerate((0.85, 1.0, 1.2), start=1):
        result = history((45.0, 80.0)[number % 2], {**TRUTH, KEY: TRUTH[KEY] * factor})
        t, z = penetration(result, rng, np.linspace(4.0, END, 25))
        nuisance = {"offset": {}, "drift": {"prior": {"normal": [0.1, 0.5]}}}
        data = record(folder / f"z{number}.csv", t, z, correlation_time=CORRELATION,
                      nuisance=nuisance)  # fmt: skip
        experiments.append(one_test(f"test {number}", (45.0, 80.0)[number % 2], data))
    (folder / "case.toml").write_text(CASE)
    tables = fit_tables(folder, experiments)
    tables["fit"]["parameters"] = {KEY: {**tables["fit"]["parameters"][KEY], "scatter": "fit"}}
    tables["fit"]["process"] = {"wear.lower": {"share": 0.03}}
    return rw.fit(tables, MPI.COMM_SELF)


def dense(fit, number, size):
    """Return the covariance of a test's readings, all in it, their mean, and its slope."""
    misfit = fit.misfit
    record, m = misfit.records[number], len(fit.parameters)
    t, s = record.series.x, record.series
    answers, depths = (v[record.rows, 0] for v in misfit.clocks(fit.x, fit.material.test_unknowns))
    covariance = s.sd[0] ** 2 * np.exp(-np.abs(np.subtract.outer(t, t)) / CORRELATION)
    covariance += FREE + (s.factor * 0.5) ** 2 * np.outer(t, t) / END**2
    covariance += size * np.outer(answers, answers) * np.minimum.outer(depths, depths)
    mean = fit.evaluation.model[record.rows] - misfit.nuisance_readings(fit.x)[record.rows]
    random_part = answers * fit.material.best_fit.excess[record.rows, 0]
    slope = misfit.columns(fit.x, fit.material.test_unknowns)[record.rows, :m]
    return covariance, mean - random_part + s.factor * 0.1 * t / END, slope


@pytest.mark.filterwarnings("ignore")
def test_log_likelihoods_are_those_of_a_dense_covariance(fit):
    arviz = pytest.importorskip("arviz")
    data, number = fit.to_arviz(), 1
    keys, taus, sizes = (
        data.posterior[name][0].values
        for name in (KEY, f"scatter of {KEY} between specimens", "process.wear.lower")
    )
    covariance, mean, slope = dense(fit, number, float(sizes[0]))
    assert sizes[1] == sizes[0]
    rows = fit.misfit.records[number].rows
    rest = fit.misfit.data[rows] - mean
    gains, variances = np.eye(len(rest)), np.diag(covariance).copy()
    for i in range(len(rest)):  # what the other readings say of one
        others = np.arange(len(rest)) != i
        gains[i, others] = -np.linalg.solve(covariance[np.ix_(others, others)],
                                            covariance[others, i])  # fmt: skip
        variances[i] += gains[i, others] @ covariance[others, i]

    def of_readings(shift):
        off = gains @ (rest - slope[:, 0] * shift)
        return -0.5 * (np.log(2 * np.pi * variances) + off**2 / variances)

    def distance(shift):
        return ((of_readings(shift) - found) ** 2).sum()

    # the test's own k of this draw is the one that explains all of them
    found = data.log_likelihood.reading[0, 0, rows].values
    shifts = np.linspace(-4.0, 4.0, 801)
    at = shifts[np.argmin([distance(shift) for shift in shifts])]
    shift = minimize_scalar(distance, bounds=(at - 0.01, at + 0.01), method="bounded").x
    assert of_readings(shift) == pytest.approx(found, abs=1e-3)
    # a test's own k integrated: differences between draws, as a free nuisance has no density
    marginals = []
    for k, tau in zip(np.log(keys[:2]), taus, strict=False):
        spread = covariance + tau**2 * np.outer(slope[:, 0], slope[:, 0])
        off = rest - slope[:, 0] * (k - fit.material.test_unknowns[number, 0])
        marginals.append(multivariate_normal.logpdf(off, cov=spread))
    values = data["log_likelihood_test"].test[0, :2, number]
    assert float(values[1] - values[0]) == pytest.approx(marginals[1] - marginals[0], abs=1e-3)
    assert np.isfinite(arviz.loo(data).elpd_loo)
    replicas = data.posterior_predictive.reading[0] - fit.misfit.data
    assert np.abs(replicas.mean("draw")).max() < 1e-3  # mm
    assert data.posterior.attrs["of_draws"].startswith("mixture")


def test_the_evidence_is_the_integral_of_the_likelihood(fit):
    """Over k, its scatter and the offsets, on a grid; by Laplace where k and offsets are linear."""
    (parameter,), tests = fit.misfit.problem.parameters, range(3)
    low, high = np.log(parameter.bounds)
    keys = fit.x[0] + np.linspace(-1.5, 1.5, 301)
    taus = np.geomspace(2e-3, 5.0, 120)
    size = float(fit.material.sizes_of_process[0])
    logs = np.zeros((len(taus), len(keys)))
    for number in tests:
        covariance, mean, slope = dense(fit, number, size)
        rest = fit.misfit.data[fit.misfit.records[number].rows] - mean
        off = rest - (keys - fit.material.test_unknowns[number, 0])[:, None] * slope[:, 0]
        for i, tau in enumerate(taus):
            spread = covariance + tau**2 * np.outer(slope[:, 0], slope[:, 0])
            logs[i] += multivariate_normal.logpdf(off, cov=spread)
    prior = 2.0 * student_t.pdf(taus / 0.3, 4.0) / 0.3 * taus * np.log(taus[1] / taus[0])
    logs += np.log(prior)[:, None] + np.log((keys[1] - keys[0]) / (high - low))
    # offsets have a density of 1 a um here, drifts one without its factor
    of_offsets = 3 * np.log(np.sqrt(2.0 * np.pi * FREE) / 1e-3)
    of_nuisances = 1.5 * np.log(2.0 * np.pi) - 3 * np.log(0.5)
    assert fit.to_dict()["log_evidence"] == pytest.approx(
        logsumexp(logs) + of_offsets - of_nuisances, abs=0.05
    )
    assert probabilities({"a": 0.0, "b": np.log(3.0)}) == pytest.approx({"a": 0.25, "b": 0.75})
    assert probabilities({"a": -np.inf, "b": -np.inf, "c": None}) == {}
