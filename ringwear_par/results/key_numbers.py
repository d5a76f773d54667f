"""Numbers of a run: those of laboratories at all stored states, key numbers, and its summary."""

import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.cases.case import SAME_TIME, Case, density_keys
from ringwear_par.elasticity.sections import BODIES, BodyName
from ringwear_par.errors import LONGEST_SENTENCE, counted, legible, warning_lines
from ringwear_par.results.result import Result
from ringwear_par.results.variables import (
    EDGE_ERROR,
    HISTORIES,
    LABORATORY_NUMBERS,
    edge_elements,
)
from ringwear_par.schedules import Quantity, Table

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
#: balances of results, with their groups and labels, and how large they may be where equations are
#: satisfied; eq. (3) itself blocks solve to a part of the tolerance of wear
_CHECKED = {
    "residual": (BALANCES, "contact conditions, eq. (3)", 5e-2),
    "force": (BALANCES, "contact force against the applied force", 1e-6),
    "energy": (BALANCES, "worn volume against friction energy", 1e-6),
    "reaction": (MESH_BALANCES, "force on the held faces", np.inf),
    "torque": (MESH_BALANCES, "torque on the held faces", np.inf),
}
#: letters of the first column of lines
_LABEL = 13


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


def laboratory_numbers(
    cases: Sequence[Case], number: IntArray, data: Mapping[str, Any]
) -> dict[str, FloatArray]:
    """Return the masses lost and the rates of wear since the start of some states, (s,) by name.

    Parameters
    ----------
    cases : of histories on one contact line.
    number : (s,) which of their histories the states are of.
    data : stored variables of the states; NaN in the results is unknown.
    """
    numbers: dict[str, FloatArray] = {}
    for i, body in enumerate(BODIES):
        if not cases[0].laws[i]:
            continue
        volume = _volumes(data, body)
        density = np.array([case.rings[i].densities for case in cases], dtype=float)
        if not np.isnan(density).all():
            lost = np.where(volume > 0.0, volume * density[number], 0.0)  # of nothing: unknown too
            numbers[f"mass_lost_{body}"] = 1e3 * lost.sum(axis=1)
        # by 1e3, mm/h are um/h, and mm3/(N mm) are mm3/(N m)
        worn, hours = 1e3 * volume.sum(axis=1), data["time"] / _HOUR
        divisors = {"mean": cases[0].area * hours, "specific": data["normal_work"]}
        for name, divisor in divisors.items():
            unknown = np.full(worn.shape, np.nan)
            rate = np.divide(worn, divisor, out=unknown, where=divisor > 0.0)
            numbers[f"{name}_wear_rate_{body}"] = rate
    return numbers


def _volumes(data: Mapping[str, Any], body: BodyName) -> FloatArray:
    """Return the volumes (s, layers + 1), mm3, lost by the layers of a body and by itself."""
    layers = data.get(f"worn_volume_{body}_layers")
    return data[f"worn_volume_{body}"][:, None] if layers is None else layers


def _densities(result: Result, body: BodyName) -> FloatArray:
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

    #: for programs; the numbers that it is printed with, and its own name among them
    name: str
    group: str
    label: str
    #: in ``unit``; NaN where there is none
    value: float
    unit: str = ""
    #: what is printed in brackets after it; the format of the number, "" for four digits
    note: str = ""
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
    """Return the numbers of a run at its last state."""
    state, about = result.last_state, result.attributes
    names = {**HISTORIES, **LABORATORY_NUMBERS}.keys() & result.data.keys()
    ends = {name: float(result.data[name][-1]) for name in names}
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
    unknown = np.isnan(_densities(result, body)) & (volumes > 0.0)
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
        for name, (group, label, _) in _CHECKED.items()
        if name in off and (name != "energy" or about["energy_identity"])
    ]
    label, defect = "asymmetry of the compliance matrix", float(about["symmetry_defect"])
    numbers.append(KeyNumber("symmetry_defect", MESH_BALANCES, label, defect, spec=".1e"))
    if "step_error" in off:
        label, note = "of the whole history", "without that of the mesh"
        error = 1e3 * off["step_error"]
        numbers.append(KeyNumber("step_error", TIME_STEPS, label, error, "um", note, ".2g"))
    return numbers


# -- in words --------------------------------------------------------------------------------------


def labelled(lines: Iterable[tuple[str, str]]) -> list[str]:
    """Return lines of a summary: what it is, and the answer behind it."""
    return [f"{label.ljust(_LABEL)}{text}" for label, text in lines]


def summary(result: Result) -> str:
    """Return a result in a few lines, see ``Result.summary``."""
    numbers = {number.name: number for number in key_numbers(result)}
    warnings, (wrong, errors) = warnings_of(result), checks(result)
    words = [f"{counted(len(warnings), 'warning')}, above"] if warnings else []
    words += [f"wrong: {', '.join(wrong)}"] if wrong else []
    answers = [*_answers(result, numbers), ("checks", f"{'; '.join(words) or 'ok'} ({errors})")]
    lines = [*warning_lines(warnings), *labelled(answers)]
    return "\n".join(legible(line, LONGEST_SENTENCE) for line in lines)


def _answers(result: Result, numbers: Mapping[str, KeyNumber]) -> Iterator[tuple[str, str]]:
    """Yield the answers of a run, one a line, with four digits."""

    def text(name: str, words: str = "{}") -> str:
        """Return a number within words, "" where there is none."""
        if (number := numbers.get(name)) is None:
            return ""
        if not number.known:
            return words.format(f"{number.label} unknown ({number.note})")
        return words.format(f"{number.text} {number.unit}".strip())

    if early := early_end(result):
        yield "ended", early
    parts = text("worn_off", " (worn off {}") + text("elastic", ", elastic {})")
    yield "penetration", text("penetration") + parts
    worn, rates = [], []
    for body in BODIES:
        if f"{body}_worn_volume" not in numbers:
            continue
        mass = text(f"{body}_mass", ", {}") if f"mass_lost_{body}" in result.data else ""
        deepest = text(f"{body}_deepest_wear", ", {} at most")
        through = text(f"{body}_share_through", ", {} of its area without layers")
        worn.append(f"{body} {text(f'{body}_worn_volume')}{mass}{deepest}{through}")
        specific = text(f"{body}_specific_rate", ", {} over the test")
        rates.append(text(f"{body}_last_rate", f"{body} {{}} at the end") + specific)
    yield "worn", "; ".join(worn) or "nothing wears"
    yield "wear rate", "; ".join(filter(None, rates)) or "none"
    where = text("r_largest_pressure", " at most (r = {})")
    largest = text("largest_pressure", f"{{}}{where}, ")
    elements = f"{text('touching')} of {result.line.n} elements touch"
    elements += "" if largest else ": the faces do not touch"
    yield "pressure", f"{text('mean_pressure')} mean, {largest}{elements}"
    energy = text("dissipated_energy")
    yield "torque", f"{text('torque')}, force {text('force')}, friction energy {energy}"


def early_end(result: Result) -> str:
    """Return where a limit ended a history before its time, "" if none did."""
    about, ended = result.attributes, float(result.data["time"][-1])
    if about["status"] != "complete" or ended >= about["time_end"] * (1.0 - SAME_TIME):
        return ""
    limit = about.get("stopped_by", "a limit of [stop]")
    return f"at t = {ended:g} of {about['time_end']:g} s, where it reached {limit}"


def checks(result: Result) -> tuple[list[str], str]:
    """Return balances that are not what the equations say, and the largest errors, in words."""
    numbers, most = check_numbers(result), {f"balance_{n}": of[2] for n, of in _CHECKED.items()}
    wrong = [f"{n.label} {n.text}" for n in numbers if n.value > most.get(n.name, np.inf)]
    worst = {BALANCES: 0.0, MESH_BALANCES: 0.0, TIME_STEPS: 0.0}
    for number in numbers:
        worst[number.group] = max(number.value, worst[number.group])
    words = [f"balances to {worst[BALANCES]:.0e}", f"mesh to {worst[MESH_BALANCES]:.0e}"]
    words += [f"time steps to {n.text} {n.unit} in all" for n in numbers if n.group == TIME_STEPS]
    return wrong, ", ".join(words)


def to_dict(result: Result) -> dict[str, Any]:
    """Return title, status, warnings and numbers, see ``Result.to_dict``."""
    numbers = [*key_numbers(result), *check_numbers(result)]
    return {
        **{name: result.attributes[name] for name in ("title", "status", "error")},
        "doubts": [doubt.to_dict() for doubt in result.doubts],
        "warnings": [doubt.text for doubt in result.doubts],
        "numbers": {
            n.name: {"value": n.value if n.known else None, "unit": n.unit} for n in numbers
        },
    }


def warnings_of(result: Result) -> list[str]:
    """Return how far a history is that has not come to its end, and what is doubted, in words."""
    about, sentences = result.attributes, []
    if about["status"] != "complete":
        time = f"t = {result.data['time'][-1]:g} of {about['time_end']:g} s"
        where = f"step {result.step[-1]}, {time}"
        sentences.append(
            f"failed after {where}: {about['error']}"
            if about["error"]
            else f"stopped after {where}: ringwear run --restart continues it"
        )
    sentences += [doubt.text for doubt in result.doubts]
    for body in BODIES if result.data["dissipated_energy"][-1] > 0.0 else ():
        law = about[f"law_{body}"]
        if law and result.data[f"worn_volume_{body}"][-1] == 0.0:
            reason = f"its pressures never reach what wears, by {law}"
            sentences.append(f"nothing of {body} is worn off: {reason}")
    return sentences
