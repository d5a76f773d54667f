"""Loops over the rows of B steps: of SDIRK2, see ``history.schemes.sdirk2``, and their control.

Arrays are (B, n) or (B,), one after another where there are several.
"""

import math

from ringwear_par.compiled.machine_code import Count, Flags, Integers, Real, Reals


def wear_by_lines(
    count: Count, n: Count, bodies: Count, pressures: Reals, steps: Reals, of_elements: Count,
    rises: Reals, onsets: Reals, rates: Reals, depths: Reals, slopes: Reals, gaps: Reals,
    with_gaps: Count, growths: Reals,
) -> None:  # fmt: skip
    """Set rates of bodies, rise x max(0, p - onset), (bodies, B, n), their depths and slopes.

    Depths and slopes (B, n) are those of all bodies; steps are of histories or of elements. With
    gaps (B, n) that close before, growths are what is left of depths, and slopes are those of it.
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
        if with_gaps:
            for k in range(row, row + n):
                growth = depths[k] - gaps[k]
                growths[k] = 0.0 if growth < 0.0 else growth
                slopes[k] = slopes[k] if growth >= 0.0 else 0.0


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
    area: Reals, weights: Reals, defects: Reals, sums: Reals,
) -> None:  # fmt: skip
    """Set what sliding does at the pressures at the start and in both stages, (5, count).

    They are energy and normal work of steps, the error of the energy, and the largest power; and
    the area in contact at the end. Weights are those of these three, (3,), and of the two stages.

    ``sliding`` (3, 2, count) are speeds and coefficients of friction.
    """
    for history in range(count):
        row, start, stage, end, touching = history * n, 0.0, 0.0, 0.0, 0.0
        for i in range(n):
            k = row + i
            start += moment[i] * before[k]
            stage += moment[i] * (of_stage[k] * at_stage[k] if with_weights else at_stage[k])
            end += moment[i] * (of_end[k] * at_end[k] if with_weights else at_end[k])
            touching += area[i] if at_end[k] > 0.0 else 0.0
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
        sums[power], sums[4 * count + history] = max(start, stage, end), touching


def choose_ends(
    count: Count, n: Count, times: Reals, limits: Reals, begun: Flags, lengths: Reals,
    next_lengths: Reals, rates: Reals, most_time: Reals, first_wear: Reals, most_wear: Reals,
    new_lengths: Reals, ends: Reals, cut: Flags,
) -> None:  # fmt: skip
    """Set lengths and ends of tries, s, and which of them are cut by their limits.

    Steps that have begun have the present lengths, others the next ones, 0 before the first step;
    these wear off ``first_wear``, and none more than ``most_wear``, mm.
    """
    for history in range(count):
        length = lengths[history]
        if not begun[history]:
            length, fastest = next_lengths[history], 0.0
            is_first = length == 0.0
            if is_first or most_wear[history] < math.inf:
                for side in range(2):
                    row = (side * count + history) * n
                    for k in range(row, row + n):
                        fastest = max(fastest, rates[k])
            if is_first:
                length = most_time[history]
                if fastest > 0.0:
                    length = min(length, first_wear[history] / fastest)
            if fastest > 0.0:
                length = min(length, most_wear[history] / fastest)
        left = limits[history] - times[history]
        cut[history] = length >= left * (1.0 - 1e-9)
        new_lengths[history] = length
        if cut[history]:
            ends[history] = limits[history]
        elif length < 0.5 * left or length > 0.9 * left:
            ends[history] = times[history] + length
        else:  # the last step would be tiny
            ends[history] = times[history] + 0.5 * left


def judge_tries(
    count: Count, n: Count, errors_before: Reals, times_before: Reals, times: Reals,
    most_time: Reals, energies: Reals, powers: Reals, energy_errors: Reals, wear_errors: Reals,
    history_errors: Reals, carried_errors: Reals, pressure_errors: Reals, wear_tolerances: Reals,
    pressure_tolerances: Reals, energy_tolerance: Real, least_allowed: Real, safety: Real,
    largest_cut: Real, largest_growth: Real, too_far: Flags, was_pressed: Flags, cut: Flags,
    lengths: Reals, next_lengths: Reals, accepted: Flags, pressed: Flags, undefined: Flags,
    new_lengths: Reals, new_next_lengths: Reals,
) -> None:  # fmt: skip
    """Set which tries are accepted, and the lengths of the next ones, see ``ErrorControl``."""
    for history in range(count):
        missed, row = 0.0, history * n
        for k in range(row, row + n):
            missed = max(missed, abs(errors_before[k]))
        tolerance, carried = wear_tolerances[history], carried_errors[history]
        whole = energy_tolerance * (
            energies[history] + powers[history] * (most_time[history] - times[history])
        )
        energy = max(energy_errors[history] / whole if whole > 0.0 else 0.0, 1e-6)
        error, least = wear_errors[history], least_allowed * tolerance
        ratio = max(energy, error / max(tolerance - carried, least))
        # the next step is to leave as much of the error before it as this one does
        share = min(carried / missed, 1.0) if missed > 0.0 else 1.0
        ahead = max(energy, error / max(tolerance - history_errors[history] * share, least))
        over = pressure_errors[history] / pressure_tolerances[history]
        if not math.isfinite(over):
            over = math.inf
        pressing = over > 1.0
        if pressing:
            ratio = max(ratio, over)
        if not math.isfinite(error + energy_errors[history] + whole + carried):
            ratio = ahead = math.inf
        if not math.isfinite(history_errors[history]):
            ahead = math.inf
        within = ratio <= 1.0
        accepted[history] = within and not too_far[history]
        pressed[history] = was_pressed[history] or pressing
        undefined[history] = ratio == math.inf
        length, uncut = times[history] - times_before[history], lengths[history]
        new_lengths[history] = uncut
        new_next_lengths[history] = next_lengths[history]
        # the third root of the error, with care
        if not within:
            new_lengths[history] = length * max(safety * ratio ** (-1.0 / 3.0), largest_cut)
        if accepted[history]:
            change = max(safety * ahead ** (-1.0 / 3.0), largest_cut)
            # errors of pressure come and go with elements: they limit steps, but do not foretell
            # them
            following = length * min(change, 1.0 if pressed[history] else largest_growth)
            new_next_lengths[history] = max(following, uncut) if cut[history] else following
