"""Records of a rig: the channels of a logger's file in the units of a case."""

import math
import re
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray
from ringwear_par.cases.files.columns import UNITS, missing_column, no_unit, unit_by_name
from ringwear_par.cases.units import factor, named_unit
from ringwear_par.cases.values import RejectedError
from ringwear_par.errors import Fault, InputError, legible
from ringwear_par.files.measurements import Measurements, unused_columns
from ringwear_par.files.table_text import ambiguous_date, is_clock, is_value
from ringwear_par.files.text import shortened

#: units of channels; of a temperature the letter behind the degree
CHANNELS = {"time": "s", "wear": "mm", "torque": "N mm", "load": "N", "temperature": "degC"}
#: how units in names are written, for messages
_WRITTEN = {"time": "s", "wear": "um", "torque": "N m", "load": "N", "temperature": "degC"}
#: words in names of columns, the surest first; letters alone are names as they are
_WORDS: dict[str, tuple[set[str], ...]] = {
    "time": ({"t", "time", "timestamp", "zeit", "datum", "uhrzeit", "date"},),
    "wear": (
        {"wear", "verschleiß", "verschleiss", "depth"},
        {"z", "penetration", "displacement", "weg", "position"},
    ),
    "torque": ({"M", "torque", "reibmoment", "drehmoment"},),
    "load": ({"F", "load", "last"},),
    "temperature": ({"T", "temperature", "temperatur"},),
}
_TEMPERATURE = re.compile(r"(?:\N{DEGREE SIGN}|deg)?\s*([CFK])\s*[\])]?$")
#: readings in degrees Celsius, by that letter
_DEGREES: dict[str, Callable[[FloatArray], FloatArray]] = {
    "C": lambda t: t, "K": lambda t: t - 273.15, "F": lambda t: (t - 32.0) / 1.8,
}  # fmt: skip
#: clocks that count from the start of a test
_ZERO = re.compile(r"0?0:00(?::|$)")
#: fewest readings of a record: in fewer no steady part can be found
FEWEST_READINGS = 60
#: share of a record at its start and at its end, whose means show whether it falls
_ENDS = 0.05

Sense = Literal["rising", "falling"]


@dataclass(frozen=True, eq=False)
class Record:
    """Readings of one test."""

    #: its name
    file: str
    #: of the file
    sha256: str
    #: (n,) s from the first stamp
    time: FloatArray
    #: s, the last stamp less the first, also where readings there are excluded
    duration: float
    #: (n,) mm, positive where material is lost, NaN where nothing was read; None: no channel
    wear: FloatArray | None
    #: (n,) N mm
    torque: FloatArray | None
    #: (n,) N
    load: FloatArray | None
    #: (n,) degC; None: no channel
    temperature: FloatArray | None
    #: whether the file's depth is a position, which falls
    falling: bool
    #: names of the channels' columns
    columns: Mapping[str, str]
    #: number of cells that were empty, of stamps that were there before, of readings left out
    empty: int
    repeated: int
    excluded: int
    #: s, increasing intervals without readings, as a user wants it
    exclude: tuple[tuple[float, float], ...] = ()
    #: sentences about how the file was read
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        read = [name for name in CHANNELS if name != "time" and getattr(self, name) is not None]
        return (
            f"<Record {self.file}: {len(self.time)} readings of {', '.join(read)} over "
            f"{self.duration:g} s>"
        )

    @property
    def end(self) -> float:
        """Time of the last reading that is not excluded, s."""
        return float(self.time[-1])

    @property
    def has_both_ends(self) -> bool:
        """Whether neither the first nor the last reading is excluded."""
        return bool(self.time[0] == 0.0) and self.end == self.duration

    def without_excluded(self, times: FloatArray) -> FloatArray:
        """Return times, s, as a clock counts them that stands still where readings are excluded."""
        return times - sum(np.clip(times, low, high) - low for low, high in self.exclude)


def read_record(
    table: Measurements,
    *,
    columns: Mapping[str, str],
    units: Mapping[str, str],
    exclude: list[tuple[float, float]],
    sense: Sense | None,
) -> Record:
    """Return the record in a table. Not collective.

    Parameters
    ----------
    columns, units : of channels, where names do not tell them.
    exclude : s from the first stamp, intervals whose readings are left out.
    sense : of the depth in the file; None: falling where it does in total.

    Raises
    ------
    InputError : all faults, each with the file, the line or the column.
    """
    table = _with_dates(table, columns)
    faults: list[str] = []
    names = _columns(table, columns, units, faults)
    if faults:
        raise InputError(*faults)
    time, rows, repeated = _times(table, names["time"], units.get("time"))
    values: dict[str, FloatArray] = {}
    empty = len(table.rows) - int(table.filled(names["time"]).sum())
    for channel, column in names.items():
        if channel == "time":
            continue
        filled = rows & table.filled(column)
        empty += int(rows.sum() - filled.sum())
        readings = np.full(len(table.rows), np.nan)
        try:
            in_base = _conversion(table, channel, column, units.get(channel))
            readings[filled] = in_base(table.numbers(column, filled))
        except InputError as error:
            faults += error.faults
            continue
        values[channel] = readings[rows]
    if faults:
        raise InputError(*faults)
    inside, duration = np.ones(len(time), dtype=bool), float(time[-1])
    for low, high in exclude:
        inside &= (time < low) | (time > high)
    time, values = time[inside], {name: column[inside] for name, column in values.items()}
    for channel in ("wear", "torque"):
        if (
            channel in values
            and (count := int(np.isfinite(values[channel]).sum())) < FEWEST_READINGS
        ):
            faults.append(
                f"{table.name}: the column {legible(names[channel])} has {count} readings"
                f"{' that are not excluded' if exclude else ''}; must have {FEWEST_READINGS} at "
                "least"
            )
    if faults:
        raise InputError(*faults)
    wear = values.get("wear")
    falling = sense == "falling" or (sense is None and wear is not None and _falls(wear))
    if wear is not None and falling:
        wear = -wear
    return Record(
        table.name, table.sha256, time, duration, wear, values.get("torque"), values.get("load"),
        values.get("temperature"), falling and wear is not None, names, empty, repeated,
        int((~inside).sum()), _union(exclude), _notes(table, names),
    )  # fmt: skip


def _union(intervals: list[tuple[float, float]]) -> tuple[tuple[float, float], ...]:
    """Return increasing intervals that cover what some intervals cover."""
    union: list[tuple[float, float]] = []
    for low, high in sorted((max(low, 0.0), high) for low, high in intervals if high > 0.0):
        if union and low <= union[-1][1]:
            union[-1] = union[-1][0], max(high, union[-1][1])
        else:
            union.append((low, high))
    return tuple(union)


def _notes(table: Measurements, names: Mapping[str, str]) -> tuple[str, ...]:
    """Return sentences about how a table is read, whose channels have columns of these names."""
    notes, time = [], names["time"]
    if date := ambiguous_date(table.cells(time)):
        notes.append(
            f"{legible(time)}: dates such as {date} are read day first, no day above 12 tells the "
            "order"
        )
    unused = [
        column
        for column in table.columns
        if column and column not in names.values() and not table.dates(column)
    ]
    if unused:
        notes.append(unused_columns(unused))
    return tuple(notes)


def _with_dates(table: Measurements, columns: Mapping[str, str]) -> Measurements:
    """Return the table with dates in front of times of day, where each has a column.

    A date that is always the same tells nothing, and a clock that begins at 0:00 counts from the
    start.
    """
    candidates = [name for name in table.columns if _names(name, _WORDS["time"][0])]
    date = next((name for name in candidates if len(table.dates(name)) > 1), None)
    if date is None:
        return table
    for clock in [columns["time"]] if "time" in columns else candidates:
        if clock != date and clock in table.columns:
            joined = table.joined(date, clock)
            if joined.begins_with_stamp(clock) and not _ZERO.match(table.first_cell(clock)):
                return joined
    return table


def _falls(wear: FloatArray) -> bool:
    """Tell whether a depth falls from its first readings to its last."""
    read = wear[np.isfinite(wear)]
    count = max(int(_ENDS * len(read)), 1)
    return bool(read[-count:].mean() < read[:count].mean())


def _columns(
    table: Measurements, columns: Mapping[str, str], units: Mapping[str, str], faults: list[str]
) -> dict[str, str]:
    """Return the columns of the channels that a table has, and add what is wrong to the faults."""
    names: dict[str, str] = {}
    for channel in CHANNELS:
        if channel in columns:
            if fault := missing_column(table, columns[channel], channel):
                faults.append(fault)
                continue
            names[channel] = columns[channel]
        elif column := _known_column(table, channel, set(columns.values()), faults):
            names[channel] = column
    if "time" not in names and not faults:
        faults.append(
            _missing(table, "time", 't, time, Zeit or timestamp; or columns = { time = "..." }')
        )
    if not {"wear", "torque"} & names.keys() and not faults:
        words = 'wear, depth, Weg, torque or M; or columns = { wear = "...", torque = "..." }'
        faults.append(_missing(table, "wear or torque", words))
    for channel, column in [*names.items()]:
        try:
            _conversion(table, channel, column, units.get(channel))
        except InputError as error:
            if channel in ("load", "temperature") and channel not in columns:
                del names[channel]  # nothing is computed of it that a case does not tell
            else:
                faults += error.faults
    return names


def _missing(table: Measurements, channel: str, words: str) -> str:
    if not any(is_value(row[0]) for row in table.rows):
        return (
            f"{table.name}: has no reading: no line begins with a number or a time; must have a "
            "line of column names, and lines of numbers below it"
        )
    return (
        f"{table.name}: has the columns {legible(', '.join(table.columns), 200)}; must have one of "
        f"{channel}, such as {words}"
    )


def _known_column(
    table: Measurements, channel: str, named: set[str], faults: list[str]
) -> str | None:
    """Return the column whose name tells that it is of a channel, None for none."""
    candidates = [
        [column for column in table.columns if column not in named and _names(column, words)]
        for words in _WORDS[channel]
    ]
    for columns in candidates:
        fitting = [column for column in columns if _may_be(table, channel, column)]
        if channel == "time":  # a date beside a time of day, or stamps beside seconds: one will do
            fitting.sort(key=lambda column: not table.begins_with_stamp(column))
        elif len(fitting) > 1:
            faults.append(
                f"{table.name}: the columns {legible(' and '.join(fitting), 200)} may both be of "
                f'{channel}; columns = {{ {channel} = "..." }} must say which is'
            )
        if fitting:
            return fitting[0]
    # in the unit of something else, which is reported
    return next((column for columns in candidates for column in columns), None)


def _names(column: str, words: set[str]) -> bool:
    """Tell whether the name of a column has one of some words; letters alone must be the first."""
    words_of_name = re.findall(r"[^\W\d_]+", column)
    return any(word.lower() in words for word in words_of_name if len(word) > 1) or (
        bool(words_of_name) and len(words_of_name[0]) == 1 and words_of_name[0] in words
    )


def _may_be(table: Measurements, channel: str, column: str) -> bool:
    """Tell whether a column is not in a unit of something else by its name."""
    label = table.label(column)
    if channel == "temperature":
        return True
    if channel == "time" and column.startswith("t") and _TEMPERATURE.search(label):
        return False
    try:
        named_unit(label, CHANNELS[channel])
    except RejectedError:
        return False
    return True


def _conversion(
    table: Measurements, channel: str, column: str, unit: str | None
) -> Callable[[FloatArray], FloatArray]:
    """Return the function of readings of a column that returns them in the channel's unit.

    Raises
    ------
    InputError : they are in no unit, or in that of something else.
    """
    base, label, written = CHANNELS[channel], table.label(column), _WRITTEN[channel]
    scale, hint = None, f', or units = {{ {channel} = "{written}" }}'
    if channel == "temperature":
        match = _TEMPERATURE.search(label) if unit is None else _TEMPERATURE.fullmatch(unit.strip())
        if match is not None:
            return _DEGREES[match[1]]
    elif unit is not None:
        with suppress(RejectedError):
            scale = factor(unit, base)
    elif channel == "time" and table.begins_with_stamp(column):
        scale = 1.0
    else:
        named = unit_by_name(table, column, base, hint)
        scale = None if named is None else factor(named, base)
    if scale is not None:
        return partial(np.multiply, scale)
    if channel == "time" and is_clock(cell := table.first_cell(column)):
        raise InputError(
            f"{table.name}: {legible(column)}: {cell} may be h:min or min:s; name it "
            f'{legible(column)} / h or {legible(column)} / min, or units = {{ time = "h" }}'
        )
    if unit is None:
        raise InputError(no_unit(table, column, written, hint))
    rule = f"must be the unit of {UNITS[base]}"
    state = f"{table.name}: units.{channel} = {shortened(unit)}"
    raise InputError(Fault(f"{state}: {rule}", code="unit"))


def _times(table: Measurements, column: str, unit: str | None) -> tuple[FloatArray, BoolArray, int]:
    """Return seconds from the first stamp, the rows that they are of, and how many were repeated.

    Raises
    ------
    InputError : cells that are no times; times that go back, the first line of which is named.
    """
    filled = table.filled(column)
    seconds = factor(unit or named_unit(table.label(column), "s") or "s", "s")
    times = seconds * table.numbers(column, filled, factor("h", "s") / seconds)
    places = np.flatnonzero(filled)
    table.refuse_fall(column, places, times, ", also where a test that was stopped goes on")
    first = np.concatenate([[True], np.diff(times) > 0.0])[: len(times)]
    rows = np.zeros(len(filled), dtype=bool)
    rows[places[first]] = True
    times = times[first]
    if len(times) < FEWEST_READINGS or math.isclose(times[0], times[-1]):
        raise InputError(
            f"{table.name}: has {len(times)} different times; must have {FEWEST_READINGS} at least"
        )
    return times - times[0], rows, int((~first).sum())
