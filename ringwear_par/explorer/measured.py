"""Measurements laid over the charts: the columns of a table, read by their names and units."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import Case, density_keys
from ringwear_par.cases.units import assumption, factor, named_unit, unit_of_column
from ringwear_par.cases.values import RejectedError
from ringwear_par.errors import InputError, legible
from ringwear_par.files.measurements import measurements_in
from ringwear_par.identification.definition.problem import BASE
from ringwear_par.results.result import Result

#: what a column may be over time, and along the radius; as in fit files
OVER_TIME = (
    "penetration", "approach", "torque", "volume.lower", "volume.upper", "mass.lower", "mass.upper",
)  # fmt: skip
ALONG_RADIUS = ("profile.lower", "profile.upper")
#: how the names of columns begin that are times and radii, or one of the quantities
_TIME, _RADIUS = re.compile(r"t(ime)?(?![a-z])", re.I), re.compile(r"r(adius)?(?![a-z])", re.I)
_WORDS = {
    "penetration": "penetration", "displacement": "penetration", "depth": "profile",
    "wear": "profile", "profile": "profile", "height": "profile", "approach": "approach",
    "torque": "torque", "moment": "torque", "volume": "volume", "mass": "mass",
}  # fmt: skip
#: columns that go with others
_BESIDE = re.compile(r"(sd|std|sigma|error|uncertainty)(?![a-z])", re.I)
#: bytes that a table may have
LARGEST = 5_000_000


@dataclass(frozen=True, eq=False)
class MeasuredColumn:
    """A column of a table over its times or radii."""

    #: names of the table and of the column
    file: str
    column: str
    #: one of those above
    quantity: str
    along: bool
    #: (n,) s, or mm where it is ``along`` the radius
    x: FloatArray
    #: (n,) as the table has them
    raw: FloatArray
    #: sentence about the column of x where its name has no unit, else ""
    x_assumption: str = ""

    @property
    def choices(self) -> Sequence[str]:
        """The quantities that it may be."""
        return ALONG_RADIUS if self.along else OVER_TIME

    @property
    def _base(self) -> str:
        """The unit of its quantity in a case."""
        return BASE[self.quantity.partition(".")[0]]

    @property
    def unit(self) -> str:
        """Its unit: the one in its name, else that of the quantity in a case."""
        return unit_of_column(self.column, self._base) or self._base

    @property
    def assumptions(self) -> list[str]:
        """Sentences about columns whose names have no unit."""
        sentences = [self.x_assumption] if self.x_assumption else []
        if unit_of_column(self.column, self._base) is None:
            sentences.append(f"{self.file}: {assumption(self.column, self._base)}")
        return sentences

    def values(self, case: Case, result: Result) -> FloatArray:
        """Return the readings, (n,) mm, N mm or mm^3: a mass as the volume of what is lost.

        Parameters
        ----------
        result : of the case, which tells what of its layers is lost.

        Raises
        ------
        InputError : its name ends with a unit of something else; or the case does not tell the
            density of a mass, or what is lost has several.
        """
        kind, _, body = self.quantity.partition(".")
        unit = _unit(self.file, self.column, self._base) or self._base
        values = factor(unit, self._base) * self.raw
        if kind != "mass":
            return cast(FloatArray, values)
        densities, place = _densities(case, result, body), f"{self.file}: {legible(self.column)}"
        with_density = {key: density for key, density in densities.items() if density is not None}
        if missing := ", ".join(key for key in densities if key not in with_density):
            raise InputError(
                f"{place}: a mass needs the density of what is lost; the case must have {missing} "
                "(g/mm^3)"
            )
        density, *more = set(with_density.values())
        if more:
            densities_words = ", ".join(
                f"{key} = {density:g}" for key, density in with_density.items()
            )
            raise InputError(
                f"{place}: a mass cannot be drawn as a volume where what is lost has several "
                f"densities ({densities_words} g/mm^3); must be a volume"
            )
        return cast(FloatArray, values / density)

    def off(self, result: Result, values: FloatArray) -> float | None:
        """Return the root mean square of readings minus curve as drawn; None: they do not meet."""
        kind, _, body = self.quantity.partition(".")
        if kind == "profile":
            x, y = result.line.r, result.profiles[f"wear_{body}"][-1]
            # outside the contact nothing is worn
            model = np.where((self.x < result.line.edges[0]) | (self.x > result.line.edges[-1]),
                             0.0, np.interp(self.x, x, y))  # fmt: skip
            return float(np.sqrt(np.mean((values - model) ** 2)))
        name = f"worn_volume_{body}" if kind in ("volume", "mass") else kind
        inside = self.x <= result.histories["time"][-1] * (1.0 + 1e-9)
        if not inside.any():
            return None
        model = np.interp(self.x, result.histories["time"], result.histories[name])
        return float(np.sqrt(np.mean((values - model)[inside] ** 2)))


def _densities(case: Case, result: Result, body: str) -> dict[str, float | None]:
    """Return the densities (g/mm^3), by key, of what of a body is lost: of its face at least."""
    densities = getattr(case, body).densities
    keys = density_keys(body, len(densities) - 1)
    volumes = result.layers.get(f"worn_volume_{body}_layers")
    lost = np.ones(1) if volumes is None else volumes[-1]
    parts = enumerate(zip(keys, densities, lost, strict=True))
    return {key: density for i, (key, density, volume) in parts if i == 0 or volume > 0.0}


def read_table(content: bytes, name: str, case: Case) -> list[MeasuredColumn]:
    """Return the columns of a table that can be laid over the charts of a case.

    One column is the time or the radius, by its name; the others are quantities by theirs, and
    depths are of the body that wears where a name does not say which. Units are in their names.

    Raises
    ------
    InputError : it is no such table.
    """
    name = legible(name)
    if len(content) > LARGEST:
        raise InputError(f"{name}: has {len(content)} bytes; must have at most {LARGEST}")
    table = measurements_in(content, name)
    first = next((c for c in table.columns if _TIME.match(c) or _RADIUS.match(c)), None)
    if first is None:
        names = legible(", ".join(table.columns), 200)
        raise InputError(
            f"{name}: has the columns {names}; must have one of times, such as time_s, or of "
            "radii, such as r_mm"
        )
    along = _TIME.match(first) is None
    base = BASE["r" if along else "time"]
    unit = _unit(name, table.label(first), base)
    scale = factor(unit or base, base)
    x_assumption = ""
    if not (unit or (not along and table.names_seconds(first, table.filled(first)))):
        x_assumption = f"{name}: {assumption(first, base)}"
    columns = []
    for column in table.columns:
        if column == first or not column or _BESIDE.match(column):
            continue
        rows = table.filled(first, column)
        if not rows.any():
            continue
        x = scale * table.numbers(first, rows, None if along else factor("h", "s") / scale)
        order = np.argsort(x, kind="stable")
        raw, quantity = (
            table.numbers(column, rows)[order],
            _quantity(table.label(column), along, case),
        )
        label = table.label(column)
        columns.append(MeasuredColumn(name, label, quantity, along, x[order], raw, x_assumption))
    if not columns:
        raise InputError(f"{name}: has no readings beside {legible(first)}; must have some")
    return columns


def _unit(file: str, column: str, base: str) -> str | None:
    """Return the unit in a column's name, None for none."""
    try:
        return named_unit(column, base)
    except RejectedError as reason:
        raise InputError(
            f"{file}: the column {legible(column)} {reason}; must be in a unit of {base}"
        ) from reason


def _quantity(column: str, along: bool, case: Case) -> str:
    """Return the quantity of a column, as well as its name tells."""
    words = re.findall("[a-z]+", column.lower())
    kind = next((_WORDS[word] for word in words if word in _WORDS), "")
    wearing = [b for b, laws in zip(("lower", "upper"), case.laws, strict=True) if laws]
    body = next((b for b in ("lower", "upper") if b in words), (wearing or ["lower"])[0])
    if along:
        return f"profile.{body}"
    if kind in ("volume", "mass"):
        return f"{kind}.{body}"
    if kind in OVER_TIME:
        return kind
    fitting = (q for q in OVER_TIME if unit_of_column(column, BASE[q.partition(".")[0]]))
    return next(fitting, "penetration")
