"""Loops over the rows of B steps: of SDIRK2, see ``history.schemes.sdirk2``, and their control.

Arrays are (B, n) or (B,), one after another where there are several.
"""

import math
from typing import NamedTuple

from ringwear_par.compiled.machine_code import Count, Flags, Integers, Reals

_SAFETY, _LARGEST_GROWTH, _LARGEST_CUT = 0.82, 5.0, 0.1
#: share of the tolerance that the error of a step may be, whatever the history's error before it
_LEAST_ALLOWED = 0.05
#: wear of the first step, in tolerances: edges wear fast and not for long
_FIRST_WEAR = 50.0
#: largest error of the dissipated energy of one step, relative to that of the whole history as it
#: would be if the power stayed
_ENERGY_TOLERANCE = 1e-4


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


class Tolerances(NamedTuple):
    """What a control holds steps of B histories to, see ``ErrorControl``."""

    #: (B,) s, ends of histories
    ends: Reals
    #: (B,) mm, and relative to the mean pressure
    wear: Reals
    pressure: Reals
    #: (B,) mm, most wear of a step
    most_wear: Reals


class Tries(NamedTuple):
    """Tries of the steps of B histories."""

    #: (B,) s, of the present step, uncut, and of the next one; 0 before the first
    lengths: Reals
    next_lengths: Reals
    #: (B,) whether errors of pressures have shortened tries of the step, and limits this one
    are_pressed: Flags
    are_cut: Flags


class StepErrors(NamedTuple):
    """Estimated errors of the tries of B histories."""

    #: (B,) mm, of the wear of steps, of histories at their ends, and what these are of before
    wear: Reals
    history: Reals
    carried: Reals
    #: (B,) mJ, and the largest power, mW
    energy: Reals
    power: Reals
    #: (B,) relative to pressures
    pressure: Reals


def choose_ends(
    count: Count, n: Count, times: Reals, limits: Reals, begun: Flags, tries: Tries,
    tolerances: Tolerances, rates: Reals, new: Tries, ends: Reals,
) -> None:  # fmt: skip
    """Set lengths and ends of tries, s, and which of them are cut by their limits.

    Steps that have begun have the present lengths, others the next ones; the first wear off some
    tolerances, and none more than they may. Rates are those of both sides, (2, B, n) mm/s.
    """
    for history in range(count):
        length, most = tries.lengths[history], tolerances.most_wear[history]
        if not begun[history]:
            length, fastest = tries.next_lengths[history], 0.0
            is_first = length == 0.0
            if is_first or most < math.inf:
                for side in range(2):
                    row = (side * count + history) * n
                    for k in range(row, row + n):
                        fastest = max(fastest, rates[k])
            if is_first:
                length = tolerances.ends[history]
                if fastest > 0.0:
                    length = min(length, _FIRST_WEAR * tolerances.wear[history] / fastest)
            if fastest > 0.0:
                length = min(length, most / fastest)
        left = limits[history] - times[history]
        new.are_cut[history] = length >= left * (1.0 - 1e-9)
        new.lengths[history] = length
        if new.are_cut[history]:
            ends[history] = limits[history]
        elif length < 0.5 * left or length > 0.9 * left:
            ends[history] = times[history] + length
        else:  # the last step would be tiny
            ends[history] = times[history] + 0.5 * left


def judge_tries(
    count: Count, n: Count, errors_before: Reals, times_before: Reals, times: Reals,
    energies: Reals, errors: StepErrors, tolerances: Tolerances, too_far: Flags, tries: Tries,
    accepted: Flags, undefined: Flags, new: Tries,
) -> None:  # fmt: skip
    """Set which tries are accepted, and the lengths of the next ones, see ``ErrorControl``."""
    for history in range(count):
        missed, row = 0.0, history * n
        for k in range(row, row + n):
            missed = max(missed, abs(errors_before[k]))
        tolerance, carried = tolerances.wear[history], errors.carried[history]
        whole = _ENERGY_TOLERANCE * (
            energies[history] + errors.power[history] * (tolerances.ends[history] - times[history])
        )
        energy = max(errors.energy[history] / whole if whole > 0.0 else 0.0, 1e-6)
        error, least = errors.wear[history], _LEAST_ALLOWED * tolerance
        ratio = max(energy, error / max(tolerance - carried, least))
        # the next step is to leave as much of the error before it as this one does
        share = min(carried / missed, 1.0) if missed > 0.0 else 1.0
        ahead = max(energy, error / max(tolerance - errors.history[history] * share, least))
        over = errors.pressure[history] / tolerances.pressure[history]
        if not math.isfinite(over):
            over = math.inf
        pressing = over > 1.0
        if pressing:
            ratio = max(ratio, over)
        if not math.isfinite(error + errors.energy[history] + whole + carried):
            ratio = ahead = math.inf
        if not math.isfinite(errors.history[history]):
            ahead = math.inf
        within = ratio <= 1.0
        accepted[history] = within and not too_far[history]
        new.are_pressed[history] = tries.are_pressed[history] or pressing
        undefined[history] = ratio == math.inf
        length, uncut = times[history] - times_before[history], tries.lengths[history]
        new.lengths[history], new.next_lengths[history] = uncut, tries.next_lengths[history]
        # the third root of the error, with care
        if not within:
            new.lengths[history] = length * max(_SAFETY * ratio ** (-1.0 / 3.0), _LARGEST_CUT)
        if accepted[history]:
            change = max(_SAFETY * ahead ** (-1.0 / 3.0), _LARGEST_CUT)
            # errors of pressure come and go with elements: they limit steps, but do not foretell
            # them
            following = length * min(change, 1.0 if new.are_pressed[history] else _LARGEST_GROWTH)
            cut = tries.are_cut[history]
            new.next_lengths[history] = max(following, uncut) if cut else following
