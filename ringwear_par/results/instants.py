"""Instants of a history: which of them figures and pages draw, and how they call them."""

from dataclasses import dataclass

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.results.result import Result

#: s, up to which times are told in a unit, and its seconds
_UNITS_OF_TIME = ((7200.0, "s", 1.0), (7 * 86400.0, "h", 3600.0), (np.inf, "days", 86400.0))
_QUARTERS = 4
#: numbers from here on have an exponent in texts
_LARGE = 1e6
#: of the highest pressure that is drawn, where a scale ends
_ROOM = 1.1


def time_unit(end: float) -> tuple[str, float]:
    """Return the unit in which times up to an end, s, are told, and its seconds."""
    return next((name, seconds) for most, name, seconds in _UNITS_OF_TIME if end <= most)


def number_words(value: float) -> str:
    """Return a number in four digits, as legends and notes have room for it."""
    return f"{value:.0f}" if 1e3 <= abs(value) < _LARGE else f"{value:.4g}"


def time_words(time: float, end: float) -> str:
    """Return a time of a history, s, as all legends call it.

    Parameters
    ----------
    end : s, of the history, which chooses the unit.
    """
    unit, seconds = time_unit(end)
    return f"{number_words(time / seconds)} {unit}"


def stages(time: FloatArray) -> list[int]:
    """Return the states that profiles are drawn of by default: the first step, four quarters.

    Parameters
    ----------
    time : (s,) float, s, of the stored states.
    """
    wished = [time[min(1, len(time) - 1)], *(time[-1] * q / _QUARTERS for q in range(1, 5))]
    return sorted({int(np.abs(time - t).argmin()) for t in wished})


def pressure_limit(area: FloatArray, pressure: FloatArray, force: FloatArray) -> float:
    """Return the pressure, MPa, that scales of some states end with at most.

    Edges of the first instant are infinite: three times the highest mean over what touches.

    Parameters
    ----------
    area : (n,) float, mm2, of the contact elements.
    pressure : (s, n) float, MPa; force : (s,) float, N.
    """
    touched = (pressure > 0.0) @ area
    return 3.0 * float((force / np.where(touched > 0.0, touched, np.inf)).max())


@dataclass(frozen=True)
class PressurePeak:
    """The highest contact pressure of a history, of all its stored states.

    Parameters
    ----------
    limit : MPa, that scales end with at most, see ``pressure_limit``.
    highest : MPa, of an element.
    time : s, when that is; end : s, of the history.
    """

    limit: float
    highest: float
    time: float
    end: float

    def top(self, drawn: float) -> float:
        """Return where a scale ends whose curves reach up to a pressure, MPa."""
        return min(self.limit, _ROOM * drawn) if drawn > 0.0 else 1.0

    def note(self, top: float) -> str:
        """Return the words about a peak that is above a scale's top, "" where it is not."""
        if self.highest <= top:
            return ""
        peak, when = number_words(self.highest), time_words(self.time, self.end)
        return f"peak of {peak} MPa at {when} not shown"


def pressure_peak(result: Result) -> PressurePeak:
    """Return the peak of the contact pressures that a result holds of all stored states."""
    pressure, time = result.profiles["pressure"], result.histories["time"]
    limit = pressure_limit(result.line.area, pressure, result.histories["force"])
    row = int(pressure.max(axis=1).argmax())
    return PressurePeak(limit, float(pressure[row].max()), float(time[row]), float(time[-1]))
