"""Sources of type B: inputs whose uncertainty a measure file has."""

from collections.abc import Mapping

from ringwear_par.measuring.analysis.budget import Source
from ringwear_par.measuring.definition.problem import Conditions, Uncertainty


def source_of(
    known: Mapping[str, Uncertainty], name: str, value: float, unit: str, sensitivity: float
) -> list[Source]:
    """Return the source of type B of an input, none where nobody says how well it is known."""
    if name not in known:
        return []
    return [Source(name, "B", known[name].of(value), unit, sensitivity)]


def load_sources(
    known: Mapping[str, Uncertainty], conditions: Conditions, relative: float
) -> list[Source]:
    """Return the source of the load, by force or by pressure: of its scale, where it changes.

    Parameters
    ----------
    relative : derivative of the measurand with respect to the logarithm of the load.
    """
    return [
        *source_of(known, "load.force", conditions.force, "N", relative / conditions.force),
        *source_of(
            known, "load.pressure", conditions.pressure, "MPa", relative / conditions.pressure
        ),
    ]
