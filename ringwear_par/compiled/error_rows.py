"""Loops over the rows of B steps that estimate and propagate errors, see ``schemes.sdirk2``.

Arrays are (B, n) or (B,), one after another where there are several.
"""

import math
from typing import NamedTuple

import numpy as np

from ringwear_par.compiled.contact_rows import Compliances
from ringwear_par.compiled.hessian_rows import Bases, Blocks
from ringwear_par.compiled.machine_code import Count, Flags, Integers, Real, Reals, part
from ringwear_par.compiled.product_rows import SPARE_ROWS, four_rows, multiply_four
from ringwear_par.compiled.system_rows import Scratch


class Estimates(NamedTuple):
    """What errors of steps are estimated from."""

    #: (B,) s
    lengths: Reals
    #: (2, B, n) mm/s, of both bodies at the start
    rates: Reals
    #: (B, n) mm, depths of both bodies together in the stages
    in_first: Reals
    in_last: Reals
    #: (B, n) mm, errors of the history before the step
    before: Reals


class Formula(NamedTuple):
    """What errors of steps are made of."""

    #: (3,) weights of the depths at the rates at the start and in both stages
    weights: Reals
    gamma: Real
    #: of bends, and of errors before
    bend_factor: Real
    factor_before: Real


class Errors(NamedTuple):
    """Estimated errors of steps and histories."""

    #: (B, n) mm, of the wear of steps, and of histories at their ends
    defect: Reals
    at_end: Reals
    #: (B, n) MPa, the pressure that a step's unfiltered error takes away, and ``SPARE_ROWS`` more
    relief: Reals
    #: (3, B) mm, the largest of steps, of histories, and of these what was before the steps
    largest: Reals

    @classmethod
    def empty(cls, count: int, n: int) -> "Errors":
        """Return errors of so many steps that are to be set."""
        relief = np.empty((count + SPARE_ROWS, n))
        return cls(np.empty((count, n)), np.empty((count, n)), relief, np.empty((3, count)))


def rate_errors(
    count: Count, n: Count, estimates: Estimates, formula: Formula, unfiltered: Reals
) -> None:
    """Set three estimates of errors of depth before they are filtered, (3, B, n) mm.

    They are those of the step, of its bend, the difference of the depth at the rate of the last
    stage to that at the start, and of the history before it.
    """
    size = count * n
    for history in range(count):
        for k in range(history * n, (history + 1) * n):
            unfiltered[k], unfiltered[size + k] = _rate_error(k, history, size, estimates, formula)
            unfiltered[2 * size + k] = estimates.before[k]


@part
def _rate_error(
    k: Count, history: Count, size: Count, estimates: Estimates, formula: Formula
) -> tuple[float, float]:
    """Return the error of a depth in a step before it is filtered, and its bend."""
    weights, gamma, last = formula.weights, formula.gamma, estimates.in_last[k]
    start = estimates.lengths[history] * (estimates.rates[k] + estimates.rates[size + k])
    in_stages = weights[1] / gamma * estimates.in_first[k], weights[2] / gamma * last
    return weights[0] * start + in_stages[0] + in_stages[1], last * (1.0 / gamma) - start


def propagate(
    count: Count, n: Count, unfiltered: Reals, reliefs: Reals, slopes: Reals, memory: Reals,
    with_memory: Count, estimates: Estimates, formula: Formula, errors: Errors, propagated: Reals,
) -> None:  # fmt: skip
    """Set the filtered error of steps, and what two others become, (2, B, n) mm.

    Reliefs are the changes of pressure with the unfiltered errors, (3, B, n) mm, which change
    depths by the slopes.
    """
    size = count * n
    for k in range(size):
        bend, carried, slope = unfiltered[size + k], unfiltered[2 * size + k], slopes[k]
        more = memory[k] - 1.0 if with_memory else 0.0
        errors.defect[k] = unfiltered[k] + slope * reliefs[k]
        propagated[k] = (more * bend + slope * reliefs[size + k]) * formula.bend_factor
        propagated[size + k] = (
            more * carried + slope * reliefs[2 * size + k]
        ) * formula.factor_before + estimates.before[k]


def sum_errors(
    count: Count, n: Count, propagated: Reals, reliefs: Reals, slopes: Reals, memory: Reals,
    with_memory: Count, errors: Errors,
) -> None:  # fmt: skip
    """Set errors of histories at the ends of steps, and the largest.

    The second of those that are ``propagated`` becomes what is left of the errors before; reliefs
    are the changes of pressure with both.
    """
    size = count * n
    for history in range(count):
        for k in range(history * n, (history + 1) * n):
            more, slope = memory[k] if with_memory else 1.0, slopes[k]
            propagated[size + k] = more * propagated[size + k] + slope * reliefs[size + k]
            errors.defect[k] += more * propagated[k] + slope * reliefs[k]
            errors.at_end[k] = propagated[size + k] + errors.defect[k]
        _set_largest(n, history, count, propagated, size + history * n, errors)


@part
def _set_largest(
    n: Count, history: Count, size: Count, earlier: Reals, start: Count, errors: Errors
) -> None:
    """Set the largest errors of a history, of which the ``earlier`` ones begin at ``start``."""
    step_error, history_error, earlier_error, total = 0.0, 0.0, 0.0, 0.0
    for i in range(n):
        k = history * n + i
        step_error = max(step_error, abs(errors.defect[k]))
        history_error = max(history_error, abs(errors.at_end[k]))
        earlier_error = max(earlier_error, abs(earlier[start + i]))
        total += errors.at_end[k]
    if not math.isfinite(total):  # comparisons do not see what is no number
        step_error = history_error = earlier_error = math.nan
    errors.largest[history], errors.largest[size + history] = step_error, history_error
    errors.largest[2 * size + history] = earlier_error


def largest_ratios(
    count: Count, n: Count, values: Reals, pressures: Reals, least: Reals, ratios: Reals
) -> None:
    """Set the largest sizes of values over pressures, or over the least (count,) if it is more."""
    for history in range(count):
        largest, total = 0.0, 0.0
        for k in range(history * n, (history + 1) * n):
            ratio = abs(values[k]) / max(pressures[k], least[history])
            largest = max(largest, ratio)
            total += ratio + pressures[k] + least[history]
        ratios[history] = largest if math.isfinite(total) else math.nan


def propagate_errors(
    count: Count, n: Count, size: Count, order: Integers, compliances: Compliances, bases: Bases,
    blocks: Blocks, scratch: Scratch, with_forces: Count, estimates: Estimates, formula: Formula,
    closing: Flags, with_closing: Count, depth_slopes: Reals, n_left: Integers, errors: Errors,
) -> None:  # fmt: skip
    """Do ``rate_errors``, ``propagate`` and ``sum_errors`` of steps in their bases.

    What slopes times a response to gaps add is diagonal there, so that another response is
    y' = (1 - P) y, P being the inverses with forces kept. ``n_left`` (1,) of the ``order`` (count,)
    are left, ``scratch.not_in_bases`` then: those that have no basis, or slopes that are no longer
    those of a diagonal Hessian. Of compliances that deviate, K' off its diagonal is left out: that
    changes errors of steps by up to 5 %, of histories by up to 8 %.
    """
    n_ready, skipped, rows = 0, 0, scratch.rows
    for k in range(count):
        history = order[k]
        row, scale, changed = history * n, blocks.compliances[history] * n, 0
        diagonal = blocks.bases[history] >= 0 and blocks.are_regular[history]
        for i in range(n):
            slope = depth_slopes[row + i] * compliances.slope_scale[scale + i]
            changed += 0 if slope == blocks.slopes[row + i] else 1
        if diagonal and changed == 0:
            scratch.in_bases[n_ready] = history
            n_ready += 1
        else:
            scratch.not_in_bases[skipped] = history
            skipped += 1
    n_left[0] = skipped
    at, responses, inverses = 0, blocks.responses, blocks.inverses
    while at < n_ready:
        row0, row1, row2, row3, together = four_rows(
            at, n_ready, 1, size, scratch.in_bases, blocks.bases
        )
        number = blocks.bases[row0]
        m, first, end = (
            bases.extents[3 * number], bases.extents[3 * number + 1], bases.extents[3 * number + 2],
        )  # fmt: skip
        for q in range(together):
            history, place = scratch.in_bases[at + q], q * n
            row, scale = history * n, blocks.compliances[history] * n
            for i in range(n):
                k, weight = row + i, compliances.weights[scale + i]
                error, bend = _rate_error(k, history, size * n, estimates, formula)
                if with_closing and closing[k]:
                    error = bend = 0.0
                errors.defect[k], rows[place + i] = error, error * weight
                rows[4 * n + place + i] = bend * weight
                rows[8 * n + place + i] = estimates.before[k] * weight
        for four in range(0, 12, 4):
            multiply_four(
                n, n, four, four + 1, four + 2, four + 3, rows, number, bases.psi, four + 12,
                four + 13, four + 14, four + 15, rows, first, end, 0, m,
            )  # fmt: skip
        for q in range(together):
            history, basis = scratch.in_bases[at + q], number * n
            row, keeps = history * n, with_forces and blocks.stiffness[history] > 0.0
            for three in range(q * n, 12 * n, 4 * n):
                change, again = 0.0, 0.0
                if keeps:
                    for i in range(m):
                        change += responses[row + i] * rows[12 * n + three + i]
                    change /= blocks.stiffness[history]
                for i in range(m):
                    rows[three + i] = inverses[row + i] * (
                        change * bases.forces[basis + i] - rows[12 * n + three + i]
                    )
                if keeps and three >= 4 * n:
                    for i in range(m):
                        again += responses[row + i] * rows[three + i]
                    again /= blocks.stiffness[history]
                for i in range(m):
                    rows[12 * n + three + i] = inverses[row + i] * (
                        rows[three + i] - again * bases.forces[basis + i]
                    )
            for i in range(q * n, (q + 1) * n):
                rows[4 * n + i] = rows[i] + formula.bend_factor * rows[16 * n + i]
                rows[8 * n + i] += formula.factor_before * rows[20 * n + i]
        multiply_four(
            n, n, 0, 1, 2, 3, rows, number, bases.psi_t, row0, row1 if together > 1 else size,
            row2 if together > 2 else size + 1, row3 if together > 3 else size + 2, errors.relief,
            0, m, first, end,
        )  # fmt: skip
        for four in (4, 8):
            multiply_four(
                n, n, four, four + 1, four + 2, four + 3, rows, number, bases.psi_t, four + 8,
                four + 9, four + 10, four + 11, rows, 0, m, first, end,
            )  # fmt: skip
        for q in range(together):
            history, step, earlier = scratch.in_bases[at + q], (12 + q) * n, (16 + q) * n
            row, scale = history * n, blocks.compliances[history] * n
            for i in range(n):
                k, per = row + i, compliances.per_scale[scale + i]
                slope = depth_slopes[k] * per
                errors.relief[k] *= per
                errors.defect[k] += slope * rows[step + i]
                rows[earlier + i] = estimates.before[k] + slope * rows[earlier + i]
                errors.at_end[k] = errors.defect[k] + rows[earlier + i]
            _set_largest(n, history, size, rows, earlier, errors)
        at += together
