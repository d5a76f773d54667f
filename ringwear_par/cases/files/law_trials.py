"""Users' wear laws tried before a case runs."""

import numpy as np

from ringwear_par.cases.case import Case
from ringwear_par.errors import Fault, InputError
from ringwear_par.schedules import largest
from ringwear_par.wear.checked_law import CompletedLaw
from ringwear_par.wear.laws import LAWS
from ringwear_par.wear.laws.user import UserLaw
from ringwear_par.wear.local_state import LocalState
from ringwear_par.wear.trials import check_object, check_user_law

_OURS = set(LAWS.values()) - {UserLaw}
_ELEMENTS = 60
#: pressures up to which laws are tried, in mean pressures of a case; MPa where it has none
_MEANS, _PRESSURE = 5.0, 300.0


def law_sources(case: Case) -> dict[str, str]:
    """Return the texts of the user's own laws by body or layer: "lower", "lower.layers[0]"."""
    return {
        table.removeprefix("wear.").removesuffix(".wear"): law.source
        for table, law in case.laws_by_table.items()
        if isinstance(law, UserLaw)
    }


def refuse_bad_laws(case: Case, name: str) -> None:
    """Refuse users' laws that are none, or whose slopes are wrong: from files, and objects.

    Not collective.

    Raises
    ------
    InputError : all faults, one sentence each.
    """
    faults: list[str] = []
    force = case.load.force
    pressure = _PRESSURE if force is None else _MEANS * largest(force) / case.area
    for table, law in case.laws_by_table.items():
        if law is None or type(law) in _OURS:  # which are what they should be
            continue
        key = f"{table}.file" if isinstance(law, UserLaw) else table
        try:
            if not isinstance(law, UserLaw):
                check_object(law)
                law = CompletedLaw(law)
            check_user_law(law, _at_start(case), pressure)
        except InputError as error:
            faults += [Fault(f"{name}: {key}: {f}", key, "not_allowed") for f in error.faults]
    if faults:
        raise InputError(*faults)


def _at_start(case: Case) -> LocalState:
    """Return the local state along the contact at the largest speed, or at 1 rad/s."""
    r = np.linspace(*case.contact, _ELEMENTS, dtype=np.float64)
    speed = (largest(case.load.omega) or 1.0) * r
    return LocalState(0.0, r, speed, largest(case.friction), np.zeros_like(r), speed)
