"""The physics of one contact line: loads and gaps (3), rates of wear (4), wear of a step.

Pure functions: they pose the contact problems, which ``contact.correction`` solves. Nothing here
depends on schemes, step control, files or observers.

There are B >= 1 histories on the line: fields are (B, n), numbers of histories (B,). Loads, laws
and gaps are ``inputs``, moduli ``compliances``; elements that follow the wear are the matter of
``moving_geometry``; states for which the physics does not hold are refused by
``refusals.states``.
"""

import itertools
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple, Self

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray, columns, inner
from ringwear_par.cases.case import Case
from ringwear_par.contact.correction import CorrectedContacts
from ringwear_par.contact.problem import ContactInputs
from ringwear_par.elasticity.bem.body import BodyCost
from ringwear_par.elasticity.bem.pair import ContactPair
from ringwear_par.elasticity.mesh import ContactLine
from ringwear_par.history.elastic.compliances import Compliances
from ringwear_par.history.inputs import HistoryInputs
from ringwear_par.schedules import in_time, integral, mean
from ringwear_par.wear.increment import Closing, WearIncrement
from ringwear_par.wear.laws.non_local import averaged_rate, averaging
from ringwear_par.wear.layered import LayeredLaw, worn_through
from ringwear_par.wear.local_state import LocalState


class Sliding(NamedTuple):
    """Speed and friction of B histories at an instant, or their means over a step."""

    #: (B,) rad/s
    omega: FloatArray
    #: (B,) coefficient
    friction: FloatArray


@dataclass(frozen=True)
class Physics:
    """Contact and wear of B cases whose contact elements are the same."""

    #: loads, laws and gaps of the cases
    inputs: HistoryInputs
    #: contact pair of each history, before any wear
    pairs: tuple[ContactPair, ...]
    #: compliances of the contact lines of the histories
    compliances: Compliances
    #: (layers, B, n) mm, along the axis, depths at which the layers of lower and upper end; None
    #: for a body without
    layer_ends: tuple[FloatArray | None, ...]
    #: (n, n) of the pressures, and of the rates, of non-local laws of lower and upper
    averages: tuple[FloatArray | None, ...] = (None, None)
    #: (B, n) mm, by which gaps are smaller than those of the worn profiles, see ``State``
    gap_offset: FloatArray | None = None
    #: how often elements were assembled anew to follow the wear, and the time and memory of it
    updates: int = 0
    update_cost: BodyCost = field(default_factory=BodyCost)
    #: whether other simulations use the pair, too
    pair_is_shared: bool = False
    #: the last increment, where rates stay: it is that of all steps or stages of the same length
    _last: list[WearIncrement] = field(default_factory=list, init=False, repr=False, compare=False)
    #: (2, B, n) layers that elements stay in, and mm along the axis, where these end: infinite of
    #: bodies themselves; None: elements are in the layers that are at the face
    layers: IntArray | None = field(default=None, init=False, repr=False, compare=False)
    ends: FloatArray | None = field(default=None, init=False, repr=False, compare=False)
    #: of elements that stay in the layers that were asked for last
    _of_layers: list[Any] = field(default_factory=list, init=False, repr=False, compare=False)

    @classmethod
    def of(
        cls,
        cases: Sequence[Case],
        pairs: ContactPair | Sequence[ContactPair],
    ) -> Self:
        """Return the physics of cases before any wear. Not collective.

        Parameters
        ----------
        cases : of one shape and mesh, with laws of the same kinds; one alone if its elements follow
            the wear.
        pairs : contact pair of the cases, or one of each.

        Raises
        ------
        ValueError : the cases cannot be stacked.
        """
        inputs = HistoryInputs.of(cases)
        pairs = (pairs,) * len(cases) if isinstance(pairs, ContactPair) else tuple(pairs)
        ends = tuple(_layer_ends(cases, body) for body in range(2))
        physics = cls(
            inputs,
            pairs,
            Compliances.of(pairs, cases),
            ends,
        )
        return physics._along_slopes()

    def with_compliances(self, compliances: Compliances, cost: BodyCost) -> Self:
        """Return the physics of elements that have followed the wear, at a further cost."""
        return replace(
            self, compliances=compliances, update_cost=self.update_cost + cost
        )._along_slopes()

    def _along_slopes(self) -> Self:
        """Return the physics with averages and layers along the slopes of its compliances."""
        inputs, true_area = self.inputs, self.area * self.compliances.every[0].obliquity
        if inputs.layered:
            ends = [None if e is None else self._along_normal(e) for e in self.layer_ends]
            inputs = inputs.with_laws(lambda i, law: law.at(ends[i]))
        averages = tuple(
            averaging(self.line.r, true_area, law.length)
            if law is not None and law.length
            else None
            for law in inputs.laws
        )
        return replace(self, inputs=inputs, averages=averages)

    @property
    def case(self) -> Case:
        """The first case."""
        return self.inputs.cases[0]

    @property
    def line(self) -> ContactLine:
        """The contact elements before any wear."""
        return self.pairs[0].line

    @cached_property
    def area(self) -> FloatArray:
        """(n,) mm^2, of the contact elements, normal to the axis."""
        return self.line.area.copy()  # loops refuse what cannot be written to

    @cached_property
    def obliquity(self) -> FloatArray | None:
        """(n,) 1 / cos alpha of sloping faces, None where all are flat."""
        first = self.compliances.every[0]
        return first.obliquity if first.slope.any() else None

    def area_in_contact(self, p: FloatArray) -> FloatArray:
        """Return the area of elements with pressure, mm^2, (B,), at (B, n)."""
        return np.asarray(inner(self.area, (p > 0.0).astype(float)))

    @cached_property
    def least_area(self) -> float:
        """mm^2, of the smallest contact element, normal to the axis."""
        return float(self.area.min())

    @cached_property
    def torque_arm(self) -> FloatArray:
        """(n,) mm^3, torque per unit shear."""
        return self.area * self.compliances.every[0].obliquity * self.line.arm

    # -- contact, eq. (3) --------------------------------------------------------------------------

    def contact_inputs(
        self, time: FloatArray, wear: FloatArray, increment: WearIncrement | None = None
    ) -> ContactInputs:
        """Return gaps and loads at a time, and the wear of the step that ends then.

        Parameters
        ----------
        time : (B,) float, s.
        wear : (2, B, n) float, mm, by which the profiles are worn.
        increment : wear of an implicit step, which is part of the contact problem.
        """
        gap = self.inputs.initial_gap
        for worn, law in zip(wear, self.inputs.laws, strict=True):
            if law is not None:
                gap = gap + worn
        if self.gap_offset is not None:
            gap = gap - self.gap_offset
        force, displacement = self.inputs.force, self.inputs.displacement
        return ContactInputs(
            gap,
            None if force is None else in_time(force, time),
            None if displacement is None else in_time(displacement, time),
            increment if self.inputs.wears else None,
        )

    def contacts(self) -> CorrectedContacts:
        """Return the contacts of the histories, to be closed. Not collective."""
        return self.compliances.contacts()

    @property
    def slight_pressure(self) -> FloatArray:
        """About what an approach as small as the tolerance of wear presses, MPa, (B,)."""
        return self.inputs.tolerance * self.compliances.stiffness

    def own_displacement(self, p: FloatArray) -> FloatArray:
        """Return the displacements (B, n) mm of elements under their own pressures alone, MPa."""
        return self.compliances.diagonal * p

    # -- wear, eq. (4) -----------------------------------------------------------------------------

    def sliding(self, time: FloatArray) -> Sliding:
        """Return speed and friction of the histories at times (B,) s."""
        return self._at_all_times or self._sliding(time)

    def _sliding(self, time: FloatArray) -> Sliding:
        inputs = self.inputs
        return Sliding(in_time(inputs.omega, time), in_time(inputs.friction, time))

    @cached_property
    def _at_all_times(self) -> Sliding | None:
        """Speed and friction of the histories, where they never change."""
        inputs = self.inputs
        return self._sliding(np.zeros(len(inputs.cases))) if inputs.steady_sliding else None

    def mean_sliding(self, start: FloatArray, end: FloatArray) -> Sliding:
        """Return the means of speed and friction over steps."""
        inputs = self.inputs
        return self._at_all_times or Sliding(
            mean(inputs.omega, start, end), mean(inputs.friction, start, end)
        )

    def local_state(self, time: FloatArray, sliding: Sliding, wear: FloatArray) -> LocalState:
        """Return the local state of a body whose wear is (B, n) mm.

        Depths of laws are along the normal; all others in this module are along the axis.
        """
        angle, arm = integral(self.inputs.omega, 0.0, time), self.line.arm
        if self.obliquity is not None:
            wear = wear / self.obliquity
        steady = self._steady
        speed = columns(sliding.omega) * arm if steady is None else steady[0]
        local = LocalState(time, self.line.r, speed, sliding.friction, wear, columns(angle) * arm)
        if steady is not None:
            local.__dict__["power"] = steady[1]
        return local

    @cached_property
    def _steady(self) -> tuple[FloatArray, FloatArray] | None:
        """(B, n) speeds, mm/s, and friction coefficient times these, where they never change."""
        sliding = self._at_all_times
        if sliding is None:
            return None
        speed = columns(sliding.omega) * self.line.arm
        return speed, columns(sliding.friction) * speed

    @property
    def _rates_stay(self) -> bool:
        """Whether an increment serves all steps."""
        return self.inputs.rates_stay

    def increment(
        self,
        time: FloatArray,
        sliding: Sliding,
        wear: FloatArray,
        step: FloatArray,
        closing: Closing | None = None,
    ) -> WearIncrement:
        """Return the wear of an implicit step that ends at a time, from wear (2, B, n) mm on.

        ``closing`` is of elements that come into contact in it.
        """
        if not self._rates_stay:
            return self._increment(time, sliding, wear, step, closing)
        if not self._last:
            self._last[:] = [self._increment(time, sliding, wear, step, None)]
        last = self._last[0]
        if closing is not None:
            return last.with_step(step, closing)
        if last.duration is not step and not np.array_equal(last.duration, step):
            last = self._last[0] = last.with_step(step)
        return last

    def _increment(
        self,
        time: FloatArray,
        sliding: Sliding,
        wear: FloatArray,
        step: FloatArray,
        closing: Closing | None,
    ) -> WearIncrement:
        at, pace = self._local_states(time, sliding, wear), self.inputs.pace
        return WearIncrement(
            self.inputs.laws, at, step, self.averages, self.obliquity, closing, pace
        )

    def _local_states(
        self, time: FloatArray, sliding: Sliding, wear: FloatArray
    ) -> tuple[LocalState, LocalState]:
        """Return the local states of lower and upper."""
        lower, upper = self.local_state(time, sliding, wear[0]), self.inputs.laws[1]
        return lower, lower if upper is None else self.local_state(time, sliding, wear[1])

    def rates(
        self, time: FloatArray, sliding: Sliding, wear: FloatArray, p: FloatArray
    ) -> FloatArray:
        """Return the rates of wear of lower and upper, (2, B, n) mm/s, at pressure and wear."""
        if self._rates_stay:
            known = self._last or [self.increment(time, sliding, wear, np.ones(len(p)))]
            return known[0].rates(p)
        rates, at = np.zeros((2, *p.shape)), self._local_states(time, sliding, wear)
        for rate, law, local, average in zip(
            rates, self.inputs.laws, at, self.averages, strict=True
        ):
            if law is not None:
                rate[:] = averaged_rate(law, local, average, p)
        if self.obliquity is not None:
            rates *= self.obliquity
        if self.inputs.pace is not None:
            rates *= self.inputs.pace[..., None]
        return rates

    def rates_at(self, time: FloatArray, wear: FloatArray, p: FloatArray) -> FloatArray:
        """Return the rates of wear, (2, B, n) mm/s, at the speed and friction of an instant."""
        return self.rates(time, self.sliding(time), wear, p)

    # -- integrals over the contact ----------------------------------------------------------------

    def integrals(self, field: FloatArray) -> FloatArray:
        """Return area integrals of a field of both bodies, (2, ..., n) to (2, ...)."""
        return np.asarray(inner(self.area, field))

    def moment(self, p: FloatArray) -> FloatArray:
        """Return the friction torque over mu in full slip, N mm, (B,), at (B, n)."""
        return inner(self.torque_arm, p)

    def torque(self, p: FloatArray, sliding: Sliding | None = None) -> FloatArray:
        """Return the friction torque in full slip, N mm, (B,), at pressure (B, n).

        Parameters
        ----------
        sliding : None: as at the start.
        """
        at = self.sliding(np.zeros(len(self.inputs.cases))) if sliding is None else sliding
        return at.friction * self.moment(p)

    def twist(self, p: FloatArray, sliding: Sliding) -> FloatArray:
        """Return the area mean of the circumferential displacement jump, mm, at pressure."""
        return sliding.friction * inner(self.compliances.twist, p)

    def reactions(self, p: FloatArray) -> FloatArray:
        """Return friction torque / mu, axial force and torque / mu on both fixed faces, (5, B).

        At pressure (B, n); N mm and N.
        """
        return np.array([inner(weights, p) for weights in self._carried])

    @cached_property
    def _carried(self) -> tuple[FloatArray, ...]:
        """What ``reactions`` are the integrals of, (n,) or (B, n), per pressure."""
        return self.torque_arm, *self.compliances.reactions.swapaxes(0, 1)

    # -- layers ------------------------------------------------------------------------------------

    def _along_normal(self, depth: FloatArray) -> FloatArray:
        """Return depths along the normal, which laws speak of, from those along the axis."""
        return depth if self.obliquity is None else depth / self.obliquity

    def layers_at(self, wear: FloatArray) -> IntArray:
        """Return the layers of lower and upper at the face, (2, B, n), worn by (2, B, n) mm.

        0 is the first; all of a body that has none.
        """
        layers = np.zeros(wear.shape, dtype=np.int64)
        for i, law in enumerate(self.inputs.laws):
            if isinstance(law, LayeredLaw):
                layers[i] = law.layers_at(self._along_normal(wear[i]))
        return layers

    def in_present_layers(self, wear: FloatArray) -> Self:
        """Return the physics of elements that stay in the layers at the face, at (2, B, n) mm."""
        return self.in_layers(self.layers_at(wear)) if self.inputs.layered else self

    def in_layers(self, layers: IntArray) -> Self:
        """Return the physics of elements that stay in these layers, (2, B, n)."""
        known = self._of_layers
        physics = next((k for k in known if np.array_equal(k.layers, layers)), None)
        if physics is None:
            physics = self._copied_in_layers(layers)
        # a step asks for the layers at its start, the next ones below, and those at its end
        known[:] = [physics, *(other for other in known if other is not physics)][:3]
        return physics

    def _copied_in_layers(self, layers: IntArray) -> Self:
        ends = np.full(layers.shape, np.inf)
        for i, law in enumerate(self.inputs.laws):
            if isinstance(law, LayeredLaw):
                end = law.end_of(layers[i])
                ends[i] = end if self.obliquity is None else end * self.obliquity
        inputs = self.inputs.with_laws(lambda i, law: law.in_layers(layers[i]))
        physics = copy(self)  # with all that it has computed, as none of it depends on layers
        physics.__dict__.update(inputs=inputs, layers=layers, ends=ends, _last=[], _of_layers=[])
        return physics

    def layer_left(self, body: int, wear: FloatArray) -> FloatArray:
        """Return the thickness left of all layers of a body, (..., n) mm, worn by (..., n) mm."""
        ends = self.layer_ends[body]
        assert ends is not None
        return np.where(worn_through(ends[-1], wear), 0.0, ends[-1] - wear)

    def layer_volumes(self, body: int, wear: FloatArray) -> FloatArray:
        """Return the worn volumes of each layer and the body itself, (..., layers + 1) mm3."""
        ends = self.layer_ends[body]
        assert ends is not None
        bounds = [np.zeros_like(ends[0]), *ends, np.full_like(ends[0], np.inf)]
        volumes = [
            np.asarray(inner(self.area, np.clip(wear, start, end) - start))
            for start, end in itertools.pairwise(bounds)
        ]
        return np.stack(volumes, axis=-1)

    # -- some of the histories ---------------------------------------------------------------------

    def at_pace(self, pace: FloatArray) -> Self:
        """Return the physics of a step in which rates are multiplied, by (2, B)."""
        # worn volume is no constant times energy where wear is random
        inputs = replace(self.inputs, pace=pace, per_energy=(None, None))
        return replace(self, inputs=inputs)

    def take(self, histories: IntArray) -> Self:
        """Return the physics of some of the histories."""
        offset = self.gap_offset
        return replace(
            self,
            inputs=self.inputs.take(histories),
            pairs=tuple(map(self.pairs.__getitem__, histories.tolist())),
            compliances=self.compliances.take(histories),
            layer_ends=tuple(
                None if ends is None else ends[:, histories] for ends in self.layer_ends
            ),
            gap_offset=None if offset is None else offset[histories],
        )


def _layer_ends(cases: Sequence[Case], body: int) -> FloatArray | None:
    """Return the depths at which layers of a body end, (layers, B, n) mm; None for no layers."""
    known: dict[tuple[float, ...], FloatArray] = {}  # of one face
    ends = []
    for case in cases:
        thicknesses = tuple(layer.thickness for layer in case.rings[body].layers)
        if thicknesses not in known:
            known[thicknesses] = case.layer_ends(body)
        ends.append(known[thicknesses])
    return np.stack(ends, axis=1) if len(ends[0]) else None
