"""Wear laws for tests, by the values of their parameters in order: ``ThresholdLaw(1e-7, 40.0)``."""

import numpy as np

from ringwear_par.cases.law import Law
from ringwear_par.wear import LocalState
from ringwear_par.wear.laws import LAWS


def _of_kind(name):
    names = LAWS[name].parameters
    return lambda *values, **more: Law.of_values(name, **dict(zip(names, values)), **more)  # noqa: B905


ThresholdLaw, ArchardLaw, PowerLaw, TableLaw, RunningInLaw, NonLocalLaw = map(
    _of_kind, ("threshold", "archard", "power", "table", "running-in", "non-local")
)


def sliding(power, time=0.0, wear=None):
    """Return the sliding of one history whose mu V is ``power`` (mu = 1)."""
    nothing = np.zeros_like(power)
    r = np.linspace(28.5, 31.5, len(power))
    return LocalState(time, r, power, 1.0, nothing if wear is None else wear, nothing)
