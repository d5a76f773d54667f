"""Trials of users' laws before they are used."""

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.errors import ComputationError, InputError
from ringwear_par.wear.checked_law import CheckedLaw, CompletedLaw
from ringwear_par.wear.law import Law, WearLaw
from ringwear_par.wear.local_state import LocalState

#: halvings of the interval of pressures in which a rate may jump
_BISECTIONS = 30
#: half of the interval of a difference quotient, in the largest pressure, and its relative error
_INTERVAL, _ERROR = 1e-4, 1e-6
#: largest pressure at which laws are tried with many histories, MPa
_TRIED_PRESSURE = 300.0


def check_object(law: object) -> None:
    """Refuse an object that is no law, or whose ``length`` or ``breakpoints`` are no numbers.

    Raises
    ------
    InputError : with its type, and the type that is needed.
    """
    must = "must be an object with rate(p, local)"
    if isinstance(law, type):
        raise InputError(f"{law.__name__} is a class; {must}, as {law.__name__}(...) may be")
    if not (isinstance(law, WearLaw) and callable(law.rate)):
        raise InputError(f"{type(law).__name__} is no wear law; {must}")
    for name, kind in (("length", "a number (mm)"), ("breakpoints", "a list of times (s)")):
        try:
            getattr(CompletedLaw(law), name)
        except Exception as error:  # whatever a user's code may raise
            raise InputError(f"{type(law).__name__}: {name}: {error}; must be {kind}") from error


def check_user_law(law: CheckedLaw, at: LocalState, pressure: float) -> None:
    """Refuse a user's law that is no law, tried at pressures up to a given one (MPa).

    Not collective.

    Raises
    ------
    InputError : it wears without pressure, gives NaN or negative rates, rates that fall or jump,
        or slopes of its own that are not those of its rates.
    """
    p = np.linspace(0.0, 1.0, 33)[:, None] * np.full_like(at.r, pressure)
    rates = []
    for row in p:
        try:
            rates.append(law.rate(row, at))
            law.d_rate_dp(row, at)
            law.d_rate_dwear(row, at)
        except ComputationError as error:
            raise InputError(str(error)) from error
    table = np.array(rates)
    worn, fall = table[0] != 0.0, np.diff(table, axis=0) < -1e-12 * table.max(initial=0.0)
    fault = ""
    if worn.any():
        e = int(worn.argmax())
        fault = f"gives {table[0, e]:g} without pressure{_where(at, e)}; must be 0"
    elif fall.any():
        i, e = (int(v[0]) for v in np.nonzero(fall))
        fault = (
            f"falls from {table[i, e]:g} to {table[i + 1, e]:g} between p = {p[i, e]:.6g} and "
            f"{p[i + 1, e]:.6g} MPa{_where(at, e)}; must not fall with pressure"
        )
    else:
        fault = _jump(law, at, p[:, 0], table)
    if fault:
        raise InputError(f"{law.called}: rate() {fault}")
    if law.defined("d_rate_dp") is not None:
        _check_slope(law, at, pressure)


def _where(at: LocalState, element: int) -> str:
    return f" (time {at.time:g} s, element {element}, r = {at.r[element]:.6g} mm)"


def _check_slope(law: CheckedLaw, at: LocalState, pressure: float) -> None:
    """Refuse a law whose ``d_rate_dp`` is not the slope of its rate, kinks aside.

    Raises
    ------
    InputError : it is not.
    """
    h = _INTERVAL * pressure
    p = pressure * np.random.default_rng(1).uniform(0.01, 0.99, len(at.r))
    quotient = (law.rate(p + h, at) - law.rate(p - h, at)) / (2.0 * h)
    slopes = np.array([law.d_rate_dp(q, at) for q in (p - h, p, p + h)])
    # the mean value theorem, of slopes that do not turn within the interval
    allowed = np.ptp(slopes, axis=0) + _ERROR * np.abs(slopes).max()
    if (np.abs(quotient - slopes[1]) > allowed).any():
        raise InputError(
            f"{law.called}: d_rate_dp() is not the derivative of rate() with respect to p; must be"
        )


def serves_many(law: Law, r: FloatArray) -> bool:
    """Tell whether a law gives the same numbers for many histories, (B, n), as for each alone.

    Code that was written for one history may take rows for elements, or look at all pressures at
    once. Not collective.

    Parameters
    ----------
    r : (n,) float, mm.
    """
    shares = np.linspace(0.0, 1.0, 3 * len(r)).reshape(3, -1)
    p, wear, speed = _TRIED_PRESSURE * shares, 1e-3 * shares[::-1], np.array([[1.0], [2.0], [3.0]])
    at = LocalState(np.arange(3.0), r, speed * r, np.array([0.1, 0.2, 0.3]), wear, 5.0 * speed * r)
    for method in ("rate", "d_rate_dp", "d_rate_dwear"):
        try:
            alone = [getattr(law, method)(p[i], at.history(i)) for i in range(3)]
        except Exception:  # it fails alone, too: its history will say so
            continue
        try:
            if not np.array_equal(getattr(law, method)(p, at), alone):
                return False
        except Exception:  # whatever a user's code may raise
            return False
    return True


def _jump(law: CheckedLaw, at: LocalState, p: FloatArray, rates: FloatArray) -> str:
    """Return where the rate jumps with pressure, "" if it does not: by bisection of steep pieces.

    Rates are (k, n) mm/s, at increasing pressures, (k,) MPa.
    """
    e = int(rates[-1].argmax())
    rise = np.diff(rates[:, e])
    i = int(rise.argmax())
    low, high, below, above = p[i], p[i + 1], rates[i, e], rates[i + 1, e]
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        rate = law.rate(np.full_like(at.r, middle), at)[e]
        if rate - below > above - rate:
            high, above = middle, rate
        else:
            low, below = middle, rate
    if above - below <= 1e-3 * rise[i]:
        return ""
    return (
        f"jumps from {below:g} to {above:g} at p = {low:.6g} MPa{_where(at, e)}; must be "
        "continuous in p"
    )
