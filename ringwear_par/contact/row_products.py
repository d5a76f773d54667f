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
        self._which = which
        #: of rows that are there several times, one after another
        self._repeated: dict[int, RowProducts] = {}
        #: numbers of matrices, and the first and last blocks of their rows
        self._runs: list[tuple[int, int, int]] = []
        #: the one matrix of all blocks, or those of each, where they are a slice
        self._stack: int | slice | None = None
        #: places of rows in the blocks; None: they follow each other
        self._slots: IntArray | None = None
        if not count or (which == which[0]).all():
            self._stack = int(which[0]) if count else 0
            return
        counts = np.bincount(which)
        numbers = np.flatnonzero(counts)
        counts = counts[numbers]
        blocks = -(-counts // ROWS)
        last = np.cumsum(blocks)
        self._n_blocks = int(last[-1])
        if len(numbers) == self._n_blocks == numbers[-1] - numbers[0] + 1:
            self._stack = slice(int(numbers[0]), int(numbers[-1]) + 1)
        ends = zip(numbers.tolist(), (last - blocks).tolist(), last.tolist(), strict=True)
        self._runs = list(ends)
        # rows of a matrix follow each other from its first block on
        starts = ROWS * (last - blocks) - (np.cumsum(counts) - counts)
        self._slots = np.empty(count, dtype=np.int64)
        order = np.argsort(which, kind="stable")
        self._slots[order] = np.arange(count) + np.repeat(starts, counts)

    def of(self, rows: FloatArray, matrices: FloatArray) -> FloatArray:
        """Return rows (..., h, n) times their matrices (n, n), digits of each row its own."""
        n = rows.shape[-1]
        if self._slots is not None and rows.ndim > 2:
            times = rows.size // (len(self._which) * n)
            if times not in self._repeated:
                self._repeated[times] = RowProducts(np.tile(self._which, times))
            flat = rows.reshape(-1, n)
            return self._repeated[times].of(flat, matrices).reshape(rows.shape)
        flat = rows.reshape(-1, n)
        count = len(flat)
        if self._slots is None:
            whole, product = count // ROWS * ROWS, np.empty_like(flat)
            matrix, shape = matrices[self._stack], (-1, ROWS, n)
            if whole:
                full = flat[:whole].reshape(shape)
                np.matmul(full, matrix, out=product[:whole].reshape(shape))
            if whole < count:
                padded = np.zeros((ROWS, n), dtype=flat.dtype)
                padded[: count - whole] = flat[whole:]
                product[whole:] = (padded @ matrix)[: count - whole]
            return product.reshape(rows.shape)
        blocks = np.zeros((ROWS * self._n_blocks, n), dtype=flat.dtype)
        blocks[self._slots] = flat
        blocks = blocks.reshape(self._n_blocks, ROWS, n)
        if self._stack is not None:
            product = blocks @ matrices[self._stack]
        else:
            product = np.empty_like(blocks)
            for number, first, last in self._runs:
                np.matmul(blocks[first:last], matrices[number], out=product[first:last])
        return product.reshape(-1, n)[self._slots]
