"""The wear law of a body or a layer: a kind of law, and the values of its parameters."""

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.errors import Fault
from ringwear_par.schedules import (
    Quantity,
    Table,
    breakpoints,
    largest,
    quantity_text,
    smallest,
    value,
)
from ringwear_par.wear.at import LocalState
from ringwear_par.wear.laws import LAWS, Kind, Values
from ringwear_par.wear.user import UserCode


@dataclass(frozen=True, repr=False)
class Law:
    """A wear law of a body or a layer."""

    kind: Kind
    #: of its parameters, by name, those of a user's file as "parameters.k"; None of unused ones
    values: Mapping[str, Any]
    #: of a user's law
    code: UserCode | None = None

    @classmethod
    def of_values(cls, name: str, **values: Any) -> "Law":
        """Return the law of ``LAWS`` with these values; those that are None have their defaults.

        Raises
        ------
        InputError : a file is no law; the fault begins with the name of its parameter.
        """
        kind = LAWS[name]
        defaults = {p.name: None if p.default is ... else p.default for p in kind.declared}
        values = defaults | {name: value for name, value in values.items() if value is not None}
        if "file" not in values:
            return cls(kind, values)
        code = UserCode.of_file(values["file"])
        values |= {f"parameters.{name}": q for name, q in values.pop("parameters")}
        return cls(replace(kind, formula=f"rate(p, at) of {code.called}"), values, code)

    @classmethod
    def of(cls, law: Any) -> "Law":
        """Return the law of a user's object, whose numbers are its parameters; a law as it is."""
        if isinstance(law, Law):
            return law
        named = fields(law) if is_dataclass(law) and not isinstance(law, type) else ()
        values = {field.name: getattr(law, field.name) for field in named}
        numbers = {name: number for name, number in values.items() if isinstance(number, float)}
        name = type(law).__name__
        kind = replace(LAWS["user"], name=name, formula=f"{name}.rate(p, local)")
        return cls(kind, numbers, UserCode(name, law))

    def __repr__(self) -> str:
        values = ", ".join(f"{k}={v!r}" for k, v in self.values.items() if v is not None)
        return f"{self.name}({values})"

    @property
    def name(self) -> str:
        """Value of ``law`` in case files, or the class of a user's object."""
        return self.kind.name

    @property
    def length(self) -> float:
        """Averaging length, mm; 0 for a local law."""
        return self.values.get("length", 0.0) if self.code is None else self.code.length

    @property
    def remembers(self) -> bool:
        """Whether the rate depends on worn depth."""
        if self.code is not None:
            return self.code.remembers
        return any(self.values[name] is not None for name in self.kind.one_of[:1])

    @property
    def linear(self) -> bool:
        """Whether the rate is a line above a threshold, whatever the pressure."""
        return self.kind.linear and not self.remembers

    @property
    def quantities(self) -> dict[str, Quantity]:
        """The numbers, tables and profiles that the rate depends on smoothly, by name."""
        values = {**self.values, **({"length": self.length} if self.length else {})}
        return {name: q for name, q in values.items() if isinstance(q, float | int | Table)}

    @cached_property
    def arguments(self) -> dict[str, Quantity | FloatArray]:
        """What the function takes besides pressure and state."""
        if "table" in self.values:
            return dict(zip("xy", np.array(self.values["table"], dtype=float).T, strict=True))
        return {
            name.removeprefix("parameters."): q
            for name, q in self.values.items()
            if isinstance(q, float | int | Table) and name != "length"
        }

    @cached_property
    def key(self) -> Hashable:
        """Equal for laws whose arguments may be stacked, for one function of many histories."""
        source = self.code and (self.code.source if self.code.is_file else id(self.code.source))
        shapes = ((name, getattr(q, "shape", ())) for name, q in self.arguments.items())
        return self.name, source, self.length, *sorted(shapes)

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Times, s, at which a parameter's table bends, and those that a user's law names."""
        own = () if self.code is None else self.code.breakpoints
        return tuple(sorted({*breakpoints(*self.quantities.values()), *own}))

    def at(self, local: LocalState) -> dict[str, Any]:
        """Return the arguments at the time and the radii of a state of one history."""
        return {
            name: q if isinstance(q, np.ndarray) else value(q, local.time, local.r)
            for name, q in self.arguments.items()
        }

    def rate(self, p: FloatArray, local: LocalState) -> FloatArray:
        """Return the rate of wear, (n,) mm/s, at pressures (n,) MPa and a state of one history.

        Raises
        ------
        LawError : the code of a user failed, or gave NaN or a negative rate.
        """
        if self.code is not None:
            return self.code.values(p, replace(local, parameters=self.at(local)))[0]
        return np.maximum(self.kind.function(p, local, **self.at(local))[0], 0.0)

    def ratio(self, friction: Quantity) -> float:
        """Return worn volume per dissipated energy, 1/MPa, 0 where it is not always the same."""
        k, low, high = self.values.get("k"), smallest(friction), largest(friction)
        if self.code or not isinstance(k, float | int) or self.values.get("p0", 0.0) != 0.0:
            return 0.0
        if self.name == "threshold":
            return k
        return k / low if self.name == "archard" and 0.0 < low == high else 0.0

    def unit(self, name: str) -> str:
        """Return the unit of a quantity, "1" where it is not declared."""
        parameter = self.kind.parameters.get(name)
        return "1" if parameter is None else parameter.unit

    def describe(self) -> str:
        """Return the formula with its numbers and units."""
        if "table" in self.values:
            (x, y), count = self.values["table"][-1], len(self.values["table"])
            end = f"{y:.10g} mm/s at p V = {x:.10g} MPa mm/s"
            return f"{self.kind.formula}, {count} of them to {end}"
        parts = []
        for name, q in self.quantities.items():
            number = f"{q:.10g}" if isinstance(q, float | int) else quantity_text(q)
            unit = "" if self.unit(name) == "1" else f" {self.unit(name)}"
            parts.append(f"{name.removeprefix('parameters.')} = {number}{unit}")
        return self.kind.formula + (f" with {', '.join(parts)}" if parts else "")


def faults_together(kind: Kind, table: str, values: Mapping[str, Any]) -> list[Fault]:
    """Return the faults of a law's parameters that are right one by one, but not together.

    Parameters
    ----------
    table : beginning of their keys, "wear.lower.".
    values : by name; None if the file has none; without those that are wrong by themselves.
    """
    faults, alternatives = [], [values[name] for name in kind.one_of if name in values]
    if kind.one_of and len(alternatives) == len(kind.one_of) and alternatives.count(None) != 1:
        keys = ", ".join(table + name for name in kind.one_of)
        sentence = f"{keys}: one of them must be given (mm)"
        faults.append(Fault(sentence, table + kind.one_of[0], "missing"))
    for name, parameter in kind.parameters.items():
        quantity, least = values.get(name), values.get(parameter.at_least)
        if quantity is not None and least is not None and smallest(quantity) < largest(least):
            sentence = (
                f"{table}{name} = {quantity_text(quantity)}: must be at least "
                f"{table}{parameter.at_least} = {quantity_text(least)}"
            )
            faults.append(Fault(sentence, f"{table}{name}", "conflict"))
    return faults


def _no_wear(p: FloatArray, at: LocalState) -> Values:
    return 0.0 * at.speed * p, 0.0 * at.speed


NO_WEAR = Law(Kind("", _no_wear, "0", linear=True), {})


def in_words(laws: Sequence[Law], thicknesses: Sequence[float]) -> str:
    """Return the laws of the layers of a body, of thicknesses in mm, and of the body itself."""
    words = [law.describe() for law in laws]
    for i, thickness in enumerate(thicknesses[: len(words)]):
        words[i] += f" through a layer of {1e3 * thickness:.6g} um"
    return ", then ".join(words) + " in the body itself" * (len(words) > 1)
