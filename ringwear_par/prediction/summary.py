"""A prediction in a few lines of text, and as JSON can hold it."""

from typing import Any

import numpy as np

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
#: draws, of which the ends of an interval of 95 % are between others
_MANY = 100


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
    draws = len(prediction.values)
    known = ""
    if draws >= _MANY:
        error = 1e3 * _error_of_ends(prediction)
        known = f", which leave the ends of the first interval uncertain by {error:.1g} um"
    lines.append(f"{draws} draws{known}: {'; '.join(prediction.sources)}")
    if prediction.failed:
        lines.append(f"{prediction.failed} draws were left out: they have no history")
    room = 10 - len(lines)
    return "\n".join([*lines, *warning_lines(doubt.text for doubt in prediction.doubts[:room])])


def _error_of_ends(prediction: Prediction) -> float:
    """Return the larger Monte Carlo error of the ends of the interval of the penetration, mm.

    Their standard deviation in other draws, by the order of these: a share p of n draws is known to
    sqrt(p (1 - p) / n).
    """
    shares = np.array([PROBABILITIES[0], PROBABILITIES[-1]])
    sd = np.sqrt(shares * (1.0 - shares) / len(prediction.values))
    around = np.clip([shares - sd, shares + sd], 0.0, 1.0)
    below, above = prediction.quantiles("penetration", around.ravel().tolist())[:, -1].reshape(2, 2)
    return 0.5 * float((above - below).max())


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
