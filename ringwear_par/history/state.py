"""The state of B histories at an instant, and the progress of their step control."""

from dataclasses import dataclass, field

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray, IntArray, short_repr
from ringwear_par.batched import along
from ringwear_par.contact.problem import ContactState, WarmStart


@dataclass(frozen=True)
class State:
    """B wear histories on one contact pair, each at an instant of its own: the physics alone."""

    #: (B,) float, s
    time: FloatArray
    #: (2, B, n) float, mm, loss of lower and upper
    wear: FloatArray = field(metadata=along(1))
    #: (2, B) float, mm^3, time integrals of the rates of the worn volumes
    worn: FloatArray = field(metadata=along(1))
    #: (B,) float, N mm, dissipated by friction
    energy: FloatArray
    #: (B,) float, N mm, integral of pressure times sliding speed over contact area and time
    normal_work: FloatArray
    #: the contact solution with these profiles
    contact: ContactState
    #: (B,) float, mm, approach at the start, from which penetration counts
    first_approach: FloatArray
    #: (2, B, n) float, mm/s, at which lower and upper wear now
    rates: FloatArray = field(metadata=along(1))
    #: (B, n) float, mm, estimated error of the wear of both bodies together by the steps so far,
    #: to be added to it; 0 from schemes that do not carry it
    error: FloatArray
    #: (2, B, n) float, mm, wear of the profiles that elements are meshed on; None where they do not
    #: follow the wear
    meshed_wear: FloatArray | None = field(default=None, metadata=along(1))
    #: (B, n) float, mm, by which gaps are smaller than those of the worn profiles since slopes have
    #: turned, see ``moving_geometry``; None where elements do not follow the wear
    gap_offset: FloatArray | None = None
    #: (2, B) float, s, when wear first got through all layers of lower and upper; infinite where it
    #: has not; None without layers
    through: FloatArray | None = field(default=None, metadata=along(1))

    __repr__ = short_repr


@dataclass(frozen=True)
class Progress:
    """The progress of the step control of B histories, (B,) each."""

    #: number of accepted steps
    steps: IntArray
    #: s, length that error control tries next; 0 before its first step
    next_step: FloatArray
    #: steps that were repeated with a smaller length
    rejected: IntArray
    #: of the contact solver, in accepted steps
    iterations: IntArray
    #: s, length of the present try, and whether a limit of time cuts it
    length: FloatArray
    cut: BoolArray
    #: whether a try of the present step was made
    begun: BoolArray
    #: whether a try of the present step failed by its pressure
    pressed: BoolArray
    #: of the contact solver, in tries of the present step
    tried_iterations: IntArray
    #: whether the error of the last try was not a number
    undefined: BoolArray
    #: s, when the first element is expected at the end of its layer; infinite where none is
    interface: FloatArray
    #: s, shortest of the next steps since an element came to its next layer, or since the start;
    #: infinite where there was none
    shortest: FloatArray
    #: mm, estimated error of the last adaptive step, see ``Step.history_error``
    step_error: FloatArray

    @classmethod
    def at_start(cls, count: int) -> "Progress":
        """Return the progress of B histories before their first step."""
        zeros, no = np.zeros(count, dtype=np.int64), np.zeros(count, dtype=bool)
        length, never = np.zeros(count), np.full(count, np.inf)
        return cls(zeros, length, zeros, zeros, length, no, no, no, zeros, no, never, never, length)


@dataclass(frozen=True)
class Start:
    """Where an interrupted history continues, to the last bit as if it had not been interrupted."""

    #: the last one, of one history (B = 1)
    state: State
    #: of step control
    progress: Progress
    #: where the contact solver starts
    warm: WarmStart
    #: how often the elements were assembled again to follow the wear
    updates: int = field(default=0, metadata=along(None))
