"""The numbers of a measurement as people read them: rows that its summary, table and page share.

All functions take the contents of measure.json (``MeasureResult.to_dict``).
"""

import math
from collections.abc import Mapping
from typing import Any

from ringwear_par.measuring.analysis.budget import COVERAGE

Outcome = Mapping[str, Any]

#: digits of an expanded uncertainty (JCGM 100, 7.2.6), and of numbers that have none
_DIGITS, _ALONE = 2, 4
#: powers of ten from which on numbers have one, and most digits behind the point of a number
_SMALL, _LARGE, _MOST_DIGITS = -3, 5, 6
#: columns of measure.csv: name, unit, and where the number is in the entry of a test
COLUMNS: tuple[tuple[str, str, tuple[str, ...]], ...] = (
    ("steady from", "h", ("steady_from", "value")),
    ("specific wear rate", "mm3/(N m)", ("specific_wear_rate", "value")),
    ("u of specific wear rate", "mm3/(N m)", ("specific_wear_rate", "u")),
    ("specific wear rate", "in3 min/(ft lbf h)", ("specific_wear_rate", "in3 min/(ft lbf h)")),
    ("wear rate", "um/h", ("wear_rate", "um/h")),
    ("u of wear rate", "um/h", ("wear_rate", "u")),
    ("wear rate", "in/h", ("wear_rate", "in/h")),
    ("friction", "1", ("friction", "value")),
    ("u of friction", "1", ("friction", "u")),
    ("pV", "MPa m/s", ("pv", "MPa m/s")),
    ("pV", "psi ft/min", ("pv", "psi ft/min")),
    ("mass lost", "mg", ("whole", "mass_loss", "value")),
    ("u of mass lost", "mg", ("whole", "mass_loss", "u")),
    ("volume lost by weighing", "mm3", ("whole", "volume", "value")),
    ("volume lost by displacement", "mm3", ("whole", "volume_by_displacement", "value")),
    ("specific wear rate of the whole test", "mm3/(N m)",
     ("whole", "specific_wear_rate", "value")),
    ("u of specific wear rate of the whole test", "mm3/(N m)",
     ("whole", "specific_wear_rate", "u")),
    ("distance", "m", ("whole", "distance", "value")),
    ("temperature, mean", "degC", ("temperature", "mean")),
    ("temperature, largest", "degC", ("temperature", "max")),
)  # fmt: skip
#: numbers of measure.json in the units of the columns above
_SCALES: dict[tuple[str, ...], float] = {
    ("steady_from", "value"): 1.0 / 3600.0,
    ("wear_rate", "u"): 3.6e6,
}


def number_at(entry: Mapping[str, Any], path: tuple[str, ...]) -> float | None:
    """Return a number of a test in the unit of its column, None where there is none."""
    value: Any = entry
    for name in path:
        if value is None:
            return None
        value = value[name]
    return None if value is None else _SCALES.get(path, 1.0) * float(value)


def estimate_text(value: float, u: float, unit: str = "") -> str:
    """Return a value, its unit and its interval of 95 %, value -+ 2 u.

    Two digits of 2 u are shown (JCGM 100, 7.2.6).
    """
    power = math.floor(math.log10(abs(value))) if value else 0
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
        f"{rate['mean']:.3g} mm3/(N m) from {low:.3g} to {high:.3g} (95 %, {len(repeats['tests'])} "
        f"specimens: {names}); between specimens {100 * rate['s_r']:.2g} %, repeatability r = "
        f"{100 * rate['r']:.2g} %"
    )


def skipped_text(entry: Mapping[str, Any]) -> str:
    """Return the counts of skipped cells and readings in words, "" for none."""
    words = {"empty": "empty cells", "repeated": "repeated stamps", "excluded": "excluded readings"}
    parts = [
        f"{entry['skipped'][key]} {text}" for key, text in words.items() if entry["skipped"][key]
    ]
    return ", ".join(parts)
