"""Loops over the rows of B steps of SDIRK2, see ``history.schemes.sdirk2``.

Arrays are (B, n) or (B,), one after another where there are several.
"""

import math

from ringwear_par.compiled.machine_code import Count, Real, Reals


def rate_errors(
    count: Count, n: Count, lengths: Reals, rates: Reals, in_first: Reals, in_last: Reals,
    before: Reals, weights: Reals, gamma: Real, errors: Reals,
) -> None:  # fmt: skip
    """Set three estimates of errors of depth before they are filtered, (3, B, n) mm.

    They are those of the step, of its bend, and of the history before it.

    The first is the sum with ``weights`` (3,) of the depths at the rates (2, B, n) of both bodies
    at the start and in the stages, the second the difference of the last to the first of these.
    """
    at_start, at_first, at_last = weights[0], weights[1] / gamma, weights[2] / gamma
    size, per_gamma = count * n, 1.0 / gamma
    for history in range(count):
        length = lengths[history]
        for k in range(history * n, (history + 1) * n):
            start, last = length * (rates[k] + rates[size + k]), in_last[k]
            errors[k] = at_start * start + at_first * in_first[k] + at_last * last
            errors[size + k] = last * per_gamma - start
            errors[2 * size + k] = before[k]


def propagate(
    count: Count, n: Count, errors: Reals, changes: Reals, memory: Reals, with_memory: Count,
    before: Reals, bend_factor: Real, factor_before: Real, defects: Reals, propagated: Reals,
) -> None:  # fmt: skip
    """Set the filtered error of steps, and what two others become, (2, B, n) mm.

    Parameters are the errors and the changes of depth with them, (3, B, n) mm.
    """
    size = count * n
    for k in range(size):
        bend, carried = errors[size + k], errors[2 * size + k]
        more = memory[k] - 1.0 if with_memory else 0.0
        defects[k] = errors[k] + changes[k]
        propagated[k] = (more * bend + changes[size + k]) * bend_factor
        propagated[size + k] = (more * carried + changes[2 * size + k]) * factor_before + before[k]


def sum_errors(
    count: Count, n: Count, propagated: Reals, changes: Reals, memory: Reals, with_memory: Count,
    defects: Reals, totals: Reals, largest: Reals,
) -> None:  # fmt: skip
    """Set errors of histories at the ends of steps, mm, and the errors of steps.

    The second of those that are ``propagated`` becomes what is left of the errors before.
    ``largest`` (3, B) are the sizes of those of the step, of the history, and of what was before.
    """
    size = count * n
    for history in range(count):
        step_error, history_error, earlier_error, total = 0.0, 0.0, 0.0, 0.0
        first, end = history * n, (history + 1) * n
        for k in range(first, end):
            more = memory[k] if with_memory else 1.0
            propagated[size + k] = more * propagated[size + k] + changes[size + k]
            defects[k] += more * propagated[k] + changes[k]
            totals[k] = propagated[size + k] + defects[k]
        for k in range(first, end):
            step_error, history_error = (
                max(step_error, abs(defects[k])),
                max(history_error, abs(totals[k])),
            )
            earlier_error = max(earlier_error, abs(propagated[size + k]))
            total += totals[k]
        if not math.isfinite(total):  # comparisons do not see what is no number
            step_error = history_error = earlier_error = math.nan
        largest[history] = step_error
        largest[count + history], largest[2 * count + history] = history_error, earlier_error


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
