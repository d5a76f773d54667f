"""Runs that are stopped after a step, as by a signal."""

import signal
from contextlib import contextmanager

import pytest

import ringwear_par as rw
from ringwear_par.results import run


@pytest.fixture
def stopped_after(monkeypatch):
    """Context manager: SIGTERM comes after a number of steps of a run."""
    call = run.Run.__call__

    @contextmanager
    def stopped_after(step):
        def interrupted(self, instant):
            if instant.state.steps[0] == step:
                signal.raise_signal(signal.SIGTERM)
            return call(self, instant)

        with monkeypatch.context() as patch:
            patch.setattr(run.Run, "__call__", interrupted)
            yield

    return stopped_after


@pytest.fixture
def restarted(tmp_path, comm, stopped_after):
    """Run a case at once, and again stopped after a step and restarted; return both files."""

    def restarted(case, overrides, step, match="SIGTERM after step"):
        whole, parts = tmp_path / "whole.h5", tmp_path / "parts.h5"
        run.run_case(case, whole, overrides, comm=comm)
        with stopped_after(step), pytest.raises(rw.ComputationError, match=match):
            run.run_case(case, parts, overrides, comm=comm)
        run.run_case(case, parts, overrides, comm=comm, restart=True)
        return whole, parts

    return restarted
