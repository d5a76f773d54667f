"""The numbers of a measurement as people read them: in summaries, tables and pages.

Entries of tests are those of measure.json (``MeasureResult.to_dict``).
"""

import csv
import io
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from ringwear_par.cases.units import CUSTOMARY, SPECIFIC
from ringwear_par.measuring.analysis.budget import COVERAGE

#: digits of an expanded uncertainty (JCGM 100, 7.2.6), and of numbers without one
_DIGITS, _ALONE = 2, 4
#: powers of ten below and above which numbers are written with an exponent, and most decimals of a
#: number
_SMALL, _LARGE, _MOST_DIGITS = -3, 5, 6


@dataclass(frozen=True)
class Quantity:
    """A number of a test: what it is called, and where it is in the test's entry."""

    name: str
    unit: str
    #: in the entry; measured: to a table with ``value`` and ``u``
    path: tuple[str, ...]
    #: from the unit of measure.json
    factor: float = 1.0
    measured: bool = False

    def of(self, entry: Mapping[str, Any], name: str = "value") -> float | None:
        """Return the number of a test, or its standard uncertainty "u"; None where it has none."""
        value: Any = entry
        for part in (*self.path, *((name,) if self.measured else ())):
            value = None if value is None else value[part]
        return None if value is None else self.factor * float(value)

    def text(self, entry: Mapping[str, Any]) -> str:
        """Return the number of a test, with its uncertainty where it has one; "" for none."""
        value = self.of(entry)
        if value is None or not math.isfinite(value):
            return ""
        return estimate_text(value, self.of(entry, "u") or 0.0 if self.measured else 0.0)


_RATE, _WEAR = "specific_wear_rate", "wear_rate"
LOAD = Quantity("load", "N", ("conditions", "force"))
SPEED = Quantity("sliding speed", "m/s", ("conditions", "speed"), 1e-3)
FRICTION = Quantity("friction", "1", ("friction",), measured=True)
TEMPERATURES = (
    Quantity("temperature, mean", "degC", ("temperature", "mean")),
    Quantity("temperature, largest", "degC", ("temperature", "max")),
)
#: numbers of each test, in the order of measure.csv and of the page
QUANTITIES = (
    LOAD, Quantity("mean pressure", "MPa", ("conditions", "pressure")), SPEED,
    Quantity("pV", "MPa m/s", ("pv", "MPa m/s")),
    Quantity("pV", "psi ft/min", ("pv", "psi ft/min")),
    Quantity("duration", "h", ("duration",), 1.0 / 3600.0),
    Quantity("distance", "m", ("whole", "distance", "value")),
    *TEMPERATURES,
    Quantity("steady from", "h", ("steady_from", "value"), 1.0 / 3600.0),
    Quantity("wear rate", "um/h", (_WEAR,), 3.6e6, measured=True),
    Quantity("wear rate", "in/h", (_WEAR, "in/h")),
    Quantity("specific wear rate", SPECIFIC, (_RATE,), measured=True),
    Quantity("specific wear rate", CUSTOMARY, (_RATE, "us"), measured=True),
    FRICTION,
    Quantity("mass lost", "mg", ("whole", "mass_loss"), measured=True),
    Quantity("volume lost by weighing", "mm3", ("whole", "volume"), measured=True),
    Quantity("volume lost by displacement", "mm3", ("whole", "volume_by_displacement"),
             measured=True),
    Quantity("specific wear rate of the whole test", SPECIFIC, ("whole", _RATE),
             measured=True),
)  # fmt: skip


def estimate_text(value: float, u: float, unit: str = "") -> str:
    """Return a value, its unit and its interval of 95 %, value -+ 2 u.

    Two digits of 2 u are shown (JCGM 100, 7.2.6).
    """
    largest = max(abs(value), COVERAGE * u)
    power = math.floor(math.log10(largest)) if largest else 0
    power = 0 if _SMALL < power < _LARGE else power
    scale, exponent = 10.0**power, f"e{power:+03d}" if power else ""
    expanded, suffix = COVERAGE * u / scale, f" {unit}" if unit not in ("", "1") else ""
    if not expanded > 0.0:
        return f"{value / scale:.{_ALONE}g}{exponent}{suffix}"
    digits = max(_DIGITS - 1 - math.floor(math.log10(expanded)), 0)
    digits = min(digits, _MOST_DIGITS)
    middle, low, high = (
        f"{value / scale + change:.{digits}f}{exponent}" for change in (0.0, -expanded, expanded)
    )
    return f"{middle}{suffix} from {low} to {high} (95 %)"


def entry_text(entry: Mapping[str, Any], factor: float = 1.0, unit: str | None = None) -> str:
    """Return an entry of measure.json with its uncertainty, in its own unit or in another."""
    unit = str(entry["unit"]) if unit is None else unit
    return estimate_text(factor * entry["value"], factor * entry["u"], unit)


def steady_text(entry: Mapping[str, Any]) -> str:
    """Return in words which part of a test its numbers are of."""
    hours = f"{entry['steady_from']['value'] / 3600.0:.3g} h"
    return {
        "steady part": f"steady from {hours} on",
        "given part": f"from {hours} on, as the measure file says",
        "last third": f"not steady; last third, from {hours} on",
    }[entry["of"]]


def repeats_text(repeats: Mapping[str, Any]) -> str:
    """Return the mean of repeats, its interval and their scatter in a sentence."""
    rate, names = repeats["specific_wear_rate"], ", ".join(repeats["tests"])
    low, high = rate["interval"]
    return (
        f"{rate['mean']:.3g} {SPECIFIC} from {low:.3g} to {high:.3g} (95 %, "
        f"{len(repeats['tests'])} specimens: {names}); between specimens "
        f"{100 * rate['s_r']:.2g} %, repeatability r = {100 * rate['r']:.2g} %"
    )


def skipped_text(entry: Mapping[str, Any]) -> str:
    """Return the counts of skipped cells and readings in words, "" for none."""
    words = {"empty": "empty cells", "repeated": "repeated stamps", "excluded": "excluded readings"}
    parts = [
        f"{entry['skipped'][key]} {text}" for key, text in words.items() if entry["skipped"][key]
    ]
    return ", ".join(parts)


def lines_of(entry: Mapping[str, Any]) -> Iterator[str]:
    """Yield the lines of a test."""
    specific, rate, friction = (
        entry[name] for name in ("specific_wear_rate", "wear_rate", "friction")
    )
    steady, whole = steady_text(entry), entry["whole"]
    if specific is not None:
        yield f"{entry_text(specific)}, {specific[CUSTOMARY]:.3g} {CUSTOMARY}; {steady}"
    numbers = []
    if rate is not None:
        numbers.append(f"wear rate {entry_text(rate, 3.6e6, 'um/h')}")
    if friction is not None:
        numbers.append(f"friction {entry_text(friction)}")
    pv = entry["pv"]
    numbers.append(f"pV {pv['MPa m/s']:.4g} MPa m/s = {pv['psi ft/min']:.5g} psi ft/min")
    if specific is None:
        numbers.append(steady)
    yield "; ".join(numbers)
    if whole["specific_wear_rate"] is not None:
        yield (
            f"whole test, by weighing: {entry_text(whole['specific_wear_rate'])}; "
            f"{entry_text(whole['mass_loss'])}, {entry_text(whole['volume'])} over "
            f"{whole['distance']['value'] / 1e3:.4g} km"
        )
    if temperature := entry["temperature"]:
        yield f"temperature {temperature['mean']:.3g} degC, at most {temperature['max']:.3g} degC"
    if skipped := skipped_text(entry):
        yield f"skipped: {skipped}"
    yield from entry["notes"]


def table(outcome: Mapping[str, Any]) -> str:
    """Return measure.csv of measure.json: a row a test, empty cells where nothing was measured."""
    text = io.StringIO()
    header, rows = table_of(outcome)
    digits = [
        ["" if v is None else f"{v:.6g}" if isinstance(v, float) else v for v in row]
        for row in rows
    ]
    csv.writer(text, lineterminator="\n").writerows([header, *digits])
    return text.getvalue()


def table_of(outcome: Mapping[str, Any]) -> tuple[list[str], list[list[Any]]]:
    """Return names of columns and rows of tests; None for what was not measured.

    Parameters
    ----------
    outcome : the contents of measure.json.
    """
    columns = [
        (q, part) for q in QUANTITIES for part in (("value", "u") if q.measured else ("value",))
    ]
    header = [f"{'u of ' * (part == 'u')}{q.name} / {q.unit}" for q, part in columns]
    rows = []
    for name, entry in outcome["tests"].items():
        numbers = [quantity.of(entry, part) for quantity, part in columns]
        codes = " ".join(doubt["code"] for doubt in entry["doubts"])
        rows.append([name, "yes" if entry["steady"] else "no", *numbers, codes])
    return ["test", "steady", *header, "doubts"], rows
