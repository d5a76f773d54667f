"""Products of rows with matrices, whose digits do not depend on which rows there are together.

BLAS rounds a row by how many there are, so that rows are put together in blocks of one size.
"""

import numpy as np

from ringwear_par.arrays import FloatArray, IntArray

#: rows of a product: BLAS rounds a row alike whoever the others are, if there are always so many
ROWS = 4


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
        #: blocks and their matrices: several of one, or as many as there are of them
        self._runs: list[tuple[slice, slice]] = []
        #: the one matrix of all rows, if there is no more than one
        self._only = 0
        #: places of rows in the blocks; None: they follow each other
        self._slots: IntArray | None = None
        if not count or (which == which[0]).all():
            self._only = int(which[0]) if count else 0
            return
        counts = np.bincount(which)
        numbers = np.flatnonzero(counts)
        counts = counts[numbers]
        blocks = -(-counts // ROWS)
        last = np.cumsum(blocks)
        self._n_blocks = int(last[-1])
        # matrices that follow each other, with a block each, are one run: one call for all of them
        single = blocks == 1
        follows = single[1:] & single[:-1] & (numbers[1:] - numbers[:-1] == 1)
        begins = [0, *(np.flatnonzero(~follows) + 1).tolist()]
        ends = [*(begin - 1 for begin in begins[1:]), len(numbers) - 1]
        names, firsts, lasts = numbers.tolist(), (last - blocks).tolist(), last.tolist()
        self._runs = [
            (slice(firsts[begin], lasts[end]), slice(names[begin], names[end] + 1))
            for begin, end in zip(begins, ends, strict=True)
        ]
        # rows of a matrix follow each other from its first block on
        starts = ROWS * (last - blocks) - (np.cumsum(counts) - counts)
        self._slots = np.empty(count, dtype=np.int64)
        order = np.argsort(which, kind="stable")
        self._slots[order] = np.arange(count) + np.repeat(starts, counts)

    def of(self, rows: FloatArray, matrices: FloatArray) -> FloatArray:
        """Return rows (..., h, n) times their matrices (n, k), digits of each row its own."""
        n, k = matrices.shape[-2:]
        if self._slots is not None and rows.ndim > 2:
            times = rows.size // (len(self._which) * n)
            if times not in self._repeated:
                self._repeated[times] = RowProducts(np.tile(self._which, times))
            flat = rows.reshape(-1, n)
            return self._repeated[times].of(flat, matrices).reshape(*rows.shape[:-1], k)
        # of rows that do not lie in memory one after another NumPy makes products without BLAS
        flat = np.ascontiguousarray(rows.reshape(-1, n))
        count = len(flat)
        if self._slots is None:
            whole, matrix = count // ROWS * ROWS, matrices[self._only]
            product, padded = np.empty((count, k)), np.zeros((ROWS, n))
            padded[: count - whole] = flat[whole:]
            if whole:
                blocks, out = (x[:whole].reshape(-1, ROWS, x.shape[1]) for x in (flat, product))
                np.matmul(blocks, matrix, out=out)
            if whole < count:
                product[whole:] = (padded @ matrix)[: count - whole]
            return product.reshape(*rows.shape[:-1], k)
        blocks = np.zeros((ROWS * self._n_blocks, n))
        blocks[self._slots] = flat
        blocks = blocks.reshape(self._n_blocks, ROWS, n)
        product = np.empty((self._n_blocks, ROWS, k))
        for run, of_run in self._runs:
            np.matmul(blocks[run], matrices[of_run], out=product[run])
        return product.reshape(-1, k)[self._slots]
