"""Scatter between specimens: against dense likelihoods, limits, and its coverage."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from ringwear_par.identification.scatter.likelihood import (
    Level,
    Limits,
    LinearisedTest,
    MixedModel,
    ReducedTest,
    of_new_specimen,
    reduce_test,
)
from ringwear_par.identification.scatter.posterior import Mixture, Size, integrate


def reduced(jacobian, z):
    """A test whose readings have unit noise and no nuisances."""
    return ReducedTest(jacobian.T @ jacobian, jacobian.T @ z, float(z @ z), 0.0)


def laboratory(seed=3, count=5, readings=7, unknowns=2):
    rng = np.random.default_rng(seed)
    jacobians = rng.standard_normal((count, readings, unknowns))
    return jacobians, rng.standard_normal((count, readings)) * 3.0


def test_likelihoods_are_those_of_the_dense_covariance():
    jacobians, z = laboratory()
    specimen = Level(0, "specimen", np.arange(5))
    batch = Level(1, "batch", np.array([0, 0, 1, 1, 1]))
    precision, mean = np.array([0.0, 0.5]), np.array([0.0, 1.5])
    tests = [reduced(j, y) for j, y in zip(jacobians, z, strict=True)]
    tau = np.array([[0.3, 0.7], [0.0, 0.2], [2.0, 0.0]])
    solved = MixedModel(tests, [specimen, batch], precision, mean).solve(tau)

    x, y = jacobians.reshape(-1, 2), z.ravel()
    number = np.repeat(np.arange(5), 7)
    for i, (first, second) in enumerate(tau):
        same = number[:, None] == number
        together = batch.group[number][:, None] == batch.group[number]
        covariance = (
            np.eye(35)
            + first**2 * same * np.outer(x[:, 0], x[:, 0])
            + second**2 * together * np.outer(x[:, 1], x[:, 1])
        )
        inverse = np.linalg.inv(covariance)
        normal = x.T @ inverse @ x + np.diag(precision)
        beta = np.linalg.solve(normal, x.T @ inverse @ y + precision * mean)
        rest = y - x @ beta
        square = rest @ inverse @ rest + precision @ (beta - mean) ** 2
        marginal = square + np.linalg.slogdet(covariance)[1]
        assert solved.effects[i, :2] == pytest.approx(beta, rel=1e-10)
        assert solved.covariance[i, :2, :2] == pytest.approx(np.linalg.inv(normal), rel=1e-10)
        assert solved.marginal[i] == pytest.approx(marginal, rel=1e-12)
        restricted = marginal + np.linalg.slogdet(normal)[1]
        assert solved.restricted[i] == pytest.approx(restricted, rel=1e-12)


@pytest.mark.parametrize("bodies", [0, 1, 2])
def test_reduced_tests_are_those_of_the_dense_covariance(bodies):
    """Noise, one free nuisance, one with a prior, and wear's own noise at three sizes."""
    rng = np.random.default_rng(8)
    n, sd, prior_mean, prior_sd = 12, 0.3, 0.4, 2.0
    jacobian, z = rng.standard_normal((n, 2)), rng.standard_normal(n)
    free, known = np.ones(n), np.linspace(0.0, 1.0, n)
    depth, answers = np.linspace(0.1, 1.0, n), rng.uniform(0.5, 1.5, (bodies, n))
    kernels = [np.outer(g, g) * np.minimum.outer(depth, depth) for g in answers]
    test = LinearisedTest(
        z / sd,
        jacobian / sd,
        np.column_stack([free, known]) / sd,
        np.array([[0.0, 1.0 / prior_sd]]),
        np.array([prior_mean / prior_sd]),
        2.0 * n * np.log(sd),
        tuple(one / sd**2 for one in kernels),
    )
    sizes = np.array([[0.04, 0.3], [0.0, 0.3], [0.5, 0.0]])[: 3 if bodies else 1, :bodies]
    for size, found in zip(sizes, reduce_test(test, sizes), strict=True):
        covariance = sd**2 * np.eye(n) + prior_sd**2 * np.outer(known, known)
        covariance += sum((s * one for s, one in zip(size, kernels, strict=True)), np.zeros((n, n)))
        inverse = np.linalg.inv(covariance)
        across = free @ inverse @ free
        projected = inverse - np.outer(inverse @ free, free @ inverse) / across
        y = z - prior_mean * known
        assert found.information == pytest.approx(jacobian.T @ projected @ jacobian, rel=1e-10)
        assert found.score == pytest.approx(jacobian.T @ projected @ y, rel=1e-9)
        assert found.square == pytest.approx(y @ projected @ y, rel=1e-9)
        volume = np.linalg.slogdet(covariance)[1] + np.log(across) - 2.0 * np.log(prior_sd)
        assert found.log_volume + found.log_nuisances == pytest.approx(volume, rel=1e-10)


def test_nuisances_that_do_the_same_count_once():
    z, jacobian = np.array([1.0, 2.0, 4.0, 3.0]), np.array([[0.0], [1.0], [2.0], [5.0]])
    none = np.zeros((0, 2))
    once = LinearisedTest(z, jacobian, np.ones((4, 1)), none[:, :1], np.zeros(0), 0.0)
    twice = LinearisedTest(z, jacobian, np.ones((4, 2)), none, np.zeros(0), 0.0)
    assert reduce_test(twice)[0].information == pytest.approx(reduce_test(once)[0].information)


def test_information_of_new_specimens_adds():
    jacobians, z = laboratory()
    tests = [reduced(j, y) for j, y in zip(jacobians, z, strict=True)]
    model = MixedModel(tests, [Level(1, "specimen", np.arange(5))], np.zeros(2), np.zeros(2))
    covariance = model.solve(np.array([[0.4]])).covariance[0, :2, :2]
    variances = np.array([0.0, 0.4**2])
    added = sum(of_new_specimen(test.information, variances) for test in tests)
    assert added == pytest.approx(np.linalg.inv(covariance), rel=1e-10)


def test_without_scatter_it_is_the_common_fit():
    jacobians, z = laboratory()
    tests = [reduced(j, y) for j, y in zip(jacobians, z, strict=True)]
    model = MixedModel(tests, [Level(0, "specimen", np.arange(5))], np.zeros(2), np.zeros(2))
    posterior = integrate(lambda _: [model], [Size(0.0, 0.3)])
    common = np.linalg.lstsq(jacobians.reshape(-1, 2), z.ravel(), rcond=None)[0]
    assert posterior.unknown(0).mean == pytest.approx(common[0], rel=1e-10)
    assert posterior.unknown(0, 2).mean == pytest.approx(common[0], rel=1e-10)


def test_large_scatter_leaves_each_test_its_own_value():
    jacobians, z = laboratory(unknowns=1)
    tests = [reduced(j, y) for j, y in zip(jacobians, z, strict=True)]
    model = MixedModel(tests, [Level(0, "specimen", np.arange(5))], np.zeros(1), np.zeros(1))
    posterior = integrate(lambda _: [model], [Size(1e3, 0.3)])
    alone = [np.linalg.lstsq(j, y, rcond=None)[0][0] for j, y in zip(jacobians, z, strict=True)]
    each = [posterior.unknown(0, i).mean for i in range(5)]
    assert each == pytest.approx(alone, rel=1e-6)
    assert posterior.unknown(0).mean == pytest.approx(np.mean(alone), rel=1e-6)
    assert posterior.weights @ posterior.means_of(3) == pytest.approx([alone[3]], rel=1e-6)


def test_quantiles_of_a_mixture():
    mixture = Mixture(np.array([0.25, 0.75]), np.array([1.0, 1.0]), np.array([4.0, 4.0]))
    assert mixture.interval(0.95) == pytest.approx((1 - 2 * 1.959964, 1 + 2 * 1.959964), abs=1e-6)
    assert (mixture.mean, mixture.sd) == pytest.approx((1.0, 2.0))
    far = Mixture(np.array([0.5, 0.5]), np.array([-10.0, 10.0]), np.array([1.0, 1.0]))
    assert far.quantile(0.25) == pytest.approx(-10.0, abs=1e-9)
    assert far.sd == pytest.approx(np.sqrt(101.0))


def test_probabilities_of_a_mixture_far_off():
    """Where they are no numbers but 0 or 1, on both sides, their logarithms are."""
    mixture = Mixture(np.array([0.25, 0.75]), np.array([0.0, 1e3]), np.array([1.0, 1.0]))
    near, far = norm.logcdf(1.0) + np.log1p(-norm.cdf(-1.0) / norm.cdf(1.0)), norm.logsf(40.0)
    assert mixture.log_probability(-1.0, 1.0) == pytest.approx(np.log(0.25) + near)
    assert mixture.log_probability(40.0, 90.0) == pytest.approx(np.log(0.25) + far)
    assert mixture.log_probability(-90.0, -40.0) == pytest.approx(np.log(0.25) + far)
    assert mixture.log_probability(910.0, 960.0) == pytest.approx(np.log(0.75) + far)


@pytest.mark.parametrize(("tau", "count", "half_width"), [(0.12, 5, 15.0), (0.3, 3, 42.0)])
def test_intervals_hold_the_material_the_size_and_the_next_specimen(tau, count, half_width):
    """Coverage of 300 sets, to four standard deviations of it; one value for all holds in 0.25."""
    rng, sd, sets = np.random.default_rng(11), 0.02, 300
    level, information = Level(0, "specimen", np.arange(count)), np.array([[sd**-2]])
    hits, widths = np.zeros(3), []
    for _ in range(sets):
        values = np.hypot(tau, sd) * rng.standard_normal(count)
        tests = [
            ReducedTest(information, v / sd**2 * np.ones(1), (v / sd) ** 2, 0.0) for v in values
        ]
        models = [MixedModel(tests, [level], np.zeros(1), np.zeros(1))]
        posterior = integrate(lambda _, models=models: models, [Size(None, 0.3)])
        low, high = posterior.unknown(0).interval(0.95)
        widths.append(50.0 * (high - low))
        size = posterior.size(0, 0.95).interval
        next_low, next_high = posterior.next_specimen(0).interval(0.95)
        hits += [
            low < 0.0 < high,
            size[0] < tau < size[1],
            next_low < tau * rng.standard_normal() < next_high,
        ]
    tolerance = 4.0 * np.sqrt(0.05 * 0.95 / sets)
    assert hits / sets == pytest.approx(0.96, abs=tolerance)
    assert np.median(widths) == pytest.approx(half_width, rel=0.1)


@pytest.mark.parametrize(
    ("limit", "sd", "sizes"), [(-0.1, 0.03, (0.1, 0.25, 0.6)), (-3.0, 1e-5, (1e-4, 0.01, 1.0))]
)
def test_limits_cut_what_scatters(limit, sd, sizes):
    """Half of the specimens are known to be below a limit only, by quadrature over the material.

    Also where that is far off.
    """
    values = np.array([0.1, 0.35, -0.05])
    known = [ReducedTest(np.eye(1) / sd**2, v / sd**2 * np.ones(1), (v / sd) ** 2, 0.0)
             for v in values]  # fmt: skip
    below = Limits(np.array([limit / sd]), np.array([[-1.0 / sd]]))
    nothing = ReducedTest(np.zeros((1, 1)), np.zeros(1), 0.0, 0.0)
    tests = [*known, *[replace(nothing, limits=below)] * 3]
    level, tau = Level(0, "specimen", np.arange(6)), np.array(sizes)
    model = MixedModel(tests, [level], np.zeros(1), np.zeros(1))
    solved = model.solve(tau[:, None])
    assert solved.settled.all()
    for i, spread in enumerate(np.hypot(tau, sd)):
        beta = np.linspace(min(limit, -0.05) - 8.0 * spread, 0.35 + 8.0 * spread, 400_001)
        logs = norm.logpdf(values[:, None], beta, spread).sum(axis=0)
        logs += 3.0 * norm.logcdf((limit - beta) / spread)
        density = np.exp(logs - logs.max())
        mean = beta @ density / density.sum()
        width = np.sqrt((beta - mean) ** 2 @ density / density.sum())
        assert solved.effects[i, 0] == pytest.approx(mean, abs=0.02 * width)
        assert np.sqrt(solved.covariance[i, 0, 0]) == pytest.approx(width, rel=0.02)
        mass = logs.max() + np.log(density.sum() * (beta[1] - beta[0]))
        # in units of the noise, and with a constant of three readings less one unknown
        mass += 3.0 * np.log(sd) + 0.5 * 2.0 * np.log(2.0 * np.pi)
        assert -0.5 * solved.restricted[i] == pytest.approx(mass, abs=0.01, rel=1e-8)


def test_unknowns_that_tests_know_well_and_far_from_zero():
    """Logarithms near -20 to 1e-4, as where a test tells k to 0.01 %: nothing depends on that."""
    values = np.array([-0.3, 0.1, 0.25])
    tau, solved = np.array([[0.3], [4.0]]), []
    for zero in (0.0, -20.0):
        information, x = np.array([[1e8]]), zero + values
        tests = [ReducedTest(information, 1e8 * x[[i]], 1e8 * x[i] ** 2, 0.0) for i in range(3)]
        level = Level(0, "specimen", np.arange(3))
        solved.append(MixedModel(tests, [level], np.zeros(1), np.zeros(1)).solve(tau))
    at_zero, far = solved
    assert far.restricted == pytest.approx(at_zero.restricted, abs=1e-3)
    assert far.effects[:, 0] + 20.0 == pytest.approx(at_zero.effects[:, 0], abs=1e-6)
