"""Weighings of specimens, before and after their tests."""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ringwear_par.cases.units import factor, told_unit
from ringwear_par.cases.values import RejectedError
from ringwear_par.errors import InputError, legible
from ringwear_par.files.measurements import Measurements, measurements_in
from ringwear_par.files.ordinary import read_bytes

_BEFORE = {"before", "vor", "vorher", "initial"}
_AFTER = {"after", "nach", "nachher", "final"}
_LOSS = {"loss", "verlust", "massenverlust"}


@dataclass(frozen=True)
class Weighing:
    """The mass that a specimen has lost.

    Parameters
    ----------
    loss : g, mean of before less mean of after.
    before, after : how many readings each is the mean of; where losses were read, these count as
        ``after``, and before is 0.
    """

    loss: float
    before: int
    after: int

    def u(self, sd: float) -> float:
        """Return the standard uncertainty, g, where one reading's is ``sd``."""
        return sd * math.sqrt(sum(1.0 / n for n in (self.before, self.after) if n))


@dataclass(frozen=True)
class Weighings:
    """All weighings of a file.

    Parameters
    ----------
    specimens : by name.
    scatter : g, sd of readings of one mass about their mean; None where none was read twice.
    sha256 : of the file.
    """

    specimens: Mapping[str, Weighing]
    scatter: float | None
    sha256: str


def read_weighings(path: Path) -> Weighings:
    """Return the weighings in a table: a row a specimen. Not collective.

    Its first column names the specimen. Others are masses before (vor, initial) and after (nach,
    final), several of which are averaged; or the loss.

    Raises
    ------
    InputError : all faults, each with the file, the line and the column.
    """
    try:
        content = read_bytes(path)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{path}: cannot be read: {reason}") from error
    table = measurements_in(content, str(path), labelled=True)
    faults: list[str] = []
    columns = _columns(table, faults)
    if faults:
        raise InputError(*faults)
    specimens: dict[str, Weighing] = {}
    squares, freedom = 0.0, 0
    for number, row in enumerate(table.rows):
        place_words = f"{table.name}: line {table.lines[number]}"
        name = row[0]
        if not name or name in specimens:
            state = "names no specimen" if not name else f"{legible(name)}: has two rows"
            faults.append(f"{place_words}: {state}; must be one row a specimen")
            continue
        masses: dict[str, list[float]] = {"before": [], "after": [], "loss": []}
        only = np.arange(len(table.rows)) == number
        for place, (kind, grams) in columns.items():
            one = table.column(place)
            if not one.filled(one.columns[0])[number]:
                continue
            try:
                masses[kind].append(grams * float(one.numbers(one.columns[0], only)[0]))
            except InputError as error:
                faults += error.faults
        for readings in masses.values():
            if len(readings) > 1:
                squares += float(np.var(readings)) * len(readings)
                freedom += len(readings) - 1
        before, after, loss = masses["before"], masses["after"], masses["loss"]
        if loss:
            specimens[name] = Weighing(float(np.mean(loss)), 0, len(loss))
        elif before and after:
            specimens[name] = Weighing(
                float(np.mean(before) - np.mean(after)), len(before), len(after)
            )
        else:
            missing = "before" if not before else "after"
            faults.append(
                f"{place_words}: {legible(name)}: has no mass {missing}; must have one at least"
            )
    if faults:
        raise InputError(*faults)
    scatter = math.sqrt(squares / freedom) if freedom else None
    return Weighings(specimens, scatter, table.sha256)


def _columns(table: Measurements, faults: list[str]) -> dict[int, tuple[str, float]]:
    """Return the kind of each column of masses, and grams of its unit, by place."""
    columns: dict[int, tuple[str, float]] = {}
    for place in range(1, len(table.columns)):
        one = table.column(place)
        name = one.columns[0]
        words = {word.lower() for word in re.findall(r"[^\W\d_]+", name)}
        kinds = [
            kind
            for kind, known in (("before", _BEFORE), ("after", _AFTER), ("loss", _LOSS))
            if words & known
        ]
        if len(kinds) != 1:
            continue
        try:
            unit = told_unit(one.label(name), "g")
        except RejectedError as reason:
            faults.append(
                f"{table.name}: the column {legible(name)} {reason}; must be in the unit of a "
                "mass, such as mg or g"
            )
            continue
        if unit is None:
            faults.append(f"{table.name}: {legible(name)}: no unit; name it {legible(name)} / g")
            continue
        columns[place] = kinds[0], factor(unit, "g")
    kinds_read = {kind for kind, _ in columns.values()}
    if not faults and not ("loss" in kinds_read or kinds_read >= {"before", "after"}):
        faults.append(
            f"{table.name}: has the columns {legible(', '.join(table.columns), 200)}; must have "
            "masses before (vor, initial) and after (nach, final), or the loss"
        )
    return columns
