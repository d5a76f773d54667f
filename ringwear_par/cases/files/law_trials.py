"""Users' wear laws tried before a case runs."""

from dataclasses import replace

import numpy as np

from ringwear_par.cases.case import Case
from ringwear_par.errors import Fault, InputError, LawError
from ringwear_par.schedules import largest
from ringwear_par.wear.at import LocalState
from ringwear_par.wear.user import UserCode, place_words

_ELEMENTS = 60
#: pressures up to which laws are tried, in mean pressures of a case; MPa where it has none
_MEANS, _PRESSURE = 5.0, 300.0
#: how many pressures laws are tried at: up to the largest, then again and again between the two
#: where the rate rises most; rise between the last two, over that of the first, of a jump
_TRIED, _JUMP = (33, *13 * (5,)), 0.1


def law_sources(case: Case) -> dict[str, str]:
    """Return the texts of the user's own laws by body or layer: "lower", "lower.layers[0]"."""
    return {
        table.removeprefix("wear.").removesuffix(".wear"): law.code.source
        for table, law in case.laws_by_table.items()
        if law.code is not None and law.code.is_file
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
        if law.code is None:
            continue
        key = f"{table}.file" if law.code.is_file else table
        try:
            _try(law.code, replace(at, parameters=law.at(at)), pressure)
        except (InputError, LawError) as error:
            faults.append(Fault(f"{name}: {key}: {error}", key, "not_allowed"))
    if faults:
        raise InputError(*faults)


def _try(code: UserCode, local: LocalState, pressure: float) -> None:
    """Refuse code that is no law, tried at pressures up to a given one, MPa."""
    if isinstance(code.source, type) or not callable(code.get("rate")):
        raise InputError(
            f"{code.called} is no wear law; must be an object with rate(p, local), not a class"
        )
    try:
        _ = code.length, code.breakpoints
    except Exception as error:  # whatever a user's code may raise
        must = "length must be a number (mm), breakpoints a list of times (s)"
        raise InputError(f"{code.called}: {error}; {must}") from error
    low, high, steepest = 0.0, pressure, 0.0
    for count in _TRIED:
        p = np.linspace(low, high, count)
        rates = np.array([code.values(np.full_like(local.r, q), local)[0] for q in p])
        rises = np.diff(rates, axis=0)
        wrong = [(rates[0] != 0.0) & (low == 0.0), *(rises < -1e-12 * rates.max())]
        for i, e in np.argwhere(wrong)[:1].tolist():
            what = f"falls from {rates[i - 1, e]:g} to" if i else "gives"
            must = "must not fall with pressure" if i else "must be 0 without pressure"
            place = place_words(local, e, p[i])
            raise InputError(f"{code.called}: rate() {what} {rates[i, e]:g}{place}; {must}")
        i, e = np.unravel_index(rises.argmax(), rises.shape)
        low, high, steepest = p[i], p[i + 1], max(steepest, rises[i, e])
    if rises[i, e] > _JUMP * steepest:
        raise InputError(
            f"{code.called}: rate() jumps from {rates[i, e]:g} to {rates[i + 1, e]:g}"
            f"{place_words(local, int(e), high)}; must be continuous"
        )
