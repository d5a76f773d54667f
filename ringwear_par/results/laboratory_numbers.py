"""The numbers of laboratories, one table: mass lost, rates of wear, sliding distance, p V.

They follow from what is stored of a history, so that files do not store them at every state.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import Case
from ringwear_par.elasticity.sections import BODIES, BodyName
from ringwear_par.results.result import HistoryColumns, Result
from ringwear_par.results.variables import Variable
from ringwear_par.schedules import Quantity, Table, in_time, integral, mean, stack

_HOUR = 3600.0


@dataclass(frozen=True)
class LaboratoryInputs:
    """What laboratory numbers follow from: states of one history, or the ends of several."""

    #: (s,) s
    time: FloatArray
    #: (s,) N
    force: FloatArray
    #: (s,) N mm, pressure times sliding distance, over all places; NaN where it is not known
    normal_work: FloatArray
    #: (s,) rad, slid so far, and rad/s
    angle: FloatArray
    omega: FloatArray
    #: mm2, and mm
    area: float
    mean_radius: float
    #: (s, layers + 1) mm3 of lower and upper, the body itself last; None of what does not wear
    volumes: tuple[FloatArray | None, FloatArray | None]
    #: (layers + 1,) or (s, layers + 1) g/mm3, NaN where unknown
    densities: tuple[FloatArray, FloatArray]


def _worn(body: int, inputs: LaboratoryInputs) -> FloatArray | None:
    volumes = inputs.volumes[body]
    return None if volumes is None else volumes.sum(axis=1)


def _mass(body: int, inputs: LaboratoryInputs) -> FloatArray | None:
    volumes, densities = inputs.volumes[body], inputs.densities[body]
    if volumes is None or np.isnan(densities).all():
        return None
    lost = np.where(volumes > 0.0, volumes * densities, 0.0)  # nothing lost needs no density
    return 1e3 * lost.sum(axis=1)


def _volume_over(body: int, inputs: LaboratoryInputs, divisor: FloatArray) -> FloatArray | None:
    """Return the worn volume of a body over a divisor, times 1e3; NaN where that is not positive.

    By 1e3, mm/h are um/h, and mm3/(N mm) are mm3/(N m).
    """
    volume = _worn(body, inputs)
    if volume is None:
        return None
    rates = np.full(volume.shape, np.nan)
    return np.divide(1e3 * volume, divisor, out=rates, where=divisor > 0.0)


@dataclass(frozen=True)
class LaboratoryNumber:
    """A number that laboratories report: its variable, and its name among the key numbers."""

    variable: Variable
    #: name and group of the key number, and its own name within the group
    key: str
    group: str
    label: str
    #: computes it; None where there is none
    values: Callable[[LaboratoryInputs], FloatArray | None]

    def at_end(self) -> Variable:
        """Return the variable of the end of a history."""
        return replace(self.variable, dimensions=())


def _of_bodies(
    name: str, key: str, label: str, unit: str, meaning: str,
    values: Callable[[int, LaboratoryInputs], FloatArray | None],
) -> list[LaboratoryNumber]:  # fmt: skip
    return [
        LaboratoryNumber(
            Variable(f"{name}_{body}", ("step",), unit, meaning.format(body)),
            f"{body}_{key}", body, label, partial(values, i),
        )
        for i, body in enumerate(BODIES)
    ]  # fmt: skip


SLIDING = "sliding at the mean radius"
#: by name
LABORATORY_NUMBERS = {
    number.variable.name: number
    for number in (
        *_of_bodies(
            "mass_lost", "mass", "mass lost", "mg",
            "mass lost by the {} ring, by its density; nothing where that is not given", _mass,
        ),
        *_of_bodies(
            "mean_wear_rate", "mean_rate", "mean rate", "um/h",
            "mean rate of wear of the {} ring since the start: volume over contact area and time",
            lambda body, inputs: _volume_over(body, inputs, inputs.area * inputs.time / _HOUR),
        ),
        *_of_bodies(
            "specific_wear_rate", "specific_rate", "specific wear rate", "mm3/(N m)",
            "specific wear rate of the {} ring since the start: volume over force and distance",
            lambda body, inputs: _volume_over(body, inputs, inputs.normal_work),
        ),
        LaboratoryNumber(
            Variable("sliding_distance", ("step",), "m", "sliding distance at the mean radius"),
            "distance", SLIDING, "distance", lambda c: 1e-3 * c.angle * c.mean_radius,
        ),
        LaboratoryNumber(
            Variable(
                "pressure_velocity", ("step",), "MPa m/s",
                "p V: mean pressure on the nominal area times speed at the mean radius",
            ),
            "p_v", SLIDING, "p V", lambda c: 1e-3 * c.force / c.area * c.omega * c.mean_radius,
        ),
    )
}  # fmt: skip


def laboratory_numbers(inputs: LaboratoryInputs) -> dict[str, FloatArray]:
    """Return the numbers of states (s,) by name; those that there are."""
    numbers = {name: number.values(inputs) for name, number in LABORATORY_NUMBERS.items()}
    return {name: values for name, values in numbers.items() if values is not None}


def laboratory_inputs(result: Result) -> LaboratoryInputs:
    """Return the inputs of the numbers of a result, (stored states,) each."""
    about, histories = result.attributes, result.histories
    time, omega = histories["time"], schedule_of(about, "omega")
    volumes, densities = [], []
    for body in BODIES:
        layers = result.layers.get(f"worn_volume_{body}_layers")
        volume = histories[f"worn_volume_{body}"][:, None] if layers is None else layers
        volumes.append(volume if about[f"law_{body}"] else None)
        densities.append(densities_of(result, body))
    return LaboratoryInputs(
        time, histories["force"], _normal_work(result), integral(omega, 0.0, time),
        in_time(omega, time), float(about["nominal_area"]), float(about["mean_radius"]),
        (volumes[0], volumes[1]), (densities[0], densities[1]),
    )  # fmt: skip


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
    friction, last = schedule_of(result.attributes, "friction"), result.checkpoint
    means = mean(friction, time[:-1], time[1:])
    with np.errstate(divide="ignore", invalid="ignore"):
        work = np.concatenate([[0.0], np.cumsum(np.diff(energy) / means)])
        if last is not None and last.state.time == time[-1]:
            end = float(last.state.normal_work)
            work *= end / work[-1] if isinstance(friction, Table) else 1.0
            work[-1] = end
    return work


def end_numbers(
    cases: Sequence[Case], columns: HistoryColumns, normal_work: FloatArray
) -> dict[str, FloatArray]:
    """Return the numbers at the last stored states of B histories on one contact pair, (B,).

    Parameters
    ----------
    cases : theirs.
    columns : theirs, as stored.
    normal_work : (B,) N mm, see ``LaboratoryInputs``.
    """
    stored = np.diff(columns.offsets) > 0
    last = columns.offsets[1:][stored] - 1
    known = [case for case, some in zip(cases, stored.tolist(), strict=True) if some]
    if not known:
        return {}
    time, omega = columns.histories["time"][last], stack([c.load.omega for c in known])
    volumes, densities = [], []
    for i, body in enumerate(BODIES):
        layers = columns.layers.get(f"worn_volume_{body}_layers")
        volume = columns.histories[f"worn_volume_{body}"][:, None] if layers is None else layers
        volumes.append(volume[last] if any(case.laws[i] is not None for case in known) else None)
        case_densities = [[np.nan if d is None else d for d in c.rings[i].densities] for c in known]
        densities.append(np.array(case_densities))
    inputs = LaboratoryInputs(
        time, columns.histories["force"][last], normal_work[stored], integral(omega, 0.0, time),
        in_time(omega, time), known[0].area, known[0].mean_radius, (volumes[0], volumes[1]),
        (densities[0], densities[1]),
    )  # fmt: skip
    numbers = {}
    for name, values in laboratory_numbers(inputs).items():
        numbers[name] = np.full(len(cases), np.nan)
        numbers[name][stored] = values
    return numbers
