"""Products of rows with matrices, whose digits do not depend on which rows there are together."""

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.compiled import contact_rows
from ringwear_par.compiled.machine_code import load

#: rows that the loop multiplies at a time, less one: room after its products
ROOM = 3


class RowProducts:
    """Rows that have a matrix each.

    Parameters
    ----------
    which : (h,) int, the number of each row's matrix.
    """

    def __init__(self, which: IntArray) -> None:
        self._which, self._order = np.ascontiguousarray(which), np.argsort(which, kind="stable")

    def of(self, rows: FloatArray, matrices: FloatArray) -> FloatArray:
        """Return rows (..., h, n) times their matrices (m, n, k), digits of each row its own."""
        (*shape, n), (_, n, k), count = rows.shape, matrices.shape, len(self._which)
        size = rows.size // n
        products = np.empty((size + ROOM, k))
        load(contact_rows).multiply(
            count, n, k, size // max(count, 1), count, self._order, self._which,
            np.ascontiguousarray(rows), matrices, products,
        )  # fmt: skip
        return products[:size].reshape(*shape, k)
