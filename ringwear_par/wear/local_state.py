"""The quantities along a contact line, besides the pressure, that a wear law may read."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray, columns
from ringwear_par.schedules import history, take


@dataclass(frozen=True)
class LocalState:
    """Quantities besides the pressure that a wear law may read, at the contact elements.

    Of one history, or of B: then ``time`` and ``friction`` may be (B,), which are stored as (B, 1).

    Parameters
    ----------
    time : s.
    r : (n,) float, mm.
    speed : (..., n) float, mm/s, sliding speed V.
    friction : Coulomb's mu.
    wear : (..., n) float, mm, depth worn off this body so far.
    slid : (..., n) float, mm, distance slid so far (speed integrated over time).
    parameters : values of a user's law's own parameters at this time, each a number or (..., n).
    """

    time: float | FloatArray
    r: FloatArray
    speed: FloatArray
    friction: float | FloatArray
    wear: FloatArray
    slid: FloatArray
    parameters: Mapping[str, Any] = field(default_factory=dict)
    #: values that a law has computed from this state, for its next call: the law, then the values
    memo: list[Any] = field(default_factory=list, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if isinstance(self.time, np.ndarray):
            object.__setattr__(self, "time", columns(self.time))
        if isinstance(self.friction, np.ndarray):
            object.__setattr__(self, "friction", columns(self.friction))

    @cached_property
    def power(self) -> FloatArray:
        """(..., n) mm/s, friction coefficient times sliding speed."""
        return self.friction * self.speed

    def worn_by(self, depth: FloatArray) -> "LocalState":
        """Return the local state of a body worn by more, (..., n) mm."""
        after = replace(self, wear=self.wear + depth)
        after.__dict__["power"] = self.power
        return after

    if not TYPE_CHECKING:  # type checkers see unknown names without it

        def __getattr__(self, name: str) -> Any:
            names = ", ".join([*(f.name for f in fields(self) if f.name != "memo"), "power"])
            raise AttributeError(f"LocalState has no {name!r}; it has {names}")

    def take(self, histories: IntArray) -> "LocalState":
        """Return the local state of some of B histories."""
        return replace(
            self,
            time=take(self.time, histories),
            speed=take(self.speed, histories),
            friction=take(self.friction, histories),
            wear=take(self.wear, histories),
            slid=take(self.slid, histories),
        )

    def history(self, i: int) -> "LocalState":
        """Return the local state of one of B histories."""
        return replace(
            self,
            time=history(self.time, i),
            speed=history(self.speed, i),
            friction=history(self.friction, i),
            wear=history(self.wear, i),
            slid=history(self.slid, i),
        )
