"""Interfaces of layers: steps end where the first element reaches one.

Each element wears by the law of one layer throughout a step, so that rates do not jump within it. A
try that goes too far beyond an interface is repeated, to a shorter end: when the first element gets
there by the quadratic through the wear of the first try. If it goes beyond by less, the depth
beyond is replaced by what the next layer loses in the same time, at the pressure of the last part
of the step, which keeps the balance of energy; contacts are solved once more with that wear. So
several elements may cross at once.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np

from ringwear_par import batched
from ringwear_par.arrays import BoolArray, FloatArray, columns
from ringwear_par.contact.correction import CorrectedContacts
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.history.physics import Physics, Sliding
from ringwear_par.history.schemes.step import Step
from ringwear_par.history.state import State
from ringwear_par.wear.layered import worn_through

#: largest correction of depth where an element crosses, over the tolerance of wear: of adaptive
#: cases, and of fixed steps; and the share of it that steps aim at. Of 40
#: random coatings the median error was 0.0044 um with 0.02 and 0.0037 um with 0.3 and 1, the
#: largest 0.0087, 0.0098 and 0.0095 um; 3 um that wear through took 222, 192 and 173 tries.
_ALLOWED, _ALLOWED_OF_FIXED, _AIM = 1.0, 0.02, 0.8
#: largest share of the next layer that a step aims to wear off
_AIM_IN_NEXT = 0.5
#: largest factor by which errors of depth grow in a next layer: near the threshold of a layer they
#: grow without bound. Of 24 random coatings of 3 um, bodies wearing up to 2000 times as fast, the
#: worst error was 0.012 um with 3000, 0.089 um with 300 and 1.2 um without
_MOST_GROWTH = 3000.0
#: least rate at the end of a step, over its mean rate
_LEAST_RATE = 0.01
#: relative change of a depth that is round-off
_ROUND_OFF = 1e-14


def end_at_interfaces(
    contacts: CorrectedContacts,
    before: State,
    step: Step,
    passage: "Passage | None",
) -> Step:
    """Return a step whose elements have the wear and rates of the layers that they are in then.

    Of histories where an element has gone too far beyond its layer, it has the time when it got
    there, instead.

    Parameters
    ----------
    passage : of the elements in the step; None without layers.
    """
    if passage is None:
        return step
    after, length = step.state, columns(step.state.time - before.time)
    left, aim = passage.ends - after.wear, passage.aim
    rise = (after.rates - before.rates) / length
    crossing = passage.crossing
    reached: float | FloatArray = np.inf
    crossed = too_far = np.zeros(len(after.time), dtype=bool)
    if passage.any_crossing:
        too_far = passage.too_far
        if too_far.any():
            left_before = passage.ends - before.wear + aim
            shares = _shares(left_before, before.rates * length, after.wear - before.wear)
            shares = np.where(crossing, shares, np.inf)
            reached = before.time + (after.time - before.time) * _least(shares)
            crossing = crossing & ~too_far[:, None]
        crossed = crossing.any(axis=(0, 2))
        if crossed.any():
            after, ends = _in_next_layers(contacts, before, after, passage, crossing, crossed)
            left = ends - after.wear
            rise[crossing], aim[crossing] = 0.0, 0.0
    expected = after.time + _least(_times(left + aim, after.rates, rise))
    return replace(
        step,
        state=after,
        too_far=too_far,
        interface=np.where(too_far, reached, expected),
        crossed=crossed,
    )


def next_to_cross(physics: Physics, state: State) -> str:
    """Return which element of a single history is to come to the end of its layer first."""
    present = physics.in_present_layers(state.wear)
    assert present.layers is not None
    assert present.ends is not None
    left = present.ends - state.wear
    times = _times(left, state.rates, np.zeros_like(left))[:, 0]
    body, e = (int(place) for place in np.unravel_index(times.argmin(), times.shape))
    layer = present.layers[body, 0, e]
    return f"{BODIES[body]}.layers[{layer}], element {e} (r = {physics.line.r[e]:.6g} mm)"


@dataclass(frozen=True)
class Passage:
    """How elements come to the ends of their layers in a step, (2, B, n) of lower and upper."""

    #: with the laws of the layers that elements are in at the start, of the next layers below, and
    #: of those that are at the face
    present: Physics
    below: Physics
    physics: Physics
    #: mm, depths at which these layers and the next ones end, infinite of bodies themselves
    ends: FloatArray
    next_ends: FloatArray
    #: mm, at the end of the step
    wear: FloatArray
    #: which elements get to the end of their layer, and whether any does
    crossing: BoolArray
    any_crossing: bool
    #: mm, depths at the end, or at which elements came to the ends of their layers
    reached: FloatArray
    #: (B,) s, time of the rates of the last part of the step
    time: FloatArray
    sliding: Sliding
    #: (B, n) MPa, of the last part
    pressure: FloatArray
    #: mm/s, rates in the last part, those of the next layers then, and those at which elements went
    #: beyond the ends of their layers, which are not much less than the mean rates of the step: the
    #: pressure may have fallen below the threshold of the layer by then
    rates: FloatArray
    rates_below: FloatArray
    rates_beyond: FloatArray

    @classmethod
    def of(
        cls,
        physics: Physics,
        present: Physics,
        before: State,
        after: State,
        time: FloatArray,
        sliding: Sliding,
        pressure: FloatArray,
        rates: FloatArray,
    ) -> Self | None:
        """Return the passage of elements in a step; None where bodies have no layers.

        The time, pressure and rates are of the last part of the step.
        """
        ends, layers, wear = present.ends, present.layers, after.wear
        if ends is None or layers is None:
            return None
        below = physics.in_layers(layers + np.isfinite(ends))
        assert below.ends is not None
        crossing = worn_through(ends, wear)
        any_crossing = bool(crossing.any())
        reached = np.where(crossing, ends, wear) if any_crossing else wear
        rates_below = below.rates(time, sliding, reached, pressure)
        mean_rates = (wear - before.wear) / columns(after.time - before.time)
        rates_beyond = np.maximum(rates, _LEAST_RATE * mean_rates * (rates_below > 0.0))
        return cls(
            present, below, physics, ends, below.ends, wear, crossing, any_crossing, reached, time,
            sliding, pressure, rates, rates_below, rates_beyond,
        )  # fmt: skip

    @cached_property
    def time_beyond(self) -> FloatArray:
        """Time that elements have been beyond the ends of their layers, s; 0 where they are not.

        Infinite where it is not known.
        """
        beyond, rate = np.maximum(self.wear - self.reached, 0.0), self.rates_beyond
        return np.divide(beyond, rate, out=np.where(beyond > 0.0, np.inf, 0.0), where=rate > 0.0)

    @cached_property
    def depth_below(self) -> FloatArray:
        """Depths that elements lose of their next layer in this time, mm."""
        return np.where(self.rates_below > 0.0, self.time_beyond, 0.0) * self.rates_below

    @cached_property
    def rate_ratio_below(self) -> FloatArray:
        """Rates of the next layers over those of these; infinite where these do not wear."""
        rate = self.rates_beyond
        return np.divide(self.rates_below, rate, out=np.full_like(rate, np.inf), where=rate > 0.0)

    @property
    def allowed(self) -> FloatArray:
        """Largest correction of depths, (B, 1) mm."""
        physics = self.physics
        most = _ALLOWED if physics.inputs.cases[0].time.adaptive else _ALLOWED_OF_FIXED
        return columns(most * physics.inputs.tolerance)

    @property
    def too_far(self) -> BoolArray:
        """Whether an element of a history, (B,), has gone too far beyond its layer.

        Also if it has worn through the next layer, whatever that is like: below it is another.
        """
        correction = np.abs(self.depth_below - (self.wear - self.reached))
        wrong = (correction > self.allowed) | np.isinf(self.time_beyond)
        wrong |= self.crossing & worn_through(self.next_ends, self.reached + self.depth_below)
        return wrong.any(axis=(0, 2))

    @property
    def aim(self) -> FloatArray:
        """Depth beyond the ends of layers that steps aim at, mm, within the next layers.

        Infinite in bodies, and where a body is next that wears as fast as this layer.
        """
        in_next = np.full_like(self.ends, np.inf)
        np.subtract(self.next_ends, self.ends, out=in_next, where=np.isfinite(self.next_ends))
        ratio = self.rate_ratio_below
        np.divide(in_next, np.maximum(ratio, 1.0), out=in_next, where=np.isfinite(in_next))
        with np.errstate(divide="ignore"):
            aim = self.allowed / np.abs(ratio - 1.0)
        return np.minimum(_AIM * aim, _AIM_IN_NEXT * in_next)

    @property
    def error_ratio(self) -> FloatArray:
        """Errors of both bodies' depths after a crossing over those before it, (B, n).

        An element crosses too early or too late by the error over the rate.
        """
        after = np.where(self.crossing, self.rates_below, self.rates)
        return _ratio(self.rates.sum(axis=0), after.sum(axis=0))

    def growth_at(self, usual: FloatArray) -> FloatArray:
        """Return factors by which errors of depth grow in the next layer, 1 or more, (B, n).

        At the pressures, or at usual ones, (B, 1) MPa, if it is more there. Pressures may have
        fallen to the usual ones when the layer is worn through; near a threshold hardly anything is
        worn off it then.
        """
        low, at = np.minimum(self.pressure, usual), (self.time, self.sliding)
        # where an element will cross: a layer that is run in by then wears slowly
        at_end = np.where(np.isfinite(self.ends), self.ends, self.wear)
        rates = self.present.rates(*at, at_end, low)
        rates_below = self.below.rates(*at, self.reached, low)
        at_usual, present = _ratio(rates, rates_below), _ratio(self.rates, self.rates_below)
        return np.maximum(np.maximum(present, at_usual), 1.0).max(axis=0)


def _ratio(rates: FloatArray, rates_below: FloatArray) -> FloatArray:
    """Return rates below over those above, at most ``_MOST_GROWTH``; 1 where both are 0."""
    most = np.where(rates_below > 0.0, _MOST_GROWTH, 1.0)
    ratio: FloatArray = np.divide(
        rates_below, rates, out=most, where=rates * _MOST_GROWTH > rates_below
    )
    return ratio


def _in_next_layers(
    contacts: CorrectedContacts,
    before: State,
    after: State,
    passage: Passage,
    crossing: BoolArray,
    crossed: BoolArray,
) -> tuple[State, FloatArray]:
    """Return the state with the depths beyond the ends of layers replaced by those of the next.

    And the depths, (2, B, n) mm, at which the layers end that elements are in then.

    Parameters
    ----------
    crossing, crossed : (2, B, n) elements, and (B,) histories with such.
    """
    physics, time, contact = passage.physics, after.time, after.contact
    wear = np.where(crossing, passage.ends + passage.depth_below, after.wear)
    still = ~(np.abs(wear - after.wear) > _ROUND_OFF * wear).any(axis=(0, 2))
    if not still.all():
        solved = contacts.solve(
            physics.contact_inputs(time, wear), contact.pressure, already_solved=(still, contact)
        )
        solved = replace(
            solved,
            iterations=contact.iterations + solved.iterations,
            residual=np.maximum(contact.residual, solved.residual),
        )
        contact = batched.where(still, contact, solved)
    present = physics.in_present_layers(wear)
    assert present.ends is not None
    in_body = crossing & np.isinf(present.ends)
    time_beyond = np.where(in_body, passage.time_beyond, -np.inf).max(axis=-1)
    rates = present.rates_at(time, wear, contact.pressure)
    assert after.through is not None
    # what follows leaves histories as they are that do not cross
    state = replace(
        after,
        wear=wear,
        worn=after.worn + physics.integrals(wear - after.wear),
        contact=contact,
        rates=np.where(crossed[:, None], rates, after.rates),
        error=after.error * np.where(crossing.any(axis=0), passage.error_ratio, 1.0),
        through=np.minimum(after.through, np.maximum(time - time_beyond, before.time)),
    )
    return state, present.ends


def _shares(need: FloatArray, slope: FloatArray, change: FloatArray) -> FloatArray:
    """Return the share of a step after which wear has gone on by ``need`` mm, less than its change.

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


def _least(values: FloatArray) -> FloatArray:
    """Return the least values of (2, B, n), (B,)."""
    return values.min(axis=(0, 2))
