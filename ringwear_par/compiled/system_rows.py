"""Loops that solve the systems of the Hessians of B contact problems, see ``contact.hessians``.

Arrays are (B, n) or (B,), of which ``histories`` (count,) are at work, but for those that are
called compact: (count, n) or (count,), of these one after another.
"""

from typing import NamedTuple

from ringwear_par.compiled.contact_rows import Compliances, Contacts, set_pressures
from ringwear_par.compiled.hessian_rows import (
    Bases,
    Blocks,
    Renewals,
    compare_slopes_of,
    invert_block,
    set_slopes_of,
    solve_by_factor,
)
from ringwear_par.compiled.machine_code import Count, Flags, Integers, Real, Reals, part
from ringwear_par.compiled.product_rows import four_rows, multiply_four

#: of conjugate gradients
_MOST_ITERATIONS = 200


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
        set_slopes_of(n, history, place, compliances, blocks, depth_slopes)
        compare_slopes_of(n, history, place, compliances, blocks, renewals, free)
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
                invert_block(n, history, bases, blocks, renewals.rates[place])
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
        solve_by_factor(n, row * n, blocks.factors, 0, scratch.rows, start, solutions)
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
