"""The numbers of laboratories, one table: mass lost, rates of wear, sliding distance, p V.

They follow from what is stored of a history, so that files do not store them at every state.
"""

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import Case
from ringwear_par.elasticity.sections import BODIES, BodyName
from ringwear_par.results.result import HistoryColumns, Result
from ringwear_par.results.variables import Variable
from ringwear_par.schedules import Quantity, Table, in_time, integral, mean, stack

_HOUR = 3600.0


_OF_BODIES = {
    "mass_lost": (
        "mg", "mass lost by the {} ring, by its density; nothing where that is not given",
    ),
    "mean_wear_rate": (
        "um/h",
        "mean rate of wear of the {} ring since the start: volume over contact area and time",
    ),
    "specific_wear_rate": (
        "mm3/(N m)",
        "specific wear rate of the {} ring since the start: volume over force and distance",
    ),
}  # fmt: skip
#: the variables of these numbers at stored states, by name
LABORATORY_NUMBERS = {
    variable.name: variable
    for variable in (
        *(
            Variable(f"{name}_{body}", ("step",), unit, meaning.format(body))
            for name, (unit, meaning) in _OF_BODIES.items()
            for body in BODIES
        ),
        Variable("sliding_distance", ("step",), "m", "sliding distance at the mean radius"),
        Variable(
            "pressure_velocity", ("step",), "MPa m/s",
            "p V: mean pressure on the nominal area times speed at the mean radius",
        ),
    )
}  # fmt: skip


def laboratory_numbers(result: Result) -> dict[str, FloatArray]:
    """Return the numbers of the stored states of a result (s,) by name; those that there are."""
    about, histories = result.attributes, result.histories
    volumes = {
        body: result.layers.get(
            f"worn_volume_{body}_layers", histories[f"worn_volume_{body}"][:, None]
        )
        for body in BODIES
        if about[f"law_{body}"]
    }
    return _numbers(
        histories["time"], histories["force"], _normal_work(result), schedule_of(about, "omega"),
        float(about["nominal_area"]), float(about["mean_radius"]), volumes,
        {body: densities_of(result, body) for body in volumes},
    )  # fmt: skip


def end_numbers(
    cases: Sequence[Case], columns: HistoryColumns, normal_work: FloatArray
) -> dict[str, FloatArray]:
    """Return the numbers at the last stored states of B histories on one contact pair, (B,).

    Parameters
    ----------
    cases : theirs.
    columns : theirs, as stored.
    normal_work : (B,) N mm, see ``_numbers``.
    """
    stored, last = np.diff(columns.offsets) > 0, columns.offsets[1:] - 1
    if not stored.any():
        return {}
    volumes, densities = {}, {}
    for i, body in enumerate(BODIES):
        if any(case.laws[i] is not None for case in cases):
            volumes[body] = columns.layers.get(
                f"worn_volume_{body}_layers", columns.histories[f"worn_volume_{body}"][:, None]
            )[last]
            densities[body] = np.array([case.rings[i].densities for case in cases], dtype=float)
    numbers = _numbers(
        columns.histories["time"][last], columns.histories["force"][last], normal_work,
        stack([case.load.omega for case in cases]), cases[0].area, cases[0].mean_radius, volumes,
        densities,
    )  # fmt: skip
    return {name: np.where(stored, values, np.nan) for name, values in numbers.items()}


def _numbers(
    time: FloatArray,
    force: FloatArray,
    normal_work: FloatArray,
    omega: Quantity,
    area: float,
    radius: float,
    volumes: Mapping[BodyName, FloatArray],
    densities: Mapping[BodyName, FloatArray],
) -> dict[str, FloatArray]:
    """Return the numbers of states (s,) of one history, or of the ends of several.

    Parameters
    ----------
    time, force : (s,) s and N.
    normal_work : (s,) N mm, pressure times sliding distance over all places; NaN where unknown.
    omega : rad/s.
    area, radius : of the nominal contact, mm2, and its mean, mm.
    volumes : (s, layers + 1) mm3 of each body that wears, the body itself last.
    densities : (layers + 1,) or (s, layers + 1) g/mm3 of these, NaN where unknown.
    """
    numbers: dict[str, FloatArray] = {}
    for body, volume in volumes.items():
        if not np.isnan(densities[body]).all():
            lost = np.where(volume > 0.0, volume * densities[body], 0.0)  # of nothing: unknown too
            numbers[f"mass_lost_{body}"] = 1e3 * lost.sum(axis=1)
        # by 1e3, mm/h are um/h, and mm3/(N mm) are mm3/(N m)
        worn, hours = 1e3 * volume.sum(axis=1), time / _HOUR
        for name, divisor in (("mean", area * hours), ("specific", normal_work)):
            unknown = np.full(worn.shape, np.nan)
            rate = np.divide(worn, divisor, out=unknown, where=divisor > 0.0)
            numbers[f"{name}_wear_rate_{body}"] = rate
    numbers["sliding_distance"] = 1e-3 * integral(omega, 0.0, time) * radius
    numbers["pressure_velocity"] = 1e-3 * force / area * in_time(omega, time) * radius
    return {name: numbers[name] for name in LABORATORY_NUMBERS if name in numbers}


def densities_of(result: Result, body: BodyName) -> FloatArray:
    """Return the densities of the layers and of a body itself (layers + 1,) g/mm3, or NaN."""
    about, layers = result.attributes, result.layers.get(f"worn_volume_{body}_layers")
    unknown = (np.nan,) * (0 if layers is None else layers.shape[1] - 1)
    layer_densities = about.get(f"density_{body}_layers", unknown)
    return np.array([*layer_densities, about.get(f"density_{body}", np.nan)])


def schedule_of(about: Mapping[str, Any], name: str) -> Quantity:
    """Return friction or omega of a result's attributes, a number or a table in time."""
    if f"{name}_table" in about:
        times, values = zip(*json.loads(about[f"{name}_table"]), strict=True)
        return Table(times, values)
    return float(about[name])


def _normal_work(result: Result) -> FloatArray:
    """Return the work of the pressures over the sliding distance (s,), N mm.

    It is that of the friction energy; where friction is a table, with its mean between states, such
    that the end is what the history knows.
    """
    energy, time = result.histories["dissipated_energy"], result.histories["time"]
    means = mean(schedule_of(result.attributes, "friction"), time[:-1], time[1:])
    with np.errstate(divide="ignore", invalid="ignore"):
        work = np.concatenate([[0.0], np.cumsum(np.diff(energy) / means)])
        if (last := result.checkpoint) is not None and last.state.time == time[-1]:
            work *= last.state.normal_work / work[-1]
            work[-1] = last.state.normal_work  # without friction, too
    return work
