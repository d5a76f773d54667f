"""Weighings of specimens, before and after their tests."""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.files.columns import no_unit, unit_by_name
from ringwear_par.cases.units import bare_name, factor, unit_of_column
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.errors import InputError, legible
from ringwear_par.files.measurements import Measurements, read_measurements, unused_columns
from ringwear_par.files.table_text import EMPTY

#: kinds of columns of masses, and the words in their names
KINDS = {
    "before": {"before", "vor", "vorher", "initial"},
    "after": {"after", "nach", "nachher", "final"},
    "loss": {"loss", "verlust", "massenverlust"},
}
#: these and the standard deviation, which may be that of a loss: "sd loss"
MASSES = {"sd": {"sd", "u"}, **KINDS}
#: decimals of masses in g: differences have the digits that were typed, and no more
_DIGITS = 12
#: words that names of columns may have besides those that tell what is weighed
_BESIDE = {*BODIES, "mass", "masse", "m", "id", "no", "nr"}


@dataclass(frozen=True)
class Weighing:
    """The mass that a specimen has lost."""

    #: g, mean of before less mean of after
    loss: float
    #: how many readings each is the mean of; a loss that was read is of one before and one after
    before: int
    after: int

    @classmethod
    def of(cls, masses: Mapping[str, Sequence[float]], digit: float) -> "Weighing":
        """Return the weighing of masses (g) by what they are of, see ``KINDS``.

        Parameters
        ----------
        digit : g, the last digit of the coarsest of them.

        Raises
        ------
        InputError : some are missing, or a loss is not that of the masses beside it.
        """
        before, after, loss = (masses.get(kind, ()) for kind in KINDS)
        if loss and before and after:
            difference = float(np.mean(before) - np.mean(after))
            if abs(float(np.mean(loss)) - difference) > digit * (1.0 + 1e-6):
                raise InputError(
                    f"has a loss of {1e3 * float(np.mean(loss)):.6g} mg beside before - after = "
                    f"{1e3 * difference:.6g} mg; must be the same, or one of both empty"
                )
        if loss:
            return cls(float(np.mean(loss)), len(loss), len(loss))
        if before and after:
            lost = round(float(np.mean(before) - np.mean(after)), _DIGITS)
            return cls(lost, len(before), len(after))
        missing = "after" if before else "before"
        raise InputError(f"has no mass {missing}; must have one at least")

    def u(self, sd: float) -> float:
        """Return the standard uncertainty, g, where one reading's is ``sd``."""
        return sd * math.sqrt(1.0 / self.before + 1.0 / self.after)


@dataclass(frozen=True)
class Weighings:
    """All weighings of a file."""

    #: by name
    specimens: Mapping[str, Weighing]
    #: g, sd of readings of one mass about their mean; None where none was read twice
    scatter: float | None
    #: g, by the digits of readings
    resolution: float
    #: of the file
    sha256: str
    #: sentences about how the file was read
    notes: tuple[str, ...] = ()

    @property
    def coarse(self) -> bool:
        """Whether readings of one mass scatter by less than they are rounded by."""
        return self.scatter is not None and self.scatter < self.rounding

    @property
    def rounding(self) -> float:
        """Standard uncertainty of a reading by its resolution alone, g (JCGM 100, F.2.2.1)."""
        return self.resolution / math.sqrt(12.0)

    @property
    def sd(self) -> float | None:
        """Standard uncertainty of one weighing, g: its scatter, but at least its rounding."""
        return None if self.scatter is None else max(self.scatter, self.rounding)


def read_weighings(path: Path) -> Weighings:
    """Return the weighings in a table: a row a specimen. Not collective.

    Its first column names the specimen. Others are masses before (vor, initial) and after (nach,
    final), several of which are averaged; or the loss.

    Raises
    ------
    InputError : all faults, each with the file, the line and the column.
    """
    table = read_measurements(path, labelled=True)
    faults: list[str] = []
    columns = _columns(table, faults)
    if faults:
        raise InputError(*faults)
    specimens: dict[str, Weighing] = {}
    squares, freedom = 0.0, 0
    readings = _readings(table, columns, faults)
    for number, row in enumerate(table.rows):
        place_words = f"{table.name}: line {table.lines[number]}"
        name = row[0]
        if not name or name in specimens:
            state = "names no specimen" if not name else f"{legible(name)}: has two rows"
            faults.append(f"{place_words}: {state}; must be one row a specimen")
            continue
        masses = {
            wanted: [
                float(readings[place][number])
                for place, (kind, _) in columns.items()
                if kind == wanted and np.isfinite(readings[place][number])
            ]
            for wanted in KINDS
        }
        digits = [
            grams * last_digit(row[place])
            for place, (_, grams) in columns.items()
            if np.isfinite(readings[place][number])
        ]
        for kind, values in masses.items():
            if len(values) > 1:
                squares += float(np.var(values)) * len(values) / (2 if kind == "loss" else 1)
                freedom += len(values) - 1
        try:
            specimens[name] = Weighing.of(masses, max(digits, default=0.0))
        except InputError as error:
            faults.append(f"{place_words}: {legible(name)}: {error}")
    if faults:
        raise InputError(*faults)
    scatter = math.sqrt(squares / freedom) if freedom else None
    unused = [name for i, name in enumerate(table.columns) if i and name and i not in columns]
    notes = (f"weighings: {unused_columns(unused)}",) if unused else ()
    return Weighings(specimens, scatter, _resolution(table, columns), table.sha256, notes)


def _readings(
    table: Measurements, columns: Mapping[int, tuple[str, float]], faults: list[str]
) -> dict[int, FloatArray]:
    """Return the masses of all rows by the places of columns, g; NaN where nothing was read."""
    readings = {}
    for place, (_, grams) in columns.items():
        column = table.column(place)
        filled = column.filled(column.columns[0])
        readings[place] = np.full(len(table.rows), np.nan)
        try:
            readings[place][filled] = grams * column.numbers(column.columns[0], filled)
        except InputError as error:
            faults += error.faults
    return readings


def last_digit(cell: str) -> float:
    """Return the value of the last digit of a number as it is written."""
    return 10.0 ** int(Decimal(cell.replace(",", ".")).as_tuple().exponent)


def _resolution(table: Measurements, columns: Mapping[int, tuple[str, float]]) -> float:
    """Return the finest last digit of masses, g: zeros there may be dropped."""
    return min(
        grams * last_digit(row[place])
        for place, (_, grams) in columns.items()
        for row in table.rows
        if row[place].lower() not in EMPTY
    )


def roles_by_name(
    column: Measurements, words: Mapping[str, set[str]], base: Callable[[str], str]
) -> list[str]:
    """Return the roles that a column may have: with a unit that fits, a word of its name tells.

    Else the name must be that word, so that a missing or wrong unit is reported.

    Parameters
    ----------
    column : a table of one column.
    words : of names by what columns are of; letters alone are as they are.
    base : returns a unit of that, "" for none.
    """
    (name,) = column.columns
    label, words_of_name = column.label(name), re.findall(r"[^\W\d_]+", bare_name(name))
    in_name = {word.lower() if len(word) > 1 else word for word in words_of_name}
    known = {word for word in in_name if len(word) > 1} | {*words_of_name[:1]}
    roles = [role for role, usual in words.items() if known & usual]
    fitting = [role for role in roles if base(role) and unit_of_column(label, base(role))]
    roles = fitting or [role for role in roles if in_name - _BESIDE <= words[role]]
    return roles if len(KINDS.keys() & {*roles}) < 2 else []  # "before - after" is neither


def _columns(table: Measurements, faults: list[str]) -> dict[int, tuple[str, float]]:
    """Return the kind of each column of masses, and grams of its unit, by place."""
    columns: dict[int, tuple[str, float]] = {}
    for place in range(1, len(table.columns)):
        column, name = table.column(place), table.columns[place]
        role = next(iter(roles_by_name(column, MASSES, lambda _: "g")), "")
        if role not in KINDS:
            continue
        try:
            if (unit := unit_by_name(column, name, "g")) is None:
                raise InputError(no_unit(table, name, "g"))
        except InputError as error:
            faults += error.faults
            continue
        columns[place] = role, factor(unit, "g")
    kinds_read = {kind for kind, _ in columns.values()}
    if not faults and not ("loss" in kinds_read or kinds_read >= {"before", "after"}):
        faults.append(
            f"{table.name}: has the columns {legible(', '.join(table.columns), 200)}; must have "
            "masses before (vor, initial) and after (nach, final), or the loss, with their units"
        )
    return columns
