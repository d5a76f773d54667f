"""Searches for the optimum: where they start, and what leads on from where they are stuck."""

from dataclasses import replace

import numpy as np
import pytest
from laboratory import FITTED

from ringwear_par.identification.definition.fit_file import read_fit
from ringwear_par.identification.estimation import solution
from ringwear_par.identification.estimation.minimise import minimise
from ringwear_par.identification.fit import fit, fit_problem


def test_a_profile_that_finds_a_better_optimum_is_followed(tables, comm, monkeypatch):
    """From where a minimiser has stuck, half a standard deviation away."""
    expected = fit(tables(intervals=["profile"]), comm)
    calls = []

    def stuck(misfit, x, *args, **kwargs):
        found = minimise(misfit, x, *args, **kwargs)
        calls.append(found)
        if len(calls) > 1:
            return found
        away = found.x.copy()
        away[1] += 0.5 * expected.parameters[1].sd
        return replace(found, x=away, evaluation=misfit.evaluate(away))

    monkeypatch.setattr(solution, "minimise", stuck)
    found = fit(tables(intervals=["profile"]), comm)
    assert len(calls) == len(found.starts) == 2
    assert found.chi2 == pytest.approx(expected.chi2, rel=1e-9)
    for one, other in zip(found.parameters, expected.parameters, strict=True):
        assert abs(one.estimate - other.estimate) < 1e-3 * one.sd
        assert np.abs(np.subtract(one.interval, other.interval)).max() < 0.05 * one.sd


def test_starts_are_where_readings_respond_to_all_parameters(tables, comm):
    """Of thresholds that mostly are above all pressures, from which nothing leads away."""
    given = tables()
    given["fit"]["parameters"] = {**FITTED, "wear.lower.p0": {"start": 0.0, "bounds": [0.0, 1000]}}
    found = fit_problem(read_fit(given), comm)
    assert found.n_at_best == 4
    assert all(start.converged for start in found.starts)
