"""How long steps of fixed length may be."""

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.cases.case import SAME_TIME, Case
from ringwear_par.contact.correction import CorrectedContacts
from ringwear_par.contact.problem import ContactState
from ringwear_par.elasticity.bem.pair import ContactCompliance, largest_stable_step
from ringwear_par.history.elastic.bodies import young
from ringwear_par.history.physics import Physics
from ringwear_par.schedules import Table, integral, largest
from ringwear_par.wear.law import Law
from ringwear_par.wear.layered import LayeredLaw
from ringwear_par.wear.local_state import LocalState

#: share of the range of a load by which steps may miss it
_SLIGHT_MISS = 0.01


def missed_corner(case: Case) -> tuple[float, float, float] | None:
    """Return the corner of the load's table that fixed steps pass over, None for none.

    That is its time (s), the load there (N or mm), and what the load would be between both ends of
    the step; of several corners, the one that is missed most.
    """
    load = case.load.displacement if case.load.force is None else case.load.force
    step = case.time.step
    if case.time.adaptive or not isinstance(load, Table):
        return None
    x, y = np.array(load.x), np.array(load.y)
    number = np.floor(x / step + SAME_TIME)
    share = np.clip(x / step - number, 0.0, 1.0)
    straight = (1.0 - share) * load(number * step) + share * load((number + 1.0) * step)
    missed = np.where((x > 0.0) & (x < case.time.end), np.abs(y - straight), 0.0)
    i = int(missed.argmax())
    if missed[i] <= _SLIGHT_MISS * np.ptp(y):
        return None
    return float(x[i]), float(y[i]), float(straight[i])


def stable_steps(physics: Physics, contacts: CorrectedContacts) -> list[float]:
    """Return the largest stable steps of the explicit scheme, s, of B histories.

    Unworn, under the largest load and speed, with the steepest slopes of the laws at any time.
    """
    warm = contacts.warm
    largest_pressures = most_loaded_contacts(physics, contacts).pressure.max(axis=1).tolist()
    contacts.warm = warm
    return [
        _stable_step(case, physics.pairs[i].compliance(young(case)), largest_pressures[i])
        for i, case in enumerate(physics.inputs.cases)
    ]


def _stable_step(case: Case, compliance: ContactCompliance, largest_pressure: float) -> float:
    """Return the largest stable step of a case, s, at its largest pressure, MPa."""
    line = compliance.line
    p = np.full_like(line.r, largest_pressure)
    zero = np.zeros_like(p)
    slopes, omega = zero, case.load.omega
    for time in (0.0, *case.breakpoints):
        slid = integral(omega, 0.0, time) * line.arm
        at = LocalState(time, line.r, largest(omega) * line.arm, largest(case.friction), zero, slid)
        every = [_steepest(law, p, at) for law in case.laws if law is not None]
        slopes = np.maximum(slopes, sum(every, zero))
    return largest_stable_step(compliance, slopes * compliance.obliquity)


def _steepest(law: Law, p: FloatArray, at: LocalState) -> FloatArray:
    """Return the slope of a law with pressure, the steepest of those of layers."""
    if isinstance(law, LayeredLaw):
        return np.max([layer.d_rate_dp(p, at) for layer in law.laws], axis=0)
    return law.d_rate_dp(p, at)


def most_loaded_contacts(
    physics: Physics, contacts: CorrectedContacts, histories: IntArray | None = None
) -> ContactState:
    """Return the contacts before any wear, under the largest loads of the cases.

    Parameters
    ----------
    histories : those that are solved; None: all.
    """
    engine, inputs = contacts.engine, physics.inputs
    loads = [case.load for case in inputs.cases]
    if inputs.force is None:
        approach = np.array([largest(load.displacement or 0.0) for load in loads])
        return engine.solve(inputs.initial_gap, approach=approach, histories=histories)
    force = np.array([largest(load.force or 0.0) for load in loads])
    return engine.solve(inputs.initial_gap, force=force, histories=histories)
