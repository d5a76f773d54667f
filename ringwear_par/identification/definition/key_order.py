"""Fitted keys that a wear law orders, as k_start of at least k."""

from collections.abc import Sequence

from ringwear_par.cases.case import Case
from ringwear_par.cases.schema import key_of
from ringwear_par.elasticity.geometry.sections import BODIES
from ringwear_par.identification.definition.problem import FittedParameter
from ringwear_par.wear.law import parameters_of
from ringwear_par.wear.laws import LAWS


def ordered_keys(parameters: Sequence[FittedParameter]) -> list[tuple[int, int]]:
    """Return the pairs (i, j) of fitted keys of one scale of which i is never less than j.

    That is as their wear law declares them, see ``Parameter.at_least``.
    """
    least = {
        name: parameter.at_least
        for law in LAWS.values()
        for name, parameter in parameters_of(law).items()
    }
    places = {parameter.key: i for i, parameter in enumerate(parameters)}
    pairs = []
    for i, parameter in enumerate(parameters):
        table, _, name = parameter.key.rpartition(".")
        j = places.get(f"{table}.{least.get(name, '')}")
        of_law = key_of(parameter.key) is not None  # not a parameter of a user's law
        if of_law and j is not None and parameter.log == parameters[j].log:
            pairs.append((i, j))
    return pairs


def refuse_order(
    said: str, parameters: Sequence[FittedParameter], case: Case, faults: list[str]
) -> None:
    """Add a fault where bounds, or a value that is not fitted, break a rule of a law's numbers.

    As k_start of at least k. Of two fitted keys of one scale the rule is a bound, see
    ``ordered_keys``.

    Parameters
    ----------
    said : how sentences about the experiment begin.
    """
    fitted = {parameter.key: parameter for parameter in parameters}
    ordered = {(parameters[i].key, parameters[j].key) for i, j in ordered_keys(parameters)}
    for body, law in zip(BODIES, case.laws, strict=True):
        if law is None:
            continue
        for name, rule in parameters_of(type(law)).items():
            keys = f"wear.{body}.{name}", f"wear.{body}.{rule.at_least}"
            if not rule.at_least or not fitted.keys() & set(keys) or keys in ordered:
                continue
            ranges = []
            for key, number in zip(keys, (name, rule.at_least), strict=True):
                value = law.quantity(number)
                if key in fitted:
                    ranges.append((fitted[key].bounds, "bounds "))
                elif isinstance(value, float | int):
                    ranges.append(((float(value), float(value)), "value "))
            if len(ranges) == 2 and ranges[0][0][0] < ranges[1][0][1]:
                (upper, of_upper), (lower, of_lower) = ranges
                faults.append(
                    f"{said}: {keys[0]}: {of_upper}{_range(upper)} lets it be less than {keys[1]}, "
                    f"{of_lower}{_range(lower)}; must be at least {lower[1]:g}, or both be fitted "
                    "with the same scale"
                )


def _range(ends: tuple[float, float]) -> str:
    low, high = ends
    return f"{low:g}" if low == high else f"[{low:g}, {high:g}]"
