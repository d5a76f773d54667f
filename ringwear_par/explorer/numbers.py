"""Which numbers of a case have a slider, and how far each slider reaches."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from ringwear_par.cases.layers import expanded
from ringwear_par.cases.schema import quantity_label, unit_of
from ringwear_par.cases.units import is_plain
from ringwear_par.cases.values import Interval, RejectedError, is_number
from ringwear_par.studies.variations import name_fault, own_key, value_of, without_units

#: headings of the page, and how the keys below them begin
_GROUPS = {
    "wear.": "Wear", "load.": "Load and friction", "contact.friction": "Load and friction",
    "time.end": "Time", "time.steps": "Time", "lower.": "Lower body", "upper.": "Upper body",
}  # fmt: skip
#: the plane of contact, where bodies move away from each other, and what no history depends on
_NOT_MOVED = ("lower.z[1]", "upper.z[0]", "density")
#: numbers that matter by their order, and the factor up and down that their sliders reach
_REACH = {
    "k": 100.0, "k_start": 100.0, "depth": 100.0, "distance": 100.0, "length": 100.0,
    "young": 10.0, "thickness": 10.0, "crown": 10.0, "sphere": 10.0,
}  # fmt: skip
#: other sliders reach from nothing to so many times the value, or from a zero to these
_TIMES, _FROM_ZERO = 3.0, {"p0": 100.0, "n": 2.0, "friction": 0.5}
#: positions of a decade, and least number of those of other sliders, whose steps are 1, 0.1, ...
_OF_A_DECADE, _POSITIONS = 100, 100


@dataclass(frozen=True)
class Number:
    """A number of a case with its slider, which moves the logarithm of some."""

    #: as studies name it, such as "wear.lower.k" or "upper.r[1]"
    name: str
    group: str
    #: in the unit of the case, as both ends of the slider
    value: float
    low: float
    high: float
    log: bool = False

    @property
    def label(self) -> str:
        """What it is, with its unit."""
        return quantity_label(self.name, unit_of(self.name))

    @property
    def step(self) -> float:
        """The distance between positions of the slider."""
        if self.name == "time.steps":
            return 1.0
        return 1.0 / _OF_A_DECADE if self.log else _step(self.low, self.high)

    def position(self, value: float) -> float:
        """Return where the slider stands for a value."""
        return math.log10(value) if self.log else value

    def text(self, position: float) -> str:
        """Return the value at a position of the slider, as its field shows it."""
        return f"{10.0**position:.3g}" if self.log else f"{position:.6g}"

    def read(self, text: str) -> float | None:
        """Return the value of a text, perhaps with a unit; None: it is no number."""
        try:
            value = float(text) if is_plain(text) else without_units(self.name, text)
        except RejectedError:
            return None
        return float(value) if is_number(value) and (value > 0.0 or not self.log) else None


def numbers_of(keys: Mapping[str, Any]) -> list[Number]:
    """Return the numbers of a case that have a slider, by their groups.

    Parameters
    ----------
    keys : dotted keys and raw values of the case.
    """
    found = []
    for name in _names(keys):
        group = next((group for start, group in _GROUPS.items() if name.startswith(start)), None)
        if group is None or name.endswith(_NOT_MOVED) or name_fault("", name, name) is not None:
            continue
        value = without_units(name, value_of(keys, name))
        if is_number(value):
            low, high, log = _reach(keys, name, float(value))
            found.append(Number(name, group, float(value), low, high, log))
    order = [*dict.fromkeys(_GROUPS.values())]
    return sorted(found, key=lambda number: order.index(number.group))


def _names(keys: Mapping[str, Any]) -> Iterator[str]:
    """Yield the names of all keys, of entries of pairs, of shapes and of users' parameters."""
    for path, raw in expanded(keys).items():
        if path.endswith((".r", ".z")):
            yield from (f"{path}[0]", f"{path}[1]")
        elif isinstance(raw, Mapping):
            yield from (f"{path}.{entry}" for entry in raw)
        else:
            yield path


def _reach(keys: Mapping[str, Any], name: str, value: float) -> tuple[float, float, bool]:
    """Return the ends of a slider, and whether it is logarithmic."""
    last = name.rpartition(".")[2]
    if last in _REACH and value > 0.0:
        return value / _REACH[last], value * _REACH[last], True
    if name.endswith("]"):  # one of two radii or heights
        pair = [without_units(f"{name[:-3]}[{i}]", value_of(keys, f"{name[:-3]}[{i}]"))
                for i in range(2)]  # fmt: skip
        low, high = (value + side * 0.5 * (pair[1] - pair[0]) for side in (-1.0, 1.0))
        return (max(low, 0.0) if ".r[" in name else low), high, False
    if name == "time.steps":
        return 1.0, max(_TIMES * value, 10.0), False
    low, high = sorted((0.0, _TIMES * value)) if value else (0.0, _FROM_ZERO.get(last, 1.0))
    interval = own_key(name).numbers or Interval(-math.inf)
    inside = 0.0 if interval.ends else _step(low, high)
    low, high = max(low, interval.low + inside), min(high, interval.high - inside)
    return float(f"{low:.12g}"), float(f"{high:.12g}"), False


def _step(low: float, high: float) -> float:
    """Return the power of ten that is at most a part of the way between two ends."""
    return float(10.0 ** math.floor(math.log10((high - low) / _POSITIONS)))
