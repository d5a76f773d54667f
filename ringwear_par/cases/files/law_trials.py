"""Users' wear laws tried before a case runs."""

from dataclasses import replace

import numpy as np

from ringwear_par.cases.case import Case
from ringwear_par.errors import Fault, InputError, LawError
from ringwear_par.schedules import largest
from ringwear_par.wear.at import LocalState
from ringwear_par.wear.user import try_law

_ELEMENTS = 60
#: pressures up to which laws are tried, in mean pressures of a case; MPa where it has none
_MEANS, _PRESSURE = 5.0, 300.0


def law_sources(case: Case) -> dict[str, str]:
    """Return the texts of the user's own laws by body or layer: "lower", "lower.layers[0]"."""
    return {
        table.removeprefix("wear.").removesuffix(".wear"): law.code.source
        for table, law in case.laws_by_table.items()
        if law is not None and law.code is not None and law.code.is_file
    }


def refuse_bad_laws(case: Case, name: str) -> None:
    """Refuse users' laws that are none: from files, and objects. Not collective.

    Raises
    ------
    InputError : all faults, one sentence each.
    """
    faults: list[str] = []
    force = case.load.force
    pressure = _PRESSURE if force is None else _MEANS * largest(force) / case.area
    r = np.linspace(*case.contact, _ELEMENTS, dtype=np.float64)
    speed = (largest(case.load.omega) or 1.0) * r  # at the largest speed, or at 1 rad/s
    at = LocalState(0.0, r, speed, largest(case.friction), np.zeros_like(r), speed)
    for table, law in case.laws_by_table.items():
        if law is None or law.code is None:
            continue
        key = f"{table}.file" if law.code.is_file else table
        try:
            try_law(law.code, replace(at, parameters=law.at(at)), pressure)
        except (InputError, LawError) as error:
            faults.append(Fault(f"{name}: {key}: {error}", key, "not_allowed"))
    if faults:
        raise InputError(*faults)
