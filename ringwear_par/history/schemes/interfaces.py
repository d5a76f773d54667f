"""Interfaces of layers: steps end where the first element reaches one.

Each element stays in its layer throughout a step, so that rates do not jump within it. A try that
goes too far beyond an interface is repeated: it ends where the quadratic through the wear of this
one says that the first element gets there. What goes beyond it by no more than a small share of the
tolerance is worn off the next layer instead, in the time that it took, which keeps the balance of
energy; contacts are solved once more with that wear. So several elements may cross at once.
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from ringwear_par import batched
from ringwear_par.arrays import BoolArray, FloatArray, IntArray, columns
from ringwear_par.contact.correction import CorrectedContacts
from ringwear_par.history.physics import Physics
from ringwear_par.history.schemes.step import Step
from ringwear_par.history.schemes.tangent import Along
from ringwear_par.history.state import State
from ringwear_par.wear.layered import worn_through

#: by how much depths may be wrong where elements cross, in ``time.tolerance``; what steps aim at
_ALLOWED, _AIM = 0.02, 0.5
#: by how many times an error of depth counts more at most: near the threshold of a layer there is
#: no bound. Of 24 random coatings of 3 um, bodies wearing up to 2000 times as fast, the worst was
#: off by 0.012 um with 3000, by 0.089 with 300 and by 1.2 without
_MOST_GROWTH = 3000.0
#: share of a depth below which a change of it is none
_ROUND_OFF = 1e-14


@dataclass(frozen=True)
class LastPart:
    """The last part of a step, in which all elements wear at the pressure of one contact.

    Parameters
    ----------
    time, omega : (B,) s and rad/s, at which rates are those of the part.
    pressure : (B, n) MPa.
    """

    time: FloatArray
    omega: FloatArray
    pressure: FloatArray


def end_at_interfaces(
    physics: Physics,
    contacts: CorrectedContacts,
    before: State,
    step: Step,
    passage: "Passage | None",
    along: Along | None,
) -> Step:
    """Return a step with its elements in the layers that they have come to.

    Or, of histories where an element has gone too far beyond its layer, when it got there.

    Parameters
    ----------
    physics : of the layers at the start of the step.
    passage : of its elements; None without layers.
    along : derivatives along it.
    """
    if passage is None:
        return step
    after, length = step.state, columns(step.state.time - before.time)
    too_far, left = passage.too_far, passage.ends - before.wear
    reached = np.full(too_far.shape, np.inf)
    if too_far.any():
        shares = _shares(left + passage.aim, before.rates * length, after.wear - before.wear)
        shares = np.where(passage.crossing, shares, np.inf)
        reached = before.time + (after.time - before.time) * _first(shares)
    rise, aim = (after.rates - before.rates) / length, passage.aim
    crossing = passage.crossing & ~too_far[:, None]
    if crossing.any():
        after = _in_next_layers(physics, contacts, before, after, passage, crossing, along)
        rise[crossing], aim[crossing] = 0.0, 0.0
    left = physics.ends_of(physics.layers_at(after.wear)) - after.wear
    expected = after.time + _first(_times(left + aim, after.rates, rise))
    return replace(
        step, state=after, too_far=too_far, interface=np.where(too_far, reached, expected)
    )


@dataclass(frozen=True)
class Passage:
    """How elements come to the ends of their layers in a step, (2, B, n) of lower and upper.

    Parameters
    ----------
    ends : mm, of the layers, infinite of bodies themselves.
    crossing : which elements get there.
    beyond : mm, how far these are beyond it; 0 of others.
    here, below : mm/s, rates in the last part of the step, and those of the next layers.
    most : (B, 1) mm, by which depths may be wrong.
    """

    ends: FloatArray
    crossing: BoolArray
    beyond: FloatArray
    here: FloatArray
    below: FloatArray
    most: FloatArray

    @classmethod
    def of(cls, physics: Physics, before: State, after: State, part: LastPart) -> Self | None:
        """Return the passage of elements in a step, whose physics is that of its layers.

        None where bodies have none.
        """
        if not physics.inputs.layered:
            return None
        layers, wear, at = physics.layers_at(before.wear), after.wear, (part.time, part.omega)
        ends = physics.ends_of(layers)
        inside = np.isfinite(ends)
        crossing = inside & worn_through(ends, wear)
        reached = np.where(crossing, ends, wear)
        return cls(
            ends,
            crossing,
            np.where(crossing, np.maximum(wear - ends, 0.0), 0.0),
            physics.rates(*at, wear, part.pressure),
            physics.in_layers(layers + inside).rates(*at, reached, part.pressure),
            columns(_ALLOWED * physics.inputs.tolerance),
        )

    @property
    def time(self) -> FloatArray:
        """(2, B, n) s, since when elements have been beyond."""
        never = np.where(self.beyond > 0.0, np.inf, 0.0)
        return np.divide(self.beyond, self.here, out=never, where=self.here > 0.0)

    @property
    def depth(self) -> FloatArray:
        """(2, B, n) mm, that elements lose of the next layer in this time."""
        return np.where(self.below > 0.0, self.time, 0.0) * self.below

    @property
    def faster(self) -> FloatArray:
        """(2, B, n), rates of the next layers over those of these."""
        ones = np.ones_like(self.here)
        return np.divide(self.below, self.here, out=ones, where=self.here > 0.0)

    @property
    def too_far(self) -> BoolArray:
        """(B,), in which histories an element goes on in its layer for too long."""
        wrong = np.abs(self.depth - self.beyond) > self.most
        return (self.crossing & wrong).any(axis=(0, 2))

    @property
    def aim(self) -> FloatArray:
        """(2, B, n) mm, how far beyond the ends of layers steps are to go.

        Infinite where the next one wears as this one does.
        """
        with np.errstate(divide="ignore"):
            return _AIM * self.most / np.abs(self.faster - 1.0)

    @property
    def growth(self) -> FloatArray:
        """(B, n), by how many times an error of depth is more in the next layer, from 1 on.

        Which begins to wear so much too early or too late.
        """
        here, below = self.here, self.below
        most = np.where(below > 0.0, _MOST_GROWTH, 1.0)
        ratio = np.divide(below, here, out=most, where=here * _MOST_GROWTH > below)
        return np.maximum(ratio, 1.0).max(axis=0)


def _in_next_layers(
    physics: Physics,
    contacts: CorrectedContacts,
    before: State,
    after: State,
    passage: Passage,
    crossing: BoolArray,
    along: Along | None,
) -> State:
    """Return the state with what is beyond the ends of layers worn off the next ones."""
    wear = np.where(crossing, passage.ends + passage.depth, after.wear)
    p, crosses = after.contact.pressure, crossing.any(axis=(0, 2))
    moved = np.abs(wear - after.wear) > _ROUND_OFF * wear
    still = ~(moved & crossing).any(axis=(0, 2))
    layers = physics.layers_at(wear)
    following = physics.in_layers(layers)
    if along is not None:
        along.cross(crossing, passage.faster, following.inputs.laws)
    contact = after.contact
    if not still.all():
        solved = contacts.solve(
            physics.contact_inputs(after.time, wear),
            p,
            already_solved=(still, contact),
            along=along,
        )
        solved = replace(
            solved,
            iterations=contact.iterations + solved.iterations,
            residual=np.maximum(contact.residual, solved.residual),
        )
        contact = batched.where(still, contact, solved)
    rates = following.rates_at(after.time, wear, contact.pressure)
    itself = crossing & np.isinf(physics.ends_of(layers))
    since = np.where(itself, passage.time, -np.inf).max(axis=-1)
    new = replace(
        after,
        wear=wear,
        worn=after.worn + physics.integrals(wear - after.wear),
        contact=contact,
        rates=rates,
        error=after.error * np.where(crossing.any(axis=0), passage.growth, 1.0),
        tangent=None if along is None else along.reached(contact),
        through=np.minimum(after.through, np.maximum(after.time - since, before.time)),
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
