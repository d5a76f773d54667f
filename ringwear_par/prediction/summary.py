"""A prediction in a few lines of text, and as JSON can hold it."""

from typing import Any

from ringwear_par.errors import warning_lines
from ringwear_par.prediction.prediction import PROBABILITIES, Prediction, depth_words
from ringwear_par.results.key_numbers import time_words
from ringwear_par.results.variables import DISPLAY_UNITS, HISTORIES

#: of which the summary tells the end, and what it calls them
_ENDS = {
    "penetration": "penetration",
    "worn_volume_lower": "volume worn off lower",
    "worn_volume_upper": "volume worn off upper",
    "torque": "torque",
}


def summary(prediction: Prediction) -> str:
    """Return the outcome as the command prints it: at the end of the case first."""
    end = float(prediction.time[-1])
    lines = []
    for name, words in _ENDS.items():
        low, _, median, _, high = prediction.quantiles(name)[:, -1]
        if high == 0.0 and name != "penetration":
            continue
        unit, factor = DISPLAY_UNITS.get(name, (HISTORIES[name].unit, 1.0))
        unit = unit.replace("\N{MICRO SIGN}", "u")
        first, last, middle = (f"{factor * value:.4g}" for value in (low, high, median))
        spread = "" if first == last else f"  from {first} to {last} {unit}"
        lines.append(f"{words}  {middle} {unit}{spread}")
    lines[0] = f"{lines[0]} (95 %, {prediction.whose}, after {time_words(end, end)})"
    if prediction.depth is not None:
        when = prediction.time_to(prediction.depth)
        lines.append(f"{depth_words(prediction.depth)}: {when.words(end)}")
    lines.append(f"{len(prediction.values)} draws: {'; '.join(prediction.sources)}")
    if prediction.failed:
        lines.append(f"{prediction.failed} draws were left out: they have no history")
    room = 10 - len(lines)
    return "\n".join([*lines, *warning_lines(doubt.text for doubt in prediction.doubts[:room])])


def to_dict(prediction: Prediction) -> dict[str, Any]:
    """Return the contents of prediction.json."""
    return {
        "of": prediction.of,
        "whose": prediction.whose,
        "fit": prediction.fit,
        "draws": len(prediction.values),
        "failed": prediction.failed,
        "seed": prediction.seed,
        "keys": dict(prediction.keys),
        "drawn_from": list(prediction.sources),
        "probabilities": list(PROBABILITIES),
        "time": prediction.time.tolist(),
        "quantiles": {
            name: {"unit": HISTORIES[name].unit, "values": prediction.quantiles(name).T.tolist()}
            for name in prediction.histories
        },
        "depth": None
        if prediction.depth is None
        else {"depth": prediction.depth, **prediction.time_to(prediction.depth)._asdict()},
        "summary": summary(prediction).splitlines(),
        "doubts": [doubt.to_dict() for doubt in prediction.doubts],
        "case": prediction.case,
        "versions": dict(prediction.versions),
    }
