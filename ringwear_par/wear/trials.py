"""Trials of laws before they are used: of users' code, and of derivatives against rates.

Derivatives are compared with rates by Taylor tests.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.errors import ComputationError, InputError
from ringwear_par.wear.checked_law import CheckedLaw, CompletedLaw
from ringwear_par.wear.increment import WearIncrement
from ringwear_par.wear.law import Law, WearLaw, parameters_of
from ringwear_par.wear.laws.non_local import averaging
from ringwear_par.wear.local_state import LocalState

#: round-off of a rate, relative to the largest one
_NOISE = 1e-14
#: halvings of the interval of pressures in which a rate may jump
_BISECTIONS = 30
#: largest pressure at which laws are tried with many histories, MPa
_TRIED_PRESSURE = 300.0


@dataclass(frozen=True)
class Remainders:
    """A Taylor test: ``|f(p + h d) - f(p) - h f'(p) d|`` at halved h falls with order 2."""

    #: h, in the unit of what is varied
    steps: tuple[float, ...]
    #: largest remainder of all elements at each, relative to the largest ``|f'(p) d|``
    remainders: tuple[float, ...]
    #: whether at the smallest h each element's remainder is at most h times the change of its
    #: derivative over h: then nothing but kinks lowers the order
    bounded: bool

    @property
    def order(self) -> float:
        """Smallest observed order; infinity where no remainder is left but round-off."""
        pairs = [
            math.log(a / b) / math.log(h / k)
            for a, b, h, k in zip(
                self.remainders, self.remainders[1:], self.steps, self.steps[1:], strict=False
            )
            if b > 1e-9 * k
        ]
        return min(pairs, default=math.inf)

    @property
    def passed(self) -> bool:
        """Whether the derivative is one: order near 2, or less because of kinks."""
        return self.order > 1.9 or self.bounded


def taylor_test(
    law: Law, at: LocalState, p: FloatArray, direction: FloatArray, step: float = 0.0
) -> Remainders:
    """Compare a law's derivative with respect to pressure with its rate. Not collective.

    Parameters
    ----------
    law : any law, built in or the user's.
    at : local state at which it is tried.
    p : (n,) float, MPa.
    direction : (n,) float, at most 1.
    step : s; the wear over an implicit step is tried, memory included; 0 for the rate alone.
    """
    average = averaging(at.r, np.ones_like(at.r), float(law.length)) if law.length else None
    wear = WearIncrement((law, None), (at, at), step or 1.0, (average, None))

    def f(h: float) -> FloatArray:
        return wear.depth(p + h * direction) if step else law.rate(p + h * direction, at)

    def slope(h: float) -> FloatArray:
        q = p + h * direction
        return wear.jacobian(q) @ direction if step else law.d_rate_dp(q, at) * direction

    return _remainders(f, slope, float(p.max()))


def taylor_test_wear(law: Law, at: LocalState, p: FloatArray, scale: float) -> Remainders:
    """Compare a law's derivative with respect to worn depth with its rate. Not collective.

    Parameters
    ----------
    scale : mm, over which the rate changes.
    """

    def worn(h: float) -> LocalState:
        return replace(at, wear=at.wear + h)

    return _remainders(
        lambda h: law.rate(p, worn(h)), lambda h: law.d_rate_dwear(p, worn(h)), scale, _NOISE
    )


def taylor_test_parameter(law: Law, at: LocalState, p: FloatArray, name: str) -> Remainders:
    """Compare a law's derivative with respect to a numeric parameter with its rate.

    Not collective.
    """
    number, sign = law.parameter(name, at), _free_side(law, name)

    def changed(h: float) -> Law:
        return law.with_parameter(name, number + sign * h)

    return _remainders(
        lambda h: changed(h).rate(p, at),
        lambda h: sign * changed(h).d_rate_dparameter(name, p, at),
        float(np.abs(number).max()) or 1.0,
        _NOISE,
    )


def step_error(law: Law, at: LocalState, p: FloatArray, step: float) -> float | None:
    """Return the error of a law's own depth d of an implicit step, relative to the largest d.

    It must be step rate(p, wear + d). None: the law leaves it to iteration. Not collective.

    Parameters
    ----------
    step : s.
    """
    depth = law.depth_in_step(p, at, step) if law.remembers else None
    if depth is None:
        return None
    error = np.abs(depth - step * law.rate(p, at.worn_by(depth))).max()
    return float(error / (np.abs(depth).max() or 1.0))


def depends(law: Law, at: LocalState, p: FloatArray, name: str) -> bool:
    """Tell whether a law's rate changes at all with a numeric parameter. Not collective."""
    number = law.parameter(name, at)
    close = number + _free_side(law, name) * 2.0**-8 * (float(np.abs(number).max()) or 1.0)
    return not np.array_equal(law.with_parameter(name, close).rate(p, at), law.rate(p, at))


def _free_side(law: Law, name: str) -> float:
    """Return the sign of changes of a parameter that never make it larger than one above it."""
    above = any(other.at_least == name for other in parameters_of(type(law)).values())
    return -1.0 if above else 1.0


def _remainders(
    f: Callable[[float], FloatArray],
    slope: Callable[[float], FloatArray],
    scale: float,
    noise: float = 0.0,
) -> Remainders:
    """Compare values along a line, at h <= scale / 2^8 from its start, with their derivative.

    The noise, relative to the largest value, may be round-off.
    """
    along, start = slope(0.0), f(0.0)
    size = float(np.abs(along).max()) or 1.0
    steps = tuple(scale * 2.0**-i for i in range(8, 13))
    off = np.array([np.abs(f(h) - start - h * along) for h in steps])
    off = np.maximum(off - noise * np.abs(start).max(), 0.0)
    change = np.abs(slope(steps[-1]) - along)
    bounded = off[-1] <= steps[-1] * (2.0 * change + 1e-9 * size)  # the mean value theorem
    return Remainders(steps, tuple((off.max(axis=1) / size).tolist()), bool(bounded.all()))


def check_user_slope(law: CheckedLaw, at: LocalState, pressure: float) -> None:
    """Refuse a user's law whose ``d_rate_dp`` is not the slope of its rate. Not collective.

    Raises
    ------
    InputError : it is not.
    """
    if law.defined("d_rate_dp") is None:
        return
    rng = np.random.default_rng(1)
    tried = pressure * rng.uniform(0.01, 0.99, len(at.r))
    if not taylor_test(law, at, tried, rng.uniform(-1.0, 1.0, len(at.r))).passed:
        raise InputError(
            f"{law.called}: d_rate_dp() is not the derivative of rate() with respect to p; "
            "must be (see ringwear laws)"
        )


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
    InputError : it wears without pressure, gives NaN or negative rates, or rates that fall or jump.
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
    if table[0].any():
        e = int(np.flatnonzero(table[0])[0])
        raise InputError(
            f"{law.called}: rate() gives {table[0, e]:g} without pressure (time {at.time:g} s, "
            f"element {e}, r = {at.r[e]:.6g} mm); must be 0: no wear without contact"
        )
    fall = np.diff(table, axis=0) < -1e-12 * table.max(initial=0.0)
    if fall.any():
        i, e = (int(v[0]) for v in np.nonzero(fall))
        raise InputError(
            f"{law.called}: rate() falls from {table[i, e]:g} to {table[i + 1, e]:g} between "
            f"p = {p[i, e]:.6g} and {p[i + 1, e]:.6g} MPa (time {at.time:g} s, element {e}, "
            f"r = {at.r[e]:.6g} mm); must not fall with pressure"
        )
    jump = _jump(law, at, p[:, 0], table)
    if jump:
        raise InputError(jump)


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
        f"{law.called}: rate() jumps from {below:g} to {above:g} at p = {low:.6g} MPa "
        f"(time {at.time:g} s, element {e}, r = {at.r[e]:.6g} mm); must be continuous in p"
    )
