"""The quantities of a state whose limits, the keys of [stop] in a case, end a history.

A history ends after the step in which a quantity reaches its limit, so it goes beyond the limit by
up to the change in this step. A new quantity is a function like these, in any file of ``history``,
and a line in ``STOP_CRITERIA`` of ``cases/schema.py``. It has to grow towards its limit, and states
are those of B histories: it returns (B,).
"""

from collections.abc import Mapping, Sequence

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray, largest
from ringwear_par.cases.case import Case
from ringwear_par.cases.schema import STOP_CRITERIA, import_named
from ringwear_par.history.state import State


def penetration(state: State) -> FloatArray:
    """Return the approach since the start, (B,) mm."""
    return state.contact.approach - state.first_approach


def wear_lower(state: State) -> FloatArray:
    """Return the largest depth worn off lower, (B,) mm."""
    return largest(state.wear[0])


def wear_upper(state: State) -> FloatArray:
    """Return the largest depth worn off upper, (B,) mm."""
    return largest(state.wear[1])


def energy(state: State) -> FloatArray:
    """Return the energy dissipated by friction, (B,) N mm."""
    return state.energy


def stop_limits(cases: Sequence[Case]) -> Mapping[str, FloatArray]:
    """Return the limits of B cases by criterion, (B,) each, infinite of cases that have none."""
    limits = [dict(case.stop) for case in cases]
    names = dict.fromkeys(name for limits_of_case in limits for name in limits_of_case)
    return {name: np.array([of_case.get(name, np.inf) for of_case in limits]) for name in names}


def limits_reached(limits: Mapping[str, FloatArray], state: State) -> dict[str, BoolArray]:
    """Return which histories have reached each limit, (B,), by criterion."""
    return {
        name: import_named(STOP_CRITERIA[name].function)(state) >= limit
        for name, limit in limits.items()
    }


def have_reached(limits: Mapping[str, FloatArray], state: State) -> BoolArray:
    """Return which histories have reached a limit, (B,)."""
    reached = np.zeros(len(state.time), dtype=bool)
    for which in limits_reached(limits, state).values():
        reached |= which
    return reached


def limit_words(case: Case, name: str) -> str:
    """Return a limit of a case in words: "stop.penetration = 0.05 mm"."""
    return f"stop.{name} = {dict(case.stop)[name]:g} {STOP_CRITERIA[name].unit}"
