"""What a wear law's parameters are: declared once, at the law, as annotations of its fields.

A field ``p0: Annotated[Quantity, Parameter("MPa", "threshold pressure")] = 0.0`` is a parameter
with its unit, meaning and default; case files, messages and ``ringwear info --schema`` read it
from there.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass, replace
from functools import lru_cache
from typing import Annotated, Any, Literal, get_type_hints

from ringwear_par.schedules import Quantity


@dataclass(frozen=True)
class Parameter:
    """A parameter of a wear law.

    Parameters
    ----------
    unit : "1" for none, "-" where it has no sense.
    meaning : in a few words.
    kind : a quantity is a number, a table in time or a profile along the radius; the others are
        a number only, pairs (p V, rate), the name of a Python file, a table of quantities.
    low, high : between which numbers may lie.
    ends : whether they may be these too.
    at_least : the parameter of the same law that it is never less than, "" for none.
    local : whether the rate at a place depends on it, and has a derivative with respect to it.
    name, default : of the field that declares it; the default is ... where it must be given.
    """

    unit: str
    meaning: str
    kind: Literal["quantity", "number", "rates", "file", "parameters"] = "quantity"
    low: float = 0.0
    high: float = math.inf
    ends: bool = True
    at_least: str = ""
    local: bool = True
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
