"""The numbers of a case that a slider moves: which there are, their ranges, and the keys they make.

Keys are raw ones, as the user wrote them: a number in a unit of its own keeps it.
"""

import itertools
import math
import re
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from ringwear_par.cases.layers import changed_layers, expanded
from ringwear_par.cases.schema import BY_PATH, Key, key_of
from ringwear_par.cases.units import factor, has_unit, in_unit, is_plain, number_and_unit
from ringwear_par.cases.values import Interval, RejectedError, is_number
from ringwear_par.elasticity.profiles import SHAPE_UNITS
from ringwear_par.errors import InputError, legible
from ringwear_par.wear.catalogue import LAWS
from ringwear_par.wear.parameters import parameters_of

#: numbers that matter by their order
_LOGARITHMIC = frozenset(
    {"k", "k_start", "young", "thickness", "depth", "distance", "length", "crown", "sphere"}
)
#: factor up and down that logarithmic sliders reach; stiffness does not vary as k does
_REACH = 100.0
_SHORT_REACH = dict.fromkeys(("young", "thickness", "crown", "sphere"), 10.0)
#: linear sliders reach from nothing to so many times the value, or from a zero to these
_TIMES, _FROM_ZERO = 3.0, {"p0": 100.0, "n": 2.0, "friction": 0.5}
#: about how many positions a linear slider has, and a decade of a logarithmic one
_POSITIONS, _OF_A_DECADE = 200, 100
#: tables are multiplied by up to so much
_FACTOR = 10.0
_LOADS = ("load.force", "load.pressure", "load.displacement", "load.omega")
_ENTRY, _BODIES = ("inner", "outer"), ("lower", "upper")


@dataclass(frozen=True)
class Control:
    """A number of a case with its slider.

    Parameters
    ----------
    name : unique, such as "lower.young", "upper.r[1]", "wear.lower.parameters.k" or, of all the
        values of a table, "load.force x".
    path : key of the case, or of an entry of a layer, "lower.layers[0].thickness".
    entry : place in a pair, name in a table; None: the key is the number.
    group : what it is shown under.
    label, meaning : in words.
    unit : of ``value``, "" for none.
    written : whether the unit is written in the case, as the user did.
    value, low, high, step : of the slider; of a logarithmic one the step is that of log10.
    log : whether the slider is logarithmic.
    whole : whether it is a whole number.
    scales : whether it multiplies the numbers of a table.
    assembles : whether bodies have to be assembled for another value.
    """

    name: str
    path: str
    entry: int | str | None
    group: str
    label: str
    meaning: str
    unit: str
    written: bool
    value: float
    low: float
    high: float
    step: float
    log: bool = False
    whole: bool = False
    scales: bool = False
    assembles: bool = False

    @property
    def text(self) -> str:
        """The value as its field shows it."""
        return f"{self.value:.10g}"

    @property
    def gist(self) -> str:
        """The meaning in a few words."""
        return re.split(r"[,;:(]", self.meaning)[0].strip()

    def at(self, value: float) -> "Control":
        """Return the control at another value, its slider reaching that far."""
        if self.low <= value <= self.high:
            return replace(self, value=value)
        if self.log:
            if value <= 0.0:  # which the case will tell to be wrong
                return replace(self, value=value)
            most = min(value * _FACTOR, sys.float_info.max)
            low, high = min(self.low, value / _FACTOR), max(self.high, most)
            return replace(self, value=value, low=low, high=high)
        low, high = min(self.low, value), max(self.high, value)
        step = _nice((high - low) / _POSITIONS)
        return replace(self, value=value, low=low, high=high, step=max(step, self.step))


def controls_of(keys: Mapping[str, Any]) -> list[Control]:
    """Return the controls of a case that is good, by its raw keys, in the order of the page."""
    keys = expanded(keys)
    return [
        *_laws(keys), *_tests(keys), *_times(keys), *_materials(keys), *_layers(keys),
        *_shapes(keys),
    ]  # fmt: skip


def changed(
    keys: Mapping[str, Any], controls: Mapping[str, Control], texts: Mapping[str, str]
) -> tuple[dict[str, Any], dict[str, Control]]:
    """Return keys with other numbers, and the controls as they then stand.

    Parameters
    ----------
    keys : raw ones.
    controls : of these keys, by name.
    texts : numbers by the names of controls, perhaps with units, as in a case file.

    Raises
    ------
    InputError : all texts that are no numbers.
    """
    there, made, moved, faults = expanded(keys), dict[str, Any](), dict(controls), []
    for name, text in texts.items():
        control = controls.get(name)
        if control is None:
            faults.append(f"{legible(name)}: is no number of this case that can be moved")
            continue
        try:
            raw, value = _read(control, text)
        except RejectedError as reason:
            why = f" ({reason})" if str(reason) else ""
            unit = f" in {control.unit}" if control.unit else ""
            hint = ", or one with its unit" if control.unit and not control.scales else ""
            faults.append(
                f"{control.name} = {legible(text) or '(empty)'}: must be a number{unit}{hint}{why}"
            )
            continue
        moved[name] = control.at(value)
        made[control.path] = _put(control, made.get(control.path, there.get(control.path)), raw)
    if faults:
        raise InputError(*faults)
    return {**keys, **changed_layers(keys, made)}, moved


def _read(control: Control, text: str) -> tuple[Any, float]:
    """Return what a text means in a case file, and how much it is in the unit of the control."""
    text = text.strip().replace("\N{MINUS SIGN}", "-")
    if is_plain(text):
        value = float(text)
        if not math.isfinite(value):
            raise RejectedError
        if control.whole and value.is_integer() and abs(value) < 1e15:
            return int(value), value
        return (f"{text} {control.unit}" if control.written else value), value
    if control.scales or not has_unit(text) or not control.unit:
        raise RejectedError
    return text, float(in_unit(text, control.unit))


def _put(control: Control, there: Any, raw: Any) -> Any:
    """Return the raw value of a key with that of a control in it."""
    if control.scales:
        if isinstance(control.entry, str):
            return {**there, control.entry: _scaled(there[control.entry], raw)}
        return _scaled(there, raw)
    if isinstance(control.entry, int):
        entries = list(there)
        entries[control.entry] = raw
        return entries
    if isinstance(control.entry, str):
        shape, _, place = control.entry.partition("[")
        if place:  # one of the two fillets
            entries = list(there[shape])
            entries[int(place[:-1])] = raw
            return {**there, shape: entries}
        return {**there, control.entry: raw}
    return raw


def _scaled(table: Any, times: float) -> Any:
    """Return a table [[x, value], ...], or { r = such a table }, its values multiplied."""
    if isinstance(table, Mapping):
        return {axis: _scaled(points, times) for axis, points in table.items()}
    return [[x, _times_as_much(value, times)] for x, value in table]


def _times_as_much(value: Any, times: float) -> Any:
    if times == 1.0:
        return value
    if isinstance(value, str):  # with a unit
        number, unit = number_and_unit(value)
        return f"{number * times:.12g} {unit}"
    return float(f"{value * times:.12g}")


# -- which there are -------------------------------------------------------------------------------


def _laws(keys: Mapping[str, Any]) -> Iterator[Control]:
    whose = {
        f"{layer}.wear": f"{body}, layer {number}"
        for body in _BODIES
        for number, layer in enumerate(_layers_of(body, keys), start=1)
    }
    for table, wears in {**{f"wear.{body}": body for body in _BODIES}, **whose}.items():
        if f"{table}.law" not in keys:
            continue
        law = LAWS[keys[f"{table}.law"]]
        group = f"Wear of {wears}: {law.formula}"
        for name, parameter in parameters_of(law).items():
            path = f"{table}.{name}"
            raw = keys.get(path, None if parameter.default is ... else parameter.default)
            if parameter.kind == "parameters":
                for entry, own in (raw or {}).items():
                    meaning = f"parameter of the law of {wears}"
                    yield from _quantity(path, entry, own, group, entry, meaning, "", None)
            elif parameter.kind != "file" and raw is not None:
                key = _key(path)
                unit = key.unit.partition(" and ")[2] or parameter.unit
                yield from _quantity(
                    path, None, raw, group, name, parameter.meaning, _shown(unit), key.numbers
                )


def _tests(keys: Mapping[str, Any]) -> Iterator[Control]:
    group = "Load, speed and friction"
    for path in (*_LOADS, "contact.friction"):
        if path in keys:
            key = BY_PATH[path]
            label = path.rpartition(".")[2]
            yield from _quantity(
                path, None, keys[path], group, label, key.meaning, _shown(key.unit), key.numbers
            )


def _materials(keys: Mapping[str, Any]) -> Iterator[Control]:
    for body in _BODIES:
        layered = bool(_layers_of(body, keys))  # whose moduli count over that of the body
        for name in ("young", "poisson"):
            key = BY_PATH[f"{body}.{name}"]
            yield from _quantity(
                key.path, None, keys[key.path], "Materials", f"{body} {name}", key.meaning,
                _shown(key.unit), key.numbers, assembles=layered or name == "poisson",
            )  # fmt: skip


def _layers(keys: Mapping[str, Any]) -> Iterator[Control]:
    for body in _BODIES:
        for number, layer in enumerate(_layers_of(body, keys), start=1):
            for name in ("thickness", "young", "poisson"):
                key, path = _key(f"{layer}.{name}"), f"{layer}.{name}"
                yield from _quantity(
                    path, None, keys[path], f"Layer {number} of {body}", name, key.meaning,
                    _shown(key.unit), key.numbers, assembles=True,
                )  # fmt: skip


def _layers_of(body: str, keys: Mapping[str, Any]) -> list[str]:
    """Return how the names of entries of layers begin, from the contact face on."""
    starts = (f"{body}.layers[{i}]" for i in itertools.count())
    return list(itertools.takewhile(lambda start: f"{start}.thickness" in keys, starts))


def _key(path: str) -> Key:
    """Return the key of a number of a case."""
    key = key_of(path)
    assert key is not None
    return key


def _shapes(keys: Mapping[str, Any]) -> Iterator[Control]:
    for body in _BODIES:
        group = f"Shape of {body}"
        r, z = (in_unit(keys[f"{body}.{name}"], "mm") for name in "rz")
        width, height = r[1] - r[0], z[1] - z[0]
        for place, label in enumerate(("inner radius", "outer radius")):
            yield _length(
                f"{body}.r", place, keys, group, label, max(r[place] - 0.5 * width, 0.0),
                r[place] + 0.5 * width,
            )  # fmt: skip
        # the other plane is that of the contact
        if body == "lower":
            ends = z[1] - _TIMES * height, z[1] - 0.2 * height
            yield _length("lower.z", 0, keys, group, "bottom", *ends)
        else:
            ends = z[0] + 0.2 * height, z[0] + _TIMES * height
            yield _length("upper.z", 1, keys, group, "top", *ends)
        yield from _faces(body, keys, group)


def _faces(body: str, keys: Mapping[str, Any], group: str) -> Iterator[Control]:
    chamfer, profile = keys.get(f"{body}.chamfer"), keys.get(f"{body}.profile")
    anything, meaning = Interval(0.0, ends=True), BY_PATH[f"{body}.profile"].meaning
    for entry, raw in _places(chamfer):
        told = "chamfer" if entry is None else f"{_ENTRY[entry]} chamfer"
        yield from _quantity(
            f"{body}.chamfer", entry, raw, group, told, BY_PATH["upper.chamfer"].meaning, "mm",
            anything, assembles=True,
        )  # fmt: skip
    if isinstance(profile, Mapping):
        ((shape, given),) = profile.items()
        if shape not in SHAPE_UNITS or shape == "trace":
            return
        unit = SHAPE_UNITS[shape]
        interval = Interval(-45.0, 45.0) if shape == "cone" else anything
        for place, raw in _places(given):
            size = shape if place is None else f"{shape}[{place}]"
            told = shape if place is None else f"{_ENTRY[place]} {shape}"
            yield from _quantity(
                f"{body}.profile", size, raw, group, told, meaning, unit, interval, assembles=True
            )


def _places(raw: Any) -> Iterator[tuple[int | None, Any]]:
    """Return the numbers of one, or of a pair, with their places."""
    if isinstance(raw, list):
        yield from enumerate(raw)
    elif raw is not None:
        yield None, raw


def _times(keys: Mapping[str, Any]) -> Iterator[Control]:
    if "time.end" in keys:
        key = BY_PATH["time.end"]
        yield from _quantity(
            key.path, None, keys[key.path], "Time", "end", key.meaning, "s", key.numbers
        )
    elif "time.steps" in keys:
        steps = float(keys["time.steps"])
        high = max(_TIMES * steps, 10.0)
        step = max(1.0, _nice(high / _POSITIONS))
        yield Control(
            "time.steps", "time.steps", None, "Time", "steps", BY_PATH["time.steps"].meaning, "",
            False, steps, min(step, steps), high, step, whole=True,
        )  # fmt: skip


# -- how they are ----------------------------------------------------------------------------------


def _shown(unit: str) -> str:
    return "" if unit in ("1", "-") else unit


def _quantity(
    path: str, entry: int | str | None, raw: Any, group: str, label: str, meaning: str, unit: str,
    interval: Interval | None, assembles: bool = False,
) -> Iterator[Control]:  # fmt: skip
    """Return the control of a number, or of all numbers of a table."""
    name = _name(path, entry)
    if isinstance(raw, list | Mapping):
        yield Control(
            f"{name} \N{MULTIPLICATION SIGN}", path, entry, group,
            f"{label} \N{MULTIPLICATION SIGN}", f"{meaning}; all values of the table times this",
            "", False, 1.0, 1.0 / _FACTOR, _FACTOR, 1.0 / _OF_A_DECADE, log=True, scales=True,
        )  # fmt: skip
        return
    value, own = _with_unit(raw, unit)
    share = factor(own, unit) if own else 1.0
    reach = _linear
    if label.rpartition(" ")[2] in _LOGARITHMIC or (interval is None and _extreme(value)):
        reach = _logarithmic
    size = label.rpartition(" ")[2]
    if value:  # positions are round in the unit that is shown
        if interval is not None and own:
            interval = Interval(interval.low / share, interval.high / share, interval.ends)
        low, high, step, log = reach(size, value, interval)
    else:
        low, high, step, log = reach(size, value, interval)
        low, high = _round(low / share), _round(high / share)
        if not log:
            step = _nice(step / share)
    yield Control(
        name, path, entry, group, label, meaning, own or unit, bool(own), value, min(low, value),
        max(high, value), step, log, assembles=assembles,
    )  # fmt: skip


def _length(
    path: str, place: int, keys: Mapping[str, Any], group: str, label: str, low: float, high: float
) -> Control:
    """Return the control of one of a pair of lengths, between two (mm)."""
    value, own = _with_unit(keys[path][place], "mm")
    share = factor(own, "mm") if own else 1.0
    return Control(
        _name(path, place), path, place, group, label, BY_PATH[path].meaning, own or "mm",
        bool(own), value, _round(low / share), _round(high / share),
        _nice((high - low) / share / _POSITIONS),
        assembles=True,
    )  # fmt: skip


def _name(path: str, entry: int | str | None) -> str:
    if isinstance(entry, int):
        return f"{path}[{entry}]"
    return path if entry is None else f"{path}.{entry}"


def _with_unit(raw: Any, unit: str) -> tuple[float, str]:
    """Return a raw number and the unit that it has of its own, "" for none."""
    if is_number(raw):
        return float(raw), ""
    return number_and_unit(raw)


def _extreme(value: float) -> bool:
    """Tell whether a number that nothing is known of is likely to matter by its order."""
    return value > 0.0 and not 1e-3 <= value <= 1e4


def _logarithmic(
    name: str, value: float, interval: Interval | None
) -> tuple[float, float, float, bool]:
    if value <= 0.0:
        return _linear(name, value, interval)
    reach = _SHORT_REACH.get(name, _REACH)
    return _round(value / reach), _round(value * reach), 1.0 / _OF_A_DECADE, True


def _linear(name: str, value: float, interval: Interval | None) -> tuple[float, float, float, bool]:
    ends = sorted((0.0, _TIMES * value)) if value else [0.0, _FROM_ZERO.get(name, 1.0)]
    if interval is None and not value:
        ends = [-ends[1], ends[1]]
    step = _nice((ends[1] - ends[0]) / _POSITIONS)
    if interval is not None:
        inside = 0.0 if interval.ends else step
        ends = [max(ends[0], interval.low + inside), min(ends[1], interval.high - inside)]
    return _round(ends[0]), _round(ends[1]), step, False


def _round(value: float) -> float:
    return float(f"{value:.12g}")


def _nice(step: float) -> float:
    """Return 1, 2 or 5 times a power of ten, as large as a step or a little larger."""
    power = 10.0 ** math.floor(math.log10(step))
    times = next(m for m in (1.0, 2.0, 5.0, 10.0) if m * power >= step * (1.0 - 1e-9))
    return _round(times * power)
