"""How long explicit steps may be."""

from typing import TYPE_CHECKING, Any

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import Case
from ringwear_par.contact.problem import ContactState
from ringwear_par.contact.solver import ContactSolver
from ringwear_par.elasticity.pair import ContactCompliance, largest_stable_step
from ringwear_par.schedules import integral, largest
from ringwear_par.wear.law import Law, LocalState
from ringwear_par.wear.layered import LayeredLaw

if TYPE_CHECKING:
    from ringwear_par.history.model import WearModel


def stable_step(model: "WearModel") -> float:
    """Return the largest stable step of the explicit scheme, s. Collective.

    Unworn, under the largest load and speed, with the steepest of what laws do in time.
    """
    solver = model.solver
    warm = solver.warm()
    most = float(pressed(solver, model.case).pressure.max())
    solver.warm_start(warm)
    return _stable_step(model.case, model.compliance, most)


def stable_steps(model: "WearModel") -> list[float]:
    """Return the same of B histories."""
    solver = model.batch.solver
    start = solver.start
    loads = [case.load for case in model.given.cases]
    if model.given.force is None:
        given: dict[str, Any] = {
            "approach": np.array([largest(load.displacement or 0.0) for load in loads])
        }
    else:
        given = {"force": np.array([largest(load.force or 0.0) for load in loads])}
    most = solver.solve(model.given.initial_gap, **given).pressure.max(axis=1).tolist()
    solver.start = start
    return [
        _stable_step(case, model.compliances.history(i), most[i])
        for i, case in enumerate(model.given.cases)
    ]


def _stable_step(case: Case, compliance: ContactCompliance, most: float) -> float:
    """Return the largest stable step of a case whose largest pressure is so many MPa."""
    line = compliance.line
    p = np.full_like(line.r, most)
    zero = np.zeros_like(p)
    slopes, omega = zero, case.load.omega
    for time in (0.0, *case.breakpoints):
        slid = integral(omega, 0.0, time) * line.arm
        at = LocalState(time, line.r, largest(omega) * line.arm, case.friction, zero, slid)
        every = [_steepest(law, p, at) for law in case.laws if law is not None]
        slopes = np.maximum(slopes, sum(every, zero))
    return largest_stable_step(compliance, slopes * compliance.obliquity)


def _steepest(law: Law, p: FloatArray, at: LocalState) -> FloatArray:
    """Return the slope of a law with pressure, the steepest of those of layers."""
    if isinstance(law, LayeredLaw):
        return np.max([own.d_rate_dp(p, at) for own in law.laws], axis=0)
    return law.d_rate_dp(p, at)


def pressed(solver: ContactSolver, case: Case) -> ContactState:
    """Return the contact before any wear, under the largest load of a case. Collective."""
    force, displacement = case.load.force, case.load.displacement
    return solver.solve(
        case.initial_gap,
        force=None if force is None else largest(force),
        approach=None if displacement is None else largest(displacement),
    )
