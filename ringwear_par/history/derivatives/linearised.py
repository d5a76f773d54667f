"""The linearisation of a step's wear: its derivatives by P numbers and by pressure."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.history.derivatives.numbers import Sensitivity
from ringwear_par.wear.increment import WearIncrement, WearingBody, total_of
from ringwear_par.wear.laws.non_local import averaged


@dataclass(frozen=True)
class LinearisedBody:
    """Derivatives of a body's depth, along the normal, in a step in contact all along."""

    #: at the start of the step
    body: WearingBody
    #: (..., n) mm
    depth: FloatArray
    #: (P, ..., n) mm, at given pressure
    change: FloatArray
    #: (..., n) mm/MPa, of the averaged pressure where it is averaged
    slope: FloatArray

    def with_pressure(self, d_p: FloatArray) -> FloatArray:
        """Return derivatives of the depth, (P, ..., n), at those of pressures, (P, ..., n) MPa."""
        average = self.body.average
        if average is None:
            return self.change + self.slope * d_p
        return self.change + averaged(average, self.slope * averaged(average, d_p))


@dataclass(frozen=True)
class LinearisedIncrement:
    """Derivatives of the depths of an increment by P numbers and by pressure."""

    #: of which it is the linearisation
    increment: WearIncrement
    #: those that wear
    bodies: Sequence[LinearisedBody]

    @property
    def depth(self) -> FloatArray:
        """(P, ..., n) mm, of both bodies in contact all along at given pressure."""
        return total_of([self.increment.along_axis(body.change) for body in self.bodies])

    def in_contact_problem(
        self, p: FloatArray, d_gap: FloatArray | None
    ) -> tuple[FloatArray, FloatArray]:
        """Return derivatives of the depth in the contact problem: at given pressure, and by it.

        (P, ..., n) mm and (..., n) or (..., n, n) mm/MPa.

        Parameters
        ----------
        d_gap : (P, ..., n) mm, derivatives of the gaps that wear closes.
        """
        increment, depth = self.increment, self.depth
        slope = (
            increment.along_axis(total_of([body.slope for body in self.bodies]))
            if increment.local
            else increment.jacobian(p)
        )
        if increment.closing is not None:
            closed = (increment.closing.gap == 0.0) | (increment.depth(p) > 0.0)
            assert d_gap is not None
            depth = np.where(closed, depth - d_gap, 0.0)
            slope = np.where(closed, slope, 0.0)
        return depth, slope

    def depths(
        self, d_p: FloatArray, share: FloatArray | float = 1.0, d_share: FloatArray | float = 0.0
    ) -> dict[int, FloatArray]:
        """Return derivatives of the depths in a share of the step, (P, ..., n) mm of each body.

        Parameters
        ----------
        d_p : (P, ..., n) MPa.
        d_share : of ``share``, (P, ..., n) or 0.
        """
        return {
            body.body.side: self.increment.along_axis(
                d_share * body.depth + share * body.with_pressure(d_p)
            )
            for body in self.bodies
        }


def linearise(
    increment: WearIncrement,
    p: FloatArray,
    numbers: Sensitivity,
    d_wear: FloatArray,
    d_step: FloatArray | None,
    instant: bool,
) -> LinearisedIncrement:
    """Return the derivatives of the depths of an increment by P numbers, and by pressure.

    Parameters
    ----------
    d_wear : (2, P, ..., n) mm, derivatives of the wear before the step.
    d_step : (P, ..., n) s, those of its steps; None: 0.
    instant : whether rates are those before the step, as in explicit steps.
    """
    bodies = []
    for body in increment.bodies:
        normal = d_wear[body.side] - numbers.layer_starts(body.side, body.law)
        if increment.obliquity is not None:
            normal = normal / increment.obliquity
        bodies.append(_linearised(increment, body, p, numbers, normal, d_step, instant))
    return LinearisedIncrement(increment, bodies)


def _linearised(
    increment: WearIncrement,
    body: WearingBody,
    p: FloatArray,
    numbers: Sensitivity,
    normal: FloatArray,
    d_step: FloatArray | None,
    instant: bool,
) -> LinearisedBody:
    """Return the derivatives of a body's depths; ``normal`` are those of the wear of its layer."""
    step, (side, law, at, average) = increment.step, body
    q = np.maximum(p if average is None else averaged(average, p), 0.0)
    row, d_average = numbers.averages.get(side, (0, None))
    within = law.remembers and not instant
    after = increment.after_step(law, at, q) if within else at
    rate = law.rate(q, after)
    depth = step * rate
    change = numbers.rates(side, law, q, after)
    d_before = law.d_rate_dbefore(q, after)
    if d_before is not None:
        change += d_before * normal
    change *= step
    slope = step * law.d_rate_dp(q, after)
    if d_step is not None:
        change += d_step * rate
    if within and d_before is not None:
        change /= 1.0 - step * d_before
        slope /= 1.0 - step * d_before
    if d_average is not None:
        change[row] += slope * averaged(d_average, p)
    if average is not None:
        change = averaged(average, change)
        if d_average is not None:
            change[row] += averaged(d_average, depth)
    return LinearisedBody(body, depth, change, slope)
