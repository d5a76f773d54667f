"""Measurements in the charts of the explorer: the columns of a table, read by their names."""

import re
from dataclasses import dataclass

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.units import factor, unit_of_column
from ringwear_par.errors import InputError, legible
from ringwear_par.files.measurements import measurements_in
from ringwear_par.results.result import Result

#: how the names of columns of times and radii begin
_TIME, _RADIUS = re.compile(r"t(ime)?(?![a-z])", re.I), re.compile(r"r(adius)?(?![a-z])", re.I)
#: panels by words in the names of columns, and the unit of results
_QUANTITIES = {
    **dict.fromkeys(("depth", "wear", "profile", "height"), ("wear", "mm")),
    "penetration": ("penetration", "mm"), "displacement": ("penetration", "mm"),
    "approach": ("approach", "mm"), "torque": ("torque", "N mm"), "moment": ("torque", "N mm"),
    "volume": ("volume", "mm^3"),
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Readings:
    """A column of a table over its times or radii, in the units of results."""

    name: str
    #: that has them: "wear" over radii, or one over time
    panel: str
    #: of results: "penetration", "worn_volume_lower", "wear_upper"
    variable: str
    #: (n,) s, or mm
    x: FloatArray
    y: FloatArray

    def distance(self, result: Result) -> float:
        """Return the root mean square of readings less history, NaN where they do not meet."""
        if self.panel == "wear":  # outside the contact nothing is worn
            x, y, ends = result.line.r, result.data[self.variable][-1], (0.0, 0.0)
        else:
            x, y = result.histories["time"], result.histories[self.variable]
            ends = (np.nan, np.nan)
        model = np.interp(self.x, x, y, *ends)
        known = np.isfinite(model)
        return float(np.sqrt(np.mean((self.y - model)[known] ** 2))) if known.any() else np.nan


def read_readings(content: bytes, name: str, body: str) -> list[Readings]:
    """Return the columns of a table.

    One has times or radii; the names of the others have their quantity and unit.

    Parameters
    ----------
    body : whose depths and volumes are meant where a name does not say it.

    Raises
    ------
    InputError : it is no such table.
    """
    table = measurements_in(content, legible(name))
    first = next((c for c in table.columns if _TIME.match(c) or _RADIUS.match(c)), None)
    if first is None:
        raise InputError(
            f"{legible(name)}: must have a column of times, such as time_s, or of radii, r_mm"
        )
    along = _TIME.match(first) is None
    scale = _factor(table.label(first), "mm" if along else "s")
    found = []
    for column in table.columns:
        label, words = table.label(column), re.findall("[a-z]+", column.lower())
        known = [_QUANTITIES[word] for word in words if word in _QUANTITIES]
        known = [(panel, base) for panel, base in known if (panel == "wear") == along]
        rows = table.filled(first, column)
        if column == first or not known or not rows.any():
            continue
        panel, base = known[0]
        of = next((word for word in words if word in ("lower", "upper")), body)
        variable = {"wear": f"wear_{of}", "volume": f"worn_volume_{of}"}.get(panel, panel)
        x = scale * table.numbers(first, rows, None if along else factor("h", "s") / scale)
        y, order = _factor(label, base) * table.numbers(column, rows), np.argsort(x, kind="stable")
        found.append(Readings(label, panel, variable, x[order], y[order]))
    if not found:
        names = [word for word, (panel, _) in _QUANTITIES.items() if (panel == "wear") == along]
        raise InputError(
            f"{legible(name)}: must have readings in a column whose name has one of "
            f"{', '.join(names)}, with its unit, such as {names[0]}_um"
        )
    return found


def _factor(column: str, base: str) -> float:
    """Return the unit in a column's name, or that of results, in that of results."""
    return factor(unit_of_column(column, base) or base, base)
