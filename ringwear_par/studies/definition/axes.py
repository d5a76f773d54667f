"""What the figures of sweeps share: names of outputs and keys, legends, logarithmic axes."""

import math
import re
import textwrap
from typing import Any

import numpy as np
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullLocator

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.schema import unit_of
from ringwear_par.cases.units import in_signs
from ringwear_par.pictures.style import plain

GREY = "0.45"
#: of a label along the height of a panel
_LETTERS = 26
#: values beside each other span so much before their axis is logarithmic
LOG_VALUE = 100.0
#: of the magnitude of its values an axis spans so much at least: what varies less is round-off
_LEAST_SPAN = 1e-3


def spans(values: FloatArray, ratio: float) -> bool:
    """Tell whether values ask for a logarithmic axis."""
    finite = values[np.isfinite(values)]
    return bool(len(finite) and finite.min() > 0.0 and finite.max() >= ratio * finite.min())


def least_range(low: float, high: float) -> tuple[float, float]:
    """Return the ends of a plain axis of values, wide enough that round-off stays unseen."""
    wider = _LEAST_SPAN * max(abs(low), abs(high)) - (high - low)
    return (low - 0.5 * wider, high + 0.5 * wider) if wider > 0.0 else (low, high)


def labelled(name: str) -> str:
    """Return a key with its unit."""
    unit = unit_of(name)
    return plain(f"{name} ({in_signs(unit)})" if unit else name)


def upright(label: str) -> str:
    """Return a label in lines that are no longer than a panel is high."""
    return textwrap.fill(label, _LETTERS)


def number_text(value: float, digits: int) -> str:
    """Return a number in so many digits, its exponent short."""
    return re.sub(r"e([+-])0*", lambda e: "e" + e[1].strip("+"), f"{value:.{digits}g}")


def set_decades(axis: Any, values: FloatArray) -> None:
    """Label more than the decades of a logarithmic axis that has few of them."""
    finite = values[np.isfinite(values)]
    decades = math.log10(float(finite.max()) / float(finite.min()))
    if decades < 2.5:
        few = MaxNLocator(4, steps=[1, 2, 5, 10])
        subs = (1.0, 2.0, 5.0) if decades < 1.2 else (1.0, 3.0)
        axis.set_major_locator(few if decades < 0.7 else LogLocator(subs=subs))
        axis.set_major_formatter(FuncFormatter(lambda value, _: number_text(value, 6)))
        axis.set_minor_locator(NullLocator())
