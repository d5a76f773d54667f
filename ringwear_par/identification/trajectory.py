"""A history, as far as measurements can see it."""

from dataclasses import dataclass

from ringwear_par.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class Trajectory:
    """What is read of a history, at its steps, the start included.

    The last axis of all but ``time`` holds the value and, where there are any, its derivatives.

    Parameters
    ----------
    time : (s,) s.
    approach : (s, q) mm.
    torque : (s, q) N mm.
    volume : (2, s, q) mm^3, worn off lower and upper.
    wear : (2, s, n, q) mm.
    """

    time: FloatArray
    approach: FloatArray
    torque: FloatArray
    volume: FloatArray
    wear: FloatArray
