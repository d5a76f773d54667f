"""Which cases of one contact pair may step together."""

from collections.abc import Hashable
from dataclasses import fields, is_dataclass
from functools import cache
from typing import Any

from ringwear_par.cases.case import Case
from ringwear_par.wear.checked_law import CompletedLaw
from ringwear_par.wear.law import Law, Parameter, parameters_of
from ringwear_par.wear.laws import LAWS
from ringwear_par.wear.layered import LayeredLaw, NoWear
from ringwear_par.wear.trials import serves_many


def must_run_alone(case: Case) -> bool:
    """Tell whether a case steps alone, as no other shares its elasticity. Not collective."""
    return case.follows_wear or case.output.boundary != "none"


def batch_key(case: Case) -> Hashable | None:
    """Return the key of cases of one pair that step together; None for one that steps alone.

    Of the case alone. Not collective.
    """
    if must_run_alone(case):
        return None
    output = case.output
    kinds = tuple(None if law is None else _kind(law) for law in case.laws)
    force = case.load.force is not None
    stored = output.fields, output.profiles, bool(output.times), case.stress
    return case.time.scheme, force, kinds, *stored


def can_share(case: Case) -> bool:
    """Tell whether cases of this one's ``batch_key`` may step together, as far as laws tell.

    Laws that are not ours are tried. Not collective.
    """
    laws: list[Law] = []
    for law in case.laws:
        if law is not None:
            laws += law.laws if isinstance(law, LayeredLaw) else [law]
    foreign = [law for law in laws if type(law) not in (*LAWS.values(), NoWear)]
    return all(serves_many(law, case.line.r) for law in foreign)


def _kind(law: Law) -> Hashable:
    """Return the key of laws that can be stacked."""
    parts: list[Any] = [type(law)]
    if isinstance(law, LayeredLaw):
        return (*parts, law.has_law, *map(_kind, law.laws))
    if isinstance(law, CompletedLaw):
        return (*parts, *_identity(law.user_object))
    for name, parameter in _fields_of(type(law)):  # type: ignore[arg-type]
        value = getattr(law, name)
        if parameter is not None and parameter.numeric:
            parts.append(value is None)
        elif parameter is not None and parameter.kind == "parameters":
            parts.append(tuple(name for name, _ in value))
        else:
            parts.append(value)
    return tuple(parts)


@cache
def _fields_of(law: type[Law]) -> tuple[tuple[str, Parameter | None], ...]:
    """Return the fields of a law, each with its parameter if it is one."""
    declared = parameters_of(law)
    names: list[str] = [field.name for field in fields(law)] if is_dataclass(law) else []
    return tuple((name, declared.get(name)) for name in names)


def _identity(user_law: Any) -> tuple[Hashable, ...]:
    """Return a user's object itself, or its identity where it has no hash."""
    try:
        hash(user_law)
    except TypeError:
        return (id(user_law),)
    return (user_law,)
