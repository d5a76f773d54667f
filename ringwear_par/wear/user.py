"""Wear laws of users, from files and as objects: called for one history at a time, and checked."""

import re
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Protocol, Self

import numpy as np

from ringwear_par.arrays import FloatArray, read_only
from ringwear_par.errors import InputError, LawError
from ringwear_par.files.text import read_text
from ringwear_par.wear.at import LocalState

#: step of differences over the pressure or the worn depth, and MPa and mm, what counts as these
#: where they are smaller: differences look upwards, since below rates may have no sense
_STEP, _SMALL_PRESSURE, _SMALL_WEAR = 1e-6, 1e-3, 1e-6


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


@lru_cache(maxsize=64)
def _run(source: str, name: str) -> SimpleNamespace:
    """Return what the text of a file defines. On every rank, once."""
    names: dict[str, Any] = {"__name__": "user_law", "__file__": name}
    exec(compile(source, name, "exec"), names)
    return SimpleNamespace(**names)


@dataclass(frozen=True)
class UserCode:
    """The code of a user's law."""

    #: file or class, in messages
    called: str
    #: text of the file, or the object
    source: Any

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

    @cached_property
    def remembers(self) -> bool:
        """Whether the rate may depend on ``local.wear``: objects say so, files are searched."""
        reads = not self.is_file or re.search(r"\.wear\b|\bd_rate_dwear\b", self.source) is not None
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
            h = _STEP * np.maximum(p, _SMALL_PRESSURE)
            slope = np.maximum((self._call("rate", p + h, local) - rate) / h, 0.0)
        if not self.remembers:
            return rate, slope
        if self.get("d_rate_dwear"):
            return rate, slope, self._call("d_rate_dwear", p, local)
        h = _STEP * np.maximum(local.wear, _SMALL_WEAR)
        return rate, slope, (self._call("rate", p, replace(local, wear=local.wear + h)) - rate) / h

    def _call(self, name: str, p: FloatArray, local: LocalState) -> FloatArray:
        """Return the result of a function of the code, (n,), as a copy, checked."""
        try:
            with np.errstate(all="ignore"):
                result = self.get(name)(read_only(p), local)
            if result is None or np.iscomplexobj(result):
                raise TypeError(f"it returns {type(result).__name__}, not real numbers")
            result = np.array(np.broadcast_to(np.asarray(result, dtype=float), p.shape))
        except (Exception, SystemExit) as error:  # whatever a user's code may raise
            reason = f"{type(error).__name__}: {error}"
            raise LawError(
                f"{self.called}: {name}() failed at time {local.time:g} s: {reason}"
            ) from error
        falls = name == "d_rate_dwear"  # of rates by worn depth, which may fall
        bad = ~(np.isfinite(result) & (falls | (result >= 0.0)))
        if bad.any():
            e, must = int(bad.argmax()), "finite" if falls else "finite and >= 0"
            gives = f"gives {result[e]:g}{place_words(local, e, p[e])}"
            raise LawError(f"{self.called}: {name}() {gives}; must be {must}")
        return result


def user(
    code: UserCode,
    faults: dict[int, str],
    p: FloatArray,
    at: LocalState,
    /,
    **parameters: FloatArray,
) -> tuple[FloatArray, ...]:
    """Return what laws return, of a user's law: NaN of the histories where it fails.

    Parameters
    ----------
    faults : what is wrong, by number of the history that called the law last: set here.
    """
    values = np.full((3 if code.remembers else 2, *p.shape), np.nan)
    for i in np.flatnonzero(np.isfinite(p).all(axis=1)):
        number = i if at.number is None else int(at.number[i, 0])
        own = {name: v[i] if v.shape[1] > 1 else v[i, 0] for name, v in parameters.items()}
        speed, wear, slid = (read_only(field[i]) for field in (at.speed, at.wear, at.slid))
        local = LocalState(at.time[i, 0], at.r, speed, at.friction[i, 0], wear, slid, own)
        try:
            values[:, i] = code.values(np.maximum(p[i], 0.0), local)
            faults.pop(number, None)
        except LawError as error:
            faults[number] = str(error)
    return tuple(values)


def place_words(local: LocalState, element: int, p: float) -> str:
    """Return the words of where and when a law was called."""
    return (
        f" at time {local.time:g} s, element {element} (r = {local.r[element]:.6g} mm), "
        f"p = {p:.6g} MPa"
    )
