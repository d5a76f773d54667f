"""Stamps of loggers: dates with times of day, and clock times, as seconds."""

import re
from collections.abc import Sequence
from datetime import date

import numpy as np

from ringwear_par.arrays import FloatArray

#: ISO, day first with dots, and slashes whose order the whole column tells
_DATE = (
    r"(?:(?P<iso>\d{4}-\d\d?-\d\d?)|(?P<dots>\d\d?\.\d\d?\.(?:\d{4}|\d\d))|"
    r"(?P<slashes>\d\d?/\d\d?/\d{4}))"
)
_STAMP = re.compile(
    rf"{_DATE}"
    r"(?:[T ]|,? +)(?P<h>\d\d?):(?P<min>[0-5]\d)(?::(?P<s>[0-5]\d(?:[.,]\d*)?))?"
    r" ?(?:(?P<half>[AaPp])[Mm]|Z|(?P<zone>[+-]\d\d:?\d\d))?",
    re.ASCII,
)
_DATE_ALONE = re.compile(_DATE, re.ASCII)
#: h:mm:ss, or two of them
_CLOCK = re.compile(r"(?:(\d+):(?=[0-5]\d:))?(\d+):([0-5]\d(?:[.,]\d*)?)", re.ASCII)
_DAY, _HOUR, _MONTHS, _NOON = 86400.0, 3600.0, 12, 12
#: of short years
_CENTURY = 2000


class StampError(ValueError):
    """A cell that is no stamp of its column; ``row`` says which."""

    def __init__(self, row: int, rule: str) -> None:
        super().__init__(rule)
        self.row = row


def is_stamp(cell: str) -> bool:
    """Tell whether a cell looks like a date with a time of day."""
    return _STAMP.fullmatch(cell) is not None


def is_date(cell: str) -> bool:
    """Tell whether a cell is a date without a time of day."""
    return _DATE_ALONE.fullmatch(cell) is not None


def ambiguous_date(cells: Sequence[str]) -> str:
    """Return a date of different ones that may be read day first or month first, "" for none."""
    matches = (_STAMP.match(cell) for cell in cells)
    dates = dict.fromkeys(match["slashes"] for match in matches if match and match["slashes"])
    certain = any(int(part) > _MONTHS for date in dates for part in date.split("/")[:2])
    return "" if certain or len(dates) < 2 else next(iter(dates))


def is_clock(cell: str) -> bool:
    """Tell whether a cell is a clock time, h:mm:ss or min:s."""
    return _CLOCK.fullmatch(cell) is not None


def has_hours(cell: str) -> bool:
    """Tell whether a cell is a clock time of three parts, h:mm:ss."""
    clock = _CLOCK.fullmatch(cell)
    return clock is not None and clock[1] is not None


def clock_time(cell: str, hour: float) -> float:
    """Return a clock time in the unit of which an hour is ``hour``.

    Two parts are minutes and seconds, or hours and minutes where the unit is the hour.
    """
    clock = _CLOCK.fullmatch(cell)
    if clock is None:
        raise ValueError(f"{cell} is no clock time")
    hours, minutes = float(clock[1] or 0), float(clock[2])
    seconds = float(clock[3].replace(",", "."))
    if clock[1] is None and hour == 1.0:
        hours, minutes, seconds = minutes, seconds, 0.0
    return hour * (hours + minutes / 60.0 + seconds / 3600.0)


def across_midnight(times: FloatArray, day: float) -> FloatArray:
    """Return times of day with a day added at each midnight: where they fall by half a day.

    Parameters
    ----------
    times : (n,) in order; those of more than a day are no times of day, and stay.
    day : in their unit.
    """
    if len(times) == 0 or times.max() >= day:
        return times
    return times + day * np.concatenate([[0], np.cumsum(np.diff(times) < -0.5 * day)])


def seconds_of(cells: Sequence[str]) -> FloatArray:
    """Return the seconds of stamps, counted from an arbitrary day, (n,) float.

    The day is first in dates with slashes, unless one above 12 in the second place says that the
    month is.

    Raises
    ------
    StampError : one is no stamp.
    """
    matches = []
    for row, cell in enumerate(cells):
        match = _STAMP.fullmatch(cell)
        if match is None:
            raise StampError(row, "must be a date with a time, as the lines above")
        matches.append(match)
    month_first = any(
        int(match["slashes"].split("/")[1]) > _MONTHS for match in matches if match["slashes"]
    )
    days: dict[str, int] = {}
    seconds = np.empty(len(matches))
    for row, match in enumerate(matches):
        text = match["iso"] or match["dots"] or match["slashes"]
        if text not in days:
            days[text] = _day_number(text, month_first, row)
        seconds[row] = _DAY * days[text] + _time_of_day(match, row)
    return seconds


def _day_number(text: str, month_first: bool, row: int) -> int:
    first, second, third = (int(part) for part in re.split(r"[-./]", text))
    year, month, day = third, second, first
    if "-" in text:
        year, month, day = first, second, third
    elif "/" in text and month_first:
        month, day = first, second
    try:
        return date(year if year >= 100 else _CENTURY + year, month, day).toordinal()
    except ValueError as error:
        order = "; the month is first here" if "/" in text and month_first else ""
        raise StampError(row, f"there is no such day{order}; 2026-03-14 08:15:00 is") from error


def _time_of_day(match: re.Match[str], row: int) -> float:
    hours = int(match["h"])
    if match["half"]:
        if hours > _NOON:
            raise StampError(row, "there is no such hour; AM and PM are of hours up to 12")
        hours = hours % _NOON + (_NOON if match["half"] in "Pp" else 0)
    seconds = float((match["s"] or "0").replace(",", "."))
    if hours + int(match["min"]) / 60.0 + seconds / _HOUR > 24.0:
        raise StampError(row, "there is no such hour; must be from 0:00 to 24:00")
    zone = (match["zone"] or "").replace(":", "")
    offset = int(f"{zone[0]}1") * (60 * int(zone[1:3]) + int(zone[3:])) if zone else 0
    return _HOUR * hours + 60.0 * (int(match["min"]) - offset) + seconds
