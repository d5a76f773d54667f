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
    at, spare = 0, times * size
    while at < count * times:
        row0, row1, row2, row3, together = _four(at, count, times, size, order, which)
        number = which[order[at // times]]
        _multiply_four(
            n, k, row0, row1, row2, row3, rows, number, matrices, row0,
            row1 if together > 1 else spare, row2 if together > 2 else spare + 1,
            row3 if together > 3 else spare + 2, products,
        )  # fmt: skip
        if with_derivatives:
            _multiply_four(
                n, k, row0, row1, row2, row3, rows, number, derivatives, 0, 1, 2, 3, deviating
            )
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
) -> None:  # fmt: skip
    """Set four products, of four rows or the same."""
    x0, x1, x2, x3 = row0 * n, row1 * n, row2 * n, row3 * n
    y0, y1, y2, y3 = to0 * k, to1 * k, to2 * k, to3 * k
    for j in range(k):
        products[y0 + j] = products[y1 + j] = products[y2 + j] = products[y3 + j] = 0.0
    matrix, whole = number * n * k, n // 4 * 4
    for i in range(0, whole, 4):
        a0, b0, c0, d0 = rows[x0 + i], rows[x0 + i + 1], rows[x0 + i + 2], rows[x0 + i + 3]
        a1, b1, c1, d1 = rows[x1 + i], rows[x1 + i + 1], rows[x1 + i + 2], rows[x1 + i + 3]
        a2, b2, c2, d2 = rows[x2 + i], rows[x2 + i + 1], rows[x2 + i + 2], rows[x2 + i + 3]
        a3, b3, c3, d3 = rows[x3 + i], rows[x3 + i + 1], rows[x3 + i + 2], rows[x3 + i + 3]
        m = matrix + i * k
        for j in range(k):
            a, b = matrices[m + j], matrices[m + k + j]
            c, d = matrices[m + 2 * k + j], matrices[m + 3 * k + j]
            products[y0 + j] = products[y0 + j] + a0 * a + b0 * b + c0 * c + d0 * d
            products[y1 + j] = products[y1 + j] + a1 * a + b1 * b + c1 * c + d1 * d
            products[y2 + j] = products[y2 + j] + a2 * a + b2 * b + c2 * c + d2 * d
            products[y3 + j] = products[y3 + j] + a3 * a + b3 * b + c3 * c + d3 * d
    for i in range(whole, n):
        a0, a1, a2, a3 = rows[x0 + i], rows[x1 + i], rows[x2 + i], rows[x3 + i]
        for j in range(k):
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


def _product_four(
    n: Count, row0: Count, row1: Count, row2: Count, row3: Count, to1: Count, to2: Count,
    to3: Count, reference: Count, unknowns: Reals, matrices: Reals, derivatives: Reals,
    with_derivatives: Count, deviations: Reals, deviating: Reals, products: Reals,
) -> None:  # fmt: skip
    """Set A q of four rows or the same, of which the first is sure to be set in its place."""
    _multiply_four(
        n, n, row0, row1, row2, row3, unknowns, reference, matrices, row0, to1, to2, to3, products
    )
    if with_derivatives:
        _multiply_four(
            n, n, row0, row1, row2, row3, unknowns, reference, derivatives, 0, 1, 2, 3, deviating
        )
        for i in range(n):
            products[row0 * n + i] += deviations[row0] * deviating[i]
            if to1 == row1:
                products[row1 * n + i] += deviations[row1] * deviating[n + i]
            if to2 == row2:
                products[row2 * n + i] += deviations[row2] * deviating[2 * n + i]
            if to3 == row3:
                products[row3 * n + i] += deviations[row3] * deviating[3 * n + i]


def _set_gradient(
    n: Count, history: Count, place: Count, compliance: Count, gaps: Reals, approaches: Reals,
    depths: Reals, weights: Reals, products: Reals, gradients: Reals,
) -> None:  # fmt: skip
    row, start, approach = history * n, place * n, approaches[history]
    for i in range(n):
        gap = gaps[row + i] - approach + depths[start + i]
        gradients[row + i] = gap * weights[compliance * n + i] + products[row + i]


def evaluate(
    count: Count, n: Count, size: Count, histories: Integers, places: Integers,
    references: Integers, which: Integers, unknowns: Reals, matrices: Reals, derivatives: Reals,
    with_derivatives: Count, deviations: Reals, deviating: Reals, products: Reals,
    with_products: Count, gaps: Reals, approaches: Reals, depths: Reals, weights: Reals,
    gradients: Reals, are_known: Flags,
) -> None:  # fmt: skip
    """Set gradients, the weighted gaps, and with products A q before, which then are known.

    ``histories`` (count,) should be in the order of their ``references`` (size,); depths of wear,
    compact, have their ``places``. After A q there is room for 3 rows; ``deviating`` is for 4.
    """
    at = 0
    while at < count:
        row0, row1, row2, row3, together = _four(at, count, 1, size, histories, references)
        if with_products:
            _product_four(
                n, row0, row1, row2, row3, row1 if together > 1 else size,
                row2 if together > 2 else size + 1, row3 if together > 3 else size + 2,
                references[row0], unknowns, matrices, derivatives, with_derivatives, deviations,
                deviating, products,
            )  # fmt: skip
        for q in range(together):
            history = histories[at + q]
            are_known[history] = True
            _set_gradient(
                n, history, places[at + q], which[history], gaps, approaches, depths, weights,
                products, gradients,
            )  # fmt: skip
        at += together


def judge(
    count: Count, n: Count, size: Count, histories: Integers, places: Integers,
    references: Integers, which: Integers, unknowns: Reals, matrices: Reals, derivatives: Reals,
    with_derivatives: Count, deviations: Reals, deviating: Reals, products: Reals, gaps: Reals,
    approaches: Reals, depths: Reals, weights: Reals, gradients: Reals, are_known: Flags,
    diagonals: Reals, forces: Reals, with_forces: Count, free: Flags, residuals: Reals,
    are_settled: Flags, are_broken: Flags, round_off: Real, gradient_tolerance: Real,
    force_tolerance: Real,
) -> None:  # fmt: skip
    """Evaluate, and set which histories, compact, have settled and are not finite.

    They have settled where they keep their sets and are optimal on these: the natural residual
    min(g, diag(H) x) is small against the overlap of the bodies, or at the round-off of x, and the
    force is met. ``residuals`` are relative to the largest unknowns. The sets of others become
    those of the signs; unknowns that leave them become 0, and gradients those there, with the wear
    of before. Unknowns that are no numbers become 0, and their products are not known.
    """
    at = 0
    while at < count:
        row0, row1, row2, row3, together = _four(at, count, 1, size, histories, references)
        _product_four(
            n, row0, row1, row2, row3, row1 if together > 1 else size,
            row2 if together > 2 else size + 1, row3 if together > 3 else size + 2,
            references[row0], unknowns, matrices, derivatives, with_derivatives, deviations,
            deviating, products,
        )  # fmt: skip
        for q in range(together):
            history, place = histories[at + q], places[at + q]
            compliance = which[history]
            _set_gradient(
                n, history, place, compliance, gaps, approaches, depths, weights, products,
                gradients,
            )  # fmt: skip
            settled, broken, cleared = _settle(
                n, history, compliance, unknowns, gradients, diagonals, weights, gaps,
                approaches[history], forces[history], with_forces, free, residuals, round_off,
                gradient_tolerance, force_tolerance,
            )  # fmt: skip
            are_settled[place], are_broken[place], are_known[history] = settled, broken, not broken
            if broken:
                for k in range(history * n, history * n + n):
                    unknowns[k] = 0.0
            if cleared:
                _product_four(
                    n, history, history, history, history, size, size + 1, size + 2,
                    references[history], unknowns, matrices, derivatives, with_derivatives,
                    deviations, deviating, products,
                )  # fmt: skip
                _set_gradient(
                    n, history, place, compliance, gaps, approaches, depths, weights, products,
                    gradients,
                )  # fmt: skip
        at += together


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
            n, rows[place], numbers[rows[place]], rates[place], values, bends,
            deviations[rows[place]], forces, inverses, responses, stiffness,
        )  # fmt: skip


def _invert(
    n: Count, history: Count, number: Count, rate: Real, values: Reals, bends: Reals,
    deviation: Real, forces: Reals, inverses: Reals, responses: Reals, stiffness: Reals,
) -> None:  # fmt: skip
    row, basis, carried = history * n, number * n, 0.0
    for i in range(n):
        inverse = 1.0 / (1.0 + rate * values[basis + i] + deviation * bends[basis + i])
        inverses[row + i], responses[row + i] = inverse, inverse * forces[basis + i]
    for i in range(n):
        carried += forces[basis + i] * responses[row + i]
    stiffness[history] = carried


def take_steps(
    count: Count, n: Count, rows: Integers, order: Integers, which: Integers, depth_slopes: Reals,
    slope_scale: Reals, slopes: Reals, diagonals: Reals, per_speed: Reals, free: Flags,
    are_valid: Flags, free_before: Flags, wearing_before: Flags, rates: Reals, are_new: Flags,
    have_new_sets: Flags, are_regular: Flags, round_off: Real, in_bases: Count, are_inverted: Count,
    deviations: Reals, numbers: Integers, values: Reals, bends: Reals, bases: Reals,
    transposed: Reals, basis_forces: Reals, inverses: Reals, responses: Reals, stiffness: Reals,
    factors: Reals, references: Integers, reference_weights: Reals, unknowns: Reals,
    gradients: Reals, approaches: Reals, are_known: Flags, weights: Reals, roots: Reals,
    forces: Reals, with_forces: Count, missing: Reals, per_scale: Reals, pressures: Reals,
    are_left: Flags, group: Integers, modal: Reals, steps: Reals,
) -> None:  # fmt: skip
    """Set slopes, and take the steps of histories whose Hessians are diagonal in bases they have.

    Others, compact, are left, with what ``compare_slopes`` says of them and the force that they are
    ``missing`` (B,): those that need another basis, unless inverses are what they have to be, and
    those that deviate. The ``order`` (count,) of rows is by ``numbers`` (B,) of bases. Forces and
    approaches in bases are by weights of references: ``roots`` (B,) times those. ``group``,
    ``modal`` and ``steps`` are room for 4.
    """
    at = 0
    while at < count:
        number, together = numbers[rows[order[at]]], 0
        most = 1 if number < 0 else 4
        while at < count and together < most and numbers[rows[order[at]]] == number:
            place = order[at]
            history, compliance = rows[place], which[rows[place]]
            _set_slopes(
                n, history, place, compliance, depth_slopes, slope_scale, slopes, diagonals,
                are_valid,
            )  # fmt: skip
            rate, is_new, has_new_sets = _compare_slopes(
                n, history, compliance, slopes, per_speed, free, are_valid, free_before,
                wearing_before, are_regular, round_off,
            )  # fmt: skip
            rates[place], are_new[place], have_new_sets[place] = rate, is_new, has_new_sets
            carried = 0.0
            for i in range(n):
                carried += weights[compliance * n + i] * unknowns[history * n + i]
            missing[history], are_known[history] = forces[history] - carried, False
            is_diagonal = number < 0 or (are_regular[history] and deviations[history] == 0.0)
            must_wait = not in_bases or has_new_sets or (is_new and number < 0)
            is_left = not is_diagonal or (must_wait and not are_inverted)
            if not is_left:
                if is_new and not are_inverted:
                    are_valid[history] = True
                    _invert(
                        n, history, number, rate, values, bends, deviations[history],
                        basis_forces, inverses, responses, stiffness,
                    )  # fmt: skip
                group[together] = place
                together += 1
            are_left[place] = is_left
            at += 1
        if together == 0:
            continue
        row0 = rows[group[0]]
        if number < 0:
            approaches[row0] += roots[row0] * _step_by_factor(
                n, row0, references[which[row0]], gradients, row0 * n,
                missing[row0] * roots[row0], with_forces, factors, responses, stiffness,
                reference_weights, 0, steps,
            )  # fmt: skip
        else:
            row1 = rows[group[1]] if together > 1 else row0
            row2 = rows[group[2]] if together > 2 else row0
            row3 = rows[group[3]] if together > 3 else row0
            _multiply_four(
                n, n, row0, row1, row2, row3, gradients, number, bases, 0, 1, 2, 3, modal
            )
            for q in range(together):
                history = rows[group[q]]
                approaches[history] += roots[history] * _step_in_basis(
                    n, history, number, q, missing[history] * roots[history], with_forces,
                    basis_forces, inverses, responses, stiffness, modal,
                )  # fmt: skip
            _multiply_four(n, n, 0, 1, 2, 3, modal, number, transposed, 0, 1, 2, 3, steps)
        for q in range(together):
            history, compliance, start = rows[group[q]], which[rows[group[q]]], group[q] * n
            for i in range(n):
                unknowns[history * n + i] += steps[q * n + i]
            _set_pressures(n, history, compliance, start, unknowns, per_scale, pressures)


def _step_in_basis(
    n: Count, history: Count, number: Count, q: Count, missing: Real, with_missing: Count,
    forces: Reals, inverses: Reals, responses: Reals, stiffness: Reals, modal: Reals,
) -> float:  # fmt: skip
    """Return the change of an approach; a gradient in a basis becomes the step."""
    row, basis, start, change = history * n, number * n, q * n, 0.0
    if with_missing and stiffness[history] > 0.0:
        carried = 0.0
        for i in range(n):
            carried += responses[row + i] * modal[start + i]
        change = (missing + carried) / stiffness[history]
    for i in range(n):
        modal[start + i] = (change * forces[basis + i] - modal[start + i]) * inverses[row + i]
    return change


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


def steps_by_factors(
    count: Count, n: Count, times: Count, size: Count, order: Integers, histories: Integers,
    factors: Reals, responses: Reals, stiffness: Reals, references: Integers,
    reference_weights: Reals, missing: Reals, with_missing: Count, gradients: Reals,
    which: Integers, weights: Reals, per_scale: Reals, roots: Reals, with_scales: Count,
    scaled: Reals, steps: Reals, changes: Reals,
) -> None:  # fmt: skip
    """Set steps against gradients (times, size, n), and of approaches, as ``steps_in_bases`` does.

    ``scaled`` is room for a row.
    """
    for at in range(count * times):
        place = order[at // times]
        into, compliance = at % times * size + place, which[place] * n
        start = into * n
        for i in range(n):
            side = gradients[start + i]
            scaled[i] = side * weights[compliance + i] if with_scales else side
        changes[into] = roots[which[place]] * _step_by_factor(
            n, histories[place], references[which[place]], scaled, 0,
            missing[into] * roots[which[place]], with_missing, factors, responses,
            stiffness, reference_weights, start, steps,
        )  # fmt: skip
        if with_scales:
            for i in range(n):
                steps[start + i] *= per_scale[compliance + i]


def _step_by_factor(
    n: Count, history: Count, reference: Count, gradients: Reals, at: Count, missing: Real,
    with_missing: Count, factors: Reals, responses: Reals, stiffness: Reals,
    reference_weights: Reals, to: Count, steps: Reals,
) -> float:  # fmt: skip
    """Set a step against a gradient; return the change of the approach."""
    row, change = history * n, 0.0
    _solve(n, row * n, factors, at, gradients, to, steps)
    if with_missing and stiffness[history] > 0.0:
        carried = 0.0
        for i in range(n):
            carried += reference_weights[reference * n + i] * steps[to + i]
        change = (missing + carried) / stiffness[history]
    for i in range(n):
        steps[to + i] = change * responses[row + i] - steps[to + i]
    return change


def steps_in_bases(
    count: Count, n: Count, times: Count, size: Count, order: Integers, histories: Integers,
    numbers: Integers, psi: Reals, psi_t: Reals, derivatives: Reals, bends: Reals, forces: Reals,
    slopes: Reals, are_regular: Flags, deviations: Reals, inverses: Reals, responses: Reals,
    stiffness: Reals, tolerance: Real, regular_tolerance: Real, most: Count, missing: Reals,
    with_missing: Count, gradients: Reals, which: Integers, weights: Reals, per_scale: Reals,
    roots: Reals, with_scales: Count, room: Reals, sizes: Reals, steps: Reals, changes: Reals,
) -> None:  # fmt: skip
    """Set steps against gradients (times, size, n), and of approaches, by way of bases (m, n, n).

    Gradients are of the ``histories`` (size,), those of the ``order`` (count,) of places are solved
    in the bases ``numbers`` (size,), four of a basis at a time. Steps carry the forces that are
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
        if with_scales:
            for q in range(together):
                place = order[(at + q) // times]
                start, compliance = ((at + q) % times * size + place) * n, which[place] * n
                for i in range(n):
                    room[q * n + i] = gradients[start + i] * weights[compliance + i]
            _multiply_four(n, n, 0, 1, 2, 3, room, number, psi, 4, 5, 6, 7, room)
        else:
            _multiply_four(n, n, row0, row1, row2, row3, gradients, number, psi, 4, 5, 6, 7, room)
        bent, deviating = False, False
        for q in range(together):
            place = order[(at + q) // times]
            history, into, local = histories[place], (at + q) % times * size + place, q * n
            row, basis, change, size_q = history * n, number * n, 0.0, 0.0
            if with_missing and stiffness[history] > 0.0:
                for i in range(n):
                    change += responses[row + i] * room[4 * n + local + i]
                change = (missing[into] * roots[which[place]] + change) / stiffness[history]
            for i in range(n):
                room[4 * n + local + i] = change * forces[basis + i] - room[4 * n + local + i]
            for i in range(n):
                room[local + i] = room[4 * n + local + i] * inverses[row + i]
            changes[into] = change
            regular, deviates = are_regular[history], deviations[history] != 0.0
            sizes[q] = 0.0
            if not regular or deviates:
                for i in range(n):
                    size_q += inverses[row + i] * room[4 * n + local + i] * room[4 * n + local + i]
                sizes[q], share = size_q, regular_tolerance if regular else tolerance
                sizes[4 + q] = share * share * size_q
            bent, deviating = bent or not regular, deviating or deviates
        if bent or deviating:
            _conjugate_gradients(
                at, together, n, times, number, order, histories, psi, psi_t, derivatives, bends,
                forces, slopes, bent, are_regular, deviating, deviations, inverses, responses,
                stiffness, with_missing, most, size, room, sizes, changes,
            )  # fmt: skip
        _multiply_four(
            n, n, 0, 1, 2, 3, room, number, psi_t, row0, row1 if together > 1 else spare,
            row2 if together > 2 else spare + 1, row3 if together > 3 else spare + 2, steps,
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
    histories: Integers, psi: Reals, psi_t: Reals, derivatives: Reals, bends: Reals,
    forces: Reals, slopes: Reals, bent: Count, are_regular: Flags, deviating: Count,
    deviations: Reals, inverses: Reals, responses: Reals, stiffness: Reals,
    with_missing: Count, most: Count, size: Count, room: Reals, sizes: Reals, changes: Reals,
) -> None:  # fmt: skip
    """Go on from the steps of diagonal Hessians to those of the others."""
    for i in range(4 * n):
        room[8 * n + i] = room[i]
    for iteration in range(most + 1):
        if bent:
            _multiply_four(n, n, 8, 9, 10, 11, room, number, psi_t, 12, 13, 14, 15, room)
            for q in range(together):
                row = histories[order[(at + q) // times]] * n
                for i in range(n):
                    room[(12 + q) * n + i] *= slopes[row + i]
            _multiply_four(n, n, 12, 13, 14, 15, room, number, psi, 16, 17, 18, 19, room)
        if deviating:
            _multiply_four(n, n, 8, 9, 10, 11, room, number, derivatives, 20, 21, 22, 23, room)
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
                for i in range(n):
                    room[t + i] = room[d + i] / inverses[row + i]
            else:
                for i in range(n):
                    room[t + i] += room[d + i] * (1.0 + deviation * bends[basis + i])
            if deviating:
                for i in range(n):
                    room[t + i] += deviation * room[g + i]
            if iteration > 0:
                for i in range(n):
                    curvature += room[d + i] * room[t + i]
                length = sizes[q] / curvature if curvature > 0.0 else 0.0
                for i in range(n):
                    room[x + i] += length * room[d + i]
            for i in range(n):
                room[r + i] -= length * room[t + i]
            if with_missing and stiffness[history] > 0.0:
                for i in range(n):
                    carried += responses[row + i] * room[r + i]
                carried /= stiffness[history]
                for i in range(n):
                    room[r + i] -= carried * forces[basis + i]
                changes[into] -= carried
            for i in range(n):
                norm += inverses[row + i] * room[r + i] * room[r + i]
            again = norm / sizes[q] if iteration > 0 else 0.0
            for i in range(n):
                room[d + i] = again * room[d + i] + inverses[row + i] * room[r + i]
            sizes[q] = norm
            going = going or norm > sizes[4 + q]
        if not going:
            break


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
