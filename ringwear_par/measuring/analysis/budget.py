"""Budgets of uncertainty: GUM (JCGM 100:2008) and its Monte Carlo supplement (JCGM 101:2008)."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.measuring.definition.problem import Conditions, Uncertainty

#: coverage factor of expanded uncertainties, about 95 % of a normal distribution
COVERAGE = 2.0
DRAWS, _SEED, _LEVEL = 200_000, 1, 0.95
#: of the expanded uncertainty: GUM and Monte Carlo that differ by more do not agree
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
        return self.u_of("AB")

    def u_of(self, types: str) -> float:
        """Return the standard uncertainty by the sources of one type, "A" or "B", or of "AB"."""
        parts = (source.contribution for source in self.sources if source.type in types)
        return float(np.sqrt(sum(part**2 for part in parts)))

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
        sources = tuple(
            Source(s.name, s.type, s.u, s.unit, factor * s.sensitivity) for s in self.sources
        )
        shortest = None if self.shortest is None else tuple(factor * v for v in self.shortest)
        return Estimate(factor * self.value, unit, sources, shortest)  # type: ignore[arg-type]

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
    return [Source(name, "B", known[name].of(value), unit, sensitivity)]


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
