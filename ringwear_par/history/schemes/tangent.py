"""Tangent-linear histories: derivatives of everything that is stored with respect to numbers.

Differentiated is the computed history, at the step sizes that it has: every contact solution with
its corrections, by the factors of its last Newton step. On the elements in contact

    K p + m (gap + depth(p, q) - excess p_near - delta) = 0,    m.p = F,

so that (K + m D) p' = m (delta' - gap' - depth_q - K'p / m + (excess p_near)'), m.p' = F', and then
depth' = D p' + depth_q. Where elements pass a kink (contact, a threshold), derivatives are those of
one of its sides.

Derivatives with respect to P numbers are (P, ..., n) of fields, (P, ...) of a history's numbers,
and (2, P, ..., n) of fields of both bodies.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray, IntArray, columns, inner
from ringwear_par.contact.correction import CorrectedContacts
from ringwear_par.contact.problem import ContactState
from ringwear_par.history.derivatives.linearised import LinearisedIncrement, linearise
from ringwear_par.history.physics import Physics, Sliding
from ringwear_par.history.schemes.closing_elements import ClosingElements
from ringwear_par.history.state import State, Tangent
from ringwear_par.wear.increment import WearIncrement, total_of
from ringwear_par.wear.law import Law, WearLaw

# -- along one step --------------------------------------------------------------------------------


class StepTangent:
    """Derivatives along one step, stage by stage, as the scheme and its contacts report them.

    Parameters
    ----------
    physics : with its ``sensitivity``.
    contacts : of the histories.
    before : at the start of the step; None: there is no step, and nothing was worn.
    time : (B,) s, of the first contact, and at the end of the step.
    length : (B,) s, of the step, if there is one.
    closing : the elements that wear may bring into contact in it.
    """

    def __init__(
        self,
        physics: Physics,
        contacts: CorrectedContacts,
        before: Tangent | None,
        time: tuple[FloatArray, FloatArray],
        length: FloatArray | None = None,
        closing: ClosingElements | None = None,
    ) -> None:
        assert physics.sensitivity is not None
        self._physics, self._contacts = physics, contacts
        self._numbers, self._closing = physics.sensitivity, closing
        zeros = self._numbers.zeros
        self._time, self._end = time
        shape = physics.inputs.shape
        if before is None:
            before = Tangent(
                np.stack([zeros(*shape)] * 2), zeros(*shape[:-1]), zeros(*shape),
                zeros(*shape), *[zeros(*shape[:-1])] * 3,
            )  # fmt: skip
        self._before = before
        #: (P, ...) derivatives of the length of the step, over the length; None: 0
        self._stretch: FloatArray | None = None
        if self._numbers.moving_ends and length is not None:
            ends = np.zeros_like(before.time)
            ends[-1] = 1.0
            self._stretch = (ends - before.time) / length
        #: (P, ...) s, see ``Tangent``
        self._interface = zeros(*shape[:-1])
        #: (2, P, ..., n) mm, of the wear that a stage starts from
        self.wear = before.wear
        #: (P, ..., n) MPa and (P, ...) mm, of the last contact
        self.pressure, self.approach = before.pressure, before.approach
        #: of the pressures at which the next solution is corrected
        self._correction_pressure = before.pressure
        #: of the gap at given pressure
        self._gap = zeros(*shape)
        self._increment: WearIncrement | None = None
        self._linearised: LinearisedIncrement | None = None
        self._closing_gap: FloatArray | None = None
        if closing is not None:
            self._closing_gap = np.where(closing.gap > 0.0, before.gap, 0.0)
        #: (P, ..., n) s, of the steps of elements; None: 0
        self._step: FloatArray | None = None
        self._energy = before.energy
        #: (P, ..., n) MPa, of the pressure in the last part of the step
        self._last_pressure = before.pressure

    # -- contact -----------------------------------------------------------------------------------

    def solved(
        self, wear: WearIncrement | None, solution: ContactState, at: FloatArray,
        histories: IntArray,
    ) -> None:  # fmt: skip
        """Differentiate a contact solution, see ``contact.correction.Tangents``."""
        contacts, p = self._contacts, solution.pressure
        increment = self._increment = wear
        gap = self.wear[0] + self.wear[1]
        gap -= contacts.gap_of_excess(self._correction_pressure)
        self._numbers.add_gap(gap, p, at)
        slope: FloatArray | None = None
        if increment is not None:
            linearised = self._linearise(increment, p, self._d_step(increment), instant=False)
            worn, slope = linearised.in_contact_problem(p, self._closing_gap)
            gap += worn
            self._linearised = linearised
        load = self._numbers.load(self._physics.inputs.force, self._time)
        forced = self._physics.inputs.force is not None
        d_force, d_approach = (load, None) if forced else (None, load)
        solved = contacts.engine.derivatives.tangents(
            solution, gap, d_force, d_approach, slope, histories
        )
        if len(histories) == gap.shape[1]:
            self._gap, (self.pressure, self.approach) = gap, solved
        else:
            self._gap, self.pressure = self._gap.copy(), self.pressure.copy()
            self.approach = self.approach.copy()
            self._gap[:, histories] = gap[:, histories]
            self.pressure[:, histories], self.approach[:, histories] = solved
        self._correction_pressure = self.pressure

    def _d_step(self, increment: WearIncrement) -> FloatArray | None:
        """Return derivatives of the steps of elements, (P, ..., n) s; None: 0."""
        if self._stretch is None:
            return self._step
        d_step = increment.step * self._stretch[..., None]
        return d_step if self._step is None else d_step + self._step

    def _linearise(
        self, increment: WearIncrement, p: FloatArray, d_step: FloatArray | None, instant: bool
    ) -> LinearisedIncrement:
        """Return the linearisation of an increment."""
        return linearise(increment, p, self._numbers, self.wear, d_step, instant)

    def d_depth_if_always_in_contact(self) -> dict[int, FloatArray]:
        """Return derivatives of the last stage's depths in contact all along, (P, ..., n) mm."""
        return {} if self._linearised is None else self._linearised.depths(self.pressure)

    def _wear_off(self, d_depths: dict[int, FloatArray]) -> None:
        """Add to derivatives of the wear."""
        self.wear = self.wear.copy()
        for i, depths in d_depths.items():
            self.wear[i] += depths

    # -- stages, as schemes report them ------------------------------------------------------------

    def explicit(self, increment: WearIncrement, p: FloatArray) -> None:
        """Add the wear of an explicit step, at the pressure of its start."""
        linearised = self._linearise(increment, p, self._d_step(increment), instant=True)
        self._last_pressure = self._before.pressure
        self._wear_off(linearised.depths(self._before.pressure))

    def implicit(self) -> None:
        """Add the wear of an implicit step, which is its last stage."""
        self._last_pressure = self.pressure
        self._wear_off(self.d_depth_if_always_in_contact())

    def first_stage(self, p: FloatArray, weights: FloatArray | float, share: float) -> None:
        """Add the wear of the first stage of two.

        Parameters
        ----------
        p : (..., n) MPa, at the end of the first.
        weights : factors on the weight of the stage, (..., n) or 1.
        share : of its wear that the last stage starts from.
        """
        first = self._weighted = self.pressure
        d_weights: FloatArray | float = 0.0
        if self._closing is not None:
            d_weights = self._closing.d_stage_weights(p, first, 0.0, 0.0)
            self._weighted = weights * first + d_weights * p
        self._wear_off(self._d_depths(share * weights, share * d_weights))
        self._correction_pressure = self._first = first
        self._time = self._end

    def lengthen(self, last: WearIncrement, p: FloatArray, step: FloatArray) -> None:
        """Set the steps of elements for a second try of the last stage, after one that gave ``p``.

        Parameters
        ----------
        step : s, of the stage, without the factors on its weight.
        """
        assert self._closing is not None
        factor = last.step / columns(step)
        share, d_share = self._share_after_closing(last, p)
        weights, d_closing = factor * share, factor * d_share
        d_weights = self._closing.d_stage_weights(p, self.pressure, weights, d_closing)
        self._step = np.where(self._closing.mask, 0.0, columns(step) * d_weights)
        self._correction_pressure = self._first

    def last_stage(self, last: WearIncrement, p: FloatArray, step: FloatArray) -> None:
        """Add the wear of the last stage of two, see ``first_stage`` and ``lengthen``."""
        self._last_pressure = self._weighted_last = self.pressure
        share: FloatArray | float = 1.0
        d_share: FloatArray | float = 0.0
        if self._closing is not None:
            share, d_share = self._share_after_closing(last, p)
            weights = last.step / columns(step)
            d_weights = weights * d_share
            if self._step is not None:
                d_weights = d_weights + share * self._step / columns(step)
            self._weighted_last = weights * share * self.pressure + d_weights * p
        self._wear_off(self._d_depths(share, d_share))

    def _share_after_closing(
        self, last: WearIncrement, p: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return ``WearIncrement.share`` at a solution, (..., n), and its derivatives."""
        assert self._linearised is not None
        depth = last.depth_if_always_in_contact(p)
        d_depth = total_of(list(self.d_depth_if_always_in_contact().values()))
        return last.share(depth), last.d_share(depth[0] + depth[1], d_depth, self._closing_gap)

    def _d_depths(self, share: Any, d_share: Any) -> dict[int, FloatArray]:
        """Return derivatives of the depths of the last stage in a share of its step."""
        if self._linearised is None:
            return {}
        return self._linearised.depths(self.pressure, share, d_share)

    def _ends(self, laws: Sequence[WearLaw | Law | None]) -> FloatArray:
        """Return derivatives of the ends of layers, (2, P, ..., n) mm, from the next laws."""
        ends = np.zeros_like(self.wear)
        for i, law in enumerate(laws):
            if isinstance(law, Law):
                ends[i] += self._numbers.layer_starts(i, law)
        return ends

    def end_at_interface(
        self, tangent: Tangent | None, laws: Sequence[WearLaw | Law | None], left: FloatArray
    ) -> Tangent:
        """Return the derivatives at the end of a step with those of an end at an interface.

        Parameters
        ----------
        laws : of lower and upper, of the next layers.
        left : (2, ..., n) s, until elements are at the ends of their layers.
        """
        assert tangent is not None
        self._interface = _moved_ends(left, self._ends(laws) - self.wear)
        return replace(tangent, interface=self._interface)

    def cross(
        self,
        crossing: BoolArray,
        second: tuple[WearIncrement, WearIncrement],
        p: FloatArray,
        time_beyond: FloatArray,
        rate_ratio_below: FloatArray,
    ) -> None:
        """Replace the depths beyond the ends of layers by those of the next layers.

        Parameters
        ----------
        crossing : (2, ..., n), which elements come to their next layer.
        second : wear of 1 s in the layers before and in the next ones.
        p : (..., n) MPa, of the last part of the step.
        time_beyond : (2, ..., n) s, that they have been beyond the end.
        rate_ratio_below : (2, ..., n), rates in the next layer over those before it.
        """
        ends = self._ends(second[1].laws)
        reached = np.where(crossing[:, None], ends, self.wear)
        d_p = self._last_pressure
        d_before, d_below = (
            linearise(increment, p, self._numbers, d_wear, None, instant=True).depths(d_p)
            for increment, d_wear in zip(second, (self.wear, reached), strict=True)
        )
        self.wear = self.wear.copy()
        for i in d_before:
            beyond = rate_ratio_below[i] * (self.wear[i] - ends[i])
            d_rates = d_below[i] - rate_ratio_below[i] * d_before[i]
            depth = beyond + time_beyond[i] * d_rates
            self.wear[i] = np.where(crossing[i], ends[i] + depth, self.wear[i])

    def work(self, duration: FloatArray, sliding: Sliding, p: FloatArray, d_p: FloatArray) -> None:
        """Add the energy that sliding dissipates in a duration, s, at a pressure."""
        omega, torque = sliding.omega, self._physics.torque(p, sliding)
        power = omega * d_torque(self._physics, sliding, p, d_p)
        if self._numbers.omega is not None:
            power[self._numbers.omega] += self._numbers.d_omega(omega) * torque
        if self._stretch is not None:
            power += self._stretch * (omega * torque)
        self._energy = self._energy + duration * power

    @property
    def weighted(self) -> tuple[FloatArray, FloatArray]:
        """Derivatives of the pressures of both stages, (P, ..., n), times the stages' factors."""
        return self._weighted, self._weighted_last

    def reached(self, contact: ContactState) -> Tangent:
        """Return the derivatives of the state at the end, whose contact is the last one."""
        return Tangent(
            self.wear, self._energy, self.pressure, self._d_gap(contact), self.approach,
            np.zeros_like(self._interface), self._interface,
        )  # fmt: skip

    def _d_gap(self, contact: ContactState) -> FloatArray:
        """Return derivatives of the gap: 0 in contact."""
        open_ = contact.pressure <= 0.0
        if not open_.any():
            return np.zeros_like(self._gap)
        gap = self._gap + self._contacts.engine.derivatives.deflections(self.pressure)
        if self._increment is not None and not self._increment.local:
            assert self._linearised is not None
            gap += sum(self.d_depth_if_always_in_contact().values()) - self._linearised.depth
        return np.where(open_, gap - self.approach[..., None], 0.0)


def tangent_of_step(
    physics: Physics,
    contacts: CorrectedContacts,
    state: State,
    end: FloatArray,
    first: FloatArray | None = None,
    closing: ClosingElements | None = None,
) -> StepTangent | None:
    """Return the derivatives along a step from a state to a time; None where there are none.

    Parameters
    ----------
    first : (B,) s, of its first contact; None: its end.
    """
    if physics.sensitivity is None:
        return None
    times = end if first is None else first, end
    return StepTangent(physics, contacts, state.tangent, times, end - state.time, closing)


def _moved_ends(left: FloatArray, d_left: FloatArray) -> FloatArray:
    """Return derivatives of the end of a step, (P, B) s, that keep an element where it is.

    That is the nearest one to the end of its layer.

    Parameters
    ----------
    left : (2, B, n) s, until elements are at the ends of their layers; infinite where never.
    d_left : (2, P, B, n) mm, of what is left of layers; the last row is with respect to the end of
        the step.
    """
    _, count, n = left.shape
    first, histories = left.transpose(1, 0, 2).reshape(count, -1).argmin(axis=1), np.arange(count)
    body, e = first // n, first % n
    d_first = d_left[body, :, histories, e].T
    moves = np.isfinite(left[body, histories, e]) & (d_first[-1] < 0.0)
    moved = np.divide(-d_first, d_first[-1], out=np.zeros_like(d_first), where=moves)
    moved[-1] = 0.0
    return moved


# -- variables of results --------------------------------------------------------------------------


def variables(physics: Physics, state: State) -> dict[str, Any]:
    """Return derivatives of the variables of a state by name, (P, ...) each. Not collective.

    All but that of ``penetration``, which depends on the first state, too.
    """
    tangent, numbers = state.tangent, physics.sensitivity
    if tangent is None or numbers is None:
        return {}
    p, d_p = state.contact.pressure, tangent.pressure
    volumes, sliding = physics.integrals(tangent.wear), physics.sliding(state.time)
    values = {
        "d_approach": tangent.approach,
        "d_force": numbers.load(physics.inputs.force, state.time)
        if physics.inputs.force is not None
        else np.asarray(inner(physics.area, d_p)),
        "d_torque": d_torque(physics, sliding, p, d_p),
        "d_twist": d_twist(physics, sliding, p, d_p),
        "d_worn_volume_lower": volumes[0],
        "d_worn_volume_upper": volumes[1],
        "d_dissipated_energy": tangent.energy,
        "d_pressure": d_p,
        "d_gap": tangent.gap,
        "d_wear_lower": tangent.wear[0],
        "d_wear_upper": tangent.wear[1],
    }
    return {name: value[: len(numbers.keys)] for name, value in values.items()}


def d_torque(physics: Physics, sliding: Sliding, p: FloatArray, d_p: FloatArray) -> FloatArray:
    """Return derivatives of the friction torque, (P, B) N mm, from those of pressures."""
    numbers = physics.sensitivity
    assert numbers is not None
    change = np.asarray(physics.torque(d_p, sliding))
    if numbers.friction is not None:
        change[numbers.friction] += numbers.d_friction(sliding.friction) * physics.moment(p)
    return change


def d_twist(physics: Physics, sliding: Sliding, p: FloatArray, d_p: FloatArray) -> FloatArray:
    """Return derivatives of the twist, (P, B) mm, from those of pressures."""
    numbers = physics.sensitivity
    assert numbers is not None
    change = np.asarray(physics.twist(d_p, sliding))
    if numbers.friction is not None:
        d_friction = numbers.d_friction(sliding.friction)
        change[numbers.friction] += d_friction * inner(physics.compliances.twist, p)
    for row, elastic in numbers.elastic:
        change[row] += sliding.friction * inner(elastic.twist[elastic.which], p)
    return change
