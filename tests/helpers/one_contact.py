"""The contact of one history, whose fields are (n,) and whose numbers are floats."""

import numpy as np

from ringwear_par.batched import one
from ringwear_par.contact.engine import ContactEngine
from ringwear_par.contact.scaled_compliances import ScaledCompliances


def engine_of(compliance, area, speed=None):
    """Return the engine of one history, whose wear goes with a sliding speed (n,)."""
    speed = None if speed is None else speed[None]
    compliances = ScaledCompliances.of(compliance[None], area, speed)
    return ContactEngine(compliances, np.zeros(1, dtype=int))


class OneContact:
    """An engine of one history; a context manager, which frees it."""

    def __init__(self, compliance, area, speed=None):
        self.engine = engine_of(compliance, area, speed)

    def solve(self, gap, *, force=None, approach=None, wear=None):
        """Return the contact at a force (N) or an approach (mm)."""
        force, approach = (
            None if number is None else np.array([float(number)]) for number in (force, approach)
        )
        return one(self.engine.solve(gap[None], force=force, approach=approach, wear=wear), 0)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.engine.destroy()
