"""What a wear law may read besides the pressure: time, sliding, and the memory of a place."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from ringwear_par.arrays import FloatArray, IntArray


@dataclass(frozen=True)
class LocalState:
    """Quantities besides the pressure that a wear law may read, at the contact elements.

    Users' laws are called with those of one history, as given here. Laws of the package take those
    of B histories at once: (B, 1) for each number, and (B, n).

    Parameters
    ----------
    time : s.
    r : (n,) float, mm.
    speed : (n,) float, mm/s, sliding speed V.
    friction : Coulomb's mu.
    wear : (n,) float, mm, depth worn off this body so far; of a layer, off the layer itself.
    slid : (n,) float, mm, distance slid so far (speed integrated over time).
    parameters : values of a user's law's own parameters at this time, each a number or (n,).
    number : (B, 1) int, numbers of the histories in their block, which faults are known by.
    """

    time: Any
    r: FloatArray
    speed: FloatArray
    friction: Any
    wear: FloatArray
    slid: FloatArray
    parameters: Mapping[str, Any] = field(default_factory=dict)
    number: IntArray | None = None

    @property
    def power(self) -> FloatArray:
        """(n,) mm/s, friction coefficient times sliding speed."""
        return self.friction * self.speed
