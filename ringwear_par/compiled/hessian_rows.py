"""Loops over the Hessians of B contact problems, see ``contact.hessians``.

Arrays are (B, n) or (B,), of which ``histories`` (count,) are at work, but for those that are
called compact: (count, n) or (count,), of these one after another.
"""

import math
from typing import NamedTuple

from ringwear_par.compiled.contact_rows import Compliances, Contacts, set_pressures
from ringwear_par.compiled.machine_code import Count, Flags, Integers, Real, Reals, in_order, part
from ringwear_par.compiled.product_rows import four_rows, multiply_four

#: what slopes may differ by from their shape, relative
_ROUND_OFF = 1e-12
#: of conjugate gradients
_MOST_ITERATIONS = 200


class Bases(NamedTuple):
    """m bases, see ``Basis``."""

    #: (m, n, n) bases and their transposes
    psi: Reals
    psi_t: Reals
    #: (m, n) mu, and the weights of the gap in the bases
    mu: Reals
    forces: Reals
    #: (m, 3) how many columns, and from where to where rows, are not 0
    extents: Integers
    #: (m, n, n) and (m, n), K' of ``Deviations`` in the bases, off the diagonal and on it
    derivatives: Reals
    bends: Reals


class Blocks(NamedTuple):
    """The Hessians of B contact problems and their inverses."""

    #: (B,) compliances, and how they deviate from their references
    compliances: Integers
    deviations: Reals
    #: (B, n) what wear adds to the diagonals, and these
    slopes: Reals
    diagonals: Reals
    #: (B, n) elements that inverses are of, and those of them that bases take to wear
    free: Flags
    wearing: Flags
    #: (B,) whether inverses are of the slopes, and whether these have the shape of the bases
    are_valid: Flags
    are_regular: Flags
    #: (B,) numbers of the bases, -1 of those that have none
    bases: Integers
    #: (B, n) inverses in the bases, exact where slopes are regular, else preconditioners
    inverses: Reals
    #: (B, n) what unknowns grow by with the approach, in the bases if any, and (B,) the force with
    #: it, by the weights of the reference
    responses: Reals
    stiffness: Reals
    #: (B, n, n) inverses of Cholesky factors of those that have no bases, without upper triangles
    factors: Reals


class Renewals(NamedTuple):
    """Which histories, compact, need new inverses."""

    #: (B,) rates of slopes, whether inverses are to be new, and whether they are of new sets
    rates: Reals
    are_new: Flags
    have_new_sets: Flags
    #: (B,) whether steps are left to be taken, and (1,) how many
    are_left: Flags
    n_left: Integers


class Systems(NamedTuple):
    """Systems of h histories, of several right-hand sides each, and their solutions."""

    #: (times, h, n)
    gradients: Reals
    #: (times, h) N, where forces are given
    missing: Reals
    with_forces: Count
    #: whether gradients are gaps, mm, and steps are to be pressures, MPa
    with_scales: Count
    #: (times, h, n), and room for ``SPARE_ROWS`` rows; (times, h) mm, of approaches
    steps: Reals
    changes: Reals


class Scratch(NamedTuple):
    """Arrays that loops compute with."""

    #: (24, n) and (8,)
    rows: Reals
    sizes: Reals
    #: (B,) histories that a loop solves in bases, and those that it does not
    in_bases: Integers
    not_in_bases: Integers


def set_slopes(
    count: Count, n: Count, histories: Integers, compliances: Compliances, blocks: Blocks,
    depth_slopes: Reals,
) -> None:  # fmt: skip
    """Set slopes from those of depths, compact; inverses of others are no longer valid."""
    for place in range(count):
        _set_slopes(n, histories[place], place, compliances, blocks, depth_slopes)


@part
def _set_slopes(
    n: Count, history: Count, place: Count, compliances: Compliances, blocks: Blocks,
    depth_slopes: Reals,
) -> None:  # fmt: skip
    row, start, scale, same = history * n, place * n, blocks.compliances[history] * n, True
    for i in range(n):
        slope = depth_slopes[start + i] * compliances.slope_scale[scale + i]
        same = same and slope == blocks.slopes[row + i]
    if not same:
        blocks.are_valid[history] = False
        for i in range(n):
            slope = depth_slopes[start + i] * compliances.slope_scale[scale + i]
            blocks.slopes[row + i] = slope
            blocks.diagonals[row + i] = 1.0 + slope


def compare_slopes(
    count: Count, n: Count, histories: Integers, compliances: Compliances, blocks: Blocks,
    renewals: Renewals, free: Flags,
) -> None:  # fmt: skip
    """Set which histories need a new inverse on their free elements (B, n).

    Slopes are regular where they are one rate times the speed of elements that wear; others have
    the middle between their least and their largest. Sets of the blocks become the new ones.
    """
    for place in range(count):
        _compare_slopes(n, histories[place], place, compliances, blocks, renewals, free)


@part
def _compare_slopes(
    n: Count, history: Count, place: Count, compliances: Compliances, blocks: Blocks,
    renewals: Renewals, free: Flags,
) -> None:  # fmt: skip
    row, scale, same = history * n, blocks.compliances[history] * n, True
    for k in range(row, row + n):
        same = same and free[k] == blocks.free[k]
    is_new = not (same and blocks.are_valid[history])
    renewals.are_new[place], renewals.have_new_sets[place] = is_new, False
    renewals.rates[place] = 0.0
    if not is_new:
        return
    most, least = 0.0, math.inf
    for i in range(n):
        rate = blocks.slopes[row + i] * compliances.per_speed[scale + i]
        if free[row + i] and rate > 0.0:
            most = max(most, rate)
            least = min(least, rate)
    regular = least >= (1.0 - _ROUND_OFF) * most
    # without regular wear as if all wore, so as not to need another basis
    every = most == 0.0 or not regular
    for k in range(row, row + n):
        wears = free[k] and (every or blocks.slopes[k] > 0.0)
        same = same and wears == blocks.wearing[k]
        blocks.free[k], blocks.wearing[k] = free[k], wears
    blocks.are_regular[history] = regular
    renewals.rates[place] = most if regular else 0.5 * (most + least)
    renewals.have_new_sets[place] = not same


def invert(
    count: Count, n: Count, histories: Integers, bases: Bases, blocks: Blocks, rates: Reals
) -> None:
    """Set the inverses 1 / (1 + rate mu + deviation K'_ii) in bases, and responses to approaches.

    Rates are compact.
    """
    for place in range(count):
        _invert(n, histories[place], bases, blocks, rates[place])


@part
def _invert(n: Count, history: Count, bases: Bases, blocks: Blocks, rate: Real) -> None:
    row, basis, carried = history * n, blocks.bases[history] * n, 0.0
    deviation = blocks.deviations[history]
    for i in range(n):
        inverse = 1.0 / (1.0 + rate * bases.mu[basis + i] + deviation * bases.bends[basis + i])
        blocks.inverses[row + i] = inverse
        blocks.responses[row + i] = inverse * bases.forces[basis + i]
    for i in range(n):
        carried += bases.forces[basis + i] * blocks.responses[row + i]
    blocks.stiffness[history] = carried


def take_steps(
    count: Count, n: Count, size: Count, histories: Integers, order: Integers, every: Integers,
    compliances: Compliances, contacts: Contacts, bases: Bases, blocks: Blocks,
    renewals: Renewals, systems: Systems, scratch: Scratch, depth_slopes: Reals, free: Flags,
    is_local: Count, through_layers: Count, are_inverted: Count, tolerance: Real,
    regular_tolerance: Real, approaches: Reals, forces: Reals, pressures: Reals,
) -> None:  # fmt: skip
    """Set slopes, and take the steps of histories in bases they have, or by their factors.

    Others are left, with what ``compare_slopes`` says of them: those that need another basis or
    factor, which all do whose wear is not local, unless they ``are_inverted`` by now. The ``order``
    (count,) of ``histories`` is by bases; ``every`` are all of them (size,). Gradients of the
    systems are those of the contacts; pressures are compact.
    """
    n_left, n_ready, n_factored = 0, 0, 0
    for k in range(count):
        place = order[k]
        history = histories[place]
        row, scale, carried = history * n, contacts.compliances[history] * n, 0.0
        _set_slopes(n, history, place, compliances, blocks, depth_slopes)
        _compare_slopes(n, history, place, compliances, blocks, renewals, free)
        for i in range(n):
            carried += compliances.weights[scale + i] * contacts.unknowns[row + i]
        systems.missing[history] = forces[history] - carried
        contacts.are_known[history] = False
        has_basis, is_new = blocks.bases[history] >= 0, renewals.are_new[place]
        by_factor = not has_basis or (through_layers and not blocks.are_regular[history])
        is_left = not are_inverted and (
            not is_local or renewals.have_new_sets[place] or (is_new and by_factor)
        )
        renewals.are_left[place] = is_left
        if is_left:
            n_left += 1
        elif not has_basis:
            scratch.not_in_bases[n_factored] = history
            n_factored += 1
        else:
            if is_new and not are_inverted:
                blocks.are_valid[history] = True
                _invert(n, history, bases, blocks, renewals.rates[place])
            scratch.in_bases[n_ready] = history
            n_ready += 1
    _step_in_bases(
        n_ready, n, 1, size, scratch.in_bases, every, blocks.bases, compliances, bases, blocks,
        systems, scratch, tolerance, regular_tolerance,
    )  # fmt: skip
    _step_by_factors(
        n_factored, n, 1, size, scratch.not_in_bases, every, compliances, blocks, systems, scratch
    )
    for k in range(count):
        place = order[k]
        history = histories[place]
        if not renewals.are_left[place]:
            approaches[history] += systems.changes[history]
            for i in range(history * n, history * n + n):
                contacts.unknowns[i] += systems.steps[i]
            set_pressures(n, history, place, compliances, contacts, pressures)
    renewals.n_left[0] = n_left


def factorise(
    count: Count, n: Count, histories: Integers, compliances: Compliances, blocks: Blocks,
    coupling: Reals, with_coupling: Count, work: Reals,
) -> None:  # fmt: skip
    """Set inverses of the lower Cholesky factors of Hessians, and how they respond to an approach.

    NaN of what is not positive definite. Coupling (B, n, n) is added; ``work`` is room for
    (n, 2 n).
    """
    matrices, slopes, free = compliances.matrices, blocks.slopes, blocks.free
    for place in range(count):
        history = histories[place]
        row, deviation = history * n, blocks.deviations[history]
        reference = compliances.references[blocks.compliances[history]] * n
        for i in range(n):
            at, line = 2 * i * n, (reference + i) * n
            for j in range(n):
                work[at + j] = matrices.values[line + j]
                work[at + n + j] = 0.0
            if matrices.with_derivatives:
                for j in range(n):
                    work[at + j] += deviation * matrices.derivatives[line + j]
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
                blocks.factors[line + j] = work[at + j] if free[row + i] else 0.0
        weights = compliances.reference_weights
        _solve(n, row * n, blocks.factors, reference, weights, row, blocks.responses)
        carried = 0.0
        for i in range(n):
            carried += weights[reference + i] * blocks.responses[row + i]
        blocks.stiffness[history] = carried


@part
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


@part
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
    factored: Integers, histories: Integers, numbers: Integers, compliances: Compliances,
    bases: Bases, blocks: Blocks, systems: Systems, scratch: Scratch, tolerance: Real,
    regular_tolerance: Real,
) -> None:  # fmt: skip
    """Set steps against gradients, and of approaches, of ``histories`` (size,).

    Those at the places ``in_bases`` have the bases ``numbers`` (size,), the others, at ``factored``
    places, have factors.
    """
    _step_in_bases(
        count - n_factored, n, times, size, in_bases, histories, numbers, compliances, bases,
        blocks, systems, scratch, tolerance, regular_tolerance,
    )  # fmt: skip
    _step_by_factors(
        n_factored, n, times, size, factored, histories, compliances, blocks, systems, scratch
    )


@part
def _step_by_factors(
    count: Count, n: Count, times: Count, size: Count, order: Integers, histories: Integers,
    compliances: Compliances, blocks: Blocks, systems: Systems, scratch: Scratch,
) -> None:  # fmt: skip
    """Set steps against gradients, and of approaches, by factors, see ``_step_in_bases``."""
    solutions = systems.steps
    for at in range(count * times):
        place = order[at // times]
        into, history, change = at % times * size + place, histories[place], 0.0
        compliance = blocks.compliances[history]
        start, row, scale = into * n, history * n, compliance * n
        for i in range(n):
            side = systems.gradients[start + i]
            scratch.rows[i] = side * compliances.weights[scale + i] if systems.with_scales else side
        _solve(n, row * n, blocks.factors, 0, scratch.rows, start, solutions)
        if systems.with_forces and blocks.stiffness[history] > 0.0:
            carried, reference = 0.0, compliances.references[compliance] * n
            for i in range(n):
                carried += compliances.reference_weights[reference + i] * solutions[start + i]
            missing = systems.missing[into] * compliances.roots[compliance]
            change = (missing + carried) / blocks.stiffness[history]
        for i in range(n):
            step = change * blocks.responses[row + i] - solutions[start + i]
            scaled = systems.with_scales
            solutions[start + i] = step * compliances.per_scale[scale + i] if scaled else step
        systems.changes[into] = change * compliances.roots[compliance]


@part
def _step_in_bases(
    count: Count, n: Count, times: Count, size: Count, order: Integers, histories: Integers,
    numbers: Integers, compliances: Compliances, bases: Bases, blocks: Blocks, systems: Systems,
    scratch: Scratch, tolerance: Real, regular_tolerance: Real,
) -> None:  # fmt: skip
    """Set steps against gradients (times, size, n), and of approaches, by way of bases.

    Gradients are of the ``histories`` (size,), those of the ``order`` (count,) of places are solved
    in the bases ``numbers`` (size,), four of a basis at a time. Steps carry the forces that are
    missing, where these are given, which are ``roots`` times as large by the weights of references.

    Where slopes are not regular or compliances deviate, Hessians 1 + Psi' slope Psi + deviation K'
    are not diagonal there: inverses precondition projected conjugate gradients until residuals are
    below a tolerance relative to the first. The change of approach is the multiplier of the
    condition that the force stays.
    """
    rows, sizes, responses = scratch.rows, scratch.sizes, blocks.responses
    at, spare = 0, times * size
    while at < count * times:
        row0, row1, row2, row3, together = four_rows(at, count, times, size, order, numbers)
        number = numbers[order[at // times]]
        m, first, end = (
            bases.extents[3 * number], bases.extents[3 * number + 1], bases.extents[3 * number + 2],
        )  # fmt: skip
        if systems.with_scales:
            for q in range(together):
                place = order[(at + q) // times]
                start = ((at + q) % times * size + place) * n
                scale = blocks.compliances[histories[place]] * n
                for i in range(n):
                    weight = compliances.weights[scale + i]
                    rows[q * n + i] = systems.gradients[start + i] * weight
            multiply_four(
                n, n, 0, 1, 2, 3, rows, number, bases.psi, 4, 5, 6, 7, rows, first, end, 0, m
            )
        else:
            multiply_four(
                n, n, row0, row1, row2, row3, systems.gradients, number, bases.psi, 4, 5, 6, 7,
                rows, first, end, 0, m,
            )  # fmt: skip
        bent, deviating = False, False
        for q in range(together):
            place = order[(at + q) // times]
            history, into, local = histories[place], (at + q) % times * size + place, q * n
            row, basis, change, size_q = history * n, number * n, 0.0, 0.0
            if systems.with_forces and blocks.stiffness[history] > 0.0:
                for i in range(m):
                    change += responses[row + i] * rows[4 * n + local + i]
                missing = systems.missing[into] * compliances.roots[blocks.compliances[history]]
                change = (missing + change) / blocks.stiffness[history]
            for i in range(m):
                rows[4 * n + local + i] = change * bases.forces[basis + i] - rows[4 * n + local + i]
            for i in range(m):
                rows[local + i] = rows[4 * n + local + i] * blocks.inverses[row + i]
            systems.changes[into] = change
            regular, deviates = blocks.are_regular[history], blocks.deviations[history] != 0.0
            sizes[q] = 0.0
            if not regular or deviates:
                for i in range(m):
                    residual = rows[4 * n + local + i]
                    size_q += blocks.inverses[row + i] * residual * residual
                sizes[q], share = size_q, regular_tolerance if regular else tolerance
                sizes[4 + q] = share * share * size_q
            bent, deviating = bent or not regular, deviating or deviates
        if bent or deviating:
            _conjugate_gradients(
                at, together, n, times, size, number, order, histories, m, first, end, bases,
                blocks, systems, scratch, bent, deviating,
            )  # fmt: skip
        multiply_four(
            n, n, 0, 1, 2, 3, rows, number, bases.psi_t, row0, row1 if together > 1 else spare,
            row2 if together > 2 else spare + 1, row3 if together > 3 else spare + 2,
            systems.steps, 0, m, first, end,
        )  # fmt: skip
        for q in range(together):
            place = order[(at + q) // times]
            into, compliance = (
                (at + q) % times * size + place, blocks.compliances[histories[place]],
            )  # fmt: skip
            systems.changes[into] *= compliances.roots[compliance]
            if systems.with_scales:
                for i in range(n):
                    systems.steps[into * n + i] *= compliances.per_scale[compliance * n + i]
        at += together


@part
def _conjugate_gradients(
    at: Count, together: Count, n: Count, times: Count, size: Count, number: Count,
    order: Integers, histories: Integers, m: Count, first: Count, end: Count, bases: Bases,
    blocks: Blocks, systems: Systems, scratch: Scratch, bent: Count, deviating: Count,
) -> None:  # fmt: skip
    """Go on from the steps of diagonal Hessians to those of the others."""
    rows, sizes = scratch.rows, scratch.sizes
    inverses, responses = blocks.inverses, blocks.responses
    for i in range(4 * n):
        rows[8 * n + i] = rows[i]
    for iteration in range(_MOST_ITERATIONS + 1):
        if bent:
            multiply_four(
                n, n, 8, 9, 10, 11, rows, number, bases.psi_t, 12, 13, 14, 15, rows, 0, m, first,
                end,
            )  # fmt: skip
            for q in range(together):
                row = histories[order[(at + q) // times]] * n
                for i in range(first, end):
                    rows[(12 + q) * n + i] *= blocks.slopes[row + i]
            multiply_four(
                n, n, 12, 13, 14, 15, rows, number, bases.psi, 16, 17, 18, 19, rows, first, end,
                0, m,
            )  # fmt: skip
        if deviating:
            multiply_four(
                n, n, 8, 9, 10, 11, rows, number, bases.derivatives, 20, 21, 22, 23, rows, 0, m,
                0, m,
            )  # fmt: skip
        going = False
        for q in range(together):
            if not sizes[q] > sizes[4 + q]:
                continue
            place = order[(at + q) // times]
            history, into = histories[place], (at + q) % times * size + place
            row, basis, deviation = history * n, number * n, blocks.deviations[history]
            x, r, d, t, g = q * n, (4 + q) * n, (8 + q) * n, (16 + q) * n, (20 + q) * n
            length, curvature, carried, norm = 1.0, 0.0, 0.0, 0.0
            if blocks.are_regular[history]:
                for i in range(m):
                    rows[t + i] = rows[d + i] / inverses[row + i]
            else:
                for i in range(m):
                    rows[t + i] += rows[d + i] * (1.0 + deviation * bases.bends[basis + i])
            if deviating:
                for i in range(m):
                    rows[t + i] += deviation * rows[g + i]
            if iteration > 0:
                for i in range(m):
                    curvature += rows[d + i] * rows[t + i]
                length = sizes[q] / curvature if curvature > 0.0 else 0.0
                for i in range(m):
                    rows[x + i] += length * rows[d + i]
            for i in range(m):
                rows[r + i] -= length * rows[t + i]
            if systems.with_forces and blocks.stiffness[history] > 0.0:
                for i in range(m):
                    carried += responses[row + i] * rows[r + i]
                carried /= blocks.stiffness[history]
                for i in range(m):
                    rows[r + i] -= carried * bases.forces[basis + i]
                systems.changes[into] -= carried
            for i in range(m):
                norm += inverses[row + i] * rows[r + i] * rows[r + i]
            again = norm / sizes[q] if iteration > 0 else 0.0
            for i in range(m):
                rows[d + i] = again * rows[d + i] + inverses[row + i] * rows[r + i]
            sizes[q] = norm
            going = going or norm > sizes[4 + q]
        if not going:
            break
