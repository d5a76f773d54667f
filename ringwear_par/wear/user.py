"""Wear laws of users, from files and as objects: called for one history at a time, and checked."""

import ast
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Protocol, Self

import numpy as np

from ringwear_par.arrays import FloatArray, read_only
from ringwear_par.errors import InputError, LawError
from ringwear_par.files.text import read_text
from ringwear_par.wear.at import LocalState

#: step of difference quotients over the pressure or the worn depth: their error is its square,
#: their round-off eps over it; MPa and mm, what counts as these where they are smaller
_STEP, _SMALL_PRESSURE, _SMALL_WEAR = 1e-5, 1e-3, 1e-6
#: number of pressures at which laws are tried; times that the steepest interval is halved then
_TRIED, _HALVED = 33, 30


class WearLaw(Protocol):
    """A wear law as a user may write it: any object with a rate.

    It may also have ``d_rate_dp`` and ``d_rate_dwear``, derivatives with respect to pressure and
    ``local.wear``; ``length``, mm, of the Gaussian that pressures and rates are averaged with;
    ``breakpoints`` (s), at which the rate jumps or bends; ``remembers = False``, where the rate
    does not depend on ``local.wear``. Calls come for any history, at any time, in any order, so
    that a law must not keep anything from one call to the next.
    """

    def rate(self, p: FloatArray, local: LocalState, /) -> FloatArray:
        """Return the rate of wear, (n,) mm/s, at pressures p, (n,) MPa, >= 0."""
        ...


def user(
    code: "UserCode", p: FloatArray, at: LocalState, /, **parameters: Any
) -> tuple[FloatArray, ...]:
    """A law of your own, from a Python file.

    The file defines ``rate(p, at)``, the rate of depth in mm/s at pressures p in MPa; ``at`` knows
    the speed, the radius, the friction coefficient, the time, the depth worn off and the distance
    slid so far, and the numbers that the case gives in ``parameters``, in whatever units the file
    has them.

    Use it for what the other laws cannot say: rounded thresholds, levelling off at high pressures,
    coefficients that follow the temperature of a record. Studies and fits vary its parameters as
    those of the others.

    The rate must be 0 without pressure, continuous, not negative, and must not fall with the
    pressure. It is called for one history at a time, which makes large sweeps slower. Whatever the
    file does wrong is told with time and element.

    The file may define ``d_rate_dp(p, at)`` and ``d_rate_dwear(p, at)``, and a list ``breakpoints``
    of times (s) at which the rate jumps or bends, where adaptive steps end. A file that reads
    ``at.wear`` remembers worn depth, exactly, unless it says ``remembers = False``.
    """
    values = np.full((3 if code.remembers else 2, *p.shape), np.nan)
    for i in np.flatnonzero(np.isfinite(p).all(axis=1)):
        number = i if at.number is None else int(at.number[i, 0])
        local = replace(
            at,
            time=at.time[i, 0],
            speed=read_only(at.speed[i]),
            friction=at.friction[i, 0],
            wear=read_only(at.wear[i]),
            slid=read_only(at.slid[i]),
            parameters={
                name: v[i] if v.shape[1] > 1 else v[i, 0] for name, v in parameters.items()
            },
        )
        try:
            values[:, i] = code.values(np.maximum(p[i], 0.0), local)
            code.faults.pop(number, None)
        except LawError as error:
            code.faults[number] = str(error)
    return tuple(values)


@lru_cache(maxsize=64)
def _run(source: str, name: str) -> SimpleNamespace:
    """Return what the text of a file defines. On every rank, once."""
    names: dict[str, Any] = {"__name__": "user_law", "__file__": name}
    exec(compile(source, name, "exec"), names)
    return SimpleNamespace(**names)


@lru_cache(maxsize=64)
def _reads_wear(source: str) -> bool:
    """Tell whether Python source has an attribute ``wear``, as in ``at.wear``."""
    nodes = ast.walk(ast.parse(source))
    return any(isinstance(node, ast.Attribute) and node.attr == "wear" for node in nodes)


@dataclass(frozen=True)
class UserCode:
    """The code of a user's law."""

    #: file or class, in messages
    called: str
    #: text of the file, or the object
    source: Any
    #: what is wrong with it, by number of the history that called it last
    faults: dict[int, str] = field(default_factory=dict, init=False, compare=False, repr=False)

    @classmethod
    def of_file(cls, name: str) -> Self:
        """Return the code of a Python file.

        Raises
        ------
        InputError : it cannot be read or run, or does not define a law.
        """
        must = "must be a Python file"
        try:
            code = cls(name, read_text(Path(name)))
            rate = code.get("rate")
        except InputError as error:
            raise InputError(f"file = {error}; {must}") from error
        except (Exception, SystemExit) as error:  # whatever a user's code may raise
            reason = f"{type(error).__name__}: {error}"
            raise InputError(f"file = {name}: cannot be run ({reason}); {must}") from error
        if not callable(rate):
            raise InputError(f"file = {name}: does not define rate; must define rate(p, at)")
        return code

    @property
    def is_file(self) -> bool:
        """Whether it is a file's, not an object's."""
        return isinstance(self.source, str)

    def get(self, name: str, default: Any = None) -> Any:
        """Return what the file or the object calls so."""
        functions = _run(self.source, self.called) if self.is_file else self.source
        return getattr(functions, name, default)

    @property
    def remembers(self) -> bool:
        """Whether the rate may depend on ``local.wear``: objects say so, files are searched."""
        reads = not self.is_file or self.get("d_rate_dwear") or _reads_wear(self.source)
        return bool(self.get("remembers", reads))

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Times, s, at which the rate jumps or bends."""
        return tuple(sorted(float(time) for time in self.get("breakpoints", ())))

    @property
    def length(self) -> float:
        """Averaging length of an object's law, mm; 0 for a local law."""
        return 0.0 if self.is_file else float(self.get("length", 0.0))

    def values(self, p: FloatArray, local: LocalState) -> tuple[FloatArray, ...]:
        """Return the rate, its slope, and d rate / d wear if it remembers, at pressures (n,).

        Raises
        ------
        LawError : the code failed, or gave NaN, a negative rate or a negative slope.
        """
        rate = self._call("rate", p, local)
        if self.get("d_rate_dp"):
            slope = self._call("d_rate_dp", p, local)
        else:
            slope = derivative(lambda p: self._call("rate", p, local), p, _SMALL_PRESSURE)
            slope = np.maximum(slope, 0.0)
        if not self.remembers:
            return rate, slope
        if self.get("d_rate_dwear"):
            return rate, slope, self._call("d_rate_dwear", p, local)
        return rate, slope, derivative(
            lambda wear: self._call("rate", p, replace(local, wear=wear)), local.wear, _SMALL_WEAR
        )  # fmt: skip

    def _call(self, name: str, p: FloatArray, local: LocalState) -> FloatArray:
        """Return the result of a function of the code, (n,), as a copy, checked."""
        try:
            with np.errstate(all="ignore"):
                result = self.get(name)(read_only(p), local)
            if result is None or np.iscomplexobj(result):
                raise TypeError(f"it returns {type(result).__name__}, not real numbers")
            result = np.array(np.broadcast_to(np.asarray(result, dtype=float), p.shape))
        except (Exception, SystemExit) as error:  # whatever a user's code may raise
            raise LawError(
                f"{self.called}: {name}() failed at time {local.time:g} s: "
                f"{type(error).__name__}: {error}"
            ) from error
        bad = ~np.isfinite(result)
        if name != "d_rate_dwear":
            bad |= result < 0.0
        if bad.any():
            e = int(bad.argmax())
            quantity = "rate" if name == "rate" else "derivative of the rate"
            allowed = "a finite number" + (" >= 0" if name != "d_rate_dwear" else "")
            if name == "d_rate_dp":
                allowed += ": rates must not fall with pressure"
            raise LawError(
                f"{self.called}: {name}() gives {result[e]:g} as {quantity}"
                f"{_place(local, e, p[e])}; must be {allowed}"
            )
        return result


def derivative(
    function: Callable[[FloatArray], FloatArray], x: FloatArray, smallest: float
) -> FloatArray:
    """Return the derivative of a function whose every value depends on one entry of x only.

    By a one-sided difference, which needs nothing below x, where rates may have no sense.
    """
    h = _STEP * np.maximum(np.abs(x), smallest)
    return (4.0 * function(x + h) - 3.0 * function(x) - function(x + 2.0 * h)) / (2.0 * h)


def try_law(code: UserCode, local: LocalState, pressure: float) -> None:
    """Refuse code that is no law, tried at pressures up to a given one (MPa). Not collective.

    Raises
    ------
    InputError : it is none, wears without pressure, or gives NaN, negative rates, or rates that
        fall or jump.
    """
    if isinstance(code.source, type) or not callable(code.get("rate")):
        is_class = isinstance(code.source, type)
        what = f"{code.source.__name__} is a class" if is_class else f"{code.called} is no wear law"
        raise InputError(f"{what}; must be an object with rate(p, local)")
    try:
        _ = code.length, code.breakpoints
    except Exception as error:  # whatever a user's code may raise
        must = "length must be a number (mm), breakpoints a list of times (s)"
        raise InputError(f"{code.called}: {error}; {must}") from error
    p = np.linspace(0.0, pressure, _TRIED)[:, None] * np.ones_like(local.r)
    try:
        rates = np.array([code.values(row, local)[0] for row in p])
    except LawError as error:
        raise InputError(str(error)) from error
    falls = np.diff(rates, axis=0) < -1e-12 * rates.max()
    for i, e in np.argwhere([rates[0] != 0.0, *falls])[:1].tolist():
        what = f"falls from {rates[i - 1, e]:g} to" if i else "gives"
        must = "must not fall with pressure" if i else "must be 0 without pressure"
        place = _place(local, e, p[i, e])
        raise InputError(f"{code.called}: rate() {what} {rates[i, e]:g}{place}; {must}")
    _refuse_jump(code, local, p, rates)


def _refuse_jump(code: UserCode, local: LocalState, p: FloatArray, rates: FloatArray) -> None:
    """Refuse a rate that still rises by as much where its steepest interval is a point."""
    i, e = np.unravel_index(np.diff(rates, axis=0).argmax(), (len(p) - 1, p.shape[1]))
    low, high, below, above = p[i, e], p[i + 1, e], rates[i, e], rates[i + 1, e]
    rise = above - below
    for _ in range(_HALVED):
        middle = 0.5 * (low + high)
        try:
            rate = float(code.values(np.full_like(local.r, middle), local)[0][e])
        except LawError as error:
            raise InputError(str(error)) from error
        if rate - below > above - rate:
            high, above = middle, rate
        else:
            low, below = middle, rate
    if rise > 0.0 and above - below > 0.1 * rise:
        raise InputError(
            f"{code.called}: rate() jumps from {below:g} to {above:g}"
            f"{_place(local, int(e), high)}; must be continuous"
        )


def _place(local: LocalState, element: int, p: float) -> str:
    return (
        f" at time {local.time:g} s, element {element} (r = {local.r[element]:.6g} mm), "
        f"p = {p:.6g} MPa"
    )
