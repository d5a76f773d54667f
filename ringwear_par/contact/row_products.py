"""Products of rows with matrices, whose digits do not depend on which rows there are together."""

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.compiled import product_rows
from ringwear_par.compiled.machine_code import load
from ringwear_par.compiled.product_rows import SPARE_ROWS, Matrices


class RowProducts:
    """Rows that have a matrix each.

    Parameters
    ----------
    which : (h,) int, the number of each row's matrix.
    deviations : (h,) float, of derivatives that are added to the matrices; None: 0.
    """

    def __init__(self, which: IntArray, deviations: FloatArray | None = None) -> None:
        self._which, self._order = np.ascontiguousarray(which), np.argsort(which, kind="stable")
        self._deviations = np.zeros(len(which)) if deviations is None else deviations

    def of(self, rows: FloatArray, matrices: Matrices) -> FloatArray:
        """Return rows (..., h, n) times their matrices (m, n, k), digits of each row its own."""
        (*shape, n), k, count = rows.shape, matrices.values.shape[-1], len(self._which)
        size = rows.size // n
        products = np.empty((size + SPARE_ROWS, k))
        load(product_rows).multiply(
            count, n, k, size // max(count, 1), count, self._order, self._which, self._deviations,
            matrices, np.ascontiguousarray(rows), np.empty((4, k)), products,
        )  # fmt: skip
        return products[:size].reshape(*shape, k)
