"""Samples of the posterior: exact where the model is linear, within bounds, alike on all ranks."""

import copy
import re
from dataclasses import replace

import h5py
import numpy as np
import pytest
from laboratory import FITTED, fit_tables
from linear_histories import LinearHistories
from scipy.stats import truncnorm

from ringwear_par.errors import ComputationError
from ringwear_par.identification.definition.fit_file import read_fit
from ringwear_par.identification.definition.problem import Prior
from ringwear_par.identification.estimation import posterior
from ringwear_par.identification.estimation.intervals import estimates
from ringwear_par.identification.estimation.misfit import Misfit
from ringwear_par.identification.estimation.posterior import sample_posterior
from ringwear_par.identification.fit import expected_result, fit, fit_problem


@pytest.fixture(scope="module")
def linear(laboratory):
    """A function that makes a linear problem, its optimum, covariance and samples."""
    known = {}

    def made(comm, samples=4000, deaf=False, path=None, **changes):
        folder, written = laboratory
        tables = fit_tables(folder, written, intervals=["posterior"], samples=samples)
        problem = read_fit(tables)
        if not known:
            start = {"wear.lower.k": 1.3e-7, "wear.lower.p0": 25.0}
            at = replace(problem, parameters=tuple(
                replace(p, start=start[p.key]) for p in problem.parameters))  # fmt: skip
            found = expected_result(at, comm)
            bare = found.misfit.model_readings(found.x)[:, None]
            known["problem"] = at
            known["response"] = np.concatenate([bare, found.evaluation.sensitivity], axis=1)
        response = known["response"].copy()
        if deaf:  # readings do not tell k
            response[:, 1] = 0.0
        settings = replace(problem.settings, **changes.pop("settings", {}))
        parameters = tuple(
            replace(p, **changes.get(p.key, {})) for p in known["problem"].parameters
        )
        problem = replace(problem, settings=settings, parameters=parameters)
        histories = LinearHistories(known["problem"], response)
        misfit = Misfit(problem, histories)
        x = misfit.with_best_nuisances([p.start for p in parameters])
        for _ in range(3):  # all unknowns at once, until nothing changes
            found = misfit.evaluate(x)
            step = np.linalg.lstsq(found.jacobian, -found.residuals, rcond=None)[0]
            x = np.clip(x + step, misfit.lower, misfit.upper)
        found = misfit.evaluate(x)
        _, covariance = estimates(misfit, x, found)
        drawn = sample_posterior(misfit, histories, x, covariance, path)
        unknowns = np.array(
            [[p.unknown(v) for p, v in zip(parameters, row, strict=True)] for row in drawn.samples]
        )
        return x, covariance, unknowns, drawn

    return made


def test_samples_of_a_linear_model_are_normal(linear, comm):
    """Mean, standard deviations and correlation within what so many samples tell."""
    x, covariance, unknowns, drawn = linear(comm)
    assert drawn.effective > 500
    error = 4.0 / np.sqrt(drawn.effective)
    sd = np.sqrt(np.diag(covariance))[:2]
    assert unknowns.std(axis=0) == pytest.approx(sd, rel=error)
    assert np.abs(unknowns.mean(axis=0) - x[:2]).max() < error * sd.max()
    assert np.all(np.abs(unknowns.mean(axis=0) - x[:2]) < error * sd)
    correlation = covariance[0, 1] / sd.prod()
    assert np.corrcoef(unknowns.T)[0, 1] == pytest.approx(correlation, abs=error)
    assert unknowns.tobytes() == unknowns.tobytes()


def test_samples_keep_to_a_bound(linear, comm):
    """A normal distribution of p0 that is cut off at its mean."""
    x, covariance, _, _ = linear(comm)
    low, sd = float(x[1]), float(np.sqrt(covariance[1, 1]))
    _, _, unknowns, drawn = linear(
        comm, **{"wear.lower.p0": {"bounds": (low, 200.0), "start": low + sd}}
    )
    error = 4.0 / np.sqrt(drawn.effective)
    assert unknowns[:, 1].min() >= low
    expected = truncnorm(0.0, np.inf, loc=low, scale=sd)
    assert unknowns[:, 1].mean() == pytest.approx(expected.mean(), abs=error * sd)


def test_a_prior_is_that_of_the_value_on_a_logarithmic_scale(linear, comm):
    """Where the readings tell nothing, samples of k are those of its prior."""
    mean, sd = 1.3e-7, 0.5e-7
    _, _, _, drawn = linear(
        comm, samples=16000, deaf=True, **{"wear.lower.k": {"prior": Prior(mean, sd)}}
    )
    low, high = FITTED["wear.lower.k"]["bounds"]
    expected = truncnorm((low - mean) / sd, (high - mean) / sd, loc=mean, scale=sd)
    error = 4.0 / np.sqrt(drawn.effective)
    assert error < 0.15
    assert drawn.samples[:, 0].mean() == pytest.approx(expected.mean(), abs=error * sd)
    assert drawn.samples[:, 0].std() == pytest.approx(expected.std(), rel=error)


def test_samples_are_kept(laboratory, comm, tmp_path):
    folder, written = laboratory
    tables = fit_tables(folder, written, intervals=["posterior"], samples=64, starts=1)
    tables["experiment"] = copy.deepcopy(written)
    tables["experiment"][0]["data"][0]["sd"] = "fit"
    found = fit(tables, comm)
    assert len(found.posterior.samples) >= 64
    assert "few-samples" in [doubt.code for doubt in found.doubts]
    found.save(tmp_path / "out")
    with h5py.File(tmp_path / "out/results.h5") as file:
        assert file["posterior/wear.lower.p0"][:].tolist() == found.posterior.samples[:, 1].tolist()
    told = found.to_dict()["parameters"]["wear.lower.p0"]["posterior"]
    low, high = told["interval"]
    assert FITTED["wear.lower.p0"]["bounds"][0] <= low < told["median"] < high
    assert re.search(r"posterior: .*; fitted noise stays at its best value", found.summary())


@pytest.fixture
def stop_after(monkeypatch):
    """A function that has chains stored at every step, and the process fail after some of them."""
    store, lengths = posterior._store_chain, []

    def storing(after):
        lengths.clear()

        def store_and_fail(path, key, backend, histories):
            store(path, key, backend, histories)
            lengths.append(backend.iteration)
            if len(lengths) == after:
                raise ComputationError("the power failed")

        monkeypatch.setattr(posterior, "STORE_SECONDS", 0.0)
        monkeypatch.setattr(posterior, "_store_chain", store_and_fail)
        return lengths

    return storing


def test_a_stopped_chain_continues_with_the_same_samples(linear, tmp_path, comm, stop_after):
    """In the steps that are thrown away, after them, and at the end; to the last bit."""
    *_, whole = linear(comm, samples=64)
    steps = 12 + len(whole.samples) // 16
    for after in (1, 9, steps - 1, steps):
        path = tmp_path / f"{after}.npz"
        stop_after(after)
        with pytest.raises(ComputationError, match="the power failed"):
            linear(comm, samples=64, path=path)
        lengths = stop_after(None)
        *_, again = linear(comm, samples=64, path=path)
        assert lengths == list(range(after + 1, steps + 1))
        assert again.samples.tobytes() == whole.samples.tobytes()
        assert (again.acceptance, again.effective) == (whole.acceptance, whole.effective)


def test_a_stopped_posterior_goes_on(laboratory, tmp_path, comm, stop_after):
    tables = fit_tables(*laboratory, intervals=["posterior"], samples=64, starts=1)
    stop_after(2)
    with pytest.raises(ComputationError, match="the power failed"):
        fit_problem(read_fit(tables), comm, folder=tmp_path)
    assert (tmp_path / "progress/posterior.npz").is_file()
    lengths = stop_after(None)
    found = fit_problem(read_fit(tables), comm, folder=tmp_path)
    assert lengths[0] == 3
    assert len(found.posterior.samples) == 64


def test_a_chain_of_another_problem_is_not_continued(tmp_path):
    path, shape = tmp_path / "a/chain.npz", (16, 2)
    chain, _ = posterior._stored_chain(None, "", shape)
    chain.chain, chain.log_prob = np.ones((3, *shape)), np.zeros((3, 16))
    chain.iteration, chain.accepted = 3, np.full(16, 2.0)
    chain.random_state = np.random.RandomState(1).get_state()
    posterior._store_chain(path, "one", chain, 96)
    stored, histories = posterior._stored_chain(path, "one", shape)
    assert stored.get_chain().tolist() == chain.chain.tolist()
    assert (stored.accepted.sum(), histories) == (32.0, 96)
    drawn = []
    for state in (chain.random_state, stored.random_state):
        random = np.random.RandomState()
        random.set_state(state)
        drawn.append(random.standard_normal(5).tolist())
    assert drawn[0] == drawn[1]

    def length(path, key, shape):
        return posterior._stored_chain(path, key, shape)[0].iteration

    assert length(path, "one", shape) == 3
    assert length(path, "two", shape) == 0
    assert length(path, "one", (16, 3)) == 0
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    assert length(path, "one", shape) == 0
    assert length(tmp_path / "none.npz", "one", shape) == 0
