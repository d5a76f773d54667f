"""Loops over the rows of B contact problems, see ``contact.problem``.

Arrays are (B, n) or (B,), of which ``histories`` (count,) are at work, but for those that are
called compact: (count, n) or (count,), of these one after another.
"""

import math
from typing import NamedTuple

from ringwear_par.compiled.machine_code import Count, Flags, Integers, Real, Reals, part
from ringwear_par.compiled.product_rows import Matrices, multiply_rows

#: of unknowns
ROUND_OFF = 1e-13
#: norm of the gradient at which a solver ends, relative to that of the overlap
GRADIENT_TOLERANCE = 1e-12
#: relative force balance at which a solver ends
FORCE_TOLERANCE = 1e-12


class Compliances(NamedTuple):
    """m scaled compliances near to f references, see ``ScaledCompliances``."""

    #: (f, n, n) of the references
    matrices: Matrices
    #: (m,) the reference of each
    references: Integers
    #: (f, n) weights of the gap of the references
    reference_weights: Reals
    #: (m, n) weights of the gap, and pressures over unknowns
    weights: Reals
    per_scale: Reals
    #: (m, n) slopes of gradients over unknowns, over those of gaps over pressures
    slope_scale: Reals
    #: (m, n) of speeds of elements
    per_speed: Reals
    #: (m,) weights of references over those of compliances
    roots: Reals


class Contacts(NamedTuple):
    """B contact problems."""

    #: (B,) compliances, their references, and how they deviate from these
    compliances: Integers
    references: Integers
    deviations: Reals
    #: (B, n) unknowns and gradients, the weighted gaps
    unknowns: Reals
    gradients: Reals
    #: (B, n) A q, and room for ``SPARE_ROWS`` rows, and whether these are of the unknowns
    products: Reals
    are_known: Flags


class Judgement(NamedTuple):
    """Which histories, compact, have settled and are lost, and how many."""

    are_settled: Flags
    are_lost: Flags
    #: (2,)
    counts: Integers
    #: scratch: (2, B) histories whose unknowns became 0, and their places; (4, n)
    zeroed: Integers
    derivative_products: Reals


def pressures(
    count: Count, n: Count, histories: Integers, compliances: Compliances, contacts: Contacts,
    pressures: Reals,
) -> None:  # fmt: skip
    """Set pressures, compact, which are 0 where unknowns are negative."""
    for place in range(count):
        set_pressures(n, histories[place], place, compliances, contacts, pressures)


@part
def set_pressures(
    n: Count, history: Count, place: Count, compliances: Compliances, contacts: Contacts,
    pressures: Reals,
) -> None:  # fmt: skip
    """Set the pressures of a history."""
    row, start, scale = history * n, place * n, contacts.compliances[history] * n
    for i in range(n):
        x = contacts.unknowns[row + i]
        pressures[start + i] = 0.0 if x <= 0.0 else x * compliances.per_scale[scale + i]


def evaluate(
    count: Count, n: Count, size: Count, order: Integers, places: Integers,
    compliances: Compliances, contacts: Contacts, judgement: Judgement, with_products: Count,
    gaps: Reals, approaches: Reals, depths: Reals, forces: Reals, with_forces: Count,
    with_judgement: Count, diagonals: Reals, free: Flags, residuals: Reals,
) -> None:  # fmt: skip
    """Set gradients, and with products A q before, which then are known.

    The ``order`` (count,) of histories should be by references; depths of wear, compact, have their
    ``places``.

    With judgement tell which histories have settled and which are lost. They have settled where
    they keep their sets and are optimal on these: the natural residual min(g, diag(H) x) is small
    against the overlap of the bodies, or at the round-off of x, and the force is met. ``residuals``
    are relative to the largest unknowns. The sets of others become those of the signs; unknowns
    that leave them become 0, and gradients those there, with the wear of before. Lost are those
    whose unknowns are no numbers: they become 0, and their products are not known.
    """
    if with_products:
        multiply_rows(
            count, n, n, 1, size, order, contacts.references, contacts.deviations,
            compliances.matrices, contacts.unknowns, judgement.derivative_products,
            contacts.products,
        )  # fmt: skip
    n_settled, n_lost, n_zeroed = 0, 0, 0
    for k in range(count):
        history, place = order[k], places[k]
        _set_gradient(n, history, place, compliances, contacts, gaps, approaches, depths)
        contacts.are_known[history] = True
        if with_judgement:
            settled, lost, zeroed = _settle(
                n, history, compliances, contacts, gaps, approaches[history], forces[history],
                with_forces, diagonals, free, residuals,
            )  # fmt: skip
            judgement.are_settled[place], judgement.are_lost[place] = settled, lost
            contacts.are_known[history] = not lost
            n_settled, n_lost = n_settled + settled, n_lost + lost
            if lost:
                for i in range(history * n, history * n + n):
                    contacts.unknowns[i] = 0.0
            if zeroed:
                judgement.zeroed[n_zeroed], judgement.zeroed[size + n_zeroed] = history, place
                n_zeroed = n_zeroed + 1
    if n_zeroed > 0:
        multiply_rows(
            n_zeroed, n, n, 1, size, judgement.zeroed, contacts.references, contacts.deviations,
            compliances.matrices, contacts.unknowns, judgement.derivative_products,
            contacts.products,
        )  # fmt: skip
    for k in range(n_zeroed):
        history, place = judgement.zeroed[k], judgement.zeroed[size + k]
        _set_gradient(n, history, place, compliances, contacts, gaps, approaches, depths)
    judgement.counts[0], judgement.counts[1] = n_settled, n_lost


@part
def _set_gradient(
    n: Count, history: Count, place: Count, compliances: Compliances, contacts: Contacts,
    gaps: Reals, approaches: Reals, depths: Reals,
) -> None:  # fmt: skip
    row, start, approach = history * n, place * n, approaches[history]
    scale = contacts.compliances[history] * n
    for i in range(n):
        gap, weight = gaps[row + i] - approach + depths[start + i], compliances.weights[scale + i]
        contacts.gradients[row + i] = gap * weight + contacts.products[row + i]


@part
def _settle(
    n: Count, history: Count, compliances: Compliances, contacts: Contacts, gaps: Reals,
    approach: Real, force: Real, with_forces: Count, diagonals: Reals, free: Flags,
    residuals: Reals,
) -> tuple[bool, bool, bool]:  # fmt: skip
    """Return whether a history has settled, is lost, and has unknowns that became 0."""
    unknowns, gradients = contacts.unknowns, contacts.gradients
    row, scale = history * n, contacts.compliances[history] * n
    worst, most, same = 0.0, 0.0, True
    defects, overlaps, carried, total = 0.0, 0.0, 0.0, 0.0
    for i in range(n):
        k, weight = row + i, compliances.weights[scale + i]
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
    lost = not math.isfinite(total + carried + worst)
    # where wear makes the diagonal large, round-off in x is more than the tolerance in g
    fine = worst <= ROUND_OFF * most or math.sqrt(defects) <= (
        GRADIENT_TOLERANCE * math.sqrt(overlaps)
    )
    if with_forces:
        fine = fine and abs(carried - force) <= FORCE_TOLERANCE * force
    residuals[history] = worst / most if most > 0.0 else math.inf
    zeroed = False
    if not same and not lost:
        for k in range(row, row + n):
            keep = unknowns[k] > 0.0 if free[k] else gradients[k] < 0.0
            free[k] = keep
            if not keep and unknowns[k] != 0.0:
                unknowns[k] = 0.0
                zeroed = True
    return fine and same and not lost, lost, zeroed


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
