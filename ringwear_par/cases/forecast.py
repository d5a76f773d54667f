"""How deep bodies are to wear as a case's numbers say: what a wrong unit shows by."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import Case
from ringwear_par.elasticity.boundary_fields import BODIES
from ringwear_par.schedules import Quantity, Table, largest, mean
from ringwear_par.wear.archard import ArchardLaw
from ringwear_par.wear.law import WearLaw
from ringwear_par.wear.parameters import parameters_of
from ringwear_par.wear.threshold import AboveThreshold

#: wear, in heights of a body, from which on the unit of its wear coefficient is in question
DEEP = 0.1


@dataclass(frozen=True)
class Forecast:
    """Wear of a body by the end of a case.

    Parameters
    ----------
    body : 0 for lower, 1 for upper.
    depth : mm.
    key, k : wear coefficient, 1/MPa, by which most of it is worn off.
    """

    body: int
    depth: float
    key: str
    k: float


def forecasts(case: Case) -> Iterator[Forecast]:
    """Give the wear of bodies whose laws have a wear coefficient. Not collective.

    That of the steady state at mean load and speed, without running-in; layers one after the other.
    Nothing is told where a displacement is given, for wear takes the load off.
    """
    if case.load.force is None:
        return
    end, (a, b) = case.time.end, case.overlap
    pressure = mean(case.load.force, 0.0, end) / case.area
    speed = 0.5 * (a + b) * mean(case.load.omega, 0.0, end)
    for i, strata in enumerate(_strata(case)):
        left, worn = end, []
        for table, law, thickness in strata:
            rate = _rate(case, law, pressure, speed)
            if rate <= 0.0 or left <= 0.0:
                break
            depth = min(rate * left, thickness)
            left -= depth / rate
            worn.append((depth, f"{table}.k", largest(getattr(law, "k", 0.0))))
        if worn:
            _, key, k = max(worn)
            yield Forecast(i, sum(depth for depth, *_ in worn), key, k)


def unit_question(case: Case, wear: FloatArray) -> str:
    """Return what to ask of a wear coefficient where much is worn off, or to be; "" if nothing.

    Parameters
    ----------
    wear : (2, n) mm, worn off lower and upper.
    """
    depths = wear.max(axis=1).tolist()
    for forecast in forecasts(case):
        depths[forecast.body] = max(depths[forecast.body], forecast.depth)
    for ring, strata, depth in zip(case.rings, _strata(case), depths, strict=True):
        own = [
            (largest(getattr(law, name)), f"{table}.{name}")
            for table, law, _ in strata
            for name, parameter in parameters_of(type(law)).items()
            if parameter.unit == "1/MPa"
        ]
        if own and depth > DEEP * (ring.z[1] - ring.z[0]):
            k, key = max(own)
            return f'; {key} = {k:g} is in 1/MPa: if it is in mm3/(N m), write "{k:g} mm3/(N m)"'
    return ""


def _strata(case: Case) -> list[list[tuple[str, WearLaw | None, float]]]:
    """Return table, law and thickness (mm) of the layers of lower and upper and what is below."""
    found = []
    for body, ring, itself in zip(
        BODIES, case.rings, (case.wear_lower, case.wear_upper), strict=True
    ):
        own: list[tuple[str, WearLaw | None, float]] = [
            (f"wear.{body}", itself, layer.thickness)
            if layer.wear is None
            else (f"{body}.layers[{i}].wear", layer.wear, layer.thickness)
            for i, layer in enumerate(ring.layers)
        ]
        found.append([*own, (f"wear.{body}", itself, math.inf)])
    return found


def _rate(case: Case, law: WearLaw | None, pressure: float, speed: float) -> float:
    """Return the rate of wear of a law at a pressure (MPa) and a speed (mm/s); 0: not known."""
    if isinstance(law, ArchardLaw):
        return _mean(case, law.k) * pressure * speed
    if isinstance(law, AboveThreshold):
        k: Quantity = getattr(law, "k", 0.0)
        above = max(pressure - _mean(case, law.p0), 0.0)
        return _mean(case, k) * case.friction * above * speed
    return 0.0


def _mean(case: Case, quantity: Quantity) -> float:
    """Return the mean of a quantity over the time of a case, or along its contact."""
    along = isinstance(quantity, Table) and quantity.axis == "r"
    return mean(quantity, *(case.overlap if along else (0.0, case.time.end)))
