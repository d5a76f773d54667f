"""Wear through the layers of a body, each by its own law.

An element is in one layer from the start of a step to its end, which is at the latest when it
reaches the end of the layer, see ``history.schemes.interfaces``.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray, IntArray, columns
from ringwear_par.schedules import Quantity, Stacked, Table
from ringwear_par.wear.law import Law, parameters_of, stack_laws
from ringwear_par.wear.local_state import LocalState

#: share of the depth of a layer's end below which what is left above it is round-off
_ROUND_OFF = 1e-13


def worn_through(ends: FloatArray, wear: FloatArray) -> BoolArray:
    """Tell where wear has come to the ends of layers, but for round-off.

    Parameters
    ----------
    ends : (layers, n) or (..., n) float, mm, depths of the layers' ends; may be infinite.
    wear : (..., n) float, mm.
    """
    through: BoolArray = wear >= (1.0 - _ROUND_OFF) * ends
    return through


@dataclass(frozen=True)
class NoWear(Law):
    """The law of a layer, or of a body under layers, that does not wear."""

    formula = "0"
    steady = True

    def rate(self, p: FloatArray, local: LocalState) -> FloatArray:
        """Return the rate of wear, 0 mm/s."""
        return np.zeros_like(p)

    def line(self, local: LocalState) -> tuple[FloatArray, float | FloatArray] | None:
        """Return rise and onset, 0."""
        return np.zeros_like(local.speed), 0.0

    def d_rate_dp(self, p: FloatArray, local: LocalState) -> FloatArray:
        """Return its derivative with respect to pressure, 0."""
        return np.zeros_like(p)

    def potential(self, p: FloatArray, local: LocalState) -> FloatArray:
        """Return the integral of the rate from 0 to p, 0."""
        return np.zeros_like(p)


@dataclass(frozen=True)
class LayeredLaw(Law):
    """The law of the layer that an element is in.

    The ``wear`` that the law of a layer reads is the depth worn off this layer. Parameters are
    those of the body, by name, and of layers with laws of their own, "layers[0].k".
    """

    #: of the layers from the contact face inwards, and of the body itself
    laws: tuple[Law, ...]
    #: mm, of the layers
    thicknesses: tuple[float, ...]
    #: which layers have a law of their own; the others wear as the body
    has_law: tuple[bool, ...]
    #: (layers, n) mm, or (layers, B, n) of B histories, depth at which each layer ends, measured as
    #: ``LocalState.wear``; None: as many thicknesses, at all elements
    ends: FloatArray | None = field(default=None, compare=False, repr=False)
    #: (..., n) int, the layers that elements are in, 0 at the unworn face; None: those at the depth
    #: that is worn off
    present: IntArray | None = field(default=None, compare=False, repr=False)
    #: one law whose parameters are arrays, each element's those of its layer; None where the laws
    #: of layers differ in more than numbers
    _joined: Law | None = field(default=None, init=False, compare=False, repr=False)

    def __post_init__(self) -> None:
        if self.present is not None:
            object.__setattr__(self, "_joined", _joined(self.laws, self.present))

    @classmethod
    def of(
        cls, thicknesses: Sequence[float], layer_laws: Sequence[Law | None], body: Law | None
    ) -> Self:
        """Return the law of a body with layers; a layer whose law is None wears as the body."""
        body_law = NoWear() if body is None else body
        laws = (*(body_law if law is None else law for law in layer_laws), body_law)
        return cls(laws, tuple(thicknesses), tuple(law is not None for law in layer_laws))

    def at(self, ends: FloatArray | None) -> Self:
        """Return the law at elements, where layers end at these depths, mm, see ``ends``."""
        return replace(self, ends=ends)

    @property
    def depths(self) -> FloatArray:
        """(layers, n), (layers, B, n) or (layers, 1) mm, where layers end."""
        return np.cumsum(self.thicknesses)[:, None] if self.ends is None else self.ends

    def states(self, local: LocalState) -> list[LocalState]:
        """Return the local state of each layer: with the depth worn off the layer itself."""
        starts = np.concatenate([np.zeros_like(self.depths[:1]), self.depths])
        return [
            replace(local, wear=np.maximum(local.wear - start, 0.0)) if law.reads_wear else local
            for law, start in zip(self.laws, starts, strict=True)
        ]

    def layers_at(self, wear: FloatArray) -> IntArray:
        """Return the layers that are at the face, (..., n), worn by (..., n) mm."""
        layers = np.zeros(wear.shape, dtype=np.int64)
        for end in self.depths:
            layers += worn_through(end, wear)
        return layers

    def in_layers(self, present: IntArray) -> Self:
        """Return the law of elements that are in these layers, (..., n), at any worn depth."""
        return replace(self, present=present)

    def end_of(self, layers: IntArray) -> FloatArray:
        """Return the depths at which layers end, (..., n) mm, infinite of the body itself."""
        ends = np.full(layers.shape, np.inf)
        for number, end in enumerate(self.depths):
            ends = np.where(layers == number, end, ends)
        return ends

    def _at_face(self, method: str, p: FloatArray, local: LocalState, *more: LocalState) -> Any:
        """Return a method of the law of each element's layer; None where one has none."""
        if self._joined is not None:
            return getattr(self._joined, method)(p, local, *more)
        present = self.layers_at(local.wear) if self.present is None else self.present
        values: Any = None
        for number, (law, at) in enumerate(zip(self.laws, self.states(local), strict=True)):
            in_layer = present == number
            if in_layer.any():
                of_layer = getattr(law, method)(p, at, *more)
                if of_layer is None:
                    return None
                values = of_layer if values is None else np.where(in_layer, of_layer, values)
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
        """Whether the rate may depend on worn depth: if only as it says which layer it is."""
        return self.present is None or any(law.reads_wear for law in self.laws)

    @property
    def is_steady(self) -> bool:
        """Whether the rate at a pressure changes only where speed or friction does."""
        return self.present is not None and all(law.is_steady for law in self.laws)

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

    def name_in_layer(self, name: str, number: int) -> str | None:
        """Return the name of a parameter in the law of a layer or the body, None if not in it."""
        has_law = number < len(self.has_law) and self.has_law[number]
        begin = f"layers[{number}]."
        if has_law:
            return name.removeprefix(begin) if name.startswith(begin) else None
        return None if name.startswith("layers[") else name

    def quantity(self, name: str) -> Quantity:
        """Return a numeric parameter as it was given."""
        number, short = next(self.laws_with(name))
        return self.laws[number].quantity(short)

    def laws_with(self, name: str) -> Any:
        """Yield the laws that have a parameter: their numbers, and its names in them."""
        for number in range(len(self.laws)):
            short = self.name_in_layer(name, number)
            if short is not None:
                yield number, short

    def rate(self, p: FloatArray, local: LocalState) -> FloatArray:
        """Return the rate of wear, mm/s."""
        return self._at_face("rate", p, local)

    def line(self, local: LocalState) -> tuple[FloatArray, float | FloatArray] | None:
        """Return rise, mm/s/MPa, and onset, MPa, of rates that are lines in all layers."""
        if self._joined is not None:
            return self._joined.line(local)
        if self.present is None:
            return None
        rise, onset = np.zeros((2, *self.present.shape))
        for number, (law, at) in enumerate(zip(self.laws, self.states(local), strict=True)):
            line = law.line(at)
            if line is None:
                return None
            in_layer = self.present == number
            rise, onset = np.where(in_layer, line[0], rise), np.where(in_layer, line[1], onset)
        return rise, onset

    def d_rate_dp(self, p: FloatArray, local: LocalState) -> FloatArray:
        """Return the derivative of the rate with respect to pressure, mm/s/MPa."""
        return self._at_face("d_rate_dp", p, local)

    def d_rate_dwear(self, p: FloatArray, local: LocalState) -> FloatArray:
        """Return the derivative of the rate with respect to ``local.wear``, 1/s."""
        return self._at_face("d_rate_dwear", p, local)

    def potential(self, p: FloatArray, local: LocalState) -> FloatArray | None:
        """Return the integral of the rate from 0 to p, MPa mm/s; None: by quadrature."""
        return self._at_face("potential", p, local)

    def onset(self, local: LocalState) -> float | FloatArray:
        """Return the pressure, MPa, up to which nothing wears."""
        if self._joined is not None:
            return self._joined.onset(local)
        present = self.layers_at(local.wear) if self.present is None else self.present
        onset = np.zeros(present.shape)
        for number, (law, at) in enumerate(zip(self.laws, self.states(local), strict=True)):
            onset = np.where(present == number, law.onset(at), onset)
        return onset

    def ratios(self, friction: Quantity) -> list[float]:
        """Return worn volume per dissipated energy of each layer and the body, 1/MPa, 0: none."""
        return [ratio for law in self.laws for ratio in law.ratios(friction)]

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

    def take(self, histories: IntArray) -> Self:
        """Return the law of some of B histories."""
        present, ends = self.present, self.ends
        return replace(
            self,
            laws=tuple(law.take(histories) for law in self.laws),
            ends=ends if ends is None or ends.ndim < 3 else ends[:, histories],
            present=None if present is None else present[histories],
        )


def _joined(laws: Sequence[Law], present: IntArray) -> Law | None:
    """Return one law of elements in these layers, (..., n); None where laws differ too much.

    Its parameters are arrays over the elements, so that rates take one evaluation.
    """
    first: Any = laws[0]
    if any(type(law) is not type(first) or law.reads_wear for law in laws):
        return None
    changed: dict[str, Any] = {}
    for name, parameter in parameters_of(type(first)).items():
        values = [getattr(law, name) for law in laws]
        if all(value is values[0] or np.array_equal(value, values[0]) for value in values):
            continue
        numbers = [value.numbers if isinstance(value, Stacked) else value for value in values]
        if not parameter.numeric or any(n is None or isinstance(n, Table) for n in numbers):
            return None
        changed[name] = columns(numbers[-1])
        for layer in range(len(laws) - 1):
            changed[name] = np.where(present == layer, columns(numbers[layer]), changed[name])
    joined: Law = replace(first, **changed)
    return joined
