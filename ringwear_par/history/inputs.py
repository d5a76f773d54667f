"""The inputs of B histories on one contact pair: loads, laws and gaps, stacked."""

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np

from ringwear_par import batched
from ringwear_par.arrays import BoolArray, FloatArray, IntArray
from ringwear_par.cases.case import SAME_TIME, Case
from ringwear_par.history.stop_criteria import stop_limits
from ringwear_par.schedules import Quantity, stack, take, varies
from ringwear_par.wear.law import Law, stack_laws
from ringwear_par.wear.layered import LayeredLaw


@dataclass(frozen=True)
class StoredStates:
    """Which states of B histories their cases store, besides the last one."""

    #: (B,) ``output.every``
    every: IntArray
    #: (B, m) s, ``output.times``, infinite where others have more of them; None: there are none
    times: FloatArray | None

    @classmethod
    def of(cls, cases: Sequence[Case]) -> Self:
        """Return the stored states of cases: at times of output, or after every so many steps."""
        every = np.array([case.output.every for case in cases])
        times = [case.output.times for case in cases]
        most = max(map(len, times))
        if not most:
            return cls(every, None)
        return cls(every, np.array([[*row, *[np.inf] * (most - len(row))] for row in times]))

    def at(self, steps: IntArray, time: FloatArray) -> BoolArray:
        """Return whether states after so many steps, at times (s), are stored, (B,)."""
        if self.times is None:
            return steps % self.every == 0
        same = np.abs(time[:, None] - self.times) <= SAME_TIME * time[:, None]
        return (steps == 0) | same.any(axis=1)

    def within(self, start: FloatArray, end: FloatArray) -> BoolArray:
        """Return which times of output lie strictly between two times (s), (B, m)."""
        assert self.times is not None
        after, before = self.times - start[:, None], end[:, None] - self.times
        return (after > SAME_TIME * self.times) & (before > SAME_TIME * self.times)


@dataclass(frozen=True)
class HistoryInputs:
    """Loads, laws and gaps of B cases."""

    #: the B cases
    cases: tuple[Case, ...]
    #: (B, n) float, mm, of the unworn faces
    initial_gap: FloatArray
    #: coefficient
    friction: Quantity
    #: (B,) float, mm of wear, ``time.tolerance``
    tolerance: FloatArray
    #: rad/s
    omega: Quantity
    #: N, and mm; the cases have one or the other, None is the other
    force: Quantity | None
    displacement: Quantity | None
    #: of lower and upper, None where a body does not wear
    laws: tuple[Law | None, ...]
    #: worn volume of lower and upper per dissipated energy, (B,) 1/MPa, 0 where it is no constant;
    #: None where it is one in no history. Of a body with layers, (layers + 1, B): those of the
    #: layers and of the body itself
    per_energy: tuple[FloatArray | None, ...]
    #: of each
    stored: StoredStates
    #: (B,) limits that end histories, see ``stop_criteria``, by name
    stop_limits: Mapping[str, FloatArray]
    #: (2, B) factors on the rates of wear of lower and upper in the present step; None: 1
    pace: FloatArray | None = None

    @classmethod
    def of(cls, cases: Sequence[Case]) -> Self:
        """Return the inputs of cases of one pair.

        Raises
        ------
        ValueError : the cases cannot be stacked.
        """
        if len(cases) > 1 and any(case.follows_wear for case in cases):
            raise ValueError("histories with updated geometry cannot be stacked")
        loads = [case.load for case in cases]
        frictions = [case.friction for case in cases]
        laws = list(zip(*(case.laws for case in cases), strict=True))
        return cls(
            tuple(cases),
            np.array(of_faces(cases, lambda case: case.initial_gap)),
            stack(frictions),
            np.array([case.time.tolerance for case in cases]),
            stack([load.omega for load in loads]),
            _stacked([load.force for load in loads]),
            _stacked([load.displacement for load in loads]),
            tuple(stack_laws(body_laws) for body_laws in laws),
            tuple(_per_energy(body_laws, frictions) for body_laws in laws),
            StoredStates.of(cases),
            stop_limits(cases),
        )

    def take(self, histories: IntArray) -> Self:
        """Return the inputs of some of B histories."""
        return replace(
            self,
            cases=tuple(map(self.cases.__getitem__, histories.tolist())),
            initial_gap=self.initial_gap[histories],
            friction=take(self.friction, histories),
            tolerance=self.tolerance[histories],
            omega=take(self.omega, histories),
            force=take(self.force, histories),
            displacement=take(self.displacement, histories),
            laws=tuple(None if law is None else law.take(histories) for law in self.laws),
            per_energy=tuple(None if r is None else r[..., histories] for r in self.per_energy),
            stored=batched.take(self.stored, histories),
            stop_limits={name: limit[histories] for name, limit in self.stop_limits.items()},
            pace=None if self.pace is None else self.pace[:, histories],
        )

    def with_laws(self, change: Callable[[int, LayeredLaw], LayeredLaw]) -> Self:
        """Return the inputs with ``change(body, law)`` as the laws of bodies with layers."""
        laws = tuple(
            change(i, law) if isinstance(law, LayeredLaw) else law
            for i, law in enumerate(self.laws)
        )
        return replace(self, laws=laws)

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape of fields, (B, n)."""
        return self.initial_gap.shape

    @cached_property
    def most_wear(self) -> tuple[float, ...]:
        """How deep lower and upper may be worn, mm; the cases have the same heights."""
        return tuple(0.5 * (ring.z[1] - ring.z[0]) for ring in self.cases[0].rings)

    @cached_property
    def open_ends(self) -> list[int]:
        """The end elements, 0 and -1, at which mesh.contact cut the contact."""
        return [e for e, cut in zip((0, -1), self.cases[0].open_ends, strict=True) if cut]

    @cached_property
    def wears(self) -> bool:
        """Whether any body wears."""
        return any(law is not None for law in self.laws)

    @cached_property
    def wears_locally(self) -> bool:
        """Whether the wear of each element depends on its own pressure alone."""
        return self.wears and not any(law is not None and law.length for law in self.laws)

    @cached_property
    def layered(self) -> bool:
        """Whether wear goes through layers."""
        return any(isinstance(law, LayeredLaw) for law in self.laws)

    @cached_property
    def steady_sliding(self) -> bool:
        """Whether speed and friction never change, so that they are their own means."""
        return isinstance(self.omega, float) and not varies(self.friction)

    @cached_property
    def rates_last(self) -> bool:
        """Whether rates at the end of an implicit step are those at its last instant.

        That is where sliding is steady and no law reads the wear at the start of the step.
        """
        reads = any(law is not None and law.reads_wear for law in self.laws)
        return self.steady_sliding and not reads

    @cached_property
    def rates_stay(self) -> bool:
        """Whether the rates at a pressure are the same at all times and worn depths."""
        return self.steady_sliding and all(law is None or law.is_steady for law in self.laws)


def _per_energy(laws: Sequence[Any], frictions: Sequence[Quantity]) -> FloatArray | None:
    """Return the ratios of a body's laws, see ``HistoryInputs.per_energy``."""
    first = laws[0]
    if first is None:
        return None
    ratios = np.array([law.ratios(mu) for law, mu in zip(laws, frictions, strict=True)]).T
    if isinstance(first, LayeredLaw):
        return ratios
    return ratios[0] if ratios.any() else None


def of_faces(cases: Sequence[Case], number: Callable[[Case], Any]) -> list[Any]:
    """Return a number of each case that depends on its unworn faces alone.

    It is computed once for cases of equal faces. The cases are of one pair.
    """
    known: dict[Hashable, Any] = {}
    numbers = []
    for case in cases:
        key = (*((ring.r, ring.z, ring.face) for ring in case.rings), case.mesh.contact)
        if key not in known:
            known[key] = number(case)
        numbers.append(known[key])
    return numbers


def _stacked(loads: Sequence[Quantity | None]) -> Quantity | None:
    """Return the loads of B histories as one, None where none of them has this kind of load."""
    present = [load for load in loads if load is not None]
    if present and len(present) < len(loads):
        raise ValueError("histories under a force and at a displacement cannot be stacked")
    return stack(present) if present else None
