"""The state of B histories at an instant, and the progress of their step control."""

from dataclasses import dataclass, field

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray, IntArray, short_repr
from ringwear_par.batched import along
from ringwear_par.contact.problem import ContactState, WarmStart


@dataclass(frozen=True)
class Tangent:
    """Derivatives of a state.

    Of histories with layers the last of P rows is with respect to the end of the step, which other
    numbers may move: it is where an element comes to the end of its layer.

    Parameters
    ----------
    wear : (2, P, ..., n) float, mm over each number's unit.
    energy : (P, ...) float, N mm.
    pressure, gap : (P, ..., n) float, MPa and mm, of the contact.
    approach : (P, ...) float, mm.
    time : (P, ...) float, s, of the time of the state.
    interface : (P, ...) float, s, of the end of the step if it is where the first element is at the
        end of its layer; 0 where none is.
    """

    wear: FloatArray = field(metadata=along(2))
    energy: FloatArray = field(metadata=along(1))
    pressure: FloatArray = field(metadata=along(1))
    gap: FloatArray = field(metadata=along(1))
    approach: FloatArray = field(metadata=along(1))
    time: FloatArray = field(metadata=along(1))
    interface: FloatArray = field(metadata=along(1))

    __repr__ = short_repr

    def at_interfaces(self, moving: BoolArray) -> "Tangent":
        """Return the derivatives at ends that are those of interfaces where so (B,), else fixed."""
        time = np.where(moving, self.interface, 0.0)

        def moved(values: FloatArray, rows: int) -> FloatArray:
            last = np.take(values, [-1], axis=rows)
            shift = time.reshape(*time.shape, *(1,) * (values.ndim - rows - 2))
            changed = values + shift * last
            changed[(slice(None),) * rows + (-1,)] = 0.0
            return changed

        return Tangent(
            moved(self.wear, 1), moved(self.energy, 0), moved(self.pressure, 0),
            moved(self.gap, 0), moved(self.approach, 0), time, np.zeros_like(time),
        )  # fmt: skip


@dataclass(frozen=True)
class State:
    """B wear histories on one contact pair, each at an instant of its own: the physics alone.

    Parameters
    ----------
    time : (B,) float, s.
    wear : (2, B, n) float, mm, loss of lower and upper.
    worn : (2, B) float, mm^3, time integrals of the rates of the worn volumes.
    energy : (B,) float, N mm, dissipated by friction.
    normal_work : (B,) float, N mm, pressure times sliding distance, over all places.
    contact : the contact solution with these profiles.
    rates : (2, B, n) float, mm/s, at which lower and upper wear now.
    error : (B, n) float, mm, what the wear of both bodies together lacks for the steps so far, by
        estimate; 0 from schemes that do not carry it.
    meshed_wear : (2, B, n) float, mm, the wear that the elements have followed; None where they do
        not.
    gap_offset : (B, n) float, mm, what elements are nearer than their profiles say since their
        slopes turned, see ``moving_geometry``; None where they do not.
    tangent : derivatives; None where there are none.
    through : (2, B) float, s, when wear first got through all layers of lower and upper; infinite
        where it has not; None without layers.
    """

    time: FloatArray
    wear: FloatArray = field(metadata=along(1))
    worn: FloatArray = field(metadata=along(1))
    energy: FloatArray
    normal_work: FloatArray
    contact: ContactState
    rates: FloatArray = field(metadata=along(1))
    error: FloatArray
    meshed_wear: FloatArray | None = field(default=None, metadata=along(1))
    gap_offset: FloatArray | None = None
    tangent: Tangent | None = None
    through: FloatArray | None = field(default=None, metadata=along(1))

    __repr__ = short_repr


@dataclass(frozen=True)
class Progress:
    """The progress of the step control of B histories, (B,) each.

    Parameters
    ----------
    steps : number of accepted steps.
    next_step : s, length that error control tries next; 0 before its first step.
    rejected : steps that were repeated with a smaller length.
    iterations : of the contact solver, in accepted steps.
    length : s, length of the present try.
    begun : whether a try of the present step was made.
    pressed : whether a try of the present step failed by its pressure.
    tried_iterations : of the contact solver, in tries of the present step.
    undefined : whether the error of the last try was not a number.
    interface : s, when the first element is expected at the end of its layer; infinite where none
        is.
    step_error : mm, estimated error of the last step, all of its parts, see ``Step.history_error``.
    """

    steps: IntArray
    next_step: FloatArray
    rejected: IntArray
    iterations: IntArray
    length: FloatArray
    begun: BoolArray
    pressed: BoolArray
    tried_iterations: IntArray
    undefined: BoolArray
    interface: FloatArray
    step_error: FloatArray

    @classmethod
    def at_start(cls, count: int) -> "Progress":
        """Return the progress of B histories before their first step."""
        zeros, no = np.zeros(count, dtype=np.int64), np.zeros(count, dtype=bool)
        length, never = np.zeros(count), np.full(count, np.inf)
        return cls(zeros, length, zeros, zeros, length, no, no, zeros, no, never, length)


@dataclass(frozen=True)
class Start:
    """Where an interrupted history continues, to the last bit as if it had not been interrupted.

    Parameters
    ----------
    state : the last one, of one history (B = 1).
    progress : of step control.
    warm : where the contact solver starts.
    updates : how often the elements were assembled again to follow the wear.
    """

    state: State
    progress: Progress
    warm: WarmStart
    updates: int = field(default=0, metadata=along(None))
