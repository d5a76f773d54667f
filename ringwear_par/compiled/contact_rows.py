"""Loops over the rows of B contact problems, see ``contact.problem`` and ``contact.hessians``.

Arrays are (B, n) or (B,), of which ``rows`` (count,) are at work, but for those that are called
compact: (count, n) or (count,), of these rows one after another; and ``weights``, ``per_scale``,
``slope_scale``, ``per_speed`` and ``stiffness``, (m, n), of the compliances ``which`` (B,) of the
histories.
"""

import math

from ringwear_par.compiled.machine_code import Count, Flags, Integers, Real, Reals, in_order


def multiply(
    count: Count, n: Count, k: Count, times: Count, size: Count, order: Integers, which: Integers,
    rows: Reals, matrices: Reals, derivatives: Reals, deviations: Reals, with_derivatives: Count,
    deviating: Reals, products: Reals,
) -> None:  # fmt: skip
    """Set products (times, size, k) of rows (times, size, n) with their matrices (m, n, k).

    Rows have the matrices ``which`` (size,), by which the ``order`` (count,) of those that are
    multiplied should be: digits of a row do not depend on the others. With derivatives (m, n, k),
    ``deviations`` (size,) of these are added to the matrices. After the products there is room for
    3 more; ``deviating`` is room for 4.
    """
    _multiply(
        count, n, k, times, size, order, which, rows, matrices, derivatives, deviations,
        with_derivatives, deviating, products,
    )  # fmt: skip


def _multiply(
    count: Count, n: Count, k: Count, times: Count, size: Count, order: Integers, which: Integers,
    rows: Reals, matrices: Reals, derivatives: Reals, deviations: Reals, with_derivatives: Count,
    deviating: Reals, products: Reals,
) -> None:  # fmt: skip
    at, spare = 0, times * size
    while at < count * times:
        row0, row1, row2, row3, together = _four(at, count, times, size, order, which)
        number = which[order[at // times]]
        _multiply_four(
            n, k, row0, row1, row2, row3, rows, number, matrices, row0,
            row1 if together > 1 else spare, row2 if together > 2 else spare + 1,
            row3 if together > 3 else spare + 2, products, 0, n, 0, k,
        )  # fmt: skip
        if with_derivatives:
            _multiply_four(
                n, k, row0, row1, row2, row3, rows, number, derivatives, 0, 1, 2, 3, deviating,
                0, n, 0, k,
            )  # fmt: skip
            for q in range(together):
                place = order[(at + q) // times]
                start = ((at + q) % times * size + place) * k
                for j in range(k):
                    products[start + j] += deviations[place] * deviating[q * k + j]
        at += together


def _four(
    at: Count, count: Count, times: Count, size: Count, order: Integers, which: Integers
) -> tuple[int, int, int, int, int]:
    """Return four rows of one matrix, the first again where there are fewer, and how many."""
    number, end, together = which[order[at // times]], count * times, 1
    row0 = at % times * size + order[at // times]
    row1 = row2 = row3 = row0
    if at + 1 < end and which[order[(at + 1) // times]] == number:
        row1, together = (at + 1) % times * size + order[(at + 1) // times], 2
        if at + 2 < end and which[order[(at + 2) // times]] == number:
            row2, together = (at + 2) % times * size + order[(at + 2) // times], 3
            if at + 3 < end and which[order[(at + 3) // times]] == number:
                row3, together = (at + 3) % times * size + order[(at + 3) // times], 4
    return row0, row1, row2, row3, together


@in_order
def _multiply_four(
    n: Count, k: Count, row0: Count, row1: Count, row2: Count, row3: Count, rows: Reals,
    number: Count, matrices: Reals, to0: Count, to1: Count, to2: Count, to3: Count, products: Reals,
    first: Count, end: Count, left: Count, right: Count,
) -> None:  # fmt: skip
    """Set four products, of four rows or the same.

    Of the matrix (n, k) the rows from ``first`` to ``end`` and columns from ``left`` to ``right``
    are not 0.
    """
    x0, x1, x2, x3 = row0 * n, row1 * n, row2 * n, row3 * n
    y0, y1, y2, y3 = to0 * k, to1 * k, to2 * k, to3 * k
    for j in range(k):
        products[y0 + j] = products[y1 + j] = products[y2 + j] = products[y3 + j] = 0.0
    matrix, whole = number * n * k, end - (end - first) % 4
    for i in range(first, whole, 4):
        a0, b0, c0, d0 = rows[x0 + i], rows[x0 + i + 1], rows[x0 + i + 2], rows[x0 + i + 3]
        a1, b1, c1, d1 = rows[x1 + i], rows[x1 + i + 1], rows[x1 + i + 2], rows[x1 + i + 3]
        a2, b2, c2, d2 = rows[x2 + i], rows[x2 + i + 1], rows[x2 + i + 2], rows[x2 + i + 3]
        a3, b3, c3, d3 = rows[x3 + i], rows[x3 + i + 1], rows[x3 + i + 2], rows[x3 + i + 3]
        m = matrix + i * k
        for j in range(left, right):
            a, b = matrices[m + j], matrices[m + k + j]
            c, d = matrices[m + 2 * k + j], matrices[m + 3 * k + j]
            products[y0 + j] = products[y0 + j] + a0 * a + b0 * b + c0 * c + d0 * d
            products[y1 + j] = products[y1 + j] + a1 * a + b1 * b + c1 * c + d1 * d
            products[y2 + j] = products[y2 + j] + a2 * a + b2 * b + c2 * c + d2 * d
            products[y3 + j] = products[y3 + j] + a3 * a + b3 * b + c3 * c + d3 * d
    for i in range(whole, end):
        a0, a1, a2, a3 = rows[x0 + i], rows[x1 + i], rows[x2 + i], rows[x3 + i]
        for j in range(left, right):
            a = matrices[matrix + i * k + j]
            products[y0 + j] += a0 * a
            products[y1 + j] += a1 * a
            products[y2 + j] += a2 * a
            products[y3 + j] += a3 * a


def pressures(
    count: Count, n: Count, rows: Integers, which: Integers, unknowns: Reals, per_scale: Reals,
    pressures: Reals,
) -> None:  # fmt: skip
    """Set pressures, compact, which are 0 where unknowns are negative."""
    for place in range(count):
        _set_pressures(
            n, rows[place], which[rows[place]], place * n, unknowns, per_scale, pressures
        )


def _set_pressures(
    n: Count, history: Count, compliance: Count, start: Count, unknowns: Reals, per_scale: Reals,
    pressures: Reals,
) -> None:  # fmt: skip
    for i in range(n):
        x = unknowns[history * n + i]
        pressures[start + i] = 0.0 if x <= 0.0 else x * per_scale[compliance * n + i]


def _set_gradient(
    n: Count, history: Count, place: Count, compliance: Count, gaps: Reals, approaches: Reals,
    depths: Reals, weights: Reals, products: Reals, gradients: Reals,
) -> None:  # fmt: skip
    row, start, approach = history * n, place * n, approaches[history]
    for i in range(n):
        gap = gaps[row + i] - approach + depths[start + i]
        gradients[row + i] = gap * weights[compliance * n + i] + products[row + i]


def evaluate(
    count: Count, n: Count, size: Count, order: Integers, places: Integers, references: Integers,
    which: Integers, unknowns: Reals, matrices: Reals, derivatives: Reals, deviations: Reals,
    with_derivatives: Count, deviating: Reals, products: Reals, with_products: Count, gaps: Reals,
    approaches: Reals, depths: Reals, weights: Reals, gradients: Reals, are_known: Flags,
    with_judgement: Count, diagonals: Reals, forces: Reals, with_forces: Count, free: Flags,
    residuals: Reals, are_settled: Flags, are_broken: Flags, counts: Integers, cleared: Integers,
    round_off: Real, gradient_tolerance: Real, force_tolerance: Real,
) -> None:  # fmt: skip
    """Set gradients, the weighted gaps, and with products A q before, which then are known.

    The ``order`` (count,) of histories should be by ``references`` (size,); depths of wear,
    compact, have their ``places``. After A q there is room for 3 rows; ``deviating`` is for 4.

    With judgement set which histories, compact, have settled and are not finite, and how many. They
    have settled where they keep their sets and are optimal on these: the natural residual
    min(g, diag(H) x) is small against the overlap of the bodies, or at the round-off of x, and the
    force is met. ``residuals`` are relative to the largest unknowns. The sets of others become
    those of the signs; unknowns that leave them become 0, and gradients those there, with the wear
    of before. Unknowns that are no numbers become 0, and their products are not known. There is
    room for ``cleared`` (2, size).
    """
    if with_products:
        _multiply(
            count, n, n, 1, size, order, references, unknowns, matrices, derivatives, deviations,
            with_derivatives, deviating, products,
        )  # fmt: skip
    n_settled, n_broken, n_cleared = 0, 0, 0
    for k in range(count):
        history, place = order[k], places[k]
        _set_gradient(
            n, history, place, which[history], gaps, approaches, depths, weights, products,
            gradients,
        )  # fmt: skip
        are_known[history] = True
        if with_judgement:
            settled, broken, is_cleared = _settle(
                n, history, which[history], unknowns, gradients, diagonals, weights, gaps,
                approaches[history], forces[history], with_forces, free, residuals, round_off,
                gradient_tolerance, force_tolerance,
            )  # fmt: skip
            are_settled[place], are_broken[place], are_known[history] = settled, broken, not broken
            n_settled, n_broken = n_settled + settled, n_broken + broken
            if broken:
                for i in range(history * n, history * n + n):
                    unknowns[i] = 0.0
            if is_cleared:
                cleared[n_cleared], cleared[size + n_cleared] = history, place
                n_cleared = n_cleared + 1
    if n_cleared > 0:
        _multiply(
            n_cleared, n, n, 1, size, cleared, references, unknowns, matrices, derivatives,
            deviations, with_derivatives, deviating, products,
        )  # fmt: skip
    for k in range(n_cleared):
        history = cleared[k]
        _set_gradient(
            n, history, cleared[size + k], which[history], gaps, approaches, depths, weights,
            products, gradients,
        )  # fmt: skip
    counts[0], counts[1] = n_settled, n_broken


def _settle(
    n: Count, history: Count, compliance: Count, unknowns: Reals, gradients: Reals,
    diagonals: Reals, weights: Reals, gaps: Reals, approach: Real, force: Real, with_forces: Count,
    free: Flags, residuals: Reals, round_off: Real, gradient_tolerance: Real,
    force_tolerance: Real,
) -> tuple[bool, bool, bool]:  # fmt: skip
    """Return whether a history has settled, is not finite, and has unknowns that became 0."""
    row = history * n
    worst, most, same = 0.0, 0.0, True
    defects, overlaps, carried, total = 0.0, 0.0, 0.0, 0.0
    for i in range(n):
        k, weight = row + i, weights[compliance * n + i]
        x, diagonal = unknowns[k], diagonals[k]
        natural = min(x, gradients[k] / diagonal)
        overlap = max(approach - gaps[k], 0.0) * weight
        defects += natural * diagonal * natural * diagonal
        overlaps += overlap * overlap
        carried += weight * x
        total += x + gradients[k] + diagonal  # comparisons do not see what is no number
    for k in range(row, row + n):
        x, gradient = unknowns[k], gradients[k]
        worst = max(worst, abs(min(x, gradient / diagonals[k])))
        most = max(most, x)
        same = same and (x > 0.0 if free[k] else gradient >= 0.0)
    broken = not math.isfinite(total + carried + worst)
    # where wear makes the diagonal large, round-off in x is more than the tolerance in g
    fine = worst <= round_off * most or math.sqrt(defects) <= (
        gradient_tolerance * math.sqrt(overlaps)
    )
    if with_forces:
        fine = fine and abs(carried - force) <= force_tolerance * force
    residuals[history] = worst / most if most > 0.0 else math.inf
    cleared = False
    if not same and not broken:
        for k in range(row, row + n):
            keep = unknowns[k] > 0.0 if free[k] else gradients[k] < 0.0
            free[k] = keep
            if not keep and unknowns[k] != 0.0:
                unknowns[k] = 0.0
                cleared = True
    return fine and same and not broken, broken, cleared


def set_slopes(
    count: Count, n: Count, rows: Integers, which: Integers, depth_slopes: Reals,
    slope_scale: Reals, slopes: Reals, diagonals: Reals, are_valid: Flags,
) -> None:  # fmt: skip
    """Set slopes from those of depths, compact; inverses of others are no longer valid."""
    for place in range(count):
        _set_slopes(
            n, rows[place], place, which[rows[place]], depth_slopes, slope_scale, slopes,
            diagonals, are_valid,
        )  # fmt: skip


def _set_slopes(
    n: Count, history: Count, place: Count, compliance: Count, depth_slopes: Reals,
    slope_scale: Reals, slopes: Reals, diagonals: Reals, are_valid: Flags,
) -> None:  # fmt: skip
    row, start, same = history * n, place * n, True
    for i in range(n):
        slope = depth_slopes[start + i] * slope_scale[compliance * n + i]
        same = same and slope == slopes[row + i]
    if not same:
        are_valid[history] = False
        for i in range(n):
            slope = depth_slopes[start + i] * slope_scale[compliance * n + i]
            slopes[row + i] = slope
            diagonals[row + i] = 1.0 + slope


def compare_slopes(
    count: Count, n: Count, rows: Integers, which: Integers, slopes: Reals, per_speed: Reals,
    free: Flags, are_valid: Flags, free_before: Flags, wearing_before: Flags, rates: Reals,
    are_new: Flags, have_new_sets: Flags, are_regular: Flags, round_off: Real,
) -> None:  # fmt: skip
    """Set which histories, compact, need a new inverse, with its rate and its sets.

    Slopes are regular where they are one rate, compact, times the speed of elements that wear;
    others have the middle between their least and their largest. Elements in contact and those of
    them that wear become those before.
    """
    for place in range(count):
        rates[place], are_new[place], have_new_sets[place] = _compare_slopes(
            n, rows[place], which[rows[place]], slopes, per_speed, free, are_valid, free_before,
            wearing_before, are_regular, round_off,
        )  # fmt: skip


def _compare_slopes(
    n: Count, history: Count, compliance: Count, slopes: Reals, per_speed: Reals, free: Flags,
    are_valid: Flags, free_before: Flags, wearing_before: Flags, are_regular: Flags,
    round_off: Real,
) -> tuple[float, bool, bool]:  # fmt: skip
    """Return the rate of a history, and whether it needs a new inverse, and one of new sets."""
    row, same = history * n, True
    for k in range(row, row + n):
        same = same and free[k] == free_before[k]
    if same and are_valid[history]:
        return 0.0, False, False
    most, least = 0.0, math.inf
    for i in range(n):
        rate = slopes[row + i] * per_speed[compliance * n + i]
        if free[row + i] and rate > 0.0:
            most = max(most, rate)
            least = min(least, rate)
    regular = least >= (1.0 - round_off) * most
    # without regular wear as if all wore, so as not to need another basis
    every = most == 0.0 or not regular
    for k in range(row, row + n):
        wears = free[k] and (every or slopes[k] > 0.0)
        same = same and wears == wearing_before[k]
        free_before[k], wearing_before[k] = free[k], wears
    are_regular[history] = regular
    return most if regular else 0.5 * (most + least), True, not same


def invert(
    count: Count, n: Count, rows: Integers, numbers: Integers, rates: Reals, values: Reals,
    bends: Reals, deviations: Reals, forces: Reals, inverses: Reals, responses: Reals,
    stiffness: Reals,
) -> None:  # fmt: skip
    """Set the inverses 1 / (1 + rate mu + deviation K'_ii) in bases, and responses to approaches.

    Bases have ``values`` mu, ``bends`` K'_ii and ``forces``, (m, n); rates are compact.
    """
    for place in range(count):
        _invert(
            n, rows[place], numbers[rows[place]], rates[place], values, bends, deviations, forces,
            inverses, responses, stiffness,
        )  # fmt: skip


def _invert(
    n: Count, history: Count, number: Count, rate: Real, values: Reals, bends: Reals,
    deviations: Reals, forces: Reals, inverses: Reals, responses: Reals, stiffness: Reals,
) -> None:  # fmt: skip
    row, basis, carried, deviation = history * n, number * n, 0.0, deviations[history]
    for i in range(n):
        inverse = 1.0 / (1.0 + rate * values[basis + i] + deviation * bends[basis + i])
        inverses[row + i], responses[row + i] = inverse, inverse * forces[basis + i]
    for i in range(n):
        carried += forces[basis + i] * responses[row + i]
    stiffness[history] = carried


def take_steps(
    count: Count, n: Count, size: Count, rows: Integers, order: Integers, every: Integers,
    which: Integers, depth_slopes: Reals, slope_scale: Reals, slopes: Reals, diagonals: Reals,
    per_speed: Reals, free: Flags, are_valid: Flags, free_before: Flags, wearing_before: Flags,
    rates: Reals, are_new: Flags, have_new_sets: Flags, are_regular: Flags, round_off: Real,
    in_bases: Count, through_layers: Count, are_inverted: Count, numbers: Integers, values: Reals,
    extents: Integers, psi: Reals, psi_t: Reals, derivatives: Reals, bends: Reals,
    basis_forces: Reals, deviations: Reals, inverses: Reals, responses: Reals, stiffness: Reals,
    factors: Reals, references: Integers, reference_weights: Reals, tolerance: Real,
    regular_tolerance: Real, most: Count, unknowns: Reals, gradients: Reals, approaches: Reals,
    are_known: Flags, weights: Reals, roots: Reals, forces: Reals, with_forces: Count,
    missing: Reals, per_scale: Reals, pressures: Reals, are_left: Flags, n_left: Integers,
    ready: Integers, factored: Integers, room: Reals, sizes: Reals, steps: Reals, changes: Reals,
) -> None:  # fmt: skip
    """Set slopes, and take the steps of histories in bases they have, or by their factors.

    ``n_left`` (1,) others, compact, are left, with what ``compare_slopes`` says of them: those that
    need another basis or factor, unless inverses are what they have to be. The ``order`` (count,)
    of rows is by ``numbers`` (size,) of bases; ``every`` are all histories (size,). There is room
    for forces that are ``missing``, and histories that are ``ready`` and ``factored``, (size,); for
    the rest see ``steps``.
    """
    left, n_ready, n_factored = 0, 0, 0
    for k in range(count):
        place = order[k]
        history, compliance = rows[place], which[rows[place]]
        _set_slopes(
            n, history, place, compliance, depth_slopes, slope_scale, slopes, diagonals, are_valid
        )
        rate, is_new, has_new_sets = _compare_slopes(
            n, history, compliance, slopes, per_speed, free, are_valid, free_before, wearing_before,
            are_regular, round_off,
        )  # fmt: skip
        rates[place], are_new[place], have_new_sets[place] = rate, is_new, has_new_sets
        number, carried = numbers[history], 0.0
        for i in range(n):
            carried += weights[compliance * n + i] * unknowns[history * n + i]
        missing[history], are_known[history] = forces[history] - carried, False
        by_factor = number < 0 or (through_layers and not are_regular[history])
        is_left = not are_inverted and (not in_bases or has_new_sets or (is_new and by_factor))
        are_left[place] = is_left
        if is_left:
            left += 1
        elif number < 0:
            factored[n_factored] = history
            n_factored += 1
        else:
            if is_new and not are_inverted:
                are_valid[history] = True
                _invert(
                    n, history, number, rate, values, bends, deviations, basis_forces, inverses,
                    responses, stiffness,
                )  # fmt: skip
            ready[n_ready] = history
            n_ready += 1
    _steps_in_bases(
        n_ready, n, 1, size, ready, every, numbers, extents, psi, psi_t, derivatives, bends,
        basis_forces, slopes, are_regular, deviations, inverses, responses, stiffness, tolerance,
        regular_tolerance, most, missing, with_forces, gradients, which, weights, per_scale, roots,
        False, room, sizes, steps, changes,
    )  # fmt: skip
    _steps_by_factors(
        n_factored, n, 1, size, factored, every, factors, responses, stiffness, references,
        reference_weights, missing, with_forces, gradients, which, weights, per_scale, roots, False,
        room, steps, changes,
    )  # fmt: skip
    for k in range(count):
        place = order[k]
        history = rows[place]
        if not are_left[place]:
            approaches[history] += changes[history]
            for i in range(history * n, history * n + n):
                unknowns[i] += steps[i]
            _set_pressures(n, history, which[history], place * n, unknowns, per_scale, pressures)
    n_left[0] = left


def factorise(
    count: Count, n: Count, rows: Integers, which: Integers, references: Integers, matrices: Reals,
    deviations: Reals, derivatives: Reals, with_derivatives: Count, slopes: Reals, coupling: Reals,
    with_coupling: Count, free: Flags, weights: Reals, factors: Reals, responses: Reals,
    stiffness: Reals, work: Reals,
) -> None:  # fmt: skip
    """Set inverses of the lower Cholesky factors of Hessians, and how they respond to an approach.

    ``factors`` are (B, n, n), without their upper triangles; NaN of what is not positive definite.
    ``weights`` (f, n) are those of the ``references`` (m,) of the compliances, ``work`` is room for
    (n, 2 n).
    """
    for place in range(count):
        history = rows[place]
        row, reference, deviation = history * n, references[which[history]], deviations[history]
        for i in range(n):
            at, line = 2 * i * n, (reference * n + i) * n
            for j in range(n):
                work[at + j] = matrices[line + j]
                work[at + n + j] = 0.0
            if with_derivatives:
                for j in range(n):
                    work[at + j] += deviation * derivatives[line + j]
            if with_coupling:
                for j in range(n):
                    work[at + j] += coupling[(row + j) * n + i]
            work[at + i] += slopes[row + i]
            for j in range(n):
                if j != i and not (free[row + i] and free[row + j]):
                    work[at + j] = 0.0
        _eliminate(n, work)
        for i in range(n):
            line, at = (row + i) * n, 2 * i * n + n
            for j in range(i + 1):
                factors[line + j] = work[at + j] if free[row + i] else 0.0
        _solve(n, row * n, factors, reference * n, weights, row, responses)
        carried = 0.0
        for i in range(n):
            carried += weights[reference * n + i] * responses[row + i]
        stiffness[history] = carried


@in_order
def _eliminate(n: Count, work: Reals) -> None:
    """Make (L', L^-1) of a matrix L L' and zeros, (n, 2 n), row by row, four earlier at a time."""
    width = 2 * n
    for j in range(n):
        row, i = j * width, 0
        while i < j:
            p = i * width
            if i + 4 <= j:
                q, r, s = p + width, p + 2 * width, p + 3 * width
                a, b, c, d = work[p + j], work[q + j], work[r + j], work[s + j]
                for k in range(j, n + i + 4):
                    less = a * work[p + k] + b * work[q + k] + c * work[r + k] + d * work[s + k]
                    work[row + k] -= less
                i += 4
            else:
                a = work[p + j]
                for k in range(j, n + i + 1):
                    work[row + k] -= a * work[p + k]
                i += 1
        work[row + n + j] = 1.0
        root = 1.0 / math.sqrt(work[row + j])
        for k in range(row + j, row + n + j + 1):
            work[k] *= root


def _solve(
    n: Count, start: Count, factors: Reals, at: Count, sides: Reals, to: Count, solutions: Reals
) -> None:
    """Set the solution of one system from the inverse of its factor."""
    for i in range(n):
        solutions[to + i] = 0.0
    for i in range(n):
        line, product = start + i * n, 0.0
        for j in range(i + 1):
            product += factors[line + j] * sides[at + j]
        for j in range(i + 1):
            solutions[to + j] += product * factors[line + j]


def steps(
    count: Count, n_factored: Count, n: Count, times: Count, size: Count, in_bases: Integers,
    factored: Integers, histories: Integers, numbers: Integers, extents: Integers, psi: Reals,
    psi_t: Reals, derivatives: Reals, bends: Reals, forces: Reals, slopes: Reals,
    are_regular: Flags, deviations: Reals, inverses: Reals, responses: Reals, stiffness: Reals,
    factors: Reals, references: Integers, reference_weights: Reals, tolerance: Real,
    regular_tolerance: Real,
    most: Count, missing: Reals, with_missing: Count, gradients: Reals, which: Integers,
    weights: Reals, per_scale: Reals, roots: Reals, with_scales: Count, room: Reals, sizes: Reals,
    steps: Reals, changes: Reals,
) -> None:  # fmt: skip
    """Set steps of histories that have bases, and of those that have factors, as below."""
    _steps_in_bases(
        count - n_factored, n, times, size, in_bases, histories, numbers, extents, psi, psi_t,
        derivatives, bends, forces, slopes, are_regular, deviations, inverses, responses, stiffness,
        tolerance, regular_tolerance, most, missing, with_missing, gradients, which, weights,
        per_scale, roots, with_scales, room, sizes, steps, changes,
    )  # fmt: skip
    _steps_by_factors(
        n_factored, n, times, size, factored, histories, factors, responses, stiffness, references,
        reference_weights, missing, with_missing, gradients, which, weights, per_scale, roots,
        with_scales, room, steps, changes,
    )  # fmt: skip


def _steps_by_factors(
    count: Count, n: Count, times: Count, size: Count, order: Integers, histories: Integers,
    factors: Reals, responses: Reals, stiffness: Reals, references: Integers,
    reference_weights: Reals, missing: Reals, with_missing: Count, gradients: Reals,
    which: Integers, weights: Reals, per_scale: Reals, roots: Reals, with_scales: Count,
    scaled: Reals, steps: Reals, changes: Reals,
) -> None:  # fmt: skip
    """Set steps against gradients (times, size, n), and of approaches, as in bases.

    ``scaled`` is room for a row.
    """
    for at in range(count * times):
        place = order[at // times]
        into, history, compliance = at % times * size + place, histories[place], which[place] * n
        start, row, change = into * n, history * n, 0.0
        for i in range(n):
            side = gradients[start + i]
            scaled[i] = side * weights[compliance + i] if with_scales else side
        _solve(n, row * n, factors, 0, scaled, start, steps)
        if with_missing and stiffness[history] > 0.0:
            carried, reference = 0.0, references[which[place]] * n
            for i in range(n):
                carried += reference_weights[reference + i] * steps[start + i]
            change = (missing[into] * roots[which[place]] + carried) / stiffness[history]
        for i in range(n):
            step = change * responses[row + i] - steps[start + i]
            steps[start + i] = step * per_scale[compliance + i] if with_scales else step
        changes[into] = change * roots[which[place]]


def _steps_in_bases(
    count: Count, n: Count, times: Count, size: Count, order: Integers, histories: Integers,
    numbers: Integers, extents: Integers, psi: Reals, psi_t: Reals, derivatives: Reals,
    bends: Reals, forces: Reals, slopes: Reals, are_regular: Flags, deviations: Reals,
    inverses: Reals, responses: Reals, stiffness: Reals, tolerance: Real, regular_tolerance: Real,
    most: Count, missing: Reals, with_missing: Count, gradients: Reals, which: Integers,
    weights: Reals, per_scale: Reals, roots: Reals, with_scales: Count, room: Reals, sizes: Reals,
    steps: Reals, changes: Reals,
) -> None:  # fmt: skip
    """Set steps against gradients (times, size, n), and of approaches, by way of bases (m, n, n).

    Gradients are of the ``histories`` (size,), those of the ``order`` (count,) of places are solved
    in the bases ``numbers`` (size,), four of a basis at a time; these have ``extents`` (m, 3): how
    many columns of theirs, and from where to where rows, are not 0. Steps carry the forces that are
    missing (times, size), where these are given, which are ``roots`` (m,) times as large by the
    weights of references. With scales these are gaps and pressures instead. After the steps there
    is room for 3 rows.

    Where slopes are not regular or compliances deviate, Hessians 1 + Psi' slope Psi + deviation K'
    are not diagonal there: inverses precondition projected conjugate gradients, up to ``most``
    iterations, until residuals are below a tolerance relative to the first. The change of approach
    is the multiplier of the condition that the force stays. There is ``room`` for (24, n), and of
    ``sizes`` for 8.
    """
    at, spare = 0, times * size
    while at < count * times:
        row0, row1, row2, row3, together = _four(at, count, times, size, order, numbers)
        number = numbers[order[at // times]]
        m, first, end = extents[3 * number], extents[3 * number + 1], extents[3 * number + 2]
        if with_scales:
            for q in range(together):
                place = order[(at + q) // times]
                start, compliance = ((at + q) % times * size + place) * n, which[place] * n
                for i in range(n):
                    room[q * n + i] = gradients[start + i] * weights[compliance + i]
            _multiply_four(n, n, 0, 1, 2, 3, room, number, psi, 4, 5, 6, 7, room, first, end, 0, m)
        else:
            _multiply_four(
                n, n, row0, row1, row2, row3, gradients, number, psi, 4, 5, 6, 7, room,
                first, end, 0, m,
            )  # fmt: skip
        bent, deviating = False, False
        for q in range(together):
            place = order[(at + q) // times]
            history, into, local = histories[place], (at + q) % times * size + place, q * n
            row, basis, change, size_q = history * n, number * n, 0.0, 0.0
            if with_missing and stiffness[history] > 0.0:
                for i in range(m):
                    change += responses[row + i] * room[4 * n + local + i]
                change = (missing[into] * roots[which[place]] + change) / stiffness[history]
            for i in range(m):
                room[4 * n + local + i] = change * forces[basis + i] - room[4 * n + local + i]
            for i in range(m):
                room[local + i] = room[4 * n + local + i] * inverses[row + i]
            changes[into] = change
            regular, deviates = are_regular[history], deviations[history] != 0.0
            sizes[q] = 0.0
            if not regular or deviates:
                for i in range(m):
                    size_q += inverses[row + i] * room[4 * n + local + i] * room[4 * n + local + i]
                sizes[q], share = size_q, regular_tolerance if regular else tolerance
                sizes[4 + q] = share * share * size_q
            bent, deviating = bent or not regular, deviating or deviates
        if bent or deviating:
            _conjugate_gradients(
                at, together, n, times, number, order, histories, m, first, end, psi, psi_t,
                derivatives, bends, forces, slopes, bent, are_regular, deviating, deviations,
                inverses, responses, stiffness, with_missing, most, size, room, sizes, changes,
            )  # fmt: skip
        _multiply_four(
            n, n, 0, 1, 2, 3, room, number, psi_t, row0, row1 if together > 1 else spare,
            row2 if together > 2 else spare + 1, row3 if together > 3 else spare + 2, steps,
            0, m, first, end,
        )  # fmt: skip
        for q in range(together):
            place = order[(at + q) // times]
            into, compliance = (at + q) % times * size + place, which[place] * n
            changes[into] *= roots[which[place]]
            if with_scales:
                for i in range(n):
                    steps[into * n + i] *= per_scale[compliance + i]
        at += together


def _conjugate_gradients(
    at: Count, together: Count, n: Count, times: Count, number: Count, order: Integers,
    histories: Integers, m: Count, first: Count, end: Count, psi: Reals, psi_t: Reals,
    derivatives: Reals, bends: Reals, forces: Reals, slopes: Reals, bent: Count,
    are_regular: Flags, deviating: Count, deviations: Reals, inverses: Reals, responses: Reals,
    stiffness: Reals, with_missing: Count, most: Count, size: Count, room: Reals, sizes: Reals,
    changes: Reals,
) -> None:  # fmt: skip
    """Go on from the steps of diagonal Hessians to those of the others."""
    for i in range(4 * n):
        room[8 * n + i] = room[i]
    for iteration in range(most + 1):
        if bent:
            _multiply_four(
                n, n, 8, 9, 10, 11, room, number, psi_t, 12, 13, 14, 15, room, 0, m, first, end
            )
            for q in range(together):
                row = histories[order[(at + q) // times]] * n
                for i in range(first, end):
                    room[(12 + q) * n + i] *= slopes[row + i]
            _multiply_four(
                n, n, 12, 13, 14, 15, room, number, psi, 16, 17, 18, 19, room, first, end, 0, m
            )
        if deviating:
            _multiply_four(
                n, n, 8, 9, 10, 11, room, number, derivatives, 20, 21, 22, 23, room, 0, m, 0, m
            )
        going = False
        for q in range(together):
            if not sizes[q] > sizes[4 + q]:
                continue
            place = order[(at + q) // times]
            history, into = histories[place], (at + q) % times * size + place
            row, basis, deviation = history * n, number * n, deviations[history]
            x, r, d, t, g = q * n, (4 + q) * n, (8 + q) * n, (16 + q) * n, (20 + q) * n
            length, curvature, carried, norm = 1.0, 0.0, 0.0, 0.0
            if are_regular[history]:
                for i in range(m):
                    room[t + i] = room[d + i] / inverses[row + i]
            else:
                for i in range(m):
                    room[t + i] += room[d + i] * (1.0 + deviation * bends[basis + i])
            if deviating:
                for i in range(m):
                    room[t + i] += deviation * room[g + i]
            if iteration > 0:
                for i in range(m):
                    curvature += room[d + i] * room[t + i]
                length = sizes[q] / curvature if curvature > 0.0 else 0.0
                for i in range(m):
                    room[x + i] += length * room[d + i]
            for i in range(m):
                room[r + i] -= length * room[t + i]
            if with_missing and stiffness[history] > 0.0:
                for i in range(m):
                    carried += responses[row + i] * room[r + i]
                carried /= stiffness[history]
                for i in range(m):
                    room[r + i] -= carried * forces[basis + i]
                changes[into] -= carried
            for i in range(m):
                norm += inverses[row + i] * room[r + i] * room[r + i]
            again = norm / sizes[q] if iteration > 0 else 0.0
            for i in range(m):
                room[d + i] = again * room[d + i] + inverses[row + i] * room[r + i]
            sizes[q] = norm
            going = going or norm > sizes[4 + q]
        if not going:
            break


def propagate_errors(
    count: Count, n: Count, size: Count, order: Integers, numbers: Integers, extents: Integers,
    psi: Reals, psi_t: Reals, forces: Reals, are_regular: Flags, deviations: Reals,
    inverses: Reals, responses: Reals, stiffness: Reals, with_forces: Count, slopes: Reals,
    which: Integers,
    slope_scale: Reals, weights: Reals, per_scale: Reals, lengths: Reals, rates: Reals,
    in_first: Reals, in_last: Reals, before: Reals, closing: Flags, with_closing: Count,
    depth_slopes: Reals, error_weights: Reals, gamma: Real, bend_factor: Real,
    factor_before: Real, ready: Integers, left: Integers, n_left: Integers, room: Reals,
    reliefs: Reals, defects: Reals, totals: Reals, largest: Reals,
) -> None:  # fmt: skip
    """Do ``rate_errors``, ``propagate`` and ``sum_errors`` of steps in their bases.

    What slopes times a response to gaps add is diagonal there, so that another response is
    y' = (1 - P) y, P being the inverses with forces kept. ``n_left`` (1,) of the ``order`` (count,)
    are left: those that have no basis, or slopes that are no longer those of a diagonal Hessian.
    ``room`` is for (24, n), and after the reliefs for 3 rows.
    """
    n_ready, skipped = 0, 0
    for k in range(count):
        history = order[k]
        row, scale, changed = history * n, which[history] * n, 0
        diagonal = numbers[history] >= 0 and are_regular[history] and deviations[history] == 0.0
        for i in range(n):
            slope = depth_slopes[row + i] * slope_scale[scale + i]
            changed += 0 if slope == slopes[row + i] else 1
        if diagonal and changed == 0:
            ready[n_ready] = history
            n_ready += 1
        else:
            left[skipped] = history
            skipped += 1
    n_left[0] = skipped
    at_start, at_first, at_last = (
        error_weights[0],
        error_weights[1] / gamma,
        error_weights[2] / gamma,
    )
    at, all_rows, per_gamma = 0, size * n, 1.0 / gamma
    while at < n_ready:
        row0, row1, row2, row3, together = _four(at, n_ready, 1, size, ready, numbers)
        number = numbers[row0]
        m, first, end = extents[3 * number], extents[3 * number + 1], extents[3 * number + 2]
        for q in range(together):
            history, place = ready[at + q], q * n
            row, scale, length = history * n, which[history] * n, lengths[history]
            for i in range(n):
                k, weight = row + i, weights[scale + i]
                start, last = length * (rates[k] + rates[all_rows + k]), in_last[k]
                error = at_start * start + at_first * in_first[k] + at_last * last
                bend = last * per_gamma - start
                if with_closing and closing[k]:
                    error = bend = 0.0
                defects[k], room[place + i] = error, error * weight
                room[4 * n + place + i] = bend * weight
                room[8 * n + place + i] = before[k] * weight
        for rows in range(0, 12, 4):
            _multiply_four(
                n, n, rows, rows + 1, rows + 2, rows + 3, room, number, psi, rows + 12, rows + 13,
                rows + 14, rows + 15, room, first, end, 0, m,
            )  # fmt: skip
        for q in range(together):
            history, basis = ready[at + q], number * n
            row, keeps = history * n, with_forces and stiffness[history] > 0.0
            for rows in range(q * n, 12 * n, 4 * n):
                change, again = 0.0, 0.0
                if keeps:
                    for i in range(m):
                        change += responses[row + i] * room[12 * n + rows + i]
                    change /= stiffness[history]
                for i in range(m):
                    room[rows + i] = inverses[row + i] * (
                        change * forces[basis + i] - room[12 * n + rows + i]
                    )
                if keeps and rows >= 4 * n:
                    for i in range(m):
                        again += responses[row + i] * room[rows + i]
                    again /= stiffness[history]
                for i in range(m):
                    room[12 * n + rows + i] = inverses[row + i] * (
                        room[rows + i] - again * forces[basis + i]
                    )
            for i in range(q * n, (q + 1) * n):
                room[4 * n + i] = room[i] + bend_factor * room[16 * n + i]
                room[8 * n + i] += factor_before * room[20 * n + i]
        _multiply_four(
            n, n, 0, 1, 2, 3, room, number, psi_t, row0, row1 if together > 1 else size,
            row2 if together > 2 else size + 1, row3 if together > 3 else size + 2, reliefs,
            0, m, first, end,
        )  # fmt: skip
        for rows in (4, 8):
            _multiply_four(
                n, n, rows, rows + 1, rows + 2, rows + 3, room, number, psi_t, rows + 8, rows + 9,
                rows + 10, rows + 11, room, 0, m, first, end,
            )  # fmt: skip
        for q in range(together):
            history, step, earlier = ready[at + q], (12 + q) * n, (16 + q) * n
            row, scale = history * n, which[history] * n
            step_error, history_error, earlier_error, total = 0.0, 0.0, 0.0, 0.0
            for i in range(n):
                k, per = row + i, per_scale[scale + i]
                slope = depth_slopes[k] * per
                reliefs[k] *= per
                defects[k] += slope * room[step + i]
                room[earlier + i] = before[k] + slope * room[earlier + i]
                totals[k] = defects[k] + room[earlier + i]
            for i in range(n):
                step_error = max(step_error, abs(defects[row + i]))
                history_error = max(history_error, abs(totals[row + i]))
                earlier_error = max(earlier_error, abs(room[earlier + i]))
                total += totals[row + i]
            if not math.isfinite(total):  # comparisons do not see what is no number
                step_error = history_error = earlier_error = math.nan
            largest[history], largest[size + history] = step_error, history_error
            largest[2 * size + history] = earlier_error
        at += together


def correction_errors(
    count: Count, n: Count, which: Integers, before: Reals, after: Reals, stiffness: Reals,
    pressures: Reals, forces: Reals, area: Real, errors: Reals, elements: Integers,
) -> None:  # fmt: skip
    """Set the largest errors of pressures for changes of gaps, each element alone, and where.

    Relative to the pressure or to the mean on the whole area, whichever is larger.
    """
    for history in range(count):
        largest, element, mean = 0.0, 0, max(forces[history] / area, 1e-300)
        for i in range(n):
            k, stiff = history * n + i, stiffness[which[history] * n + i]
            error = abs(after[k] - before[k]) * stiff / max(pressures[k], mean)
            if error > largest or (math.isnan(error) and not math.isnan(largest)):
                largest, element = error, i
        errors[history] = math.nan if math.isnan(forces[history]) else largest
        elements[history] = element
