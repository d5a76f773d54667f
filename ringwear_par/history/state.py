"""What a wear history is at an instant, and where it goes on from."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray, IntArray, Numbers
from ringwear_par.contact.problem import ContactState, WarmStart
from ringwear_par.history.tangent import Tangent


@dataclass(frozen=True)
class State:
    """One wear history, or B of them on one contact pair, at an instant: the physics alone.

    Parameters
    ----------
    time : float or (B,), s.
    wear : (2, ..., n) float, mm, loss of lower and upper.
    worn : (2, ...) float, mm^3, time integrals of the rates of the worn volumes.
    energy : float or (B,), N mm, dissipated by friction.
    contact : the contact solution with these profiles.
    rates : (2, ..., n) float, mm/s, at which lower and upper wear now.
    error : (..., n) float, mm, what the wear of both bodies together lacks for the steps so far, by
        estimate; 0 from schemes that do not carry it.
    shape : (2, ..., n) float, mm, the wear that the elements have followed; None where they do not.
    fit : (..., n) float, mm, what elements are nearer than their profiles say since their slopes
        turned, see ``update_geometry``; None where they do not.
    tangent : derivatives, where they were asked for.
    through : (2, ...) float, s, when wear first got through all layers of lower and upper;
        infinite where it has not, or there are none.
    """

    time: Numbers
    wear: FloatArray
    worn: FloatArray
    energy: Numbers
    contact: ContactState
    rates: FloatArray
    error: FloatArray
    shape: FloatArray | None = None
    fit: FloatArray | None = None
    tangent: Tangent | None = None
    through: FloatArray | None = None

    def take(self, histories: IntArray) -> "State":
        """Return some of B histories."""
        contact = self.contact
        return State(
            self.time[histories],
            self.wear[:, histories],
            self.worn[:, histories],
            self.energy[histories],
            ContactState(*(values[histories] for values in vars(contact).values())),
            self.rates[:, histories],
            self.error[histories],
            tangent=None if self.tangent is None else self.tangent.take(histories),
            through=None if self.through is None else self.through[:, histories],
        )

    def joined(self, other: "State") -> "State":
        """Return the histories of both."""

        def of(name: str, axis: int = 0) -> Any:
            return np.concatenate([getattr(self, name), getattr(other, name)], axis=axis)

        both = zip(vars(self.contact).values(), vars(other.contact).values(), strict=True)
        contact = ContactState(*map(np.concatenate, both))
        return State(
            of("time"), of("wear", 1), of("worn", 1), of("energy"), contact, of("rates", 1),
            of("error"), tangent=_tangent(self, other, Tangent.joined),
            through=None if self.through is None else of("through", 1),
        )  # fmt: skip

    def history(self, i: int) -> "State":
        """Return one of B histories."""
        contact = self.contact
        return State(
            float(self.time[i]),
            self.wear[:, i],
            self.worn[:, i],
            float(self.energy[i]),
            ContactState(
                contact.pressure[i], contact.gap[i], float(contact.approach[i]),
                float(contact.force[i]), int(contact.iterations[i]), float(contact.residual[i]),
            ),
            self.rates[:, i],
            self.error[i],
            tangent=None if self.tangent is None else self.tangent.history(i),
            through=None if self.through is None else self.through[:, i],
        )  # fmt: skip

    def updated(self, which: BoolArray, after: "State") -> "State":
        """Return B histories, some of which have become others."""

        def of(name: str) -> Any:
            return np.where(which, getattr(after, name), getattr(self, name))

        rows = which[:, None]
        both = zip(vars(after.contact).values(), vars(self.contact).values(), strict=True)
        contact = ContactState(
            *(np.where(rows if new.ndim == 2 else which, new, old) for new, old in both)
        )
        return State(
            of("time"),
            np.where(rows, after.wear, self.wear),
            of("worn"),
            of("energy"),
            contact,
            np.where(rows, after.rates, self.rates),
            np.where(rows, after.error, self.error),
            tangent=_tangent(self, after, lambda old, new: old.updated(which, new)),
            through=None if self.through is None else of("through"),
        )


def _tangent(
    one: State, other: State, make: Callable[[Tangent, Tangent], Tangent]
) -> Tangent | None:
    """Return what is made of the derivatives of two states, where there are any."""
    if one.tangent is None or other.tangent is None:
        return None
    return make(one.tangent, other.tangent)


@dataclass(frozen=True)
class Progress:
    """What step control remembers between two steps: numbers, or (B,) of B histories.

    Parameters
    ----------
    steps : number of steps made.
    next_step : s, what error control tries next; 0 before its first step.
    rejected : steps that were repeated with a smaller one.
    iterations : of the contact solver.
    """

    steps: Numbers = 0
    next_step: Numbers = 0.0
    rejected: Numbers = 0
    iterations: Numbers = 0

    @classmethod
    def of_many(cls, count: int) -> "Progress":
        """Return the progress of B histories at their start."""
        nothing = np.zeros(count, dtype=np.int64)
        return cls(nothing, np.zeros(count), nothing, nothing)

    def joined(self, other: "Progress") -> "Progress":
        """Return that of the histories of both."""
        both = zip(vars(self).values(), vars(other).values(), strict=True)
        return Progress(*map(np.concatenate, both))

    def take(self, histories: IntArray) -> "Progress":
        """Return that of some of B histories."""
        return Progress(*(values[histories] for values in vars(self).values()))


@dataclass(frozen=True)
class Start:
    """Where an interrupted history goes on, to the last bit as if it had not been interrupted.

    Parameters
    ----------
    state : the last one.
    progress : of step control.
    warm : where the contact solver starts.
    updates : how often the elements were assembled anew to follow the wear.
    """

    state: State
    progress: Progress
    warm: WarmStart
    updates: int = 0
