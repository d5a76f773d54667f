"""Which numbers of a case have a slider, by its raw keys: how far each reaches, in what steps."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from ringwear_par.cases.faces import SHAPE_UNITS
from ringwear_par.cases.layers import expanded
from ringwear_par.cases.schema import BY_PATH, MOST_LAYERS, key_of, quantity_name
from ringwear_par.cases.units import factor, in_unit, number_and_unit
from ringwear_par.cases.values import LEAST, MOST, Interval, is_number
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.wear.laws import LAWS

_LOADS = ("load.force", "load.pressure", "load.displacement", "load.omega", "contact.friction")
_ENTRY = ("inner", "outer")
#: numbers that matter by their order
_LOGARITHMIC = frozenset(
    {"k", "k_start", "young", "thickness", "depth", "distance", "length", "crown", "sphere"}
)
#: factor up and down that logarithmic sliders reach; sliders of stiffness reach less
_REACH = 100.0
_SHORT_REACH = dict.fromkeys(("young", "thickness", "crown", "sphere"), 10.0)
#: linear sliders reach from nothing to so many times the value, or from a zero to these
_TIMES, _FROM_ZERO = 3.0, {"p0": 100.0, "n": 2.0, "friction": 0.5}
#: about how many positions a linear slider has, and a decade of a logarithmic one
_POSITIONS, _OF_A_DECADE = 200, 100
#: largest factor on a table
_FACTOR = 10.0


@dataclass(frozen=True)
class Control:
    """A number of a case with its slider."""

    #: unique, such as "lower.young", "upper.r[1]", "wear.lower.parameters.k" or, of all the values
    #: of a table, "load.force x"
    name: str
    #: key of the case, or of an entry of a layer, "lower.layers[0].thickness"
    path: str
    #: place in a pair, name in a table; None: the key is the number
    entry: int | str | None
    #: what it is shown under
    group: str
    #: in words
    label: str
    meaning: str
    #: of ``value``, "" for none
    unit: str
    #: whether the unit is written in the case, as the user did
    written: bool
    #: of the slider; of a logarithmic one the step is that of log10
    value: float
    low: float
    high: float
    step: float
    #: whether the slider is logarithmic
    log: bool = False
    #: whether it is a whole number
    whole: bool = False
    #: whether it multiplies the numbers of a table
    scales: bool = False
    #: whether bodies have to be assembled for another value
    assembles: bool = False

    @property
    def text(self) -> str:
        """The value as its field shows it."""
        return f"{self.value:.10g}"

    @property
    def quantity(self) -> str:
        """What it is called, without the body where its group names it."""
        entry = f"[{self.entry}]" if isinstance(self.entry, int) else ""
        words = quantity_name(f"{self.path}{entry}")
        if isinstance(self.entry, str):  # the shape of a face, or a parameter of a user's law
            words = self.label
        bare = words.partition(", ")[0] if self.group != "Materials" else words
        return f"{bare} \N{MULTIPLICATION SIGN}" if self.scales and bare != self.label else bare

    def at(self, value: float) -> "Control":
        """Return the control at another value, its slider reaching that far."""
        if self.low <= value <= self.high:
            return replace(self, value=value)
        if self.log:
            if value <= 0.0:  # which the case will tell to be wrong
                return replace(self, value=value)
            least, most = max(value / _FACTOR, LEAST), min(value * _FACTOR, MOST)
            low, high = min(self.low, least), max(self.high, most)
            return replace(self, value=value, low=low, high=high)
        low, high = min(self.low, value), max(self.high, value)
        step = _nice((high - low) / _POSITIONS)
        return replace(self, value=value, low=low, high=high, step=max(step, self.step))


def controls_of(keys: Mapping[str, Any]) -> list[Control]:
    """Return the controls of a case that is good, by its raw keys, in the order of the page."""
    keys = expanded(keys)
    layers = {
        layer: (body, f"{body}, layer {number}", f"Layer {number} of {body}")
        for body in BODIES
        for number in range(MOST_LAYERS)
        for layer in [f"{body}.layers[{number}]"]
        if f"{layer}.thickness" in keys
    }
    layered = {body for body, _, _ in layers.values()}  # whose moduli count over that of the body
    wearing: dict[str, str] = {f"wear.{body}": body for body in BODIES}
    wearing |= {f"{layer}.wear": words for layer, (_, words, _) in layers.items()}
    return [
        *(control for table, whose in wearing.items() for control in _law(keys, table, whose)),
        *(
            _of_key(keys, path, "Load, speed and friction", path.rpartition(".")[2])
            for path in _LOADS
            if path in keys
        ),
        *_times(keys),
        *(
            _of_key(
                keys, f"{body}.{name}", "Materials", f"{body} {name}",
                body in layered or name == "poisson",
            )
            for body in BODIES
            for name in ("young", "poisson")
        ),
        *(
            _of_key(keys, f"{layer}.{name}", group, name, True)
            for layer, (_, _, group) in layers.items()
            for name in ("thickness", "young", "poisson")
        ),
        *_shapes(keys),
    ]  # fmt: skip


def _law(keys: Mapping[str, Any], table: str, whose: str) -> Iterator[Control]:
    """Yield the controls of the parameters of a wear law."""
    if f"{table}.law" not in keys:
        return
    law = LAWS[keys[f"{table}.law"]]
    group = f"Wear of {whose}: {law.formula}"
    for name, parameter in law.parameters.items():
        path = f"{table}.{name}"
        raw = keys.get(path, None if parameter.default is ... else parameter.default)
        if parameter.kind == "parameters":
            for entry, value in (raw or {}).items():
                meaning = f"parameter of the law of {whose}"
                yield _of_number(path, entry, value, group, entry, meaning, "", None)
        elif parameter.kind != "file" and raw is not None:
            key = key_of(path)
            assert key is not None
            unit = key.unit.partition(" and ")[2] or parameter.unit
            yield _of_number(path, None, raw, group, name, parameter.meaning, unit, key.numbers)


def _times(keys: Mapping[str, Any]) -> Iterator[Control]:
    if "time.end" in keys:
        yield _of_key(keys, "time.end", "Time", "end")
    elif "time.steps" in keys:
        steps = float(keys["time.steps"])
        high = max(_TIMES * steps, 10.0)
        step = max(1.0, _nice(high / _POSITIONS))
        yield Control(
            "time.steps", "time.steps", None, "Time", "steps", BY_PATH["time.steps"].meaning, "",
            False, steps, min(step, steps), high, step, whole=True,
        )  # fmt: skip


def _shapes(keys: Mapping[str, Any]) -> Iterator[Control]:
    for body in BODIES:
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
        label = "chamfer" if entry is None else f"{_ENTRY[entry]} chamfer"
        yield _of_number(
            f"{body}.chamfer", entry, raw, group, label, BY_PATH["upper.chamfer"].meaning, "mm",
            anything, assembles=True,
        )  # fmt: skip
    if isinstance(profile, Mapping):
        ((shape, sizes),) = profile.items()
        if shape not in SHAPE_UNITS or shape == "trace":
            return
        unit = SHAPE_UNITS[shape]
        interval = Interval(-45.0, 45.0) if shape == "cone" else anything
        for place, raw in _places(sizes):
            size = shape if place is None else f"{shape}[{place}]"
            label = shape if place is None else f"{_ENTRY[place]} {shape}"
            yield _of_number(
                f"{body}.profile", size, raw, group, label, meaning, unit, interval, assembles=True
            )


def _places(raw: Any) -> Iterator[tuple[int | None, Any]]:
    """Return the numbers of one, or of a pair, with their places."""
    if isinstance(raw, list):
        yield from enumerate(raw)
    elif raw is not None:
        yield None, raw


def _length(
    path: str, place: int, keys: Mapping[str, Any], group: str, label: str, low: float, high: float
) -> Control:
    """Return the control of one of a pair of lengths, between two (mm)."""
    value, user_unit = _with_unit(keys[path][place])
    unit_scale = factor(user_unit, "mm") if user_unit else 1.0
    return Control(
        _name(path, place), path, place, group, label, BY_PATH[path].meaning, user_unit or "mm",
        bool(user_unit), value, _round(low / unit_scale), _round(high / unit_scale),
        _nice((high - low) / unit_scale / _POSITIONS),
        assembles=True,
    )  # fmt: skip


def _of_key(
    keys: Mapping[str, Any], path: str, group: str, label: str, assembles: bool = False
) -> Control:
    """Return the control of a key that is a number, or a table of some."""
    key = key_of(path)
    assert key is not None
    return _of_number(
        path, None, keys[path], group, label, key.meaning, key.unit, key.numbers, assembles
    )


def _of_number(
    path: str, entry: int | str | None, raw: Any, group: str, label: str, meaning: str, unit: str,
    interval: Interval | None, assembles: bool = False,
) -> Control:  # fmt: skip
    """Return the control of a number, or of all numbers of a table."""
    name, unit = _name(path, entry), "" if unit in ("1", "-") else unit
    if isinstance(raw, list | Mapping):
        return Control(
            f"{name} \N{MULTIPLICATION SIGN}", path, entry, group,
            f"{label} \N{MULTIPLICATION SIGN}", f"{meaning}; all values of the table times this",
            "", False, 1.0, 1.0 / _FACTOR, _FACTOR, 1.0 / _OF_A_DECADE, log=True, scales=True,
        )  # fmt: skip
    value, user_unit = _with_unit(raw)
    scale = factor(user_unit, unit) if user_unit else 1.0
    size = label.rpartition(" ")[2]
    # of a number that nothing is known of, the order matters if it is extreme
    extreme = interval is None and not 1e-3 <= value <= 1e4
    log = value > 0.0 and (size in _LOGARITHMIC or extreme)
    if value and interval is not None and user_unit:  # positions are round in the unit shown
        interval = Interval(interval.low / scale, interval.high / scale, interval.ends)
    if log:
        reach = _SHORT_REACH.get(size, _REACH)
        low, high, step = _round(value / reach), _round(value * reach), 1.0 / _OF_A_DECADE
    else:
        low, high, step = _linear(size, value, interval)
    if not value:
        low, high, step = _round(low / scale), _round(high / scale), _nice(step / scale)
    return Control(
        name, path, entry, group, label, meaning, user_unit or unit, bool(user_unit), value,
        min(low, value), max(high, value), step, log, assembles=assembles,
    )  # fmt: skip


def _name(path: str, entry: int | str | None) -> str:
    if isinstance(entry, int):
        return f"{path}[{entry}]"
    return path if entry is None else f"{path}.{entry}"


def _with_unit(raw: Any) -> tuple[float, str]:
    """Return a raw number and the unit that it has of its own, "" for none."""
    return (float(raw), "") if is_number(raw) else number_and_unit(raw)


def _linear(name: str, value: float, interval: Interval | None) -> tuple[float, float, float]:
    """Return the ends and the step of a linear slider."""
    ends = sorted((0.0, _TIMES * value)) if value else [0.0, _FROM_ZERO.get(name, 1.0)]
    if interval is None and not value:
        ends = [-ends[1], ends[1]]
    step = _nice((ends[1] - ends[0]) / _POSITIONS)
    if interval is not None:
        inside = 0.0 if interval.ends else step
        ends = [max(ends[0], interval.low + inside), min(ends[1], interval.high - inside)]
    return _round(ends[0]), _round(ends[1]), step


def _round(value: float) -> float:
    return float(f"{value:.12g}")


def _nice(step: float) -> float:
    """Return 1, 2 or 5 times a power of ten, as large as a step or a little larger."""
    power = 10.0 ** math.floor(math.log10(step))
    times = next(m for m in (1.0, 2.0, 5.0, 10.0) if m * power >= step * (1.0 - 1e-9))
    return _round(times * power)
