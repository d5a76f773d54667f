"""Loops of products of rows with matrices, four rows of a matrix at a time.

Digits of a row do not depend on the others.
"""

from typing import NamedTuple

from ringwear_par.compiled.machine_code import Count, Integers, Reals, in_order, part

#: rows that are multiplied at a time, less one: room after products, for what is too much
SPARE_ROWS = 3


class Matrices(NamedTuple):
    """m matrices, and what rows that deviate have more."""

    #: (m, n, k)
    values: Reals
    #: (m, n, k), times the deviations of rows, where these have any
    derivatives: Reals
    with_derivatives: Count

    @classmethod
    def of(cls, values: Reals, derivatives: Reals = None) -> "Matrices":
        """Return matrices; without derivatives no row deviates."""
        deviate = derivatives is not None
        return cls(values, derivatives if deviate else values, deviate)


def multiply(
    count: Count, n: Count, k: Count, times: Count, size: Count, order: Integers, which: Integers,
    deviations: Reals, matrices: Matrices, rows: Reals, derivative_products: Reals, products: Reals,
) -> None:  # fmt: skip
    """Set products (times, size, k) of rows (times, size, n) with their matrices.

    Rows have the matrices ``which`` (size,), by which the ``order`` (count,) of those that are
    multiplied should be, and ``deviations`` (size,). There is room for four derivative products,
    and after the products for ``SPARE_ROWS`` more.
    """
    multiply_rows(
        count, n, k, times, size, order, which, deviations, matrices, rows, derivative_products,
        products,
    )  # fmt: skip


@part
def multiply_rows(
    count: Count, n: Count, k: Count, times: Count, size: Count, order: Integers, which: Integers,
    deviations: Reals, matrices: Matrices, rows: Reals, derivative_products: Reals, products: Reals,
) -> None:  # fmt: skip
    """Do ``multiply``."""
    at, spare = 0, times * size
    while at < count * times:
        row0, row1, row2, row3, together = four_rows(at, count, times, size, order, which)
        number = which[order[at // times]]
        multiply_four(
            n, k, row0, row1, row2, row3, rows, number, matrices.values, row0,
            row1 if together > 1 else spare, row2 if together > 2 else spare + 1,
            row3 if together > 3 else spare + 2, products, 0, n, 0, k,
        )  # fmt: skip
        if matrices.with_derivatives:
            multiply_four(
                n, k, row0, row1, row2, row3, rows, number, matrices.derivatives, 0, 1, 2, 3,
                derivative_products, 0, n, 0, k,
            )  # fmt: skip
            for q in range(together):
                place = order[(at + q) // times]
                start = ((at + q) % times * size + place) * k
                for j in range(k):
                    products[start + j] += deviations[place] * derivative_products[q * k + j]
        at += together


@part
def four_rows(
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


@part
@in_order
def multiply_four(
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
