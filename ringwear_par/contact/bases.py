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
_MOST_BYTES = 2**27


class Basis(NamedTuple):
    """Basis of the elements in contact and of those that wear.

    Parameters
    ----------
    psi, psi_t : (n, n) float, columns and rows of the basis; those of elements apart are 0.
    mu : (n,) float, of W.
    force : (n,) float, the weights of the gap in the basis.
    """

    psi: FloatArray
    psi_t: FloatArray
    mu: FloatArray
    force: FloatArray


def products(rows: FloatArray, matrices: FloatArray, which: IntArray | None = None) -> FloatArray:
    """Return rows (..., h, n) times a matrix (n, n), or each times its own of (m, n, n).

    Digits of a row do not depend on the others.

    Parameters
    ----------
    which : (h,) int, the matrix of each row.
    """
    if which is not None and len(matrices) > 1:
        return _own_products(rows, matrices, which)
    matrix = matrices if which is None else matrices[0]
    shape, n = rows.shape, rows.shape[-1]
    rows = rows.reshape(-1, n)
    count = len(rows)
    if count % ROWS:
        padded = np.zeros((-(-count // ROWS) * ROWS, n))
        padded[:count] = rows
        rows = padded
    return (rows.reshape(-1, ROWS, n) @ matrix).reshape(-1, n)[:count].reshape(shape)


def _own_products(rows: FloatArray, matrices: FloatArray, which: IntArray) -> FloatArray:
    """Return rows, (..., h, n), each times its own matrix."""
    used = np.unique(which)
    if len(used) == len(which):
        padded = np.zeros((*rows.shape[:-1], ROWS, rows.shape[-1]))
        padded[..., 0, :] = rows
        every = len(used) == len(matrices) and bool((which == used).all())
        return np.ascontiguousarray((padded @ (matrices if every else matrices[which]))[..., 0, :])
    product = np.empty(rows.shape)
    for k in used.tolist():
        histories = which == k
        product[..., histories, :] = products(rows[..., histories, :], matrices[k])
    return product


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
        if name in _KEPT:
            _KEPT.move_to_end(name)
            return _KEPT[name]
        basis = _KEPT[name] = self._make(np.flatnonzero(free), wearing)
        most = max(2, _MOST_BYTES // (2 * self._matrix.nbytes))
        while len(_KEPT) > most:
            _KEPT.popitem(last=False)
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
        return Basis(psi, np.ascontiguousarray(psi.T), mu, self._weights @ psi)


_KEPT: OrderedDict[tuple[bytes, bytes, bytes], Basis | None] = OrderedDict()
