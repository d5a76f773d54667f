"""A wear law from a user's Python file, and what keeps it from being one."""

import ast
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.errors import ComputationError, InputError
from ringwear_par.files.text import read_text
from ringwear_par.schedules import Quantity, breakpoints, value
from ringwear_par.schedules import stack as stack_quantities
from ringwear_par.wear.checked_law import (
    CheckedLaw,
    CompletedLaw,
    UserFunction,
    checked_call,
    read_only_state,
)
from ringwear_par.wear.law import Law, WearLaw
from ringwear_par.wear.local_state import LocalState
from ringwear_par.wear.parameters import Parameter

_BISECTIONS = 30
#: up to which laws are tried with many histories, MPa
_TRIED_PRESSURE = 300.0
_PARAMETERS = "parameters."


@lru_cache(maxsize=64)
def _compiled(source: str, name: str) -> dict[str, Any]:
    """Return the names that the source of a user's law defines. On every rank, once."""
    names: dict[str, Any] = {"__name__": "user_law", "__file__": name}
    exec(compile(source, name, "exec"), names)
    return names


@lru_cache(maxsize=64)
def _reads_wear(source: str) -> bool:
    """Tell whether Python source has an attribute ``wear``, as in ``at.wear``."""
    nodes = ast.walk(ast.parse(source))
    return any(isinstance(node, ast.Attribute) and node.attr == "wear" for node in nodes)


@dataclass(frozen=True)
class UserLaw(CheckedLaw):
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

    Parameters
    ----------
    file : its name.
    source : its text.
    parameters : pairs of name and quantity, which ``at.parameters`` holds at the time.
    """

    name = "user"
    one_by_one = True
    formula = "rate(p, at) of a Python file"

    file: Annotated[
        str,
        Parameter(
            "-",
            "file, relative to the case file, that defines rate(p, at), as user_law.py does",
            "file",
        ),
    ]
    source: str
    parameters: Annotated[
        tuple[tuple[str, Quantity], ...],
        Parameter(
            "-", "parameters of the law, which rate(p, at) reads from at.parameters", "parameters"
        ),
    ] = ()

    @classmethod
    def from_values(cls, values: Mapping[str, Any]) -> Self:
        """Return the law that a file defines.

        Raises
        ------
        InputError : the file cannot be read or run, or does not define a law.
        """
        path = Path(values["file"])
        try:
            law = cls(str(path), read_text(path), values["parameters"] or ())
        except InputError as error:
            raise InputError(f"file = {error}; must be a Python file") from error
        missing = law.missing()
        if missing:
            raise InputError(f"file = {path}: {missing}")
        return law

    def missing(self) -> str:
        """Return the fault that keeps the file from being a law, "" if there is none."""
        try:
            names = self._functions
        except (Exception, SystemExit) as error:  # whatever a user's code may raise
            return f"cannot be run ({type(error).__name__}: {error}); must be a Python file"
        if not callable(names.get("rate")):
            return "does not define rate; must define rate(p, at)"
        return ""

    @property
    def called(self) -> str:
        """Name of the law in messages."""
        return self.file

    def defines(self, function: UserFunction) -> bool:
        """Tell whether the file has a function; derivatives by parameters are not asked of it."""
        return function != "d_rate_dparameter" and function in self._functions

    @property
    def remembers(self) -> bool:
        """Whether the rate depends on worn depth."""
        if "remembers" in self._functions:
            return bool(self._functions["remembers"])
        return "d_rate_dwear" in self._functions or _reads_wear(self.source)

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Times at which a parameter's table bends, and those that the file names."""
        times = {float(time) for time in self._functions.get("breakpoints", ())}
        return tuple(sorted(times.union(breakpoints(*(q for _, q in self.parameters)))))

    @property
    def numeric(self) -> tuple[str, ...]:
        """Names of the parameters: "parameters.k"."""
        return tuple(_PARAMETERS + name for name, _ in self.parameters)

    def quantity(self, name: str) -> Quantity:
        """Return a numeric parameter as it was given."""
        return dict(self.parameters)[name.removeprefix(_PARAMETERS)]

    def with_parameter(self, name: str, values: Any) -> Self:
        """Return the law with another number, or other values at the elements."""
        changed = {**dict(self.parameters), name.removeprefix(_PARAMETERS): values}
        return replace(self, parameters=tuple(changed.items()))

    def describe(self) -> str:
        """Return the file's name with its parameters."""
        return f"rate(p, at) of {self.file}" + self._with(dict(self.parameters))

    @property
    def _functions(self) -> dict[str, Any]:
        return _compiled(self.source, self.file)

    @classmethod
    def stacked(cls, laws: Sequence[Self]) -> Self:
        """Return one law for some histories whose laws differ in parameters only.

        Raises
        ------
        ValueError : they are of different files, or have other parameters.
        """
        first = laws[0]
        kinds = {(law.file, law.source, tuple(name for name, _ in law.parameters)) for law in laws}
        if len(kinds) > 1:
            raise ValueError("laws of different Python files or parameters cannot be stacked")
        columns = zip(*(law.parameters for law in laws), strict=True)
        stacks = ((pairs[0][0], stack_quantities([q for _, q in pairs])) for pairs in columns)
        return replace(first, parameters=tuple(stacks))

    def _with_stacks(self, change: Callable[[Any], Any]) -> Self:
        return replace(self, parameters=tuple((name, change(q)) for name, q in self.parameters))

    def _call(
        self, function: UserFunction, p: FloatArray, local: LocalState, *first: str
    ) -> FloatArray:
        values = {key: value(q, local.time, local.r) for key, q in self.parameters}
        state = read_only_state(local, parameters=values)
        called = f"{self.file}: {function}()"
        return checked_call(called, function, self._functions[function], p, state, values.values())


def check_object(law: object) -> None:
    """Refuse what is no law at all, or says nonsense of itself. Not collective.

    Raises
    ------
    InputError : what it is, and what it must be.
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
    """Tell whether a law gives many histories at once, (B, n), what it gives each by itself.

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
        except Exception:  # nothing that company would change: its histories will tell
            continue
        try:
            if not np.array_equal(getattr(law, method)(p, at), alone):
                return False
        except Exception:  # whatever a user's code may raise
            return False
    return True


def _jump(law: CheckedLaw, at: LocalState, p: FloatArray, rates: FloatArray) -> str:
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
        f"{law.called}: rate() jumps from {below:g} to {above:g} at p = {low:.6g} MPa "
        f"(time {at.time:g} s, element {e}, r = {at.r[e]:.6g} mm); must be continuous in p"
    )
