"""Loops over the rows of B steps of SDIRK2, see ``history.schemes.sdirk2``.

Arrays are (B, n) or (B,), one after another where there are several.
"""

import math

from ringwear_par.compiled.machine_code import Count, Integers, Real, Reals


def wear_by_lines(
    count: Count, n: Count, bodies: Count, pressures: Reals, steps: Reals, of_elements: Count,
    rises: Reals, onsets: Reals, rates: Reals, depths: Reals, slopes: Reals,
) -> None:  # fmt: skip
    """Set rates of bodies, rise x max(0, p - onset), (bodies, B, n), their depths and slopes.

    Depths and slopes (B, n) are those of all bodies; steps are of histories or of elements.
    """
    for history in range(count):
        row, step = history * n, steps[history]
        for k in range(row, row + n):
            depths[k] = slopes[k] = 0.0
        for body in range(bodies):
            first = body * count * n
            for k in range(row, row + n):
                over, rise = pressures[k] - onsets[first + k], rises[first + k]
                duration = steps[k] if of_elements else step
                rate = rise * max(over, 0.0)
                rates[first + k] = rate
                depths[k] += duration * rate
                slopes[k] += duration * rise if over > 0.0 else 0.0


def wear_off(
    count: Count, n: Count, bodies: Count, sides: Integers, wear: Reals, rates: Reals,
    end_rates: Reals, durations: Reals, weights: Reals, with_weights: Count, area: Reals,
    after: Reals, volumes: Reals,
) -> None:  # fmt: skip
    """Set the wear after durations (count,), and add the rates of worn volumes to those.

    Wear (2, B, n) and volumes (2, B) are of both sides, rates (bodies, B, n) of those that wear,
    volumes of the ``end_rates``. Weights (B, n) multiply durations and rates.
    """
    for history in range(count):
        duration, row = durations[history], history * n
        for side in range(2):
            first = side * count * n
            for k in range(first + row, first + row + n):
                after[k] = wear[k]
        for body in range(bodies):
            from_first, to_first = body * count * n, sides[body] * count * n
            for k in range(row, row + n):
                worn = duration * rates[from_first + k]
                after[to_first + k] += weights[k] * worn if with_weights else worn
            volume = 0.0
            for i in range(n):
                rate = end_rates[from_first + row + i]
                volume += area[i] * (weights[row + i] * rate if with_weights else rate)
            volumes[sides[body] * count + history] += volume


def add_power(
    count: Count, n: Count, lengths: Reals, sliding: Reals, before: Reals, at_stage: Reals,
    at_end: Reals, of_stage: Reals, of_end: Reals, with_weights: Count, moment: Reals,
    weights: Reals, defects: Reals, sums: Reals,
) -> None:  # fmt: skip
    """Set what sliding does at the pressures at the start and in both stages, (4, count).

    They are energy and normal work of steps, the error of the energy, and the largest power.
    Weights are those of these three, (3,), and of the two stages.

    ``sliding`` (3, 2, count) are speeds and coefficients of friction.
    """
    for history in range(count):
        row, start, stage, end = history * n, 0.0, 0.0, 0.0
        for i in range(n):
            k = row + i
            start += moment[i] * before[k]
            stage += moment[i] * (of_stage[k] * at_stage[k] if with_weights else at_stage[k])
            end += moment[i] * (of_end[k] * at_end[k] if with_weights else at_end[k])
        work, power, length = 2 * count + history, 3 * count + history, lengths[history]
        start *= sliding[history]
        stage *= sliding[2 * count + history]
        end *= sliding[4 * count + history]
        sums[count + history] = length * (
            weights[0] * start + weights[1] * stage + weights[2] * end
        )
        start *= sliding[count + history]
        stage *= sliding[3 * count + history]
        end *= sliding[5 * count + history]
        sums[history] = length * (weights[0] * start + weights[1] * stage + weights[2] * end)
        sums[work] = abs(length * (defects[0] * start + defects[1] * stage + defects[2] * end))
        sums[power] = max(start, stage, end)


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
    count: Count, n: Count, errors: Reals, reliefs: Reals, slopes: Reals, memory: Reals,
    with_memory: Count, before: Reals, bend_factor: Real, factor_before: Real, defects: Reals,
    propagated: Reals,
) -> None:  # fmt: skip
    """Set the filtered error of steps, and what two others become, (2, B, n) mm.

    Parameters are the errors, (3, B, n) mm, and the changes of pressure with them, which change
    depths by the slopes.
    """
    size = count * n
    for k in range(size):
        bend, carried, slope = errors[size + k], errors[2 * size + k], slopes[k]
        more = memory[k] - 1.0 if with_memory else 0.0
        defects[k] = errors[k] + slope * reliefs[k]
        propagated[k] = (more * bend + slope * reliefs[size + k]) * bend_factor
        propagated[size + k] = (
            more * carried + slope * reliefs[2 * size + k]
        ) * factor_before + before[k]


def sum_errors(
    count: Count, n: Count, propagated: Reals, reliefs: Reals, slopes: Reals, memory: Reals,
    with_memory: Count, defects: Reals, totals: Reals, largest: Reals,
) -> None:  # fmt: skip
    """Set errors of histories at the ends of steps, mm, and the errors of steps.

    The second of those that are ``propagated`` becomes what is left of the errors before; reliefs
    are the changes of pressure with both. ``largest`` (3, B) are the sizes of those of the step, of
    the history, and of what was before.
    """
    size = count * n
    for history in range(count):
        step_error, history_error, earlier_error, total = 0.0, 0.0, 0.0, 0.0
        first, end = history * n, (history + 1) * n
        for k in range(first, end):
            more, slope = memory[k] if with_memory else 1.0, slopes[k]
            propagated[size + k] = more * propagated[size + k] + slope * reliefs[size + k]
            defects[k] += more * propagated[k] + slope * reliefs[k]
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
