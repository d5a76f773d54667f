"""Loops over the Hessians of B contact problems, see ``contact.hessians``.

Arrays are (B, n) or (B,), of which ``histories`` (count,) are at work, but for those that are
called compact: (count, n) or (count,), of these one after another.
"""

import math
from typing import NamedTuple

from ringwear_par.compiled.contact_rows import Compliances
from ringwear_par.compiled.machine_code import Count, Flags, Integers, Real, Reals, in_order, part

#: what slopes may differ by from their shape, relative
_ROUND_OFF = 1e-12


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


def set_slopes(
    count: Count, n: Count, histories: Integers, compliances: Compliances, blocks: Blocks,
    depth_slopes: Reals,
) -> None:  # fmt: skip
    """Set slopes from those of depths, compact; inverses of others are no longer valid."""
    for place in range(count):
        set_slopes_of(n, histories[place], place, compliances, blocks, depth_slopes)


@part
def set_slopes_of(
    n: Count, history: Count, place: Count, compliances: Compliances, blocks: Blocks,
    depth_slopes: Reals,
) -> None:  # fmt: skip
    """Set the slopes of a history."""
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
        compare_slopes_of(n, histories[place], place, compliances, blocks, renewals, free)


@part
def compare_slopes_of(
    n: Count, history: Count, place: Count, compliances: Compliances, blocks: Blocks,
    renewals: Renewals, free: Flags,
) -> None:  # fmt: skip
    """Set whether a history needs a new inverse."""
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
        invert_block(n, histories[place], bases, blocks, rates[place])


@part
def invert_block(n: Count, history: Count, bases: Bases, blocks: Blocks, rate: Real) -> None:
    """Set the inverse of a history in its basis."""
    row, basis, carried = history * n, blocks.bases[history] * n, 0.0
    deviation = blocks.deviations[history]
    for i in range(n):
        inverse = 1.0 / (1.0 + rate * bases.mu[basis + i] + deviation * bases.bends[basis + i])
        blocks.inverses[row + i] = inverse
        blocks.responses[row + i] = inverse * bases.forces[basis + i]
    for i in range(n):
        carried += bases.forces[basis + i] * blocks.responses[row + i]
    blocks.stiffness[history] = carried


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
        solve_by_factor(n, row * n, blocks.factors, reference, weights, row, blocks.responses)
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
def solve_by_factor(
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
