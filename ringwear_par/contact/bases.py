"""Generalised eigenbases, in which the Hessians of many wear steps are diagonal.

The slope of wear over pressure of most laws is one number times the sliding speed, on all elements
that wear. With A the scaled compliance of the elements in contact and W their speeds,

    Psi' A Psi = 1,   Psi' W Psi = mu,   (A + alpha W)^-1 = Psi diag(1 / (1 + alpha mu)) Psi',

so that one basis serves every step of every history with the same elements in contact and wearing.
"""

from collections import OrderedDict
from hashlib import blake2b
from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, cholesky, solve_triangular

from ringwear_par.arrays import BoolArray, FloatArray, IntArray

#: rows of a product: BLAS rounds a row alike whoever the others are, if there are always so many
ROWS = 8
#: bytes of the bases that are kept
_MOST_BYTES = 2**25


class Basis(NamedTuple):
    """Basis of the elements in contact and of those that wear.

    Parameters
    ----------
    psi : (n, n) float, the basis; rows of elements that are apart are 0.
    mu : (n,) float, of W.
    force : (n,) float, the weights of the gap in the basis.
    """

    psi: FloatArray
    mu: FloatArray
    force: FloatArray


class RowGroups:
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
        #: places of rows in the blocks; None: they fill them
        self._slots: IntArray | slice | None = None
        if not count or (which == which[0]).all():
            self._n_blocks, self._stack = -(-count // ROWS), int(which[0]) if count else 0
            if count % ROWS:
                self._slots = slice(count)
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

    def products(self, rows: FloatArray, matrices: FloatArray) -> FloatArray:
        """Return rows (..., h, n) times their matrices (n, n), digits of each row its own."""
        *leading, _, n = rows.shape
        blocks = rows
        if self._slots is not None:
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
        product = product.reshape(*leading, ROWS * self._n_blocks, n)
        return product if self._slots is None else product[..., self._slots, :]


class Bases:
    """The bases of one scaled compliance.

    Parameters
    ----------
    matrix : (n, n) float, A.
    speed : (n,) float, positive, W on elements that wear.
    weights : (n,) float, what the approach has in the gradient.
    """

    def __init__(self, matrix: FloatArray, speed: FloatArray, weights: FloatArray) -> None:
        self._matrix, self._speed, self._weights = matrix, speed, weights
        digest = blake2b(matrix.tobytes(), digest_size=16)
        digest.update(speed.tobytes())
        digest.update(weights.tobytes())
        self._name = digest.digest()

    def basis(self, free: BoolArray, wearing: BoolArray) -> Basis | None:
        """Return the basis of elements in contact and wearing, (n,); None: not positive definite.

        It is kept for whoever asks next.
        """
        name = (self._name, np.packbits(free).tobytes(), np.packbits(wearing & free).tobytes())
        if name in _CACHE:
            _CACHE.move_to_end(name)
            return _CACHE[name]
        basis = _CACHE[name] = self._make(np.flatnonzero(free), wearing)
        most = max(2, _MOST_BYTES // self._matrix.nbytes)
        while len(_CACHE) > most:
            _CACHE.popitem(last=False)
        return basis

    def _make(self, free: IntArray, wearing: BoolArray) -> Basis | None:
        n, size = len(self._matrix), len(free)
        psi, mu = np.zeros((n, n)), np.zeros(n)
        try:
            factor = cholesky(self._matrix[np.ix_(free, free)], lower=True, check_finite=False)
            roots = np.diag(np.sqrt(self._speed * wearing)[free])
            half = solve_triangular(factor, roots, lower=True, check_finite=False)
            values, vectors = np.linalg.eigh(half @ half.T)
        except LinAlgError:
            return None
        mu[:size] = np.maximum(values, 0.0)
        psi[free, :size] = solve_triangular(
            factor, vectors, lower=True, trans=1, check_finite=False
        )
        return Basis(psi, mu, self._weights @ psi)


_CACHE: OrderedDict[tuple[bytes, bytes, bytes], Basis | None] = OrderedDict()
