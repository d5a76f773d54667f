"""A number of a case with its slider: how far it reaches, and in what steps."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from ringwear_par.cases.schema import BY_PATH, quantity_name
from ringwear_par.cases.units import factor, number_and_unit
from ringwear_par.cases.values import LEAST, MOST, Interval, is_number

#: numbers that matter by their order
_LOGARITHMIC = frozenset(
    {"k", "k_start", "young", "thickness", "depth", "distance", "length", "crown", "sphere"}
)
#: factor up and down that logarithmic sliders reach; sliders of stiffness reach less
_REACH = 100.0
_SHORT_REACH = dict.fromkeys(("young", "thickness", "crown", "sphere"), 10.0)
#: linear sliders reach from nothing to so many times the value, or from a zero to these
TIMES, _FROM_ZERO = 3.0, {"p0": 100.0, "n": 2.0, "friction": 0.5}
#: about how many positions a linear slider has, and a decade of a logarithmic one
POSITIONS, _OF_A_DECADE = 200, 100
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
        step = nice((high - low) / POSITIONS)
        return replace(self, value=value, low=low, high=high, step=max(step, self.step))


def unit_words(unit: str) -> str:
    """Return a key's unit, "" for none."""
    return "" if unit in ("1", "-") else unit


def quantity(
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
    value, user_unit = _with_unit(raw, unit)
    unit_scale = factor(user_unit, unit) if user_unit else 1.0
    reach = _linear
    if label.rpartition(" ")[2] in _LOGARITHMIC or (interval is None and _extreme(value)):
        reach = _logarithmic
    size = label.rpartition(" ")[2]
    if value:  # positions are round in the unit that is shown
        if interval is not None and user_unit:
            interval = Interval(
                interval.low / unit_scale, interval.high / unit_scale, interval.ends
            )
        low, high, step, log = reach(size, value, interval)
    else:
        low, high, step, log = reach(size, value, interval)
        low, high = _round(low / unit_scale), _round(high / unit_scale)
        if not log:
            step = nice(step / unit_scale)
    yield Control(
        name, path, entry, group, label, meaning, user_unit or unit, bool(user_unit), value,
        min(low, value), max(high, value), step, log, assembles=assembles,
    )  # fmt: skip


def length(
    path: str, place: int, keys: Mapping[str, Any], group: str, label: str, low: float, high: float
) -> Control:
    """Return the control of one of a pair of lengths, between two (mm)."""
    value, user_unit = _with_unit(keys[path][place], "mm")
    unit_scale = factor(user_unit, "mm") if user_unit else 1.0
    return Control(
        _name(path, place), path, place, group, label, BY_PATH[path].meaning, user_unit or "mm",
        bool(user_unit), value, _round(low / unit_scale), _round(high / unit_scale),
        nice((high - low) / unit_scale / POSITIONS),
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
    ends = sorted((0.0, TIMES * value)) if value else [0.0, _FROM_ZERO.get(name, 1.0)]
    if interval is None and not value:
        ends = [-ends[1], ends[1]]
    step = nice((ends[1] - ends[0]) / POSITIONS)
    if interval is not None:
        inside = 0.0 if interval.ends else step
        ends = [max(ends[0], interval.low + inside), min(ends[1], interval.high - inside)]
    return _round(ends[0]), _round(ends[1]), step, False


def _round(value: float) -> float:
    return float(f"{value:.12g}")


def nice(step: float) -> float:
    """Return 1, 2 or 5 times a power of ten, as large as a step or a little larger."""
    power = 10.0 ** math.floor(math.log10(step))
    times = next(m for m in (1.0, 2.0, 5.0, 10.0) if m * power >= step * (1.0 - 1e-9))
    return _round(times * power)
