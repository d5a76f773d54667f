"""Implicit steps of wear for tests that know the power of friction only."""

import numpy as np

from ringwear_par.wear import LocalState
from ringwear_par.wear.increment import WearIncrement


def sliding(power, time=0.0, wear=None):
    """Return the sliding whose mu V is ``power`` (mu = 1)."""
    nothing = np.zeros_like(power)
    r = np.linspace(28.5, 31.5, len(power))
    return LocalState(time, r, power, 1.0, nothing if wear is None else wear, nothing)


def step_wear(laws, power, step):
    """Return the wear of one step under one or two laws."""
    at = sliding(power)
    return WearIncrement((*laws, None)[:2], (at, at), step)
