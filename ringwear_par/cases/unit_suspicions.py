"""Numbers of a case that are probably in another unit than the case's.

A wrong unit shows in the depth of wear that the numbers mean, which is forecast.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import Case, Ring, RingLayer
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.errors import ValidityWarning
from ringwear_par.schedules import Table, largest, mean, stack
from ringwear_par.wear.law import Law, WearLaw, parameters_of, stack_laws
from ringwear_par.wear.laws import LAWS
from ringwear_par.wear.laws.archard import ArchardLaw
from ringwear_par.wear.laws.threshold import AboveThreshold
from ringwear_par.wear.laws.user import UserLaw
from ringwear_par.wear.local_state import LocalState

#: wear, in heights of a body, above which the unit of its wear coefficient is in question
DEEP = 0.1


@dataclass(frozen=True)
class Forecast:
    """Wear of a body by the end of a case."""

    #: 0 for lower, 1 for upper
    body: int
    #: mm
    depth: float
    #: of the law by which most of it is worn off
    table: str
    #: its wear coefficient, 1/MPa, 0 for one without
    k: float


def deep_forecasts(cases: Sequence[Case]) -> list[list[Forecast]]:
    """Return of each case the forecasts of wear that is ``DEEP``. Not collective.

    At the mean pressure by the laws' own rates: that of the steady state at mean load and speed,
    without running-in; layers one after the other. There is none where a displacement is given:
    wear takes the load off.

    Parameters
    ----------
    cases : of one ``lockstep.batch_key``.
    """
    if not cases or cases[0].load.force is None:
        return [[] for _ in cases]
    try:
        return _forecast(cases)
    except (TypeError, ValueError):  # of NumPy, for a law that takes one history only
        if len(cases) == 1:
            raise
        return [_forecast([case])[0] for case in cases]


def _forecast(cases: Sequence[Case]) -> list[list[Forecast]]:
    """Return the forecasts of cases under a force, at once."""
    forecasts: list[list[Forecast]] = [[] for _ in cases]
    ends = np.array([case.time.end for case in cases])
    force, omega, friction = (
        mean(stack(quantities), 0.0, ends)
        for quantities in (
            [case.load.force or 0.0 for case in cases],
            [case.load.omega for case in cases],
            [case.friction for case in cases],
        )
    )
    long, r = np.array([np.inf]), np.array([0.5 * sum(cases[0].overlap)])
    pressure = force[:, None] / cases[0].area
    local = LocalState(0.0 * ends, r, r * omega[:, None], friction, long, long)
    for body, ring in enumerate(cases[0].rings):
        strata = [_strata(case, body) for case in cases]
        if all(law is None for _, law, _ in strata[0]):
            continue
        left, depths = ends, []
        for stratum in zip(*strata, strict=True):
            _, laws, thickness = zip(*stratum, strict=True)
            rate = _rates(cases, laws, pressure, local)
            wears = rate > 0.0
            depths.append(np.where(wears, np.minimum(rate * left, thickness), 0.0))
            left = left - np.divide(depths[-1], rate, out=left.copy(), where=wears)
        total = np.sum(depths, axis=0)
        for i in np.flatnonzero(total > DEEP * (ring.z[1] - ring.z[0])).tolist():
            worn = zip(depths, strata[i], strict=True)
            _, table, k = max((d[i], table, _coefficient(law)) for d, (table, law, _) in worn)
            forecasts[i].append(Forecast(body, float(total[i]), table, k))
    return forecasts


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
    for forecast in deep_forecasts([case])[0]:
        depths[forecast.body] = max(depths[forecast.body], forecast.depth)
    for body, (ring, depth) in enumerate(zip(case.rings, depths, strict=True)):
        coefficients = [
            (largest(getattr(law, name)), f"{table}.{name}")
            for table, law, _ in _strata(case, body)
            for name, parameter in parameters_of(type(law)).items()
            if parameter.unit == "1/MPa"
        ]
        if coefficients and depth > DEEP * (ring.z[1] - ring.z[0]):
            k, key = max(coefficients)
            if key in case.with_units:
                return ""
            return f'. {key} = {k:g} is in 1/MPa: if it is in mm3/(N m), write "{k:g} mm3/(N m)"'
    return ""


def _strata(case: Case, body: int) -> list[tuple[str, WearLaw | None, float]]:
    """Return table, law and thickness (mm) of the layers of lower or upper and what is below."""
    name, law = BODIES[body], (case.wear_lower, case.wear_upper)[body]
    strata = [
        (f"wear.{name}", law, layer.thickness)
        if layer.wear is None
        else (f"{name}.layers[{i}].wear", layer.wear, layer.thickness)
        for i, layer in enumerate(case.rings[body].layers)
    ]
    return [*strata, (f"wear.{name}", law, math.inf)]


def _rates(
    cases: Sequence[Case], laws: Sequence[Any], pressure: FloatArray, local: LocalState
) -> FloatArray:
    """Return the rates of wear of the laws of cases, (B,) mm/s; 0: not known.

    After running-in, at the mean of each parameter. Laws of users are not run.

    Parameters
    ----------
    pressure : (B, 1) MPa.
    local : with speeds (B, 1).
    """
    kind = type(laws[0])
    if kind not in LAWS.values() or kind is UserLaw:
        return np.zeros(len(cases))
    law = stack_laws([_with_means(case, law) for case, law in zip(cases, laws, strict=True)])
    assert law is not None
    return np.broadcast_to(law.rate(pressure, local), pressure.shape)[:, 0]


def _with_means(case: Case, law: Law) -> Law:
    """Return a law with the means of those parameters that are tables."""
    for name, quantity in vars(law).items():
        if isinstance(quantity, Table):
            along = case.overlap if quantity.axis == "r" else (0.0, case.time.end)
            law = law.with_parameter(name, mean(quantity, *along))
    return law


_FLAG = "implausible_numbers"
#: moduli (MPa) that are those of materials in Pa; smaller ones may be meant, of rigid bodies
_PASCALS = (1e9, 2e12)
#: largest density, g/mm^3: osmium's and a little more
_DENSEST = 0.025
#: thinnest layer, mm
_THINNEST = 1e-4
#: 1/MPa, largest specific wear rate: Archard's K = 0.01 of severe dry sliding (0.007 of mild steel
#: on itself: J. F. Archard and W. Hirst, Proc. R. Soc. A 236 (1956) 397) over a hardness of 100 MPa
_FASTEST = 1e-4
#: mm; a body whose largest length is smaller, or larger, is likely in another unit
_SMALLEST, _LARGEST = 0.3, 5000.0
#: largest mean pressure, in Young's moduli, of linear elasticity
MOST_PRESSED = 0.1
#: MPa; what is softer is a rubber or a gel, whose Poisson's ratio is larger than this
_SOFTEST, _RUBBERY = 10.0, 0.4
#: MPa, and mean pressure in moduli: what is softer and pressed more is a rubber too. Metals in GPa
#: are; friction papers bear less, and PTFE is stiffer
_SOFT, _PRESSED = 300.0, 0.03
#: MPa; moduli of metals and ceramics in GPa are such numbers, from aluminium to diamond
_GIGAPASCALS = (65.0, 1100.0)


def unit_suspicions(
    case: Case, deep: Sequence[Forecast] | None = None
) -> tuple[ValidityWarning, ...]:
    """Return numbers of a case that are more likely in another unit than meant so. Not collective.

    Its mean pressures are those of the nominal annulus.

    Parameters
    ----------
    deep : its ``deep_forecasts``, where they are known.
    """
    texts: list[str] = []
    load, materials = _load(case), case.materials
    softest = min(material.young for material in materials.values())
    for name, material in materials.items():
        young, density = material.young, material.density
        if _PASCALS[0] < young <= _PASCALS[1]:
            texts.append(
                f"{name}.young = {young:g} MPa is stiffer than any material; if it is in Pa, write "
                f'"{young:g} Pa"'
            )
        if density is not None and density > _DENSEST:
            texts.append(
                f"{name}.density = {density:g} g/mm3 is denser than any material; if it is in "
                f'g/cm3, write "{density:g} g/cm3"'
            )
        if isinstance(material, Ring):
            size = max(material.r[1], material.z[1] - material.z[0])
            if not _SMALLEST < size < _LARGEST:
                unit = "um" if size > _LARGEST else "m"
                texts.append(
                    f"{name} measures {size:g} mm; plain lengths are in mm: is it in {unit}?"
                )
    if load > MOST_PRESSED * softest:
        texts.append(
            f"the mean pressure of {load:.3g} MPa is more than a tenth of a Young's modulus, "
            f"{softest:g} MPa: elasticity is not linear there; plain loads are in N, moduli in MPa"
            f"{_or_gigapascals(softest)}"
        )
    fast = dict(_too_fast(case))
    return (
        *(ValidityWarning(_FLAG, _asking(case, text.split()[0], text)) for text in texts),
        *_keyed(case, _too_thin(materials)),
        *_keyed(case, fast.items()),
        *(warning for warning in deep_wear(case, deep) if fast.keys().isdisjoint(warning.keys)),
        *_keyed(case, _in_gigapascals(materials, load)),
    )


def are_plausible(cases: Sequence[Case]) -> bool:
    """Tell whether none of some cases of the same rings has ``unit_suspicions`` but forecasts.

    By the largest of their numbers, which are no less suspicious. Not collective.
    """
    if not cases or unit_suspicions(max(cases, key=lambda c: largest(c.load.force or 0.0)), ()):
        return not cases
    return not any(rate > _FASTEST for case in cases for *_, rate in _specific_rates(case))


def _keyed(case: Case, faults: Iterable[tuple[str, str]]) -> list[ValidityWarning]:
    return [ValidityWarning(_FLAG, _asking(case, key, text), (key,)) for key, text in faults]


def _asking(case: Case, key: str, text: str) -> str:
    """Return a sentence without its question for a unit where the user wrote one."""
    return text.partition("; if it is in")[0] if key in case.with_units else text


def deep_wear(case: Case, deep: Sequence[Forecast] | None = None) -> list[ValidityWarning]:
    """Return the wear coefficients that would wear off much of a body. Not collective."""
    forecasts = deep_forecasts([case])[0] if deep is None else deep
    return _keyed(case, (_too_deep(case, forecast) for forecast in forecasts))


def smallest_modulus(case: Case) -> float:
    """Return the smallest Young's modulus of both bodies and their layers, MPa."""
    return min(material.young for material in case.materials.values())


def too_much_load(case: Case) -> bool:
    """Tell whether the largest force presses the nominal annulus too much to be in N."""
    return _load(case) > MOST_PRESSED * smallest_modulus(case)


def _load(case: Case) -> float:
    """Return the mean pressure of the largest force, MPa; 0 where a displacement is given."""
    return 0.0 if case.load.force is None else largest(case.load.force) / case.area


def without_intended_numbers(
    flags: Sequence[str], case: Case, varied: Sequence[str]
) -> tuple[str, ...]:
    """Return flags without that of implausible numbers where a study varies all of these.

    Parameters
    ----------
    varied : keys of the study.
    """
    if _FLAG not in flags:
        return tuple(flags)
    by_purpose = all(
        any(f"{name}[".startswith(f"{key}[") for name in warning.keys for key in varied)
        for warning in unit_suspicions(case)
    )
    return tuple(flag for flag in flags if not (by_purpose and flag == _FLAG))


def _too_thin(materials: Mapping[str, Ring | RingLayer]) -> Iterator[tuple[str, str]]:
    """Yield the layers, key and sentence, whose thickness is likely in m."""
    for name, layer in materials.items():
        if isinstance(layer, RingLayer) and layer.thickness < _THINNEST:
            key, thickness = f"{name}.thickness", layer.thickness
            text = (
                f"{key} = {thickness:g} mm is {1e6 * thickness:g} nm, thinner than coatings that "
                f'wear; if it is in m, write "{thickness:g} m", which is {1e6 * thickness:g} um'
            )
            yield key, text


def _too_fast(case: Case) -> Iterator[tuple[str, str]]:
    """Yield the wear coefficients, key and sentence, by which no material wears."""
    for key, k, rate in _specific_rates(case):
        if rate > _FASTEST:
            text = (
                f"{key} = {k:g} 1/MPa is a specific wear rate of {1e3 * rate:g} mm3/(N m), more "
                f"than that of any material in dry sliding, {1e3 * _FASTEST:g}; if it is in "
                f'mm3/(N m), write "{k:g} mm3/(N m)"'
            )
            yield key, text


def _specific_rates(case: Case) -> Iterator[tuple[str, float, float]]:
    """Yield wear coefficients, key and 1/MPa, and the specific wear rates that they are, 1/MPa."""
    for table, wear in case.laws_by_table.items():
        if isinstance(wear, (AboveThreshold, ArchardLaw)):
            share = largest(case.friction) if isinstance(wear, AboveThreshold) else 1.0
            for name in ("k", "k_start"):
                k = largest(getattr(wear, name, 0.0))
                yield f"{table}.{name}", k, share * k


def _too_deep(case: Case, forecast: Forecast) -> tuple[str, str]:
    """Return key and sentence of the wear coefficient or law that wears off much of a body."""
    z = case.rings[forecast.body].z
    key = f"{forecast.table}.k" if forecast.k else forecast.table
    coefficient = f"{key} = {forecast.k:g} 1/MPa" if forecast.k else key
    question = f'; if it is in mm3/(N m), write "{forecast.k:g} mm3/(N m)"' * bool(forecast.k)
    return key, (
        f"{coefficient} would wear {forecast.depth:.3g} mm off {BODIES[forecast.body]} by "
        f"t = {case.time.end:g} s, more than a tenth of its height, {z[1] - z[0]:g} mm{question}"
    )


def _in_gigapascals(
    materials: Mapping[str, Ring | RingLayer], load: float
) -> Iterator[tuple[str, str]]:
    """Yield the moduli, key and sentence, that are likely in GPa; not those under too much load."""
    for name, material in materials.items():
        young, poisson = material.young, material.poisson
        soft = young < _SOFTEST or (young < _SOFT and load > _PRESSED * young)
        as_metal = _GIGAPASCALS[0] <= young < _GIGAPASCALS[1]
        if (soft or as_metal) and poisson < _RUBBERY and load <= MOST_PRESSED * young:
            key = f"{name}.young"
            solids = (
                "rubber, which has a Poisson's ratio near 0.5, not"
                if soft
                else "rubbers, papers and soft plastics, here with a Poisson's ratio of"
            )
            text = (
                f"{key} = {young:g} MPa is softer than any solid but {solids} {poisson:g}"
                f"{_or_gigapascals(young)}"
            )
            yield key, text


def _or_gigapascals(young: float) -> str:
    """Return the question about a modulus that may be in GPa."""
    return f'; if it is in GPa, write "{young:g} GPa"' * (young < _GIGAPASCALS[1])
