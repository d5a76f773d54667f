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
    deviations : (h,) float, of derivatives that are added to the matrices; None: none are.
    """

    def __init__(self, which: IntArray, deviations: FloatArray | None = None) -> None:
        self._which, self._order = np.ascontiguousarray(which), np.argsort(which, kind="stable")
        self._deviations = deviations

    def of(
        self, rows: FloatArray, matrices: FloatArray, derivatives: FloatArray | None = None
    ) -> FloatArray:
        """Return rows (..., h, n) times their matrices (m, n, k), digits of each row its own.

        Parameters
        ----------
        derivatives : (m, n, k) of the matrices by the deviations.
        """
        (*shape, n), (_, n, k), count = rows.shape, matrices.shape, len(self._which)
        size = rows.size // n
        products = np.empty((size + ROOM, k))
        deviate = derivatives is not None and self._deviations is not None
        load(contact_rows).multiply(
            count, n, k, size // max(count, 1), count, self._order, self._which,
            np.ascontiguousarray(rows), matrices, derivatives if deviate else matrices,
            self._deviations if deviate else products, deviate, np.empty((4, k)), products,
        )  # fmt: skip
        return products[:size].reshape(*shape, k)
