"""How deep bodies are to wear as a case's numbers say: what a wrong unit shows by."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import Case
from ringwear_par.elasticity.stress.boundary_fields import BODIES
from ringwear_par.schedules import Quantity, Table, largest, mean
from ringwear_par.wear.catalogue import LAWS
from ringwear_par.wear.law import Law, WearLaw
from ringwear_par.wear.local_state import LocalState
from ringwear_par.wear.parameters import parameters_of
from ringwear_par.wear.user import UserLaw

#: wear, in heights of a body, from which on the unit of its wear coefficient is in question
DEEP = 0.1


@dataclass(frozen=True)
class Forecast:
    """Wear of a body by the end of a case.

    Parameters
    ----------
    body : 0 for lower, 1 for upper.
    depth : mm.
    table : of the law by which most of it is worn off.
    k : its wear coefficient, 1/MPa, 0 for one without.
    """

    body: int
    depth: float
    table: str
    k: float


def forecasts(case: Case) -> Iterator[Forecast]:
    """Give the wear of bodies, at the mean pressure by the laws' own rates. Not collective.

    That of the steady state at mean load and speed, without running-in; layers one after the other.
    There is no forecast where a displacement is given: wear takes the load off.
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
            worn.append((depth, table, _coefficient(law)))
        if worn:
            _, table, k = max(worn)
            yield Forecast(i, sum(depth for depth, *_ in worn), table, k)


def _coefficient(law: WearLaw | None) -> float:
    """Return the wear coefficient k of a law, 1/MPa; 0 where it has none in this unit."""
    parameter = parameters_of(type(law)).get("k")
    if law is None or parameter is None or parameter.unit != "1/MPa":
        return 0.0
    return largest(getattr(law, "k"))  # noqa: B009


def unit_question(case: Case, wear: FloatArray) -> str:
    """Return a sentence about the unit of k where much is worn off, or to be; "" for none.

    Parameters
    ----------
    wear : (2, n) mm, worn off lower and upper.
    """
    depths = wear.max(axis=1).tolist()
    for forecast in forecasts(case):
        depths[forecast.body] = max(depths[forecast.body], forecast.depth)
    for ring, strata, depth in zip(case.rings, _strata(case), depths, strict=True):
        coefficients = [
            (largest(getattr(law, name)), f"{table}.{name}")
            for table, law, _ in strata
            for name, parameter in parameters_of(type(law)).items()
            if parameter.unit == "1/MPa"
        ]
        if coefficients and depth > DEEP * (ring.z[1] - ring.z[0]):
            k, key = max(coefficients)
            if key in case.with_units:
                return ""
            return f'. {key} = {k:g} is in 1/MPa: if it is in mm3/(N m), write "{k:g} mm3/(N m)"'
    return ""


def _strata(case: Case) -> list[list[tuple[str, WearLaw | None, float]]]:
    """Return table, law and thickness (mm) of the layers of lower and upper and what is below."""
    strata = []
    laws = case.laws_by_table
    for body, ring in zip(BODIES, case.rings, strict=True):
        tables = [f"{body}.layers[{i}].wear" for i in range(len(ring.layers))]
        tables = [table if table in laws else f"wear.{body}" for table in (*tables, "")]
        thicknesses = [*(layer.thickness for layer in ring.layers), math.inf]
        strata.append([(t, laws[t], h) for t, h in zip(tables, thicknesses, strict=True)])
    return strata


def _rate(case: Case, law: WearLaw | None, pressure: float, speed: float) -> float:
    """Return the rate of wear of a law at a pressure (MPa) and a speed (mm/s); 0: not known.

    After running-in, at the mean of each parameter. Laws of users are not run.
    """
    if not isinstance(law, Law) or type(law) not in LAWS.values() or isinstance(law, UserLaw):
        return 0.0
    for name in law.numeric:
        if isinstance(quantity := law.quantity(name), Table):
            law = law.with_parameter(name, _mean(case, quantity))
    long, r = np.array([np.inf]), np.array([0.5 * sum(case.overlap)])
    local = LocalState(0.0, r, np.array([speed]), _mean(case, case.friction), long, long)
    return float(law.rate(np.array([pressure]), local)[0])


def _mean(case: Case, quantity: Quantity) -> float:
    """Return the mean of a quantity over the time of a case, or along its contact."""
    along = isinstance(quantity, Table) and quantity.axis == "r"
    return mean(quantity, *(case.overlap if along else (0.0, case.time.end)))
