"""A wear law from a user's Python file, and what keeps it from being one."""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.errors import ComputationError, InputError, LawError
from ringwear_par.schedules import Quantity, knots, value
from ringwear_par.wear.law import LocalLaw, LocalState

_BISECTIONS = 30


def _guarded(values: FloatArray) -> FloatArray:
    """Return a view that cannot be written to: a user's law may not change what it is given."""
    view = values.view()
    view.flags.writeable = False
    return view


@lru_cache(maxsize=64)
def _compiled(source: str, name: str) -> dict[str, Any]:
    """Return what the source of a user's law defines. On every rank, once."""
    names: dict[str, Any] = {"__name__": "user_law", "__file__": name}
    exec(compile(source, name, "exec"), names)
    return names


@dataclass(frozen=True)
class UserLaw(LocalLaw):
    """A law from a Python file that defines ``rate(p, at)`` and ``slope(p, at)``.

    With ``wear_slope(p, at)`` too, the law remembers worn depth, exactly; ``at``
    is a ``LocalState``.
    A list ``knots`` names times (s) at which the rate jumps or bends, where adaptive steps end.
    Whatever the file does wrong is told with time and element.

    Parameters
    ----------
    file : its name.
    source : its text.
    parameters : pairs of name and quantity, which ``at.parameters`` holds at the time.
    """

    file: str
    source: str
    parameters: tuple[tuple[str, Quantity], ...] = ()

    def missing(self) -> str:
        """Return what keeps the file from being a law, "" if nothing does."""
        try:
            names = self._functions
        except (Exception, SystemExit) as error:  # whatever a user's code may raise
            return f"cannot be run ({type(error).__name__}: {error}); must be a Python file"
        lacking = [name for name in ("rate", "slope") if not callable(names.get(name))]
        if lacking:
            return f"does not define {' and '.join(lacking)}; must define rate(p, at), slope(p, at)"
        return ""

    @property
    def remembers(self) -> bool:
        """Whether the file defines ``wear_slope``."""
        return "wear_slope" in self._functions

    @property
    def knots(self) -> tuple[float, ...]:
        """Times at which a parameter's table bends, and those that the file names as ``knots``."""
        own = {float(time) for time in self._functions.get("knots", ())}
        return tuple(sorted(own.union(knots(*(q for _, q in self.parameters)))))

    @property
    def _functions(self) -> dict[str, Any]:
        return _compiled(self.source, self.file)

    def _call(self, name: str, p: FloatArray, at: LocalState) -> FloatArray:
        if not np.isfinite(p).all():
            raise ComputationError("contact: pressures are not finite")
        values = {key: value(q, at.time, at.r) for key, q in self.parameters}
        try:
            with np.errstate(all="ignore"):
                there = replace(
                    at,
                    parameters=values,
                    r=_guarded(at.r),
                    speed=_guarded(at.speed),
                    wear=_guarded(at.wear),
                    slid=_guarded(at.slid),
                )
                result = self._functions[name](_guarded(p), there)
            if result is None or np.iscomplexobj(result):
                raise TypeError(f"it returns {type(result).__name__}, not real numbers")
            result = np.array(np.broadcast_to(np.asarray(result, dtype=float), p.shape))
        except (Exception, SystemExit) as error:  # whatever a user's code may raise
            raise LawError(
                f"{self.file}: {name}() failed at time {at.time:g} s: "
                f"{type(error).__name__}: {error}"
            ) from error
        bad = ~np.isfinite(result)
        if name != "wear_slope":
            bad |= result < 0.0
        if bad.any():
            e = int(np.flatnonzero(bad)[0])
            what = "rate" if name == "rate" else "derivative of the rate"
            why = "a finite number >= 0"
            if name == "slope" and result[e] < 0.0:
                why += ": rates must not fall with pressure"
            elif name == "wear_slope":
                why = "a finite number"
            raise LawError(
                f"{self.file}: {name}() gives {result[e]:g} as {what} at time {at.time:g} s, "
                f"element {e} (r = {at.r[e]:.6g} mm), p = {p[e]:.6g} MPa; must be {why}"
            )
        return result

    def rate(self, p: FloatArray, at: LocalState) -> FloatArray:
        """Return the rate of wear, mm/s.

        Raises
        ------
        LawError : the function failed, or gave NaN or a negative rate.
        """
        return self._call("rate", p, at)

    def slope(self, p: FloatArray, at: LocalState) -> FloatArray:
        """Return the derivative of the rate with respect to pressure, mm/s/MPa.

        Raises
        ------
        LawError : the function failed, or gave NaN or a negative slope.
        """
        return self._call("slope", p, at)

    def wear_slope(self, p: FloatArray, at: LocalState) -> FloatArray:
        """Return the derivative of the rate with respect to ``at.wear``, 1/s."""
        return self._call("wear_slope", p, at) if self.remembers else np.zeros_like(p)


def check_user_law(law: UserLaw, at: LocalState, pressure: float) -> None:
    """Refuse a user's law that is no law, tried at pressures up to a given one (MPa).

    Not collective.

    Raises
    ------
    InputError : it wears without pressure, gives NaN or negative rates, or rates that fall or jump.
    """
    p = np.linspace(0.0, 1.0, 33)[:, None] * np.full_like(at.r, pressure)
    rates = []
    for row in p:
        try:
            rates.append(law.rate(row, at))
            law.slope(row, at)
            law.wear_slope(row, at)
        except ComputationError as error:
            raise InputError(str(error)) from error
    table = np.array(rates)
    if table[0].any():
        e = int(np.flatnonzero(table[0])[0])
        raise InputError(
            f"{law.file}: rate() gives {table[0, e]:g} without pressure (time {at.time:g} s, "
            f"element {e}, r = {at.r[e]:.6g} mm); must be 0: no wear without contact"
        )
    fall = np.diff(table, axis=0) < -1e-12 * table.max(initial=0.0)
    if fall.any():
        i, e = (int(v[0]) for v in np.nonzero(fall))
        raise InputError(
            f"{law.file}: rate() falls from {table[i, e]:g} to {table[i + 1, e]:g} between "
            f"p = {p[i, e]:.6g} and {p[i + 1, e]:.6g} MPa (time {at.time:g} s, element {e}, "
            f"r = {at.r[e]:.6g} mm); must not fall with pressure"
        )
    jump = _jump(law, at, p[:, 0], table)
    if jump:
        raise InputError(jump)


def _jump(law: UserLaw, at: LocalState, p: FloatArray, rates: FloatArray) -> str:
    """Return where the rate jumps with pressure, "" if it does not: by bisection of steep pieces.

    Parameters
    ----------
    p : (k,) float, MPa, increasing.
    rates : (k, n) float, mm/s, at these pressures.
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
        f"{law.file}: rate() jumps from {below:g} to {above:g} at p = {low:.6g} MPa "
        f"(time {at.time:g} s, element {e}, r = {at.r[e]:.6g} mm); must be continuous in p"
    )
