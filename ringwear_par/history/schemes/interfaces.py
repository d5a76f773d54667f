"""Interfaces of layers: steps end where the first element reaches one.

Each element stays in its layer throughout a step, so that rates do not jump within it. A try that
goes too far beyond an interface is repeated: it ends where the quadratic through the wear of this
one says that the first element gets there. Where it goes beyond by less, what it has lost there is
worn off the next layer instead, in the time that it took and at the pressure of the last part of
the step, which keeps the balance of energy; contacts are solved once more with that wear. So
several elements may cross at once.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np

from ringwear_par import batched
from ringwear_par.arrays import BoolArray, FloatArray, IntArray, columns
from ringwear_par.contact.correction import CorrectedContacts
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.history.physics import Physics, Sliding
from ringwear_par.history.schemes.step import Step
from ringwear_par.history.schemes.tangent import StepTangent
from ringwear_par.history.state import State
from ringwear_par.wear.increment import WearIncrement
from ringwear_par.wear.layered import worn_through

#: depth by which a step may be corrected where an element crosses, in ``time.tolerance``, the same
#: with fixed steps and adaptive ones; and the share of it that steps aim at. Of 24 random coatings
#: of 3 um the worst and the median error were the same with 0.02, 0.1, 0.3 and 1; a history took
#: 213, 201, 185 and 161 tries. Derivatives of fixed steps to ends that move are off by 1e-5 with
#: 0.02, by 5e-3 (of torques) with 0.1 and more
_ALLOWED, _AIM = 0.02, 0.5
#: by how many times an error of depth counts more at most: near the threshold of a layer there is
#: no bound. Of 24 random coatings of 3 um, bodies wearing up to 2000 times as fast, the worst was
#: off by 0.012 um with 3000, by 0.089 with 300 and by 1.2 without
_MOST_GROWTH = 3000.0
#: least rate at the end of a step, in that of all of it
_LEAST_RATE = 0.01
#: share of a depth below which a change of it is none
_ROUND_OFF = 1e-14


def end_at_interfaces(
    contacts: CorrectedContacts,
    before: State,
    step: Step,
    passage: "Passage | None",
    step_tangent: StepTangent | None,
) -> Step:
    """Return a step with its elements in the layers that they have come to.

    Or, of histories where an element has gone too far beyond its layer, when it got there.

    Parameters
    ----------
    passage : of the elements in the step; None without layers.
    step_tangent : derivatives along it.
    """
    if passage is None:
        return step
    after, length = step.state, columns(step.state.time - before.time)
    too_far, left, aim = passage.too_far, passage.ends - before.wear, passage.aim
    reached = np.full(too_far.shape, np.inf)
    if too_far.any():
        shares = _shares(left + aim, before.rates * length, after.wear - before.wear)
        shares = np.where(passage.crossing, shares, np.inf)
        reached = before.time + (after.time - before.time) * _first(shares)
    rise = (after.rates - before.rates) / length
    crossing = passage.crossing & ~too_far[:, None]
    left = passage.ends - after.wear
    if step_tangent is not None:
        laws = passage.following.inputs.laws
        tangent = step_tangent.end_at_interface(after.tangent, laws, passage.time_left)
        after = replace(after, tangent=tangent)
    if crossing.any():
        after = _in_next_layers(contacts, before, after, passage, crossing, step_tangent)
        left = np.where(crossing, passage.next_ends - after.wear, left)
        rise[crossing], aim[crossing] = 0.0, 0.0
    expected = after.time + _first(_times(left + aim, after.rates, rise))
    return replace(
        step, state=after, too_far=too_far, interface=np.where(too_far, reached, expected)
    )


def next_to_cross(physics: Physics, state: State) -> str:
    """Return which element of a single history is to come to the end of its layer first."""
    layers = physics.layers_at(state.wear)
    left = physics.ends_of(layers) - state.wear
    times = _times(left, state.rates, np.zeros_like(left))[:, 0]
    body, e = (int(place) for place in np.unravel_index(times.argmin(), times.shape))
    return (
        f"{BODIES[body]}.layers[{layers[body, 0, e]}], element {e} (r = {physics.line.r[e]:.6g} mm)"
    )


@dataclass(frozen=True)
class Passage:
    """How elements come to the ends of their layers in a step, (2, B, n) of lower and upper."""

    #: with the laws of the layers that elements are in, and with those of the layers below, where
    #: there are any
    physics: Physics
    following: Physics
    #: int, that elements are in
    layers: IntArray
    #: mm, of these, infinite of bodies themselves
    ends: FloatArray
    #: mm, at the end of the step
    wear: FloatArray
    #: which elements get to the end of their layer
    crossing: BoolArray
    #: (B,) s, at which rates are those of the last part of the step
    time: FloatArray
    sliding: Sliding
    #: (B, n) MPa, of the last part
    pressure: FloatArray
    #: mm/s, rates in the step, in its last part, and those of the next layers
    mean: FloatArray
    here: FloatArray
    below: FloatArray

    @classmethod
    def of(
        cls,
        physics: Physics,
        before: State,
        after: State,
        time: FloatArray,
        sliding: Sliding,
        pressure: FloatArray,
    ) -> Self | None:
        """Return the passage of elements in a step, whose physics is that of its layers.

        None where bodies have none.
        """
        if not physics.inputs.layered:
            return None
        layers, wear = physics.layers_at(before.wear), after.wear
        ends = physics.ends_of(layers)
        inside = np.isfinite(ends)
        following = physics.in_layers(layers + inside)
        crossing = inside & worn_through(ends, wear)
        mean = (wear - before.wear) / columns(after.time - before.time)
        here = physics.rates(time, sliding, wear, pressure)
        below = following.rates(time, sliding, np.where(crossing, ends, wear), pressure)
        return cls(
            physics, following, layers, ends, wear, crossing, time, sliding, pressure, mean, here,
            below,
        )  # fmt: skip

    @cached_property
    def reached(self) -> FloatArray:
        """Depths of elements when they came to the ends of their layers, mm; else at the end."""
        return np.where(self.crossing, self.ends, self.wear)

    @property
    def next_ends(self) -> FloatArray:
        """Depths at which the next layers of those that cross end, mm."""
        return self.physics.ends_of(self.layers + self.crossing)

    @cached_property
    def beyond(self) -> FloatArray:
        """How far elements are beyond the ends of their layers, mm; 0 where they are not."""
        return np.where(self.crossing, np.maximum(self.wear - self.ends, 0.0), 0.0)

    @cached_property
    def rate(self) -> FloatArray:
        """Rates at which elements went beyond, mm/s; 0 where these are not known.

        Those of the last part, unless pressure has fallen below the threshold of the layer by then.
        """
        return np.maximum(self.here, np.where(self.below > 0.0, _LEAST_RATE * self.mean, 0.0))

    @cached_property
    def since(self) -> FloatArray:
        """For how long elements have been beyond, s."""
        rate, beyond = self.rate, self.beyond
        return np.divide(beyond, rate, out=np.where(beyond > 0.0, np.inf, 0.0), where=rate > 0.0)

    @property
    def time_left(self) -> FloatArray:
        """When elements get to the ends of their layers at these rates, s from the end on."""
        rate, never = self.rate, np.full_like(self.ends, np.inf)
        return np.divide(self.ends - self.wear, rate, out=never, where=rate > 0.0)

    @cached_property
    def depth(self) -> FloatArray:
        """Depths that elements lose of their next layer in this time, mm."""
        return np.where(self.below > 0.0, self.since, 0.0) * self.below

    @cached_property
    def rate_ratio_below(self) -> FloatArray:
        """Rates of the next layers over those of these; infinite where these do not wear."""
        rate = self.rate
        return np.divide(self.below, rate, out=np.full_like(rate, np.inf), where=rate > 0.0)

    @property
    def allowed(self) -> FloatArray:
        """Largest correction of depths, (B, 1) mm."""
        return columns(_ALLOWED * self.physics.inputs.tolerance)

    @property
    def too_far(self) -> BoolArray:
        """In which histories, (B,), an element goes on in its layer for too long."""
        wrong = (np.abs(self.depth - self.beyond) > self.allowed) | np.isinf(self.since)
        return (self.crossing & wrong).any(axis=(0, 2))

    @property
    def aim(self) -> FloatArray:
        """How far beyond the ends of layers steps are to go, mm.

        Infinitely far where the next one wears as this one does.
        """
        with np.errstate(divide="ignore"):
            return _AIM * self.allowed / np.abs(self.rate_ratio_below - 1.0)

    @property
    def growth(self) -> FloatArray:
        """By how many times errors of depth are more in the next layer, (B, n)."""
        return _growth(self.here, self.below)

    def growth_at(self, usual: FloatArray) -> FloatArray:
        """Return ``growth``, or what it is at usual pressures, (B, 1) MPa, if that is more.

        To which pressures may have fallen when the layer is through: near a threshold of the layer
        hardly anything is worn off it.
        """
        low, at = np.minimum(self.pressure, usual), (self.time, self.sliding)
        here = self.physics.rates(*at, self.wear, low)
        return np.maximum(self.growth, _growth(here, self.following.rates(*at, self.reached, low)))

    def unit_increments(self) -> tuple[WearIncrement, WearIncrement]:
        """Return the wear of 1 s of the last part, in these layers and in the next ones."""
        at, second = (self.time, self.sliding), np.ones_like(self.time)
        return (
            self.physics.increment(*at, self.wear, second),
            self.following.increment(*at, self.reached, second),
        )


def _growth(here: FloatArray, below: FloatArray) -> FloatArray:
    """Return by how many times errors of depth are more at other rates, from 1 on, (B, n).

    The next layer then begins to wear too early or too late.
    """
    most = np.where(below > 0.0, _MOST_GROWTH, 1.0)
    ratio = np.divide(below, here, out=most, where=here * _MOST_GROWTH > below)
    return np.maximum(ratio, 1.0).max(axis=0)


def _in_next_layers(
    contacts: CorrectedContacts,
    before: State,
    after: State,
    passage: Passage,
    crossing: BoolArray,
    step_tangent: StepTangent | None,
) -> State:
    """Return the state with what is beyond the ends of layers worn off the next ones."""
    physics, time, contact = passage.physics, after.time, after.contact
    wear = np.where(crossing, passage.ends + passage.depth, after.wear)
    crosses = crossing.any(axis=(0, 2))
    still = ~(crossing & (np.abs(wear - after.wear) > _ROUND_OFF * wear)).any(axis=(0, 2))
    if step_tangent is not None:
        since, rate_ratio_below = (
            np.where(crossing, v, 0.0) for v in (passage.since, passage.rate_ratio_below)
        )
        step_tangent.cross(
            crossing, passage.unit_increments(), passage.pressure, since, rate_ratio_below
        )
    if not still.all():
        inputs = physics.contact_inputs(time, wear)
        solved = contacts.solve(
            inputs, contact.pressure, already_solved=(still, contact), tangents=step_tangent
        )
        solved = replace(
            solved,
            iterations=contact.iterations + solved.iterations,
            residual=np.maximum(contact.residual, solved.residual),
        )
        contact = batched.where(still, contact, solved)
    in_itself = crossing & np.isinf(passage.next_ends)
    since = np.where(in_itself, passage.since, -np.inf).max(axis=-1)
    present = physics.in_present_layers(wear)
    assert after.through is not None
    new = replace(
        after,
        wear=wear,
        worn=after.worn + physics.integrals(wear - after.wear),
        contact=contact,
        rates=present.rates_at(time, wear, contact.pressure),
        error=after.error * np.where(crossing.any(axis=0), passage.growth, 1.0),
        tangent=None if step_tangent is None else step_tangent.reached(contact),
        through=np.minimum(after.through, np.maximum(time - since, before.time)),
    )
    return batched.where(crosses, new, after)


def _shares(need: FloatArray, slope: FloatArray, change: FloatArray) -> FloatArray:
    """Return the share of a step after which wear comes to ``need``, mm, less than its change.

    By the quadratic through the wear at both ends, with the slope of its start, else straight.
    """
    bend = change - slope
    with np.errstate(divide="ignore", invalid="ignore"):
        share = 2.0 * need / (slope + np.sqrt(slope * slope + 4.0 * bend * need))
        return np.where((share > 0.0) & (share < 1.0), share, need / change)


def _times(need: FloatArray, rate: FloatArray, rise: FloatArray) -> FloatArray:
    """Return the times, s, in which wear goes on by ``need``, mm, its rate changing evenly.

    Infinite where it never does.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        time = 2.0 * need / (rate + np.sqrt(rate * rate + 2.0 * rise * need))
    return np.where(np.isfinite(time) & (time > 0.0), time, np.inf)


def _first(values: FloatArray) -> FloatArray:
    """Return the least values of (2, B, n), (B,)."""
    return values.min(axis=(0, 2))
