"""The key numbers of a run, one table, and how numbers and times are written."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from ringwear_par.arrays import share
from ringwear_par.cases.case import density_keys
from ringwear_par.contact.problem import ContactState
from ringwear_par.elasticity.sections import BODIES, BodyName
from ringwear_par.errors import InputError
from ringwear_par.history.state import State
from ringwear_par.results.laboratory_numbers import (
    densities_of,
    laboratory_numbers,
)
from ringwear_par.results.result import Result
from ringwear_par.results.variables import EDGE_ERROR, edge_elements

#: longest time, s, that is written in a unit, the unit, and its seconds
_UNITS_OF_TIME = ((7200.0, "s", 1.0), (7 * 86400.0, "h", 3600.0), (np.inf, "days", 86400.0))
#: numbers from which on texts have an exponent
_LARGE = 1e6
BALANCES = "largest relative errors of all steps"
MESH_BALANCES = "relative errors of the boundary elements, smaller on a finer mesh"
TIME_STEPS = "estimated error of wear depth from time steps"
#: share of an approach below which differences of two of them are errors of contact solutions:
#: where nothing wears they are up to 5e-8 on 16 elements, 4e-9 on 24
_ROUND_OFF = 1e-7
#: share of its depth within which wear has reached the end of a layer
_ON = 1e-9
#: balances of results, with their groups and labels
_CHECKED = {
    "residual": (BALANCES, "contact conditions (KKT)"),
    "force": (BALANCES, "contact force against the applied force"),
    "volume": (BALANCES, "worn profiles against integrated rates"),
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


def key_numbers(result: Result) -> list[KeyNumber]:
    """Return the numbers of a run at its last state.

    Raises
    ------
    InputError : the result was stored without its last state.
    """
    if result.checkpoint is None:
        raise InputError(f"{result.name}: holds no last state; must be one of a run")
    state = result.checkpoint.state
    laboratory = {name: float(values[-1]) for name, values in laboratory_numbers(result).items()}
    return [
        *_penetration(result, state),
        *(number for i in (0, 1) for number in _worn(result, state, i, laboratory)),
        *(number for i in (0, 1) for number in _layers(result, state, i)),
        *_pressures(result, state.contact),
        *_loads(result, state.contact, laboratory),
        *_stresses(result, state),
    ]


def _penetration(result: Result, state: State) -> Iterator[KeyNumber]:
    """Yield the penetration and its parts.

    The worn part is the mean of both depths over what presses, the elastic one the rest. Where a
    face is not flat the approach also closes gaps: then there are no parts.
    """
    group, load = "penetration", state.contact.pressure * result.line.area
    error = 1e3 * _ROUND_OFF * float(np.abs(result.histories["approach"]).max())
    total = 1e3 * float(result.histories["penetration"][-1])
    total = total if abs(total) >= error else 0.0
    yield KeyNumber("penetration", group, "total", total, "um")
    if not {"face_lower", "face_upper"} & result.attributes.keys() and load.sum() > 0:
        worn = 1e3 * float(load @ state.wear.sum(axis=0) / load.sum())
        elastic = total - worn if abs(total - worn) >= error else 0.0
        yield KeyNumber("worn_off", group, "worn off", worn, "um")
        yield KeyNumber("elastic", group, "elastic", elastic, "um")


def _worn(
    result: Result, state: State, i: int, laboratory: Mapping[str, float]
) -> Iterator[KeyNumber]:
    """Yield the wear of a body, nothing of one that does not wear."""
    body = BODIES[i]
    if not result.attributes[f"law_{body}"]:
        return
    volume = float(result.histories[f"worn_volume_{body}"][-1])
    deepest = 1e3 * float(state.wear[i].max())
    yield KeyNumber(f"{body}_deepest_wear", body, "deepest wear", deepest, "um")
    yield KeyNumber(f"{body}_worn_volume", body, "worn volume", volume, "mm3")
    mass, missing = laboratory.get(f"mass_lost_{body}", np.nan), _unknown_densities(result, body)
    yield KeyNumber(f"{body}_mass", body, "mass lost", mass, "mg", missing)
    mean, specific = (laboratory[f"{name}_wear_rate_{body}"] for name in ("mean", "specific"))
    if not np.isnan(mean):
        yield KeyNumber(f"{body}_mean_rate", body, "mean rate", mean, "um/h")
        now = 3.6e6 * float(state.rates[i] @ result.line.area) / result.attributes["nominal_area"]
        yield KeyNumber(f"{body}_last_rate", body, "rate at the end", now, "um/h")
    if not np.isnan(specific):
        label = "specific wear rate"
        yield KeyNumber(f"{body}_specific_rate", body, label, specific, "mm3/(N m)")


def _unknown_densities(result: Result, body: BodyName) -> str:
    """Return which densities the mass that a body has lost needs, "" for none."""
    total = result.histories[f"worn_volume_{body}"]
    volumes = np.atleast_1d(result.layers.get(f"worn_volume_{body}_layers", total)[-1])
    keys = density_keys(body, len(volumes) - 1)
    unknown = np.isnan(densities_of(result, body)) & (volumes > 0.0)
    missing = ", ".join(key for key, lacks in zip(keys, unknown, strict=True) if lacks)
    return f"{missing} not given" if missing else ""


def _layers(result: Result, state: State, i: int) -> Iterator[KeyNumber]:
    """Yield the wear of the layers of a body, nothing of one without.

    Time and place of the first wear through a layer are as stored states show them; the time of
    all layers is exact.
    """
    body, line = BODIES[i], result.line
    if f"share_through_{body}" not in result.layers:
        return

    def number(name: str, label: str, value: float, unit: str) -> KeyNumber:
        return KeyNumber(f"{body}_{name}", f"worn layers of {body}", label, value, unit)

    *volumes, itself = result.layers[f"worn_volume_{body}_layers"][-1].tolist()
    for layer, volume in enumerate(volumes):
        yield number(f"volume_layer_{layer}", f"volume of layer {layer}", volume, "mm3")
    yield number("volume_under_layers", "volume of the body itself", itself, "mm3")
    wear, times = result.profiles.get(f"wear_{body}"), result.histories["time"]
    if wear is None or wear.ndim == 1:
        wear, times = state.wear[i][None], state.time[None]
    for layer, end in enumerate(result.data.get(f"layer_end_{body}", ())):
        gone = wear >= end * (1.0 - _ON)
        if gone.any():
            first, label = int(gone.any(axis=1).argmax()), f"area without layer {layer}"
            deepest = int(np.where(gone[first], wear[first] - end, -np.inf).argmax())
            through, percent = f"through_layer_{layer}", 100.0 * share(line.area, gone[-1])
            yield number(f"share_{through}", label, percent, "%")
            yield number(f"time_{through}", f"{label}, first by time", float(times[first]), "s")
            r = float(line.r[deepest])
            yield number(f"r_{through}", f"{label}, first at radius", r, "mm")
    percent = 100.0 * float(result.layers[f"share_through_{body}"][-1])
    yield number("share_through", "area without layers", percent, "%")
    time = float(result.attributes.get(f"time_through_{body}", np.nan))
    if not np.isnan(time):
        yield number("time_through", "area without layers, first at time", time, "s")
    left = 1e3 * np.atleast_2d(result.layers[f"layer_left_{body}"])[-1]
    yield number("least_left", "least thickness left", float(left.min()), "um")
    yield number("most_left", "largest thickness left", float(left.max()), "um")


def _pressures(result: Result, contact: ContactState) -> Iterator[KeyNumber]:
    """Yield the contact pressures."""
    group, p = "pressure", contact.pressure
    mean, touching = float(contact.force) / result.attributes["nominal_area"], int((p > 0.0).sum())
    yield KeyNumber("mean_pressure", group, "mean over the nominal annulus", mean, "MPa")
    note = f"of {result.line.n}" + ("" if touching else ": the faces do not touch")
    if touching:
        place = int(p.argmax())
        r, edge = float(result.line.r[place]), edge_elements(p)[place]
        off = f"at an edge of contact: off by up to {100.0 * EDGE_ERROR:.0f} %" if edge else ""
        largest, smallest = float(p[place]), float(p.min())
        yield KeyNumber("largest_pressure", group, "largest of an element", largest, "MPa", off)
        yield KeyNumber("r_largest_pressure", group, "largest, at radius", r, "mm")
        yield KeyNumber("smallest_pressure", group, "smallest", smallest, "MPa")
    yield KeyNumber("touching", group, "elements in contact", touching, "", note, "d")


def _loads(
    result: Result, contact: ContactState, laboratory: Mapping[str, float]
) -> Iterator[KeyNumber]:
    """Yield approach, force, torque and energy, and the sliding at the mean radius."""
    about, histories = result.attributes, result.histories
    torque, energy = (1e-3 * float(histories[n][-1]) for n in ("torque", "dissipated_energy"))
    yield KeyNumber("force", "load", "force", float(contact.force), "N")
    yield KeyNumber("torque", "load", "torque", torque, "N m")
    yield KeyNumber("dissipated_energy", "load", "dissipated energy", energy, "J")
    yield KeyNumber("approach", "load", "approach", float(contact.approach), "mm")
    speed = float(about["omega"] * about["mean_radius"])
    group = "sliding at the mean radius"
    yield KeyNumber("speed", group, "speed", speed, "mm/s")
    yield KeyNumber("p_v", group, "p V", laboratory["pressure_velocity"], "MPa m/s")
    yield KeyNumber("distance", group, "distance", laboratory["sliding_distance"], "m")


def _stresses(result: Result, last: State) -> Iterator[KeyNumber]:
    """Yield the largest stress of each body and its layers at the last state that has stresses."""
    if (history := result.stress) is None or not history.states:
        return
    state = history.states[-1]
    beside_edge = edge_elements(last.contact.pressure) & (state.time == last.time)
    group = "largest von Mises stress"
    if state.time != result.histories["time"][-1]:
        group += f" at t = {state.time:g} s"
    if history.exclude:
        group += f", {history.exclude:g} mm and more from edges"
    for body, largest, layers in zip(BODIES, state.largest, state.layers, strict=True):
        if np.isfinite(largest.mises):
            place = f"at r = {largest.r:.6g}, z = {largest.z:.6g} mm"
            element = int(result.line.element_at(np.array([largest.r]))[0])
            if element >= 0 and beside_edge[element]:
                place += ", at an edge of contact"
            yield KeyNumber(f"{body}_mises", group, body, largest.mises, "MPa", place)
        for i, value in enumerate(np.asarray(layers).tolist()):
            label = f"layer {i} of {body}" if i < len(layers) - 1 else f"{body} itself"
            note = "nothing of it is left there" if np.isnan(value) else ""
            yield KeyNumber(f"{body}_mises_{i}", group, label, value, "MPa", note)


def check_numbers(result: Result) -> list[KeyNumber]:
    """Return the errors of a run, the worst of all its steps."""
    about, off = result.attributes, result.balances
    numbers = [
        KeyNumber(f"balance_{name}", group, label, off[name], spec=".1e")
        for name, (group, label) in _CHECKED.items()
        if name in off and (name != "energy" or about["energy_identity"])
    ]
    label, defect = "asymmetry of the compliance matrix", float(about["symmetry_defect"])
    note = "corrected for"
    numbers.append(KeyNumber("symmetry_defect", MESH_BALANCES, label, defect, "", note, ".1e"))
    if "step_error" in off:
        label, note = "of the whole history", "without that of the mesh"
        if about["closing_contact"]:
            note += ", and of elements that come into contact"
        error = 1e3 * off["step_error"]
        numbers.append(KeyNumber("step_error", TIME_STEPS, label, error, "um", note, ".2g"))
    return numbers
