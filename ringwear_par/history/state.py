"""What a wear history is at an instant, and where it goes on from."""

from dataclasses import dataclass

from ringwear_par.arrays import FloatArray, Numbers
from ringwear_par.contact.problem import ContactState, WarmStart


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
    shape : (2, ..., n) float, mm, the wear that the elements have followed; None where they do not.
    fit : (..., n) float, mm, what elements are nearer than their profiles say since their slopes
        turned, see ``WearModel.update_geometry``; None where they do not.
    """

    time: Numbers
    wear: FloatArray
    worn: FloatArray
    energy: Numbers
    contact: ContactState
    rates: FloatArray
    shape: FloatArray | None = None
    fit: FloatArray | None = None


@dataclass(frozen=True)
class Progress:
    """What step control remembers between two steps.

    Parameters
    ----------
    steps : number of steps made.
    next_step : s, what error control tries next; 0 before its first step.
    rejected : steps that were repeated with a smaller one.
    iterations : of the contact solver.
    """

    steps: int = 0
    next_step: float = 0.0
    rejected: int = 0
    iterations: int = 0


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
