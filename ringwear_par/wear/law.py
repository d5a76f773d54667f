"""Wear laws, eq. (4) of the paper and beyond: the methods and parameters of a law.

A law returns the rate of wear at a contact pressure. The rate may depend on the time, the sliding
speed, the friction coefficient, and on the memory of a place: the depth worn off this body and the
distance slid. Rates must not be negative and not fall with pressure, so that the implicit step is a
convex problem.

Its parameters are declared once, as annotations of its fields: a field
``p0: Annotated[Quantity, Parameter("MPa", "threshold pressure")] = 0.0`` is a parameter with its
unit, meaning and default; case files, messages and ``ringwear info --schema`` read it from there.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, is_dataclass, replace
from functools import lru_cache
from typing import (
    Annotated,
    Any,
    ClassVar,
    Literal,
    Protocol,
    Self,
    get_type_hints,
    runtime_checkable,
)

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray, derivative
from ringwear_par.errors import Fault
from ringwear_par.schedules import (
    Quantity,
    Stacked,
    breakpoints,
    history,
    largest,
    quantity_text,
    smallest,
    take,
)
from ringwear_par.schedules import stack as stack_quantities
from ringwear_par.wear.local_state import LocalState


@dataclass(frozen=True)
class Parameter:
    """A parameter of a wear law."""

    #: "1" of a plain number, "-" of a file or a table
    unit: str
    #: in a few words
    meaning: str
    #: a quantity is a number, a table in time or a profile along the radius; the others are a
    #: number only, pairs (p V, rate), the name of a Python file, a table of quantities
    kind: Literal["quantity", "number", "rates", "file", "parameters"] = "quantity"
    #: least and largest number that is allowed
    low: float = 0.0
    high: float = math.inf
    #: whether ``low`` and ``high`` themselves are allowed
    ends: bool = True
    #: the parameter of the same law that this one must not be less than, "" for none
    at_least: str = ""
    #: whether the rate at a place depends on it, and has a derivative with respect to it
    local: bool = True
    #: name and default of the field that declares it; the default is ... where there is none
    name: str = ""
    default: Any = ...

    @property
    def needed(self) -> bool:
        """Whether it must be given."""
        return self.default is ...

    @property
    def numeric(self) -> bool:
        """Whether the rate has a derivative with respect to it."""
        return self.kind in ("quantity", "number") and self.local


def _declared(law: type) -> Mapping[str, Parameter]:
    declared: dict[str, Parameter] = {}
    if not is_dataclass(law):
        return declared
    hints = get_type_hints(law, include_extras=True)
    for field in fields(law):
        for note in getattr(hints[field.name], "__metadata__", ()):
            if isinstance(note, Parameter):
                default = ... if field.default is MISSING else field.default
                declared[field.name] = replace(note, name=field.name, default=default)
    return declared


#: the parameters that a class of laws declares, by name, in their order
parameters_of: Callable[[type], Mapping[str, Parameter]] = lru_cache(_declared)

#: parameters of more than one law
Coefficient = Annotated[Quantity, Parameter("1/MPa", "wear coefficient")]
Threshold = Annotated[Quantity, Parameter("MPa", "threshold pressure")]


#: pressure (MPa), worn depth (mm) and parameter of which difference quotients take a part as their
#: step, where the value itself is smaller
_SMALL_PRESSURE, SMALL_WEAR, _SMALL_PARAMETER = 1e-3, 1e-6, 1e-3


@runtime_checkable
class WearLaw(Protocol):
    """A wear law as a user may write it: any object with a rate.

    It may have other attributes of ``Law``, such as ``d_rate_dp`` or ``breakpoints``; ``complete``
    adds the missing ones. Calls come for any history, at any time, in any order, so that a law must
    not keep anything from one call to the next. If (B, n) pressures give other rates than the (n,)
    of each history, histories are computed one by one.
    """

    def rate(self, p: FloatArray, local: LocalState, /) -> FloatArray:
        """Return the rate of wear, (..., n) mm/s, at pressures p, (..., n) MPa, >= 0."""
        ...


class Law:
    """A wear law with all methods that a history calls; a subclass needs no more than ``rate``.

    Pressures ``p`` are (..., n) float, MPa, >= 0; so are results, but for their units.
    """

    #: value of ``law`` in case files, and the rate in the paper's symbols
    name: ClassVar[str] = ""
    formula: ClassVar[str] = "rate(p, local)"

    #: averaging length, mm; 0 for a local law
    length: float = 0.0
    #: whether the rate depends on the pressure, the speed, friction and parameters alone; each
    #: class says so itself, as one that overrides a rate may read the time
    steady: ClassVar[bool] = False

    def __init_subclass__(cls, **options: Any) -> None:
        """Leave closed forms to the class that defines them: others may override the rate."""
        super().__init_subclass__(**options)
        for form in ("depth_in_step", "line"):
            if form not in vars(cls):
                setattr(cls, form, getattr(Law, form))

    @property
    def remembers(self) -> bool:
        """Whether the rate depends on ``local.wear``."""
        return False

    @property
    def reads_wear(self) -> bool:
        """Whether the rate may depend on ``local.wear``, if only on that at the start of a step."""
        return self.remembers

    @property
    def is_steady(self) -> bool:
        """Whether the rate at a pressure changes only where speed or friction does."""
        return vars(type(self)).get("steady", False) and not self.breakpoints

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Times, s, at which a parameter's table bends."""
        return breakpoints(*map(self.quantity, self.numeric))

    @property
    def numeric(self) -> tuple[str, ...]:
        """Names of the parameters that the rate has derivatives with respect to."""
        return tuple(
            name
            for name, parameter in parameters_of(type(self)).items()
            if parameter.numeric and getattr(self, name) is not None
        )

    def rate(self, p: FloatArray, local: LocalState) -> FloatArray:
        """Return the rate of wear, mm/s."""
        raise NotImplementedError

    def d_rate_dp(self, p: FloatArray, local: LocalState) -> FloatArray:
        """Return the derivative of the rate with respect to pressure, mm/s/MPa, >= 0."""
        d_rate = derivative(lambda p: self.rate(p, local), p, _SMALL_PRESSURE)
        return np.maximum(d_rate, 0.0)

    def d_rate_dwear(self, p: FloatArray, local: LocalState) -> FloatArray:
        """Return the derivative of the rate with respect to ``local.wear``, 1/s."""
        if not self.remembers:
            return np.zeros_like(p)
        return derivative(
            lambda wear: self.rate(p, replace(local, wear=wear)), local.wear, SMALL_WEAR
        )

    def quantity(self, name: str) -> Quantity:
        """Return a numeric parameter as it was given."""
        return getattr(self, name)

    def per_energy(self, friction: float) -> float | None:
        """Return worn volume per dissipated energy, 1/MPa, if it is always the same."""
        return None

    def ratios(self, friction: Quantity) -> list[float]:
        """Return worn volume per dissipated energy, 1/MPa, 0 where it is not always the same."""
        ends = {self.per_energy(of(friction)) or 0.0 for of in (smallest, largest)}
        return [ends.pop() if len(ends) == 1 else 0.0]

    def onset(self, local: LocalState) -> float | FloatArray:
        """Return the pressure, MPa, up to which nothing wears."""
        return 0.0

    def potential(self, p: FloatArray, local: LocalState) -> FloatArray | None:
        """Return the integral of the rate from 0 to p, MPa mm/s; None: by quadrature."""
        return None

    def line(self, local: LocalState) -> tuple[FloatArray, float | FloatArray] | None:
        """Return rise, mm/s/MPa, and onset, MPa, of a rate that is rise x max(0, p - onset).

        None of other rates, and of those that depend on the wear within a step.
        """
        return None

    def depth_in_step(
        self, p: FloatArray, local: LocalState, step: float | FloatArray
    ) -> FloatArray | None:
        """Return the depth d = step rate(p, wear + d) of an implicit step, mm; None: by iteration.

        Of laws that remember; the step is in s. A subclass does not inherit it.
        """
        return None

    def describe(self) -> str:
        """Return the formula with its numbers and units."""
        values = {
            name: getattr(self, name)
            for name, parameter in parameters_of(type(self)).items()
            if parameter.kind in ("quantity", "number")
        }
        return self.formula + self._values_text(values)

    def _values_text(self, values: Mapping[str, Quantity | None]) -> str:
        """Return " with ..." of numbers and tables that are not None."""
        declared = parameters_of(type(self))
        parts = []
        for name, q in values.items():
            if q is not None:
                unit = declared[name].unit if name in declared else "1"
                number = f"{q:.10g}" if isinstance(q, float | int) else quantity_text(q)
                parts.append(f"{name} = {number}" + (f" {unit}" if unit not in ("1", "-") else ""))
        return f" with {', '.join(parts)}" if parts else ""

    # -- of many histories -------------------------------------------------------------------------

    @classmethod
    def stacked(cls, laws: Sequence[Self]) -> Self:
        """Return one law for some histories whose laws differ in numeric parameters only.

        Raises
        ------
        ValueError : they differ in something else.
        """
        first: Any = laws[0]
        changed: dict[str, Any] = {}
        for declared in fields(first):
            name = declared.name
            values = [getattr(law, name) for law in laws]
            if all(q == values[0] for q in values):
                continue
            parameter = parameters_of(cls).get(name)
            if parameter is None or not parameter.numeric or None in values:
                raise ValueError(f"laws of different {name} cannot be stacked")
            quantity = parameter.kind == "quantity"
            changed[name] = stack_quantities(values) if quantity else np.array(values)[:, None]
        return replace(first, **changed)

    def history(self, i: int) -> Self:
        """Return the law of one of B histories."""
        return self._with_stacks(lambda q: history(q, i))

    def take(self, histories: IntArray) -> Self:
        """Return the law of some of B histories."""
        return self._with_stacks(lambda q: take(q, histories))

    def _with_stacks(self, change: Callable[[Any], Any]) -> Self:
        """Return the law with changes of the parameters that differ between histories."""
        parameters = {name: getattr(self, name) for name in parameters_of(type(self))}
        stacks = {k: q for k, q in parameters.items() if isinstance(q, Stacked | np.ndarray)}
        changed = {name: change(q) for name, q in stacks.items()}
        return replace(self, **changed) if changed else self  # type: ignore[type-var]

    # -- from the keys of a case file --------------------------------------------------------------

    @classmethod
    def from_values(cls, values: Mapping[str, Any]) -> Self:
        """Return the law with these parameters; those that are None have their defaults.

        Raises
        ------
        InputError : they make no law; each fault begins with the name of a parameter.
        """
        return cls(**{name: v for name, v in values.items() if v is not None})

    @classmethod
    def has_rules(cls) -> bool:
        """Return whether parameters that are right one by one can be wrong together."""
        checks = {"from_values", "faults", "__post_init__"}
        bounds = any(parameter.at_least for parameter in parameters_of(cls).values())
        return bounds or any(checks & vars(k).keys() for k in cls.__mro__ if k is not Law)

    @classmethod
    def faults(cls, table: str, values: Mapping[str, Any]) -> list[Fault]:
        """Return the faults of parameters that are right one by one, but not together.

        Parameters
        ----------
        table : beginning of their keys, "wear.lower.".
        values : by name; None if the file has none; without those that are wrong by themselves.
        """
        faults = []
        for name, parameter in parameters_of(cls).items():
            quantity, least = values.get(name), values.get(parameter.at_least)
            if quantity is not None and least is not None and smallest(quantity) < largest(least):
                sentence = (
                    f"{table}{name} = {quantity_text(quantity)}: must be at least "
                    f"{table}{parameter.at_least} = {quantity_text(least)}"
                )
                faults.append(Fault(sentence, f"{table}{name}", "conflict"))
        return faults


@dataclass(frozen=True)
class PacedLaw(Law):
    """The rate of another law times a factor: in a step of a history whose wear is random."""

    #: the other law
    law: Law
    #: the factor, or (B, 1) of B histories
    pace: float | FloatArray

    @property
    def remembers(self) -> bool:
        """Whether the rate depends on ``local.wear``."""
        return self.law.remembers

    def rate(self, p: FloatArray, local: LocalState) -> FloatArray:
        """Return the rate of wear, mm/s."""
        return self.pace * self.law.rate(p, local)

    def d_rate_dp(self, p: FloatArray, local: LocalState) -> FloatArray:
        """Return the derivative of the rate with respect to pressure, mm/s/MPa."""
        return self.pace * self.law.d_rate_dp(p, local)

    def d_rate_dwear(self, p: FloatArray, local: LocalState) -> FloatArray:
        """Return the derivative of the rate with respect to ``local.wear``, 1/s."""
        return self.pace * self.law.d_rate_dwear(p, local)

    def line(self, local: LocalState) -> tuple[FloatArray, float | FloatArray] | None:
        """Return rise and onset of a rate that is a line."""
        line = self.law.line(local)
        return None if line is None else (self.pace * line[0], line[1])

    def depth_in_step(
        self, p: FloatArray, local: LocalState, step: float | FloatArray
    ) -> FloatArray | None:
        """Return the depth of an implicit step, mm; None: by iteration."""
        return self.law.depth_in_step(p, local, self.pace * step)

    def potential(self, p: FloatArray, local: LocalState) -> FloatArray | None:
        """Return the integral of the rate from 0 to p, MPa mm/s; None: by quadrature."""
        potential = self.law.potential(p, local)
        return None if potential is None else self.pace * potential

    def onset(self, local: LocalState) -> float | FloatArray:
        """Return the pressure, MPa, up to which nothing wears."""
        return self.law.onset(local)


def stack_laws(laws: Sequence[Law | None]) -> Law | None:
    """Return one law for B histories from theirs, whose parameters are arrays where they differ.

    Raises
    ------
    ValueError : they are of different classes, or differ in more than numeric parameters.
    """
    first = laws[0]
    if all(law is first or law == first for law in laws):
        return first
    same = [law for law in laws if law is not None and type(law) is type(first)]
    if first is None or len(same) < len(laws):
        raise ValueError("laws of different kinds cannot be stacked")
    return first.stacked(same)
