"""Numbers of a test from its start to its end: by weighing, and by displacement."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ringwear_par.cases.units import SPECIFIC
from ringwear_par.measuring.analysis.autoregression import extrapolate
from ringwear_par.measuring.analysis.budget import (
    Estimate,
    Source,
    load_sources,
    shortest_interval,
    source_of,
)
from ringwear_par.measuring.analysis.steady_part import Blocks, Change
from ringwear_par.measuring.definition.problem import Conditions, Problem, Test, Uncertainty

#: block means at either end of a test: a parabola through the first, where wear may run in, and a
#: line through the last tell the depth there, at most so many blocks away
_END_BLOCKS, _RUNNING_IN, _STEADY = 5, 2, 1


@dataclass(frozen=True)
class WholeTest:
    """Numbers of a test from its start to its end."""

    #: m, slid
    distance: float
    #: mg
    mass_loss: Estimate | None
    #: mm3
    volume: Estimate | None
    #: mm3/(N m); None: not weighed
    specific_wear_rate: Estimate | None
    #: mm3, area times depth; None: no depth was read near an end
    volume_by_displacement: Estimate | None


def displaced_volume(
    wear: Blocks, change: Change, test: Test, uncertainties: Mapping[str, Uncertainty]
) -> Estimate | None:
    """Return the volume by displacement of the whole test, mm3; None without its ends.

    Parameters
    ----------
    change : of the steady part, whose errors are those at the ends too.
    """
    ends, farthest = (0.0, test.duration), _END_BLOCKS * float(np.median(np.diff(wear.time)))
    if wear.time[0] > farthest or test.duration - wear.time[-1] > farthest:
        return None
    first, last = slice(_END_BLOCKS), slice(-_END_BLOCKS, None)
    (before, u_before), (after, u_after) = (
        extrapolate(
            wear.time[blocks], wear.value[blocks], end, degree, sd=change.sd,
            autocorrelation=change.autocorrelation,
        )
        for end, blocks, degree in zip(ends, (first, last), (_RUNNING_IN, _STEADY), strict=True)
    )  # fmt: skip
    area = test.conditions(*ends).area
    volume = area * (after - before)
    sources = (
        Source("readings", "A", float(np.hypot(u_before, u_after)), "mm", area),
        *source_of(uncertainties, "displacement", 1.0, "1", volume),
    )
    return Estimate(volume, "mm3", sources)


def whole_test(test: Test, problem: Problem, by_depth: Estimate | None) -> WholeTest:
    """Return the numbers of the whole test."""
    conditions = test.conditions(0.0, test.duration)
    distance = conditions.speed * test.duration * 1e-3
    if test.weighing is None or test.density is None:
        return WholeTest(distance, None, None, None, by_depth)
    return WholeTest(distance, *_weighed(test, problem, conditions), by_depth)


def _weighed(
    test: Test, problem: Problem, conditions: Conditions
) -> tuple[Estimate, Estimate, Estimate]:
    """Return mass lost (mg), volume (mm3) and specific wear rate (mm3/(N m)) by weighing."""
    uncertainties, weighing, density = problem.uncertainty, test.weighing, test.density
    assert weighing is not None
    assert density is not None
    mass, key = weighing.loss, f"{test.body}.density"
    u = 0.0 if problem.mass_sd is None else weighing.u(problem.mass_sd)

    def balance(sensitivity: float) -> list[Source]:
        if problem.mass_sd is None:
            return []
        return [Source("mass", problem.mass_type, u, "g", sensitivity)]

    work = conditions.product * conditions.radius * test.duration * 1e-3  # N m, less friction's mu
    volume, rate = mass / density, mass / (density * work)
    mass_loss = Estimate(1e3 * mass, "mg", tuple(balance(1e3)))
    by_mass = Estimate(
        volume, "mm3",
        (*balance(1.0 / density),
         *source_of(uncertainties, key, density, "g/mm^3", -volume / density)),
    )  # fmt: skip
    sources = (
        *balance(1.0 / (density * work)),
        *source_of(uncertainties, key, density, "g/mm^3", -rate / density),
        *load_sources(uncertainties, conditions, -rate),
        *source_of(
            uncertainties, "load.omega", conditions.omega, "rad/s", -rate / conditions.omega
        ),
        *source_of(uncertainties, "time", 1.0, "1", -rate),
    )
    us = {source.name: source.u for source in sources}
    if not any(us.values()):
        return mass_loss, by_mass, Estimate(rate, SPECIFIC, sources)
    load_u = us.get("load.force", conditions.area * us.get("load.pressure", 0.0))
    shortest = shortest_interval(
        lambda m, rho, force, omega, time: (
            m / (rho * work * force / conditions.force * omega / conditions.omega * time)
        ),
        (mass, density, conditions.force, conditions.omega, 1.0),
        (u, us.get(key, 0.0), load_u, us.get("load.omega", 0.0), us.get("time", 0.0)),
    )
    return mass_loss, by_mass, Estimate(rate, SPECIFIC, sources, shortest)
