"""A measurement in a few lines of text: the specific wear rate first, then each test."""

from collections.abc import Iterator, Mapping
from typing import Any

from ringwear_par.errors import warning_lines
from ringwear_par.measuring.measure_numbers import (
    entry_text,
    repeats_text,
    skipped_text,
    steady_text,
)
from ringwear_par.measuring.measure_result import MeasureResult

_SPECIFIC, _CUSTOMARY = "mm3/(N m)", "in3 min/(ft lbf h)"


def summary(result: MeasureResult) -> str:
    """Return the outcome as the command prints it."""
    outcome = result.to_dict()
    tests: Mapping[str, Any] = outcome["tests"]
    lines = [f"specific wear rate {repeats_text(one)}" for one in outcome["repeats"]]
    if not lines:
        count = len(tests)
        lines.append(
            f"numbers of {'this specimen' if count == 1 else f'these {count} specimens'} only: "
            "repeats of a material scatter more"
        )
    width = max(map(len, tests))
    for name, entry in tests.items():
        for number, line in enumerate(_lines(entry)):
            lines.append(f"{'' if number else name:{width}}  {line}")
    lines += [f"note: {note}" for note in outcome["notes"]]
    doubts = [f"{name}: {d['text']}" for name, entry in tests.items() for d in entry["doubts"]]
    return "\n".join([*lines, *warning_lines(doubts)])


def _lines(entry: Mapping[str, Any]) -> Iterator[str]:
    """Yield the lines of a test."""
    specific, rate, friction = (
        entry[name] for name in ("specific_wear_rate", "wear_rate", "friction")
    )
    steady, whole = steady_text(entry), entry["whole"]
    if specific is not None:
        yield f"{entry_text(specific)}, {specific[_CUSTOMARY]:.3g} {_CUSTOMARY}; {steady}"
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
