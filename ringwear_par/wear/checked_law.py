"""Laws of users' code, from files and as objects.

Their results are checked, and the methods of a law that they lack are computed. Built-in laws are
called as they are.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import partial, wraps
from typing import Any, ClassVar, Literal

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray, read_only
from ringwear_par.errors import ComputationError, LawError
from ringwear_par.schedules import Quantity, value
from ringwear_par.wear.law import Law, WearLaw
from ringwear_par.wear.local_state import LocalState

#: functions of a law that may be the user's
UserFunction = Literal["rate", "d_rate_dp", "d_rate_dwear"]
#: beginning of the names of parameters that a file reads from its state
PARAMETERS = "parameters."


def checked_call(
    called: str,
    name: UserFunction,
    function: Callable[[FloatArray, LocalState], Any],
    p: FloatArray,
    local: LocalState,
    parameters: Iterable[Any] = (),
) -> FloatArray:
    """Return the checked result of a function of a user's law, (..., n), as a copy.

    Real, unless an input is complex, as in complex steps: such results are not checked here, as
    ``derivative`` compares each element's with a difference quotient.

    Parameters
    ----------
    called : law and function, as in "law.py: rate()".
    name : of the function.
    function : of the user's code.
    p : (..., n) float, MPa.
    local : as the code sees it, with arrays that are read-only.
    parameters : values of the law's parameters.

    Raises
    ------
    LawError : the function failed, or returned NaN, a negative rate or a negative slope.
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
    if name != "d_rate_dwear":
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
    allowed = "a finite number" if name == "d_rate_dwear" else "a finite number >= 0"
    if name == "d_rate_dp" and result[where] < 0.0:
        allowed += ": rates must not fall with pressure"
    return (
        f"{called} gives {result[where]:g} as {quantity} at {_when(local)}, "
        f"element {e} (r = {local.r[e]:.6g} mm), p = {p[where]:.6g} MPa; must be {allowed}"
    )


def _when(local: LocalState) -> str:
    times = np.unique(local.time)
    if len(times) == 1:
        return f"time {times[0]:g} s"
    return f"times from {times[0]:g} to {times[-1]:g} s"


def _each_history(method: Callable[..., Any]) -> Callable[..., Any]:
    """Have a method called for one history at a time where the code serves no more.

    Derivatives too: whether code takes complex numbers may depend on the history.
    """

    @wraps(method)
    def call(law: "CheckedLaw", *arguments: Any) -> Any:
        place = isinstance(arguments[0], str)  # a parameter's name may come first
        first, p, states = arguments[:place], arguments[place], arguments[place + 1 :]
        # code that serves many may have been written for the (n,) of one
        if p.ndim == 1 or not (law.one_by_one or len(p) == 1):
            return method(law, *arguments)
        rows = (
            call(law.history(i), *first, p[i], *(state.history(i) for state in states))
            for i in range(len(p))
        )
        return np.array(list(rows))

    return call


class CheckedLaw(Law):
    """A law of a user's code: its results are checked, and missing derivatives are computed.

    Whatever the code does wrong is reported with time and element.
    """

    #: whether the code serves one history at a time
    one_by_one: ClassVar[bool] = False

    @property
    def reads_wear(self) -> bool:
        """Whether the rate may depend on ``local.wear``: it may, as code is not searched for it."""
        return True

    @property
    def called(self) -> str:
        """Name of the law in messages."""
        raise NotImplementedError

    def defined(self, function: UserFunction) -> Callable[..., Any] | None:
        """Return a function of the code, None where it has none."""
        raise NotImplementedError

    def _call(
        self, function: UserFunction, p: FloatArray, local: LocalState, *first: str
    ) -> FloatArray:
        """Return the checked result of a function of the code, (..., n).

        ``first`` are its arguments before the pressure.
        """
        code = self.defined(function)
        assert code is not None
        values = {
            name.removeprefix(PARAMETERS): value(self.quantity(name), local.time, local.r)
            for name in self.numeric
        }
        state = replace(
            local,
            r=read_only(local.r),
            speed=read_only(local.speed),
            wear=read_only(local.wear),
            slid=read_only(local.slid),
            parameters=values,
        )
        called = f"{self.called}: {function}()"
        return checked_call(called, function, partial(code, *first), p, state, values.values())

    @_each_history
    def rate(self, p: FloatArray, local: LocalState) -> FloatArray:
        """Return the rate of wear, mm/s.

        Raises
        ------
        LawError : the code failed, or gave NaN or a negative rate.
        """
        return self._call("rate", p, local)

    @_each_history
    def d_rate_dp(self, p: FloatArray, local: LocalState) -> FloatArray:
        """Return the derivative of the rate with respect to pressure, mm/s/MPa.

        Raises
        ------
        LawError : the code failed, or gave NaN or a negative derivative.
        """
        defined = self.defined("d_rate_dp")
        return self._call("d_rate_dp", p, local) if defined else super().d_rate_dp(p, local)

    @_each_history
    def d_rate_dwear(self, p: FloatArray, local: LocalState) -> FloatArray:
        """Return the derivative of the rate with respect to ``local.wear``, 1/s."""
        defined = self.defined("d_rate_dwear")
        return self._call("d_rate_dwear", p, local) if defined else super().d_rate_dwear(p, local)


@dataclass(frozen=True)
class CompletedLaw(CheckedLaw):
    """A user's object with a ``rate``, completed to a ``Law``.

    Its rate counts as one that remembers wear unless it says ``remembers = False``. Where it is a
    dataclass, the numbers among its fields are its parameters.
    """

    user_object: WearLaw

    def _attribute(self, name: str, default: Any) -> Any:
        return getattr(self.user_object, name, default)

    @property
    def length(self) -> float:  # type: ignore[override]
        """Averaging length, mm; 0 for a local law."""
        return float(self._attribute("length", 0.0))

    @property
    def remembers(self) -> bool:
        """Whether the rate may depend on ``local.wear``."""
        return bool(self._attribute("remembers", True))

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Times, s, at which the rate jumps or bends."""
        return tuple(sorted(float(time) for time in self._attribute("breakpoints", ())))

    @property
    def numeric(self) -> tuple[str, ...]:
        """Names of the fields that are numbers."""
        law: Any = self.user_object
        numbers = [f.name for f in fields(law)] if is_dataclass(law) else []
        return tuple(
            name
            for name in numbers
            if name != "length" and isinstance(getattr(law, name), float | np.ndarray)
        )

    def quantity(self, name: str) -> Quantity:
        """Return a numeric parameter as it was given."""
        return getattr(self.user_object, name)

    @property
    def called(self) -> str:
        """Name of the law in messages."""
        return type(self.user_object).__name__

    def defined(self, function: UserFunction) -> Callable[..., Any] | None:
        """Return a method of the object, None where it has none."""
        return self._attribute(function, None)

    def per_energy(self, friction: float) -> float | None:
        """Return worn volume per dissipated energy, 1/MPa, if it is always the same."""
        return self._attribute("per_energy", super().per_energy)(friction)

    def onset(self, local: LocalState) -> float | FloatArray:
        """Return the pressure, MPa, up to which nothing wears."""
        return self._attribute("onset", super().onset)(local)

    def potential(self, p: FloatArray, local: LocalState) -> FloatArray | None:
        """Return the integral of the rate from 0 to p, MPa mm/s; None: by quadrature."""
        integral = self._attribute("potential", super().potential)
        return integral(read_only(p), local)

    def describe(self) -> str:
        """Return the object's formula with its numbers."""
        formula = self._attribute("formula", f"{self.called}.rate(p, local)")
        return formula + self._values_text({name: self.quantity(name) for name in self.numeric})


def complete(law: WearLaw | Law) -> Law:
    """Return a law with all methods that a history calls: itself, or an object completed."""
    return law if isinstance(law, Law) else CompletedLaw(law)
