"""Sweeps of which it does not matter how well indices are known."""

import pytest

from ringwear_par.studies.analysis import sensitivity


@pytest.fixture
def few_resamples(monkeypatch):
    """Indices are quick: they take most of the time."""
    monkeypatch.setattr(sensitivity, "RESAMPLES", 20)
    monkeypatch.setattr(sensitivity, "EVALUATIONS", 1e4)
