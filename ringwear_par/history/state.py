"""The state of B histories, each at an instant of its own, and a step of them."""

from dataclasses import dataclass

from ringwear_par.arrays import BoolArray, FloatArray, IntArray


@dataclass(frozen=True)
class State:
    """B wear histories: the contact with the profiles worn up to their times; and their steps.

    All that a history goes on from.
    """

    #: (B,) s; N mm, dissipated by friction; and integrals of pressure times sliding speed, N mm
    time: FloatArray
    energy: FloatArray
    normal_work: FloatArray
    #: (w, B, n) mm and mm/s along the axis, of the bodies that wear
    wear: FloatArray
    rates: FloatArray
    #: (w, B, n) layers that elements are in, 0 at the unworn face
    layer: IntArray
    #: (B, n) MPa, (B,) mm, and mm, the approach before any wear
    pressure: FloatArray
    approach: FloatArray
    first_approach: FloatArray
    #: (B, n) MPa/s of the pressure in the last step, from which the next one is guessed
    trend: FloatArray
    #: (B, 2) s, when wear first got through all layers of lower and upper; infinite before
    through: FloatArray
    #: (B,) steps made; iterations of the contact solver in them; and mm, the largest error that a
    #: step was estimated to make, over the share of the tolerance that it may make
    steps: IntArray
    iterations: IntArray
    error: FloatArray
    #: (B,) s, of the next try, and when an element is expected at the end of its layer
    length: FloatArray
    interface: FloatArray
    #: of elements that follow the wear: (w, 1, n) mm, the wear that they are meshed on, and (1, n)
    #: mm by which gaps are smaller since slopes have turned, see ``following``; None of others
    meshed: FloatArray | None = None
    offset: FloatArray | None = None


@dataclass(frozen=True)
class Step:
    """A step of B histories, with its errors."""

    #: at its end
    state: State
    #: (B, n) mm >= 0, estimated errors of the wear of both bodies together
    error: FloatArray
    #: (B,) estimated error of the dissipated energy, N mm, and largest power, N mm/s
    energy_error: FloatArray
    power: FloatArray
    #: (B,) whether a contact was not solved
    failed: BoolArray
    #: (B,) whether an element went too far beyond its layer: the state's ``interface`` is when one
    #: was at its end
    too_far: BoolArray
