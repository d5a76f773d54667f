"""Samples of the posterior: exact where the model is linear, within bounds, kept."""

import copy
import re
from dataclasses import replace

import h5py
import numpy as np
import pytest
from laboratory import FITTED, fit_tables
from linear_histories import LinearHistories
from scipy.stats import truncnorm

from ringwear_par.identification.definition.fit_file import read_fit
from ringwear_par.identification.definition.problem import Prior
from ringwear_par.identification.estimation.intervals import estimates
from ringwear_par.identification.estimation.misfit import Misfit
from ringwear_par.identification.estimation.posterior import sample_posterior
from ringwear_par.identification.fit import expected_result, fit
from ringwear_par.identification.model.rounds import StoppedError


class StoppedHistories(LinearHistories):
    """Linear histories that a signal stops after some rounds."""

    rounds_left = None

    def responses(self, *args, **kwargs):
        """Return readings at points, or stop."""
        if self.rounds_left is not None:
            self.rounds_left -= 1
            if self.rounds_left < 0:
                raise StoppedError("stopped")
        return super().responses(*args, **kwargs)


@pytest.fixture(scope="module")
def linear(laboratory):
    """A function that makes a linear problem, its optimum, covariance and samples."""
    known = {}

    def made(comm, samples=4000, deaf=False, path=None, stopped_after=None, **changes):
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
        parameters = tuple(
            replace(p, **changes.get(p.key, {})) for p in known["problem"].parameters
        )
        problem = replace(problem, parameters=parameters)
        histories = StoppedHistories(known["problem"], response)
        misfit = Misfit(problem, histories)
        x = misfit.with_best_nuisances([p.start for p in parameters])
        for _ in range(3):  # all unknowns at once, until nothing changes
            found = misfit.evaluate(x)
            step = np.linalg.lstsq(found.jacobian, -found.residuals, rcond=None)[0]
            x = np.clip(x + step, misfit.lower, misfit.upper)
        found = misfit.evaluate(x)
        _, covariance = estimates(misfit, x, found)
        histories.rounds_left = stopped_after
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
    assert np.all(np.abs(unknowns.mean(axis=0) - x[:2]) < error * sd)
    correlation = covariance[0, 1] / sd.prod()
    assert np.corrcoef(unknowns.T)[0, 1] == pytest.approx(correlation, abs=error)


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


def test_a_chain_that_was_stopped_goes_on_with_the_same_samples(linear, tmp_path, comm):
    """In the steps that are thrown away, and after them; to the last bit."""
    *_, whole = linear(comm, samples=64)
    for rounds in (2, 14):
        path = tmp_path / f"{rounds}.npz"
        with pytest.raises(StoppedError):
            linear(comm, samples=64, path=path, stopped_after=rounds)
        *_, again = linear(comm, samples=64, path=path)
        assert again.samples.tobytes() == whole.samples.tobytes()
        assert (again.acceptance, again.effective) == (whole.acceptance, whole.effective)
