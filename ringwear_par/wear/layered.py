"""Wear through the layers of a body, each by its own law."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.schedules import Quantity
from ringwear_par.wear.law import Law, Layers, stack_laws
from ringwear_par.wear.layer_split import worn_through
from ringwear_par.wear.local_state import LocalState


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
    has_law : which layers have a law of their own; the others wear as the body.
    ends : (layers, n) mm, or (layers, B, n) of B histories, depth at which each layer ends,
        measured as ``LocalState.wear``; None: as many thicknesses, at all elements.
    """

    laws: tuple[Law, ...]
    thicknesses: tuple[float, ...]
    has_law: tuple[bool, ...]
    ends: FloatArray | None = field(default=None, compare=False, repr=False)

    @classmethod
    def of(
        cls, thicknesses: Sequence[float], layer_laws: Sequence[Law | None], body: Law | None
    ) -> Self:
        """Return the law of a body with layers, whose own laws are None where they wear as it."""
        itself = NoWear() if body is None else body
        laws = (*(itself if law is None else law for law in layer_laws), itself)
        return cls(laws, tuple(thicknesses), tuple(law is not None for law in layer_laws))

    def at(self, ends: FloatArray) -> Self:
        """Return the law at elements, where layers end at these depths, mm, see ``ends``."""
        return replace(self, ends=ends)

    @property
    def depths(self) -> FloatArray:
        """(layers, n), (layers, B, n) or (layers, 1) mm, where layers end."""
        return np.cumsum(self.thicknesses)[:, None] if self.ends is None else self.ends

    def remaining(self, wear: FloatArray) -> FloatArray:
        """Return the thickness that remains of layers, (layers, ..., n) mm, worn by (..., n) mm."""
        layers, *shape = self.depths.shape
        ends = self.depths.reshape(layers, *(1,) * (wear.ndim - len(shape)), *shape)
        starts = np.concatenate([np.zeros_like(ends[:1]), ends[:-1]])
        reached = np.maximum(wear, starts)
        return np.where(worn_through(ends, reached), 0.0, ends - reached)

    def states(self, local: LocalState) -> list[LocalState]:
        """Return the local state of each layer: with the depth worn off the layer itself."""
        starts = np.concatenate([np.zeros_like(self.depths[:1]), self.depths])
        return [
            replace(local, wear=np.maximum(local.wear - start, 0.0)) if law.reads_wear else local
            for law, start in zip(self.laws, starts, strict=True)
        ]

    def layers(self, local: LocalState) -> Layers:
        """Return the layers at the start of a step."""
        remaining = self.remaining(local.wear)
        present = (remaining <= 0.0).sum(axis=0)
        return Layers(self.laws, self.states(local), remaining, present)

    def present(self, wear: FloatArray) -> IntArray:
        """Return which layer is at the face, (..., n), worn by (..., n) mm."""
        return (self.remaining(wear) <= 0.0).sum(axis=0)

    def _at_face(self, method: str, p: FloatArray, local: LocalState) -> FloatArray:
        """Return a method of the law of the layer that is at the face of each element."""
        shape = np.broadcast_shapes(p.shape, local.wear.shape)
        present = np.broadcast_to(self.present(local.wear), shape)
        values = np.zeros(shape)
        for number, (law, at) in enumerate(zip(self.laws, self.states(local), strict=True)):
            here = present == number
            if here.any():
                values = np.where(here, getattr(law, method)(p, at), values)
        return values

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
            for i, (law, has_law) in enumerate(zip(self.laws, self.has_law, strict=False))
            if has_law
            for name in law.numeric
        ]
        return (*self.laws[-1].numeric, *of_layers)

    def of_layer(self, name: str, number: int) -> str | None:
        """Return the name of a parameter in the law of a layer or the body, None if not in it."""
        has_law = number < len(self.has_law) and self.has_law[number]
        begin = f"layers[{number}]."
        if has_law:
            return name.removeprefix(begin) if name.startswith(begin) else None
        return None if name.startswith("layers[") else name

    def quantity(self, name: str) -> Quantity:
        """Return a numeric parameter as it was given."""
        number, short = next(self.having(name))
        return self.laws[number].quantity(short)

    def having(self, name: str) -> Any:
        """Yield the laws that have a parameter, by number, and what they call it."""
        for number in range(len(self.laws)):
            short = self.of_layer(name, number)
            if short is not None:
                yield number, short

    def with_parameter(self, name: str, values: Any) -> Self:
        """Return the law with another number, or other values at the elements."""
        laws = list(self.laws)
        for number, short in self.having(name):
            laws[number] = laws[number].with_parameter(short, values)
        return replace(self, laws=tuple(laws))

    def rate(self, p: FloatArray, local: LocalState) -> FloatArray:
        """Return the rate of wear, mm/s."""
        return self._at_face("rate", p, local)

    def d_rate_dp(self, p: FloatArray, local: LocalState) -> FloatArray:
        """Return the derivative of the rate with respect to pressure, mm/s/MPa."""
        return self._at_face("d_rate_dp", p, local)

    def d_rate_dwear(self, p: FloatArray, local: LocalState) -> FloatArray:
        """Return the derivative of the rate with respect to ``local.wear``, 1/s."""
        return self._at_face("d_rate_dwear", p, local)

    def d_rate_dparameter(self, name: str, p: FloatArray, local: LocalState) -> FloatArray:
        """Return the derivative of the rate with respect to a numeric parameter's value there."""
        present, d_rate = self.present(local.wear), np.zeros_like(p)
        states = self.states(local)
        for number, short in self.having(name):
            of_layer = self.laws[number].d_rate_dparameter(short, p, states[number])
            d_rate = np.where(present == number, of_layer, d_rate)
        return d_rate

    def layer_ratios(self, friction: Any) -> list[Any]:
        """Return worn volume per dissipated energy of each layer and the body, 1/MPa, 0: none."""
        ratios = [law.per_energy(friction) for law in self.laws]
        return [0.0 * friction if ratio is None else ratio for ratio in ratios]

    def describe(self) -> str:
        """Return the formulas with their numbers and units, layer by layer."""
        through = [
            f"{law.describe()} through a layer of {1e3 * thickness:.6g} um"
            for law, thickness in zip(self.laws, self.thicknesses, strict=False)
        ]
        return ", then ".join([*through, f"{self.laws[-1].describe()} in the body itself"])

    @classmethod
    def stacked(cls, laws: Sequence[Self]) -> Self:
        """Return one law for some histories whose laws differ in numeric parameters only.

        Raises
        ------
        ValueError : they differ in something else.
        """
        first = laws[0]
        if any(law.has_law != first.has_law for law in laws):
            raise ValueError("laws of different layers cannot be stacked")
        stacks = [stack_laws(group) for group in zip(*(law.laws for law in laws), strict=True)]
        return replace(
            first,
            laws=tuple(law for law in stacks if law is not None),
            ends=np.stack([law.depths for law in laws], axis=1),
        )

    def history(self, i: int) -> Self:
        """Return the law of one of B histories."""
        ends = self.ends
        if ends is not None and ends.ndim == 3:
            ends = ends[:, i]
        return replace(self, laws=tuple(law.history(i) for law in self.laws), ends=ends)

    def take(self, histories: IntArray) -> Self:
        """Return the law of some of B histories."""
        ends = self.ends
        if ends is not None and ends.ndim == 3:
            ends = ends[:, histories]
        return replace(self, laws=tuple(law.take(histories) for law in self.laws), ends=ends)
