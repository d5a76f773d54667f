"""Guards of a user's law: local state that it cannot change, and results that are checked.

For laws from files and for objects; built-in laws are called as they are.
"""

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.errors import ComputationError, LawError
from ringwear_par.wear.local_state import LocalState

#: functions of a law that may be the user's
UserFunction = Literal["rate", "d_rate_dp", "d_rate_dwear", "d_rate_dparameter"]
_SIGNED = ("d_rate_dwear", "d_rate_dparameter")


def read_only(values: FloatArray) -> FloatArray:
    """Return a view that cannot be written to."""
    view = values.view()
    view.flags.writeable = False
    return view


def read_only_state(local: LocalState, **changes: Any) -> LocalState:
    """Return local state, with changes, as a user's law sees it: it may not change what it has."""
    return replace(
        local,
        r=read_only(local.r),
        speed=read_only(local.speed),
        wear=read_only(local.wear),
        slid=read_only(local.slid),
        **changes,
    )


def checked_call(
    called: str,
    name: UserFunction,
    function: Callable[[FloatArray, LocalState], Any],
    p: FloatArray,
    local: LocalState,
    parameters: Iterable[Any] = (),
) -> FloatArray:
    """Return the checked result of a function of a user's law, (..., n), as a copy.

    Real, unless something that it knows is complex: such answers are held against differences
    element by element (see ``derivative``), so that they are not refused here for one of them.

    Parameters
    ----------
    called : law and function, as in "law.py: rate()".
    name : of the function.
    function : of the user's code.
    p : (..., n) float, MPa.
    local : as of ``read_only_state``.
    parameters : values that the function knows besides.

    Raises
    ------
    LawError : the function failed, or gave NaN, a negative rate or a negative slope.
    ComputationError : pressures are not finite.
    """
    if not np.isfinite(p).all():
        raise ComputationError("contact: pressures are not finite")
    try:
        with np.errstate(all="ignore"):
            result = function(read_only(p), local)
        known = (p, local.wear, local.speed, local.friction, local.slid, *parameters)
        real = not any(map(np.iscomplexobj, known))
        if result is None or (real and np.iscomplexobj(result)):
            raise TypeError(f"it returns {type(result).__name__}, not real numbers")
        result = np.asarray(result, dtype=float if real else complex)
        result = np.array(np.broadcast_to(result, p.shape))
    except (Exception, SystemExit) as error:  # whatever a user's code may raise
        raise LawError(
            f"{called} failed at {_when(local)}: {type(error).__name__}: {error}"
        ) from error
    if not real:
        return result
    bad = ~np.isfinite(result)
    if name not in _SIGNED:
        bad |= result < 0.0
    if bad.any():
        raise LawError(_refused(called, name, p, local, result, np.argwhere(bad)[0]))
    return result


def _refused(
    called: str,
    name: UserFunction,
    p: FloatArray,
    local: LocalState,
    result: FloatArray,
    place: IntArray,
) -> str:
    """Return the fault of a result at a place: (element,) or (history, element)."""
    *among, e = (int(i) for i in place)
    where = (*among, e)
    if among:
        local = local.history(among[0])
    quantity = {"rate": "rate", "potential": "integral of the rate"}.get(
        name, "derivative of the rate"
    )
    why = "a finite number" if name in _SIGNED else "a finite number >= 0"
    if name == "d_rate_dp" and result[where] < 0.0:
        why += ": rates must not fall with pressure"
    return (
        f"{called} gives {result[where]:g} as {quantity} at {_when(local)}, "
        f"element {e} (r = {local.r[e]:.6g} mm), p = {p[where]:.6g} MPa; must be {why}"
    )


def _when(local: LocalState) -> str:
    times = np.unique(local.time)
    if len(times) == 1:
        return f"time {times[0]:g} s"
    return f"times from {times[0]:g} to {times[-1]:g} s"
