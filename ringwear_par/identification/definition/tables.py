"""Tables of a fit file, read key by key; what is wrong is collected."""

import difflib
import math
from collections.abc import Mapping, Set
from typing import Any

from ringwear_par.cases.text import shortened
from ringwear_par.cases.units import in_unit
from ringwear_par.cases.values import RejectedError, Values, is_number, pair
from ringwear_par.errors import MOST_FAULTS, legible
from ringwear_par.identification.definition.problem import Prior


class TableReader:
    """A table whose keys are asked for one by one.

    Parameters
    ----------
    said : how sentences about it begin, file and place.
    table : its keys and raw values; something else is a fault.
    faults : to which sentences are added.
    """

    def __init__(self, said: str, table: Any, faults: list[str]) -> None:
        self.said, self.faults = said, faults
        self._table: Mapping[str, Any] = table if isinstance(table, Mapping) else {}
        self._asked: list[str] = []
        if not isinstance(table, Mapping):
            faults.append(f"{said} = {shortened(table)}: must be a table")

    def __contains__(self, key: str) -> bool:
        return key in self._table

    def keys(self) -> Set[str]:
        """Return the keys that are there."""
        return self._table.keys()

    def fault(self, told: str) -> None:
        """Add a sentence about the table."""
        self.faults.append(f"{self.said}: {told}")

    def wrong(self, key: str, allowed: str) -> None:
        """Add a sentence about a key."""
        told = f"= {shortened(self._table[key])}" if key in self._table else "is missing"
        self.fault(f"{key} {told}: {allowed}")

    def raw(self, key: str, default: Any = None) -> Any:
        """Return a value as it is."""
        self._asked.append(key)
        return self._table.get(key, default)

    def read(self, key: str, values: Values, default: Any = ..., unit: str = "") -> Any:
        """Return what a key holds; its default, or None for none, where it is absent or wrong.

        Parameters
        ----------
        unit : in which numbers that have a unit of their own are returned; "": they have none.
        """
        value = self.raw(key, ...)
        fallback = None if default is ... else default
        if value is ...:
            if default is ...:
                self.wrong(key, f"must be {values.allowed}")
            return fallback
        try:
            value = in_unit(value, unit)
            return values.read(list(value) if isinstance(value, tuple) else value)
        except RejectedError as reason:
            why = f" ({reason})" if str(reason) else ""
            self.wrong(key, f"must be {values.allowed}{why}")
            return fallback

    def choice(self, key: str, names: tuple[str, ...], default: str | None = None) -> str | None:
        """Return one of some names."""
        value = self.raw(key, default)
        if isinstance(value, str) and value in names:
            return value
        self.wrong(key, f"must be one of {', '.join(names)}")
        return default

    def prior(self) -> Prior | None:
        """Return the prior { normal = [mean, sd] }, if there is one."""
        value = self.raw("prior")
        if value is None:
            return None
        numbers = value.get("normal") if isinstance(value, Mapping) and len(value) == 1 else None
        if (
            not isinstance(numbers, list | tuple)
            or len(numbers) != 2
            or not all(is_number(v) and math.isfinite(v) for v in numbers)
            or numbers[1] <= 0
        ):
            self.wrong("prior", "must be { normal = [mean, sd] }, two numbers, sd > 0")
            return None
        return Prior(float(numbers[0]), float(numbers[1]))

    def bounds(self, default: Any = ...) -> tuple[float, float] | None:
        """Return the bounds [low, high]."""
        found: tuple[float, float] | None = self.read("bounds", pair(-math.inf), default)
        return found

    def finish(self) -> None:
        """Add a sentence for each key that nobody asked for."""
        for key in self._table:
            if key not in self._asked:
                few = len(self.faults) < MOST_FAULTS
                near = difflib.get_close_matches(key.lower(), self._asked, n=1) if few else []
                hint = f" (did you mean {near[0]}?)" if near else ""
                self.fault(
                    f"{legible(key)}: unknown key{hint}; must be one of "
                    f"{', '.join(dict.fromkeys(self._asked))}"
                )
