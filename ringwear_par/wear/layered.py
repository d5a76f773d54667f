"""Wear through the layers of a body: each by its own law, and how a step divides among them."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray, IntArray
from ringwear_par.schedules import Quantity
from ringwear_par.wear.law import Law, stack_laws
from ringwear_par.wear.local_state import LocalState

#: share of the depth of a layer's end below which what is left above it is round-off
ROUND_OFF = 1e-13


def worn_through(ends: FloatArray, wear: FloatArray) -> BoolArray:
    """Tell where wear has come to the ends of layers, but for round-off.

    Parameters
    ----------
    ends : (layers, n) or (n,) float, mm, depths of the layers' ends.
    wear : (..., n) float, mm.
    """
    through: BoolArray = ends - wear <= ROUND_OFF * np.abs(ends)
    return through


@dataclass(frozen=True)
class NoWear(Law):
    """Of a layer, or a body under layers, that does not wear."""

    formula = "0"

    def rate(self, p: FloatArray, local: LocalState) -> FloatArray:
        """Return the rate of wear, 0 mm/s."""
        return np.zeros_like(p)

    def d_rate_dp(self, p: FloatArray, local: LocalState) -> FloatArray:
        """Return its derivative with respect to pressure, 0."""
        return np.zeros_like(p)

    def potential(self, p: FloatArray, local: LocalState) -> FloatArray:
        """Return the integral of the rate from 0 to p, 0."""
        return np.zeros_like(p)


@dataclass(frozen=True)
class LayeredLaw(Law):
    """The law of the layer that is at the face where and when a body wears.

    Laws that remember worn depth are told of what is worn off their own layer. Parameters are those
    of the body, by name, and of layers with laws of their own, "layers[0].k".

    Parameters
    ----------
    laws : of the layers from the contact face inwards, and of the body itself.
    thicknesses : mm, of the layers.
    own : which layers have a law of their own; the others wear as the body.
    ends : (layers, n) mm, depth at which each layer ends, measured as ``LocalState.wear``; None:
        as many thicknesses, at all elements.
    """

    laws: tuple[Law, ...]
    thicknesses: tuple[float, ...]
    own: tuple[bool, ...]
    ends: FloatArray | None = field(default=None, compare=False, repr=False)

    @classmethod
    def of(cls, thicknesses: Sequence[float], own: Sequence[Law | None], body: Law | None) -> Self:
        """Return the law of a body with layers, whose own laws are None where they wear as it."""
        itself = NoWear() if body is None else body
        laws = (*(itself if law is None else law for law in own), itself)
        return cls(laws, tuple(thicknesses), tuple(law is not None for law in own))

    def at(self, ends: FloatArray) -> Self:
        """Return the law at elements, where layers end at these depths, (layers, n) mm."""
        return replace(self, ends=ends)

    @property
    def depths(self) -> FloatArray:
        """(layers, n) or (layers, 1) mm, where layers end."""
        return np.cumsum(self.thicknesses)[:, None] if self.ends is None else self.ends

    def left(self, wear: FloatArray) -> FloatArray:
        """Return what is left of each layer, (layers, ..., n) mm, worn by (..., n) mm."""
        ends = self.depths.reshape(len(self.thicknesses), *(1,) * (wear.ndim - 1), -1)
        starts = np.concatenate([np.zeros_like(ends[:1]), ends[:-1]])
        reached = np.maximum(wear, starts)
        return np.where(worn_through(ends, reached), 0.0, ends - reached)

    def states(self, local: LocalState) -> list[LocalState]:
        """Return what each law is told: the depth worn off its own layer."""
        starts = np.concatenate([np.zeros_like(self.depths[:1]), self.depths])
        return [
            replace(local, wear=np.maximum(local.wear - start, 0.0)) if law.reads_wear else local
            for law, start in zip(self.laws, starts, strict=True)
        ]

    def present(self, wear: FloatArray) -> IntArray:
        """Return which layer is at the face, (..., n), worn by (..., n) mm."""
        return (self.left(wear) <= 0.0).sum(axis=0)

    def _there(self, asked: str, p: FloatArray, local: LocalState, *first: Any) -> FloatArray:
        """Return what the law of each place's layer gives."""
        shape = np.broadcast_shapes(p.shape, local.wear.shape)
        present = np.broadcast_to(self.present(local.wear), shape)
        found = np.zeros(shape)
        for number, (law, at) in enumerate(zip(self.laws, self.states(local), strict=True)):
            here = present == number
            if here.any():
                found = np.where(here, getattr(law, asked)(*first, p, at), found)
        return found

    # -- as any law --------------------------------------------------------------------------------

    @property
    def length(self) -> float:  # type: ignore[override]
        """Averaging length, mm, of the laws; such laws are not for layers."""
        return max(law.length for law in self.laws)

    @property
    def remembers(self) -> bool:
        """Whether the rate of any layer depends on worn depth."""
        return any(law.remembers for law in self.laws)

    @property
    def reads_wear(self) -> bool:
        """Whether the rate may depend on worn depth: it says which layer it is."""
        return True

    @property
    def breakpoints(self) -> tuple[float, ...]:
        """Times, s, at which a parameter's table bends."""
        return tuple(sorted({time for law in self.laws for time in law.breakpoints}))

    @property
    def numeric(self) -> tuple[str, ...]:
        """Names of the parameters that the rate has derivatives with respect to."""
        of_layers = [
            f"layers[{i}].{name}"
            for i, (law, own) in enumerate(zip(self.laws, self.own, strict=False))
            if own
            for name in law.numeric
        ]
        return (*self.laws[-1].numeric, *of_layers)

    def of_layer(self, name: str, number: int) -> str | None:
        """Return what the law of a layer, or the body, calls a parameter; None: it has it not."""
        own = number < len(self.own) and self.own[number]
        begin = f"layers[{number}]."
        if own:
            return name.removeprefix(begin) if name.startswith(begin) else None
        return None if name.startswith("layers[") else name

    def quantity(self, name: str) -> Quantity:
        """Return a numeric parameter as it was given."""
        number, own = next(self.having(name))
        return self.laws[number].quantity(own)

    def having(self, name: str) -> Any:
        """Yield the laws that have a parameter, by number, and what they call it."""
        for number in range(len(self.laws)):
            own = self.of_layer(name, number)
            if own is not None:
                yield number, own

    def with_parameter(self, name: str, there: Any) -> Self:
        """Return the law with another number, or other values at the elements."""
        laws = list(self.laws)
        for number, own in self.having(name):
            laws[number] = laws[number].with_parameter(own, there)
        return replace(self, laws=tuple(laws))

    def rate(self, p: FloatArray, local: LocalState) -> FloatArray:
        """Return the rate of wear, mm/s."""
        return self._there("rate", p, local)

    def d_rate_dp(self, p: FloatArray, local: LocalState) -> FloatArray:
        """Return the derivative of the rate with respect to pressure, mm/s/MPa."""
        return self._there("d_rate_dp", p, local)

    def d_rate_dwear(self, p: FloatArray, local: LocalState) -> FloatArray:
        """Return the derivative of the rate with respect to ``local.wear``, 1/s."""
        return self._there("d_rate_dwear", p, local)

    def d_rate_dparameter(self, name: str, p: FloatArray, local: LocalState) -> FloatArray:
        """Return the derivative of the rate with respect to a numeric parameter's value there."""
        present, found = self.present(local.wear), np.zeros_like(p)
        states = self.states(local)
        for number, own in self.having(name):
            there = self.laws[number].d_rate_dparameter(own, p, states[number])
            found = np.where(present == number, there, found)
        return found

    def layer_ratios(self, friction: Any) -> list[Any]:
        """Return worn volume per dissipated energy of each layer and the body, 1/MPa, 0: none."""
        ratios = [law.per_energy(friction) for law in self.laws]
        return [0.0 * friction if ratio is None else ratio for ratio in ratios]

    def describe(self) -> str:
        """Return the formulas with their numbers and units, layer by layer."""
        told = [
            f"{law.describe()} through a layer of {1e3 * thickness:.6g} um"
            for law, thickness in zip(self.laws, self.thicknesses, strict=False)
        ]
        return ", then ".join([*told, f"{self.laws[-1].describe()} in the body itself"])

    @classmethod
    def stacked(cls, laws: Sequence[Self]) -> Self:
        """Return one law for some histories whose laws differ in numeric parameters only.

        Raises
        ------
        ValueError : they differ in something else.
        """
        first = laws[0]
        if any((law.thicknesses, law.own) != (first.thicknesses, first.own) for law in laws):
            raise ValueError("laws of different layers cannot be stacked")
        each = [stack_laws(own) for own in zip(*(law.laws for law in laws), strict=True)]
        return replace(first, laws=tuple(law for law in each if law is not None))

    def history(self, i: int) -> Self:
        """Return the law of one of B histories."""
        return replace(self, laws=tuple(law.history(i) for law in self.laws))

    def take(self, histories: IntArray) -> Self:
        """Return the law of some of B histories."""
        return replace(self, laws=tuple(law.take(histories) for law in self.laws))


# -- a step ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Passage:
    """How the time of a step divides among the layers of a body.

    Parameters
    ----------
    times : (layers + 1, ..., n) shares of the step.
    depths : (layers + 1, ..., n) mm, worn off each along the normal.
    left_behind : (layers, ..., n) bool, which layers are worn through by then.
    """

    times: FloatArray
    depths: FloatArray
    left_behind: FloatArray


def passage(full: FloatArray, left: FloatArray, share: FloatArray | float) -> Passage:
    """Return how wear goes through layers in a share of a step.

    A layer of which c mm are left, and which all of the step would wear by a mm, takes the share
    c / a of it, and the next one what remains.

    Parameters
    ----------
    full : (layers + 1, ..., n) mm, what each would lose in all of the step.
    left : (layers, ..., n) mm, of each layer.
    share : (..., n) or a number, of the step.
    """
    times, depths = np.zeros_like(full), np.zeros_like(full)
    behind = np.zeros(left.shape, dtype=bool)
    remains = np.broadcast_to(np.asarray(share, dtype=float), full.shape[1:])
    for number in range(len(left)):
        a, c = full[number], left[number]
        # a share that ends at the interface does so in spite of round-off
        behind[number] = through = worn_through(c, remains * a) & ((remains > 0.0) | (c <= 0.0))
        taken = np.divide(c, a, out=np.zeros_like(a), where=through & (a > 0.0))
        taken = np.where(through, np.minimum(taken, remains), remains)
        times[number] = taken
        depths[number] = np.where(through, c, taken * a)
        remains = np.where(through, remains - taken, 0.0)
    times[-1] = remains
    depths[-1] = remains * full[-1]
    return Passage(times, depths, behind)


def d_passage(
    full: FloatArray,
    d_full: FloatArray,
    gone: Passage,
    share: FloatArray | float,
    d_share: Any = 0.0,
    d_left: FloatArray | None = None,
) -> FloatArray:
    """Return how what a passage wears off, all layers together, varies: (..., n) mm over what does.

    Parameters
    ----------
    d_full : (layers + 1, ..., n), perhaps of P numbers: (layers + 1, P, ..., n).
    gone : the passage.
    d_share : as ``d_full`` without its first axis.
    d_left : (layers, ..., n) or of P numbers, of what is left.
    """
    total = np.zeros(np.broadcast_shapes(d_full.shape[1:], np.shape(d_share)))
    remains = np.broadcast_to(np.asarray(share, dtype=float), full.shape[1:])
    d_remains: Any = d_share + np.zeros_like(total)
    for number, through in enumerate(gone.left_behind):
        a, taken = full[number], gone.times[number]
        d_c = 0.0 if d_left is None else d_left[number]
        inside = d_remains * a + remains * d_full[number]
        total = total + np.where(through, d_c, inside)
        d_taken = np.divide(
            d_c - taken * d_full[number], a, out=np.zeros_like(total), where=through & (a > 0.0)
        )
        remains = np.where(through, remains - taken, 0.0)
        d_remains = np.where(through, d_remains - d_taken, 0.0)
    return total + d_remains * full[-1] + remains * d_full[-1]
