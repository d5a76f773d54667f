"""Sweeps whose cases are computed alone, as long ones are, and stopped."""

import signal
from contextlib import contextmanager

import pytest

from ringwear_par.studies.analysis import sensitivity
from ringwear_par.studies.execution import single_cases


@pytest.fixture
def few_resamples(monkeypatch):
    """Indices of sweeps, where it does not matter how well they are known: most of the time."""
    monkeypatch.setattr(sensitivity, "RESAMPLES", 20)
    monkeypatch.setattr(sensitivity, "EVALUATIONS", 1e4)


@pytest.fixture
def one_by_one(monkeypatch):
    """Cases of sweeps are computed alone, as long ones are."""
    monkeypatch.setattr(single_cases, "LONG_STEPS", 0)


@pytest.fixture
def stopped_after(monkeypatch, one_by_one):
    """Context manager: SIGTERM comes after a number of steps of a case."""
    call = single_cases.CheckpointWatch.__call__

    @contextmanager
    def stopped_after(step):
        def interrupted(self, snapshot):
            if snapshot.progress.steps == step:
                signal.raise_signal(signal.SIGTERM)
            return call(self, snapshot)

        with monkeypatch.context() as patch:
            patch.setattr(single_cases.CheckpointWatch, "__call__", interrupted)
            yield

    return stopped_after
