"""Numbers of a run: those of laboratories at all stored states, and the key numbers at its end."""

import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.cases.case import Case, density_keys
from ringwear_par.elasticity.sections import BODIES, BodyName
from ringwear_par.results.result import Result
from ringwear_par.results.variables import EDGE_ERROR, edge_elements
from ringwear_par.schedules import Quantity, Schedules, Table, in_time, integral

_HOUR = 3600.0
#: longest time, s, that is written in a unit, the unit, and its seconds
_UNITS_OF_TIME = ((7200.0, "s", 1.0), (7 * 86400.0, "h", _HOUR), (np.inf, "days", 86400.0))
#: numbers from which on texts have an exponent
_LARGE = 1e6
#: share of an approach below which differences of two of them are errors of contact solutions:
#: where nothing wears they are up to 5e-8 on 16 elements, 4e-9 on 24
_ROUND_OFF = 1e-7
#: groups of checks
BALANCES = "largest relative errors of all steps"
MESH_BALANCES = "relative errors of the boundary elements, smaller on a finer mesh"
TIME_STEPS = "estimated error of wear depth from time steps"
#: balances of results, with their groups and labels
_CHECKED = {
    "residual": (BALANCES, "contact conditions, eq. (3)"),
    "force": (BALANCES, "contact force against the applied force"),
    "energy": (BALANCES, "worn volume against friction energy"),
    "reaction": (MESH_BALANCES, "force on the held faces"),
    "torque": (MESH_BALANCES, "torque on the held faces"),
}


def time_unit(end: float) -> tuple[str, float]:
    """Return the unit in which times up to an end, s, are written, and its seconds."""
    return next((name, seconds) for most, name, seconds in _UNITS_OF_TIME if end <= most)


def number_words(value: float) -> str:
    """Return a number in four digits."""
    return f"{value:.0f}" if 1e3 <= abs(value) < _LARGE else f"{value:.4g}"


def time_words(time: float, end: float) -> str:
    """Return a time, s, of a history in words; its end, s, chooses the unit."""
    unit, seconds = time_unit(end)
    return f"{number_words(time / seconds)} {unit}"


# -- numbers of laboratories -----------------------------------------------------------------------


def laboratory_numbers(result: Result) -> dict[str, FloatArray]:
    """Return the numbers of the stored states of a result (s,) by name; those that there are."""
    about = result.attributes
    densities = {body: densities_of(result, body) for body in BODIES if about[f"law_{body}"]}
    omega, time = schedule_of(about, "omega"), result.data["time"]
    return _numbers(
        result.data, slice(None), in_time(omega, time), integral(omega, 0.0, time),
        about["nominal_area"], about["mean_radius"], densities,
    )  # fmt: skip


def end_numbers(
    cases: Sequence[Case], data: Mapping[str, Any], offsets: IntArray
) -> dict[str, FloatArray]:
    """Return the numbers at the last stored states of B histories on one contact pair, (B,).

    Parameters
    ----------
    data, offsets : see ``HistoryColumns``.
    """
    stored, last = np.diff(offsets) > 0, offsets[1:] - 1
    if not stored.any():
        return {}
    densities = {
        body: np.array([case.rings[i].densities for case in cases], dtype=float)
        for i, body in enumerate(BODIES)
        if any(case.laws[i] for case in cases)
    }
    omega, time = Schedules.of([c.load.omega for c in cases]), data["time"][last]
    numbers = _numbers(
        data, last, omega.at(time), omega.integral(time), cases[0].area, cases[0].mean_radius,
        densities,
    )  # fmt: skip
    return {name: np.where(stored, values, np.nan) for name, values in numbers.items()}


def _numbers(
    data: Mapping[str, Any],
    rows: Any,
    omega: FloatArray,
    angle: FloatArray,
    area: float,
    radius: float,
    densities: Mapping[BodyName, FloatArray],
) -> dict[str, FloatArray]:
    """Return the numbers of states (s,) of one history, or of the ends of several.

    Parameters
    ----------
    data, rows : stored variables by name, and which of their rows are of these states.
    omega, angle : (s,) rad/s, and rad turned since the start.
    area, radius : of the nominal contact, mm2, and its mean, mm.
    densities : (layers + 1,) or (s, layers + 1) g/mm3 of each body that wears, NaN where unknown.
    """
    numbers: dict[str, FloatArray] = {}
    time, force = data["time"][rows], data["force"][rows]
    for body, density in densities.items():
        volume = _volumes(data, body)[rows]
        if not np.isnan(density).all():
            lost = np.where(volume > 0.0, volume * density, 0.0)  # of nothing: unknown too
            numbers[f"mass_lost_{body}"] = 1e3 * lost.sum(axis=1)
        # by 1e3, mm/h are um/h, and mm3/(N mm) are mm3/(N m)
        worn, hours = 1e3 * volume.sum(axis=1), time / _HOUR
        for name, divisor in (("mean", area * hours), ("specific", data["normal_work"][rows])):
            unknown = np.full(worn.shape, np.nan)
            rate = np.divide(worn, divisor, out=unknown, where=divisor > 0.0)
            numbers[f"{name}_wear_rate_{body}"] = rate
    numbers["sliding_distance"] = 1e-3 * angle * radius
    numbers["pressure_velocity"] = 1e-3 * force / area * omega * radius
    return numbers


def _volumes(data: Mapping[str, Any], body: BodyName) -> FloatArray:
    """Return the volumes (s, layers + 1), mm3, lost by the layers of a body and by itself."""
    layers = data.get(f"worn_volume_{body}_layers")
    return data[f"worn_volume_{body}"][:, None] if layers is None else layers


def densities_of(result: Result, body: BodyName) -> FloatArray:
    """Return the densities of the layers and of a body itself (layers + 1,) g/mm3, or NaN."""
    about, unknown = result.attributes, [np.nan] * (_volumes(result.data, body).shape[1] - 1)
    layers = about.get(f"density_{body}_layers", unknown)
    return np.array([*layers, about.get(f"density_{body}", np.nan)])


def schedule_of(about: Mapping[str, Any], name: str) -> Quantity:
    """Return friction or omega of a result's attributes, a number or a table in time."""
    if f"{name}_table" in about:
        times, values = zip(*json.loads(about[f"{name}_table"]), strict=True)
        return Table(times, values)
    return float(about[name])


# -- key numbers -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class KeyNumber:
    """A number of a run and how it is printed."""

    #: for programs
    name: str
    #: the numbers that it is printed with
    group: str
    #: its own name within the group
    label: str
    #: in ``unit``; NaN where there is none
    value: float
    unit: str = ""
    #: what is printed in brackets after it
    note: str = ""
    #: the format of the number; "" for four digits
    spec: str = ""

    @property
    def known(self) -> bool:
        """Whether there is one."""
        return not math.isnan(self.value)

    @property
    def text(self) -> str:
        """The number as it is printed, without its unit."""
        if not self.known:
            return "none"
        return format(self.value, self.spec) if self.spec else number_words(self.value)


#: name, label, value, unit and note of a number, the last two if there are any
_Row = tuple[Any, ...]


def _group(group: str, rows: Iterable[_Row]) -> list[KeyNumber]:
    """Return the numbers of a group; those that are not known and have no note are left out."""
    numbers = [KeyNumber(name, group, label, float(v), *rest) for name, label, v, *rest in rows]
    return [number for number in numbers if number.known or number.note]


def key_numbers(result: Result) -> list[KeyNumber]:
    """Return the numbers of a run at its last state.

    Raises
    ------
    InputError : the result was stored without its last state.
    """
    state, about = result.last_state, result.attributes
    ends = {name: float(values[-1]) for name, values in result.histories.items()}
    ends |= {name: float(values[-1]) for name, values in laboratory_numbers(result).items()}
    wearing = [body for body in BODIES if about[f"law_{body}"]]
    pressure = state.pressure[0]
    numbers = _group("penetration", _penetration(result, pressure, state.wear[:, 0].sum(axis=0)))
    for body, wear, rates in zip(wearing, state.wear[:, 0], state.rates[:, 0], strict=True):
        numbers += _group(body, _worn(result, body, wear, rates, ends))
    for body in BODIES:
        numbers += _group(f"worn layers of {body}", _layers(result, body))
    numbers += _group("pressure", _pressures(result, pressure))
    numbers += _group("load", (
        ("force", "force", ends["force"], "N"),
        ("torque", "torque", 1e-3 * ends["torque"], "N m"),
        ("dissipated_energy", "dissipated energy", 1e-3 * ends["dissipated_energy"], "J"),
        ("approach", "approach", ends["approach"], "mm"),
    ))  # fmt: skip
    numbers += _group("sliding at the mean radius", (
        ("speed", "speed", about["omega"] * about["mean_radius"], "mm/s"),
        ("p_v", "p V", ends["pressure_velocity"], "MPa m/s"),
        ("distance", "distance", ends["sliding_distance"], "m"),
    ))  # fmt: skip
    return numbers + _stresses(result)


def _penetration(result: Result, pressure: FloatArray, wear: FloatArray) -> Iterator[_Row]:
    """Yield the penetration and its parts.

    The worn part is the mean of both depths over what presses, the elastic one the rest. Where a
    face is not flat the approach also closes gaps: then there are no parts.
    """
    load = pressure * result.line.area
    least = _ROUND_OFF * np.abs(result.data["approach"]).max()

    def shown(depth: float) -> float:
        return 1e3 * depth if abs(depth) >= least else 0.0

    total = float(result.data["penetration"][-1])
    yield "penetration", "total", shown(total), "um"
    if not {"face_lower", "face_upper"} & result.attributes.keys() and load.sum() > 0:
        worn = float(load @ wear / load.sum())
        yield "worn_off", "worn off", 1e3 * worn, "um"
        yield "elastic", "elastic", shown(total - worn), "um"


def _worn(
    result: Result, body: BodyName, wear: FloatArray, rates: FloatArray, ends: Mapping[str, float]
) -> Iterator[_Row]:
    """Yield the wear of a body that wears."""
    volumes = _volumes(result.data, body)[-1]
    unknown = np.isnan(densities_of(result, body)) & (volumes > 0.0)
    keys = density_keys(body, len(volumes) - 1)
    missing = ", ".join(key for key, lacks in zip(keys, unknown, strict=True) if lacks)
    mass, mean_rate = ends.get(f"mass_lost_{body}", np.nan), ends[f"mean_wear_rate_{body}"]
    now = 3.6e6 * float(rates @ result.line.area) / result.attributes["nominal_area"]
    yield f"{body}_deepest_wear", "deepest wear", 1e3 * wear.max(), "um"
    yield f"{body}_worn_volume", "worn volume", ends[f"worn_volume_{body}"], "mm3"
    yield f"{body}_mass", "mass lost", mass, "mg", f"{missing} not given" if missing else ""
    yield f"{body}_mean_rate", "mean rate", mean_rate, "um/h"
    yield f"{body}_last_rate", "rate at the end", np.nan if np.isnan(mean_rate) else now, "um/h"
    specific = ends[f"specific_wear_rate_{body}"]
    yield f"{body}_specific_rate", "specific wear rate", specific, "mm3/(N m)"


def _layers(result: Result, body: BodyName) -> Iterator[_Row]:
    """Yield the wear of the layers of a body, nothing of one without."""
    data = result.data
    if f"share_through_{body}" not in data:
        return
    *volumes, itself = data[f"worn_volume_{body}_layers"][-1].tolist()
    for layer, volume in enumerate(volumes):
        yield f"{body}_volume_layer_{layer}", f"volume of layer {layer}", volume, "mm3"
    yield f"{body}_volume_under_layers", "volume of the body itself", itself, "mm3"
    label, percent = "area without layers", 100.0 * data[f"share_through_{body}"][-1]
    yield f"{body}_share_through", label, percent, "%"
    time = result.attributes.get(f"time_through_{body}", np.nan)
    yield f"{body}_time_through", f"{label}, first at time", time, "s"
    left = 1e3 * np.atleast_2d(data[f"layer_left_{body}"])[-1]
    yield f"{body}_least_left", "least thickness left", left.min(), "um"


def _pressures(result: Result, p: FloatArray) -> Iterator[_Row]:
    """Yield the contact pressures."""
    touching, note = int((p > 0.0).sum()), f"of {result.line.n}"
    mean_pressure = result.data["force"][-1] / result.attributes["nominal_area"]
    yield "mean_pressure", "mean over the nominal annulus", mean_pressure, "MPa"
    if touching:
        place = int(p.argmax())
        off = f"at an edge of contact: off by up to {100.0 * EDGE_ERROR:.0f} %"
        off *= bool(edge_elements(p)[place])
        yield "largest_pressure", "largest of an element", p[place], "MPa", off
        yield "r_largest_pressure", "largest, at radius", result.line.r[place], "mm"
    else:
        note += ": the faces do not touch"
    yield "touching", "elements in contact", touching, "", note, ".0f"


def _stresses(result: Result) -> list[KeyNumber]:
    """Return the largest stress of each body and its layers at the last state that has stresses."""
    if "stress_time" not in (data := result.data):
        return []
    rows, group = list[_Row](), "largest von Mises stress"
    if (time := data["stress_time"][-1]) != data["time"][-1]:
        group += f" at t = {time:g} s"
    if exclude := float(data["stress_exclude"]):
        group += f", {exclude:g} mm and more from edges"
    for body in BODIES:
        largest, r, z = (data[f"max_mises_{body}{end}"][-1] for end in ("", "_r", "_z"))
        if np.isfinite(largest):
            place = f"at r = {r:.6g}, z = {z:.6g} mm"
            rows.append((f"{body}_mises", body, largest, "MPa", place))
        layers = data.get(f"max_mises_{body}_layers", [()])[-1]
        for i, value in enumerate(layers):
            label = f"layer {i} of {body}" if i < len(layers) - 1 else f"{body} itself"
            note = "nothing of it is left there" if np.isnan(value) else ""
            rows.append((f"{body}_mises_{i}", label, value, "MPa", note))
    return _group(group, rows)


def check_numbers(result: Result) -> list[KeyNumber]:
    """Return the errors of a run, the worst of all its steps."""
    about, off = result.attributes, result.balances
    numbers = [
        KeyNumber(f"balance_{name}", group, label, off[name], spec=".1e")
        for name, (group, label) in _CHECKED.items()
        if name in off and (name != "energy" or about["energy_identity"])
    ]
    label, defect = "asymmetry of the compliance matrix", float(about["symmetry_defect"])
    numbers.append(KeyNumber("symmetry_defect", MESH_BALANCES, label, defect, spec=".1e"))
    if "step_error" in off:
        label, note = "of the whole history", "without that of the mesh"
        error = 1e3 * off["step_error"]
        numbers.append(KeyNumber("step_error", TIME_STEPS, label, error, "um", note, ".2g"))
    return numbers
