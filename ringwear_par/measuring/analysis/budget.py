"""Budgets of uncertainty (JCGM 100:2008, and 101:2008 by Monte Carlo); those of a whole test."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.units import SPECIFIC
from ringwear_par.measuring.analysis.steady_part import Blocks, Change, extrapolate
from ringwear_par.measuring.definition.problem import Conditions, Problem, Test, Uncertainty

#: coverage factor of expanded uncertainties, about 95 % of a normal distribution
COVERAGE = 2.0
DRAWS, _SEED, _LEVEL = 200_000, 1, 0.95
#: share of the expanded uncertainty by which GUM and Monte Carlo may differ and still agree
_AGREEMENT = 0.1


@dataclass(frozen=True)
class Source:
    """A source of uncertainty."""

    #: of what is not known for certain
    name: str
    #: A, from statistics of readings, or B
    type: Literal["A", "B"]
    #: its standard uncertainty, in ``unit``
    u: float
    unit: str
    #: derivative of the measurand with respect to it
    sensitivity: float
    #: whether all tests of a rig have the same error, as of its load or its sensors
    shared: bool = False

    @property
    def contribution(self) -> float:
        """Standard uncertainty of the measurand from this source alone."""
        return abs(self.sensitivity) * self.u


@dataclass(frozen=True)
class Estimate:
    """A measurand: its value, and the sources of its uncertainty."""

    value: float
    unit: str
    sources: tuple[Source, ...]
    #: the shortest interval of 95 % of Monte Carlo draws; None where nothing was drawn
    shortest: tuple[float, float] | None = None

    def __repr__(self) -> str:
        low, high = self.interval
        return f"<Estimate {self.value:.4g} {self.unit}, from {low:.4g} to {high:.4g} (95 %)>"

    @property
    def u(self) -> float:
        """Combined standard uncertainty, of sources that do not depend on each other."""
        return math.hypot(*(source.contribution for source in self.sources))

    @property
    def u_shared(self) -> float:
        """Standard uncertainty by what all tests of a rig share."""
        return math.hypot(*(source.contribution for source in self.sources if source.shared))

    @property
    def interval(self) -> tuple[float, float]:
        """The value less and plus its expanded uncertainty, U = 2 u."""
        return self.value - COVERAGE * self.u, self.value + COVERAGE * self.u

    @property
    def agrees(self) -> bool:
        """Whether the interval of GUM and that of Monte Carlo differ by at most a tenth of U."""
        if self.shortest is None or self.u == 0.0:
            return True
        most = _AGREEMENT * COVERAGE * self.u
        ends = zip(self.interval, self.shortest, strict=True)
        return all(abs(end - limit) <= most for end, limit in ends)

    def share(self, source: Source) -> float:
        """Return the share of a source in the square of the uncertainty."""
        return (source.contribution / self.u) ** 2 if self.u > 0.0 else 0.0

    def scaled(self, factor: float, unit: str) -> "Estimate":
        """Return the measurand in another unit, of which its own is ``factor``."""
        sources = tuple(replace(s, sensitivity=factor * s.sensitivity) for s in self.sources)
        shortest = self.shortest and (factor * self.shortest[0], factor * self.shortest[1])
        return Estimate(factor * self.value, unit, sources, shortest)

    def to_dict(self) -> dict[str, Any]:
        """Return its entry in measure.json."""
        entry = {
            "value": self.value,
            "u": self.u,
            "interval": list(self.interval),
            "unit": self.unit,
            "budget": [
                {
                    "source": source.name, "type": source.type, "u": source.u,
                    "unit": source.unit, "sensitivity": source.sensitivity,
                    "share": self.share(source),
                }
                for source in self.sources
            ],
        }  # fmt: skip
        if self.shortest is not None:
            entry["monte_carlo"] = list(self.shortest)
        return entry


def shortest_interval(
    measurand: Callable[..., FloatArray],
    values: Sequence[float],
    us: Sequence[float],
    *,
    draws: int = DRAWS,
) -> tuple[float, float]:
    """Return the shortest interval of 95 % of draws of a measurand (JCGM 101, 7.7).

    Parameters
    ----------
    measurand : of its inputs, each (draws,).
    values, us : of the inputs, which are normal and do not depend on each other; one whose u is 0
        is constant.
    """
    random = np.random.default_rng(_SEED)
    inputs = [
        value + u * random.standard_normal(draws) if u > 0.0 else np.full(draws, value)
        for value, u in zip(values, us, strict=True)
    ]
    drawn = np.sort(measurand(*inputs))
    inside = int(_LEVEL * draws)
    first = int(np.argmin(drawn[inside:] - drawn[:-inside]))
    return float(drawn[first]), float(drawn[first + inside])


def source_of(
    known: Mapping[str, Uncertainty], name: str, value: float, unit: str, sensitivity: float
) -> list[Source]:
    """Return the source of type B of an input, none where its uncertainty is not given."""
    if name not in known:
        return []
    return [Source(name, "B", known[name].of(value), unit, sensitivity, shared=True)]


def load_sources(
    known: Mapping[str, Uncertainty], conditions: Conditions, relative: float
) -> list[Source]:
    """Return the source of the load, by force or by pressure: of its scale, where it changes.

    Parameters
    ----------
    relative : derivative of the measurand with respect to the logarithm of the load.
    """
    return [
        *source_of(known, "load.force", conditions.force, "N", relative / conditions.force),
        *source_of(
            known, "load.pressure", conditions.pressure, "MPa", relative / conditions.pressure
        ),
    ]


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
