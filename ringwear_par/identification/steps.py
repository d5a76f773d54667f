"""Steps of a fit's histories: frozen, so that readings depend smoothly on what is sought."""

import itertools

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.identification.problem import Experiment

#: of a test, and fewest of a piece between two bends of its schedules
STEPS, _FEWEST, _FEWEST_SHORT = 40, 6, 3
#: first step of a piece, of the test; a piece that is short, of the test
_FIRST, _SHORT = 2e-4, 1e-2
#: times closer than this share of the test are one
_CLOSE = 1e-7


def step_times(experiment: Experiment, steps: int = STEPS) -> FloatArray:
    """Return the ends of about so many steps of a test, s.

    After the start, and after every bend of a schedule, they grow geometrically: pressures change
    quickly there. Profiles are read at ends of steps.
    """
    case = experiment.case
    end = case.time.end
    pieces = []
    for low, high in itertools.pairwise((0.0, *case.breakpoints, end)):
        length = high - low
        if length > _SHORT * end:
            count = max(_FEWEST, round(steps * (0.4 + 0.6 * length / end)))
            pieces.append(low + np.geomspace(_FIRST * length, length, count))
        else:
            pieces.append(np.linspace(low, high, 1 + max(_FEWEST_SHORT, steps // 10))[1:])
    fixed = {*case.breakpoints, end, *(s.at for s in experiment.series if s.at is not None)}
    times: list[float] = []
    for time in sorted({*np.concatenate(pieces).tolist(), *fixed}):
        if times and time - times[-1] <= _CLOSE * end:
            times[-1] = time if time in fixed else times[-1]
        else:
            times.append(time)
    times[-1] = end
    return np.array(times)
