"""Steps of a fit's histories: frozen, so that readings depend smoothly on what is sought."""

import itertools
import math

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.identification.definition.problem import Experiment
from ringwear_par.wear.layered import LayeredLaw

#: of a test with constant conditions
STEPS = 40
#: sd, by which steps half as long may move what a fit seeks
MOST_SHIFT_SD = 0.2
#: by which there are more, equal ones where layers may be worn through
_EQUAL = 4
#: of them, fewest of a piece between two bends of schedules; fewest of any piece
_SHARE, _FEWEST = 0.3, 3
#: shares of the test: its first step, half of one after a bend; a piece that is short
_FIRST, _SHORT = 2e-4, 1e-2
#: times closer than this share of the test are one
_CLOSE = 1e-7


def step_times(experiment: Experiment, steps: int = STEPS) -> FloatArray:
    """Return the ends of steps of a test, s.

    After the start, and after every bend of a schedule, they grow geometrically: pressures change
    quickly there. Profiles are read at ends of steps. Pieces between bends share the steps of a
    test, but for a number that each needs. Where a body with layers wears, steps stay short to the
    end: rates change at once as a layer is worn through, whenever that is.

    Parameters
    ----------
    steps : of a test whose schedules have no bends.
    """
    case = experiment.case
    end = case.time.end
    cuts = list(itertools.pairwise((0.0, *case.breakpoints, end)))
    long = sum(high - low > _SHORT * end for low, high in cuts)
    layered = bends_within(experiment)
    pieces = []
    for low, high in cuts:
        length = high - low
        if length > _SHORT * end:
            proportional = round(steps * (0.4 / math.sqrt(long) + 0.6 * length / end))
            count = max(_FEWEST, round(_SHARE * steps), proportional)
            first = min((_FIRST if long == 1 else 2.0 * _FIRST) * end, length / count)
            grown = np.geomspace(first, length, count)
            pieces.append(low + (_limited(grown, _EQUAL * count) if layered else grown))
        else:
            count = max(_FEWEST, steps // 10)
            pieces.append(np.linspace(low, high, 1 + count)[1:])
    fixed = {*case.breakpoints, end, *(s.at for s in experiment.series if s.at is not None)}
    times: list[float] = []
    for time in sorted({*np.concatenate(pieces).tolist(), *fixed}):
        if times and time - times[-1] <= _CLOSE * end:
            times[-1] = time if time in fixed else times[-1]
        else:
            times.append(time)
    times[-1] = end
    return np.array(times)


def bends_within(experiment: Experiment) -> bool:
    """Tell whether layers may be worn through: readings then bend where a step's end meets that."""
    return any(isinstance(law, LayeredLaw) for law in experiment.case.laws)


def _limited(grown: FloatArray, count: int) -> FloatArray:
    """Return ends of growing steps until they are as long as ``count`` equal ones, then these."""
    equal = np.linspace(0.0, grown[-1], 1 + count)[1:]
    early = grown[np.diff(grown, prepend=0.0) < equal[0]]
    return np.concatenate([early, equal[equal > early.max(initial=0.0)]])
