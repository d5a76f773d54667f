"""Products of rows with matrices, whose digits do not depend on which rows there are together.

BLAS rounds a row by how many there are, so that rows are put together in blocks of one size.
"""

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray

#: rows of a product: BLAS rounds a row alike whoever the others are, if there are always so many
ROWS = 8


class RowProducts:
    """Rows that have a matrix each, put together by matrix in blocks of ``ROWS``.

    Parameters
    ----------
    which : (h,) int, the number of each row's matrix.
    """

    def __init__(self, which: IntArray) -> None:
        count = len(which)
        #: numbers of matrices, and the first and last blocks of their rows
        self._runs: list[tuple[int, int, int]] = []
        #: the one matrix of all blocks, or those of each, where they are a slice
        self._stack: int | slice | None = None
        #: places of rows in the blocks; None: they follow each other
        self._slots: IntArray | None = None
        if not count or (which == which[0]).all():
            self._stack = int(which[0]) if count else 0
            return
        numbers, group, counts = np.unique(which, return_inverse=True, return_counts=True)
        blocks = -(-counts // ROWS)
        last = np.cumsum(blocks)
        self._n_blocks = int(last[-1])
        if len(numbers) == self._n_blocks == numbers[-1] - numbers[0] + 1:
            self._stack = slice(int(numbers[0]), int(numbers[-1]) + 1)
        ends = zip(numbers.tolist(), (last - blocks).tolist(), last.tolist(), strict=True)
        self._runs = list(ends)
        order = np.argsort(group, kind="stable")
        within = np.arange(count) - (np.cumsum(counts) - counts)[group[order]]
        self._slots = np.empty(count, dtype=np.int64)
        self._slots[order] = ROWS * (last - blocks)[group[order]] + within

    def of(self, rows: FloatArray, matrices: FloatArray) -> FloatArray:
        """Return rows (..., h, n) times their matrices (n, n), digits of each row its own."""
        *leading, count, n = rows.shape
        if self._slots is None:
            whole, product = count // ROWS * ROWS, np.empty(rows.shape)
            matrix = matrices[self._stack]
            if whole:
                shape = (*leading, whole // ROWS, ROWS, n)
                full = (..., slice(whole), slice(None))
                np.matmul(rows[full].reshape(shape), matrix, out=product[full].reshape(shape))
            if whole < count:
                rest = (..., slice(whole, None), slice(None))
                padded = np.zeros((*leading, ROWS, n))
                padded[..., : count - whole, :] = rows[rest]
                product[rest] = (padded @ matrix)[..., : count - whole, :]
            return product
        blocks = np.zeros((*leading, ROWS * self._n_blocks, n))
        blocks[..., self._slots, :] = rows
        blocks = blocks.reshape(*leading, self._n_blocks, ROWS, n)
        if self._stack is not None:
            product = blocks @ matrices[self._stack]
        else:
            product = np.empty_like(blocks)
            for number, first, last in self._runs:
                part = (..., slice(first, last), slice(None), slice(None))
                np.matmul(blocks[part], matrices[number], out=product[part])
        return product.reshape(*leading, ROWS * self._n_blocks, n)[..., self._slots, :]
