"""Taylor tests: whether a law's derivatives are those of its rate."""

import math
from dataclasses import dataclass

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.errors import InputError
from ringwear_par.wear.increment import WearIncrement, averaging
from ringwear_par.wear.law import LocalState, WearLaw
from ringwear_par.wear.user import UserLaw


@dataclass(frozen=True)
class Remainders:
    """A Taylor test: ``|f(p + h d) - f(p) - h f'(p) d|`` at halved h falls with order 2.

    Parameters
    ----------
    steps : h, MPa.
    remainders : largest remainder of all elements at each, relative to the largest ``|f'(p) d|``.
    bounded : whether at the smallest h no element's remainder is more than h times what the
        derivative changes on the way, so that kinks, and nothing else, may spoil the order.
    """

    steps: tuple[float, ...]
    remainders: tuple[float, ...]
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
    law: WearLaw, at: LocalState, p: FloatArray, direction: FloatArray, step: float = 0.0
) -> Remainders:
    """Compare a law's derivative with its rate. Not collective.

    Parameters
    ----------
    law : any law, built in or the user's.
    at : sliding at which it is tried.
    p : (n,) float, MPa.
    direction : (n,) float, at most 1.
    step : s; the wear over an implicit step is tried, memory included; 0 for the rate alone.
    """
    average = averaging(at.r, np.ones_like(at.r), float(law.length)) if law.length else None
    wear = WearIncrement((law, None), (at, at), step or 1.0, (average, None))

    def f(p: FloatArray) -> FloatArray:
        return wear.depth(p) if step else law.rate(p, at)

    def slope_along(p: FloatArray) -> FloatArray:
        return wear.derivative(p) @ direction if step else law.slope(p, at) * direction

    slope, start = slope_along(p), f(p)
    size = float(np.abs(slope).max()) or 1.0
    steps = tuple(float(p.max()) * 2.0**-i for i in range(8, 13))
    off = np.array([np.abs(f(p + h * direction) - start - h * slope) for h in steps])
    change = np.abs(slope_along(p + steps[-1] * direction) - slope)
    bounded = off[-1] <= steps[-1] * (2.0 * change + 1e-9 * size)  # the mean value theorem
    return Remainders(steps, tuple((off.max(axis=1) / size).tolist()), bool(bounded.all()))


def check_user_slope(law: UserLaw, at: LocalState, pressure: float) -> None:
    """Refuse a user's law whose slope is another one than that of its rate. Not collective.

    Raises
    ------
    InputError : it is.
    """
    rng = np.random.default_rng(1)
    tried = pressure * rng.uniform(0.01, 0.99, len(at.r))
    if not taylor_test(law, at, tried, rng.uniform(-1.0, 1.0, len(at.r))).passed:
        raise InputError(
            f"{law.file}: slope() is not the derivative of rate() with respect to p; must be "
            "(see ringwear laws)"
        )
