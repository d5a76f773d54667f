"""The key numbers of a run, one table; what summaries and pictures call numbers and instants."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import density_keys
from ringwear_par.contact.problem import ContactState
from ringwear_par.elasticity.sections import BODIES, BodyName
from ringwear_par.errors import InputError
from ringwear_par.history.state import State
from ringwear_par.results.laboratory_numbers import (
    LABORATORY_NUMBERS,
    SLIDING,
    densities_of,
    laboratory_inputs,
    laboratory_numbers,
)
from ringwear_par.results.layers import worn_layers
from ringwear_par.results.result import Result
from ringwear_par.results.variables import EDGE_ERROR, edge_elements

#: longest time, s, that is written in a unit, the unit, and its seconds
_UNITS_OF_TIME = ((7200.0, "s", 1.0), (7 * 86400.0, "h", 3600.0), (np.inf, "days", 86400.0))
_QUARTERS = 4
#: numbers from which on texts have an exponent
_LARGE = 1e6
#: end of a scale of pressures over the highest one that is drawn
_ROOM = 1.1


def time_unit(end: float) -> tuple[str, float]:
    """Return the unit in which times up to an end, s, are written, and its seconds."""
    return next((name, seconds) for most, name, seconds in _UNITS_OF_TIME if end <= most)


def number_words(value: float) -> str:
    """Return a number in four digits, as legends and notes have room for it."""
    return f"{value:.0f}" if 1e3 <= abs(value) < _LARGE else f"{value:.4g}"


def time_words(time: float, end: float) -> str:
    """Return a time of a history, s, as all legends call it.

    Parameters
    ----------
    end : s, of the history, which chooses the unit.
    """
    unit, seconds = time_unit(end)
    return f"{number_words(time / seconds)} {unit}"


def instants(times: Sequence[float], end: float) -> list[str]:
    """Return times of a history, s, as round as a hundredth of its end tells them apart.

    Where that is too round, as ``time_words``.
    """
    unit, seconds = time_unit(end)
    end_digits = 2 - math.floor(math.log10(end / seconds)) if end > 0.0 else 0
    words = []
    for time in times:
        digits = max(end_digits, 1 - math.floor(math.log10(time / seconds)), 0) if time > 0.0 else 0
        words.append(f"{number_words(round(time / seconds, digits))} {unit}")
    return words if len(set(words)) == len(words) else [time_words(time, end) for time in times]


def stages(time: FloatArray) -> list[int]:
    """Return the states that profiles are drawn of by default: the first step, four quarters.

    Parameters
    ----------
    time : (s,) float, s, of the stored states.
    """
    instants = [time[min(1, len(time) - 1)], *(time[-1] * q / _QUARTERS for q in range(1, 5))]
    return sorted({int(np.abs(time - t).argmin()) for t in instants})


def pressure_limit(area: FloatArray, pressure: FloatArray, force: FloatArray) -> float:
    """Return the pressure, MPa, that scales of some states end with at most.

    Edges of the first instant are infinite: three times the highest mean over what touches.

    Parameters
    ----------
    area : (n,) float, mm2, of the contact elements.
    pressure : (s, n) float, MPa.
    force : (s,) float, N.
    """
    touched = (pressure > 0.0) @ area
    return 3.0 * float((force / np.where(touched > 0.0, touched, np.inf)).max())


@dataclass(frozen=True)
class PressurePeak:
    """The highest contact pressure of a history, of all its stored states."""

    #: MPa, that scales end with at most, see ``pressure_limit``
    limit: float
    #: MPa, of an element
    highest: float
    #: s, when that is
    time: float
    #: s, of the history
    end: float

    def top(self, drawn: float) -> float:
        """Return where a scale ends whose curves reach up to a pressure, MPa."""
        return min(self.limit, _ROOM * drawn) if drawn > 0.0 else 1.0

    def note(self, top: float) -> str:
        """Return the words about a peak that is above a scale's top, "" where it is not."""
        if self.highest <= top:
            return ""
        peak, when = number_words(self.highest), time_words(self.time, self.end)
        return f"peak of {peak} MPa at {when} not shown"


def pressure_peak(result: Result) -> PressurePeak:
    """Return the peak of the contact pressures that a result holds of all stored states."""
    pressure, time = result.profiles["pressure"], result.histories["time"]
    limit = pressure_limit(result.line.area, pressure, result.histories["force"])
    row = int(pressure.max(axis=1).argmax())
    return PressurePeak(limit, float(pressure[row].max()), float(time[row]), float(time[-1]))


BALANCES = "largest relative errors of all steps"
MESH_BALANCES = "relative errors of the boundary elements, smaller on a finer mesh"
TIME_STEPS = "estimated error of wear depth from time steps"
#: share of an approach below which differences of two of them are errors of contact solutions:
#: where nothing wears they are up to 5e-8 on 16 elements, 4e-9 on 24
_ROUND_OFF = 1e-7
#: of results, with the group in which they are printed
_CHECKED = {
    "residual": (BALANCES, "contact conditions (KKT)"),
    "force": (BALANCES, "contact force against the applied force"),
    "volume": (BALANCES, "worn profiles against integrated rates"),
    "energy": (BALANCES, "worn volume against friction energy"),
    "reaction": (MESH_BALANCES, "force on the held faces"),
    "torque": (MESH_BALANCES, "torque on the held faces"),
}


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
    #: the format of the number
    spec: str = ".6g"
    #: what is printed in brackets after it
    note: str = ""

    @property
    def known(self) -> bool:
        """Whether there is one."""
        return not math.isnan(self.value)

    @property
    def text(self) -> str:
        """The number as it is printed, without its unit."""
        return "none" if math.isnan(self.value) else format(self.value, self.spec)

    @property
    def short(self) -> str:
        """The number in four digits, without its unit."""
        rounded = self.spec.endswith("g") and not math.isnan(self.value)
        return number_words(self.value) if rounded else self.text

    def __str__(self) -> str:
        unit = "" if math.isnan(self.value) else f" {self.unit}".rstrip()
        return f"{self.label} {self.text}{unit}" + f" ({self.note})" * bool(self.note)


def in_groups(numbers: Iterable[KeyNumber]) -> dict[str, list[KeyNumber]]:
    """Return key numbers by group, in order."""
    groups: dict[str, list[KeyNumber]] = {}
    for number in numbers:
        groups.setdefault(number.group, []).append(number)
    return groups


def key_numbers(result: Result) -> list[KeyNumber]:
    """Return the numbers of a run at its last state. Not collective.

    Raises
    ------
    InputError : the result was stored without its last state.
    """
    if result.checkpoint is None:
        raise InputError(f"{result.name}: holds no last state; must be one of a run")
    state = result.checkpoint.state
    laboratory = _laboratory(result)
    return [
        *_penetration(result, state),
        *(number for i in (0, 1) for number in _worn(result, state, i, laboratory)),
        *(number for body in BODIES for number in _layers(result, body)),
        *_pressures(result, state.contact),
        *_loads(result, state.contact, laboratory),
        *_stresses(result),
    ]


def _laboratory(result: Result) -> dict[str, KeyNumber]:
    """Return the numbers of laboratories at the last state, by their names as key numbers."""
    numbers = laboratory_numbers(laboratory_inputs(result))
    entries = [(LABORATORY_NUMBERS[name], float(values[-1])) for name, values in numbers.items()]
    return {
        n.key: KeyNumber(n.key, n.group, n.label, value, n.variable.unit, ".4g")
        for n, value in entries
    }


def nominal_area(result: Result) -> float:
    """Return the area (mm2) where the bodies face each other."""
    return float(result.attributes["nominal_area"])


def _penetration(result: Result, state: State) -> Iterator[KeyNumber]:
    """Yield the penetration and its parts.

    The worn part is the mean of both depths over what presses, the elastic one the rest. Where a
    face is not flat the approach also closes gaps: then there are no parts.
    """
    group, load = "penetration", state.contact.pressure * result.line.area
    approach = float(np.abs(result.histories["approach"]).max())
    total = _micrometres(float(result.histories["penetration"][-1]), approach)
    yield KeyNumber("penetration", group, "total", total, "um")
    if not {"face_lower", "face_upper"} & result.attributes.keys() and load.sum() > 0:
        worn = 1e3 * float(load @ state.wear.sum(axis=0) / load.sum())
        yield KeyNumber("worn_off", group, "worn off", worn, "um")
        yield KeyNumber(
            "elastic", group, "elastic", _micrometres(1e-3 * (total - worn), approach), "um", ".3g"
        )


def _micrometres(length: float, scale: float) -> float:
    """Return a length in um, 0 where it is no more than the error of another (mm)."""
    return 0.0 if abs(length) < _ROUND_OFF * scale else 1e3 * length


def _worn(
    result: Result, state: State, i: int, laboratory: Mapping[str, KeyNumber]
) -> Iterator[KeyNumber]:
    """Yield the wear of a body, nothing of one that does not wear."""
    body, about, line = BODIES[i], result.attributes, result.line
    if not about[f"law_{body}"]:
        return

    def number(name: str, label: str, value: float, unit: str, spec: str = ".6g") -> KeyNumber:
        return KeyNumber(f"{body}_{name}", body, label, value, unit, spec)

    volume = float(result.histories[f"worn_volume_{body}"][-1])
    yield number("deepest_wear", "deepest wear", 1e3 * state.wear[i].max(), "um")
    yield number("worn_volume", "worn volume", volume, "mm3")
    yield replace(
        laboratory.get(f"{body}_mass", number("mass", "mass lost", np.nan, "mg")),
        spec=".6g", note=_unknown_densities(result, body, volume),
    )  # fmt: skip
    if (mean_rate := laboratory[f"{body}_mean_rate"]).known:
        yield mean_rate
        now = 3.6e6 * float(state.rates[i] @ line.area) / nominal_area(result)
        yield number("last_rate", "rate at the end", now, "um/h", ".4g")
    if (specific := laboratory[f"{body}_specific_rate"]).known:
        yield specific


def _unknown_densities(result: Result, body: BodyName, volume: float) -> str:
    """Return which densities the mass that a body has lost needs, "" for none."""
    volumes = [volume]
    if f"worn_volume_{body}_layers" in result.layers:
        volumes = result.layers[f"worn_volume_{body}_layers"][-1].tolist()
    keys = density_keys(body, len(volumes) - 1)
    parts = zip(keys, densities_of(result, body).tolist(), volumes, strict=True)
    missing = ", ".join(key for key, density, lost in parts if lost > 0.0 and np.isnan(density))
    return f"{missing} not given" if missing else ""


def _layers(result: Result, body: BodyName) -> Iterator[KeyNumber]:
    """Yield the wear of the layers of a body, nothing of one without."""
    if f"share_through_{body}" not in result.layers:
        return

    def number(name: str, label: str, value: float, unit: str, spec: str = ".4g") -> KeyNumber:
        return KeyNumber(f"{body}_{name}", f"worn layers of {body}", label, value, unit, spec)

    *volumes, itself = result.layers[f"worn_volume_{body}_layers"][-1].tolist()
    for i, volume in enumerate(volumes):
        yield number(f"volume_layer_{i}", f"volume of layer {i}", volume, "mm3", ".6g")
    yield number("volume_under_layers", "volume of the body itself", itself, "mm3", ".6g")
    innermost, places = len(volumes) - 1, {end.layer: end for end in worn_layers(result, body)}
    for i, layer in places.items():
        if i < innermost:
            share = 100.0 * layer.share
            yield number(f"share_through_layer_{i}", f"area without layer {i}", share, "%")
            yield number(f"time_through_layer_{i}", "first by t =", layer.time, "s")
            yield number(f"r_through_layer_{i}", "at r =", layer.r, "mm", ".6g")
    share = 100.0 * float(result.layers[f"share_through_{body}"][-1])
    time = float(result.attributes.get(f"time_through_{body}", np.nan))
    all_layers = "all layers" if innermost else "the layer"
    yield number("share_through", f"area without {all_layers}", share, "%")
    if not np.isnan(time):
        yield number("time_through", "first at t =", time, "s")
        if innermost in places:
            yield number("r_through", "at r =", places[innermost].r, "mm", ".6g")
    left = 1e3 * np.atleast_2d(result.layers[f"layer_left_{body}"])[-1]
    yield number("least_left", "least thickness left", left.min(), "um")
    yield number("most_left", "largest thickness left", left.max(), "um")


def _pressures(result: Result, contact: ContactState) -> Iterator[KeyNumber]:
    """Yield the contact pressures."""
    group, n, p = "pressure", result.line.n, contact.pressure
    mean, touching = contact.force / nominal_area(result), (p > 0.0).sum()
    label = "mean over the nominal annulus"
    yield KeyNumber("mean_pressure", group, label, mean, "MPa", ".4g")
    if touching:
        largest = int(p.argmax())
        note = "at the edge of contact, where it may be off by "
        note = f"{note}{100.0 * EDGE_ERROR:.0f} %" if edge_elements(p)[largest] else ""
        label = "largest of an element"
        yield KeyNumber("largest_pressure", group, label, p[largest], "MPa", ".4g", note)
        yield KeyNumber("r_largest_pressure", group, "at r =", result.line.r[largest], "mm")
        yield KeyNumber("smallest_pressure", group, "smallest", p.min(), "MPa", ".4g")
    note = f"of {n}" if touching else f"of {n}: the faces do not touch"
    yield KeyNumber("touching", group, "elements in contact", int(touching), spec="d", note=note)


def _loads(
    result: Result, contact: ContactState, laboratory: Mapping[str, KeyNumber]
) -> Iterator[KeyNumber]:
    """Yield approach, force, torque and energy, and the sliding at the mean radius."""
    about = result.attributes
    last = {name: float(values[-1]) for name, values in result.histories.items()}
    yield KeyNumber("force", "load", "force", contact.force, "N")
    yield KeyNumber("torque", "load", "torque", 1e-3 * last["torque"], "N m")
    energy = 1e-3 * last["dissipated_energy"]
    yield KeyNumber("dissipated_energy", "load", "dissipated energy", energy, "J")
    yield KeyNumber("approach", "load", "approach", contact.approach, "mm", ".7g")
    speed = about["omega"] * about["mean_radius"]
    yield KeyNumber("speed", SLIDING, "speed", speed, "mm/s", ".4g")
    yield from (laboratory[name] for name in ("p_v", "distance"))


def _stresses(result: Result) -> Iterator[KeyNumber]:
    """Yield the largest stress of each body and its layers at the last state that has stresses."""
    if result.stress is None or not result.stress.states:
        return
    state, exclude = result.stress.states[-1], result.stress.exclude
    assert result.checkpoint is not None
    last = result.checkpoint.state
    beside_edge = edge_elements(last.contact.pressure) & (state.time == last.time)
    group = "largest von Mises stress"
    if state.time != result.histories["time"][-1]:
        group += f" at t = {state.time:g} s"
    if exclude:
        group += f", {exclude:g} mm and more from edges"
    for body, largest, layers in zip(BODIES, state.largest, state.layers, strict=True):
        if np.isfinite(largest.mises):
            place = f"at r = {largest.r:.6g}, z = {largest.z:.6g} mm"
            element = int(result.line.element_at(np.array([largest.r]))[0])
            if element >= 0 and beside_edge[element]:
                place += ", at the radius of an element at the edge of contact"
            yield KeyNumber(f"{body}_mises", group, body, largest.mises, "MPa", ".5g", place)
        for i, value in enumerate(np.asarray(layers).tolist()):
            label = f"layer {i} of {body}" if i < len(layers) - 1 else f"{body} itself"
            note = "nothing of it is left there" if np.isnan(value) else ""
            yield KeyNumber(f"{body}_mises_{i}", group, label, value, "MPa", ".5g", note)


def check_numbers(result: Result) -> list[KeyNumber]:
    """Return the errors of a run, the worst of all its steps. Not collective."""
    about, off = result.attributes, result.balances
    numbers = [
        KeyNumber(
            f"balance_{name}", group,
            label.replace("volume", "volume by layer") if result.layers else label,
            off[name], spec=".1e",
        )
        for name, (group, label) in _CHECKED.items()
        if name in off and (name != "energy" or about["energy_identity"])
    ]  # fmt: skip
    defect, label = float(about["symmetry_defect"]), "asymmetry of the compliance matrix"
    numbers.append(
        KeyNumber("symmetry_defect", MESH_BALANCES, label, defect, "", ".1e", "corrected for")
    )
    if "step_error" in off:
        error, label = 1e3 * off["step_error"], "of the whole history"
        numbers.append(KeyNumber("step_error", TIME_STEPS, label, error, "um", ".2g"))
    return numbers
