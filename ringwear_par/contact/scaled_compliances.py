"""Compliances as contact problems have them: scaled, with the bases of their Hessians.

The slope of wear over pressure of most laws is one number times the sliding speed, on all elements
that wear. With A the scaled compliance of the elements in contact and W their speeds,

    Psi' A Psi = 1,   Psi' W Psi = mu,   (A + alpha W)^-1 = Psi diag(1 / (1 + alpha mu)) Psi',

so that one basis serves every step of every history with the same elements in contact and wearing.
"""

from collections import OrderedDict
from dataclasses import dataclass, field
from hashlib import blake2b
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, cholesky, solve_triangular

from ringwear_par.arrays import BoolArray, FloatArray, IntArray
from ringwear_par.batched import along, take

#: bytes of the bases that are kept
_MOST_BYTES = 2**25


class Basis(NamedTuple):
    """Basis of the elements in contact and of those that wear."""

    #: (n, n) float, the basis; rows of elements that are apart are 0
    psi: FloatArray
    #: (n,) float, of W
    mu: FloatArray
    #: (n,) float, the weights of the gap in the basis
    force: FloatArray


@dataclass(frozen=True, eq=False)
class ScaledCompliances:
    """m compliances of one contact line."""

    #: (n,) float, mm^2
    area: FloatArray = field(metadata=along(None))
    #: (m, n, n) float, A, symmetric with a unit diagonal
    matrices: FloatArray
    #: (m, n) float, 1/MPa, pressure times this is the unknown
    scale: FloatArray
    #: (m, n) float, gap times this is the gradient
    weights: FloatArray
    #: (m, n) float, positive, W on elements that wear, but for a factor
    speed: FloatArray
    #: (m, n) float, MPa/mm, of each element alone
    stiffness: FloatArray
    #: (m, n, n) float, mm/MPa, what the symmetric compliances have more than the collocated ones,
    #: transposed
    transposed_excess: FloatArray
    #: (m,) bytes, different if anything is that a basis depends on
    names: Any

    @classmethod
    def of(
        cls,
        symmetric: FloatArray,
        area: FloatArray,
        speed: FloatArray | None = None,
        excess: FloatArray | None = None,
    ) -> "ScaledCompliances":
        """Return compliances scaled.

        Parameters
        ----------
        symmetric : (m, n, n) float, mm^3/MPa, symmetric area-weighted compliances.
        speed : (m, n) float, what the slopes of most wear over pressure are in proportion to, where
            elements wear: sliding speeds, along the axis; None: they are uniform.
        excess : (m, n, n) float, mm/MPa, what these have more than the collocated ones; None: no
            more.
        """
        diagonal = np.diagonal(symmetric, axis1=1, axis2=2)
        scale = np.sqrt(diagonal)
        matrices = symmetric / (scale[:, :, None] * scale[:, None, :])
        weights = area / scale
        speed = weights / scale if speed is None else speed * (weights / scale)
        speed = speed / speed.max(axis=1, keepdims=True)
        excess = np.zeros_like(symmetric) if excess is None else excess
        names = [
            blake2b(b"".join(part.tobytes() for part in parts), digest_size=16).digest()
            for parts in zip(matrices, speed, weights, strict=True)
        ]
        return cls(
            area, matrices, scale, weights, speed, area / diagonal,
            np.ascontiguousarray(excess.transpose(0, 2, 1)), np.array(names, dtype=object),
        )  # fmt: skip

    def of_histories(self, values: FloatArray, which: IntArray) -> FloatArray:
        """Return values (m, n) for each history, (B, n); where all have the same, (1, n)."""
        return values if len(values) == 1 else values[which]

    def take(self, numbers: IntArray) -> "ScaledCompliances":
        """Return some of the compliances, in ascending order."""
        return self if len(numbers) == len(self.matrices) else take(self, numbers)

    def basis(self, number: int, free: BoolArray, wearing: BoolArray) -> Basis | None:
        """Return the basis of elements in contact and wearing, (n,); None: not positive definite.

        It is kept for whoever needs it next.
        """
        sets = np.packbits(free).tobytes(), np.packbits(wearing & free).tobytes()
        name = self.names[number], *sets
        if name in _CACHE:
            _CACHE.move_to_end(name)
            return _CACHE[name]
        basis = _CACHE[name] = _basis(
            self.matrices[number], self.speed[number] * wearing, self.weights[number],
            np.flatnonzero(free),
        )  # fmt: skip
        most = max(2, _MOST_BYTES // self.matrices[number].nbytes)
        while len(_CACHE) > most:
            _CACHE.popitem(last=False)
        return basis


def _basis(
    matrix: FloatArray, speed: FloatArray, weights: FloatArray, free: IntArray
) -> Basis | None:
    n, size = len(matrix), len(free)
    psi, mu = np.zeros((n, n)), np.zeros(n)
    try:
        factor = cholesky(matrix[np.ix_(free, free)], lower=True, check_finite=False)
        roots = np.diag(np.sqrt(speed[free]))
        half = solve_triangular(factor, roots, lower=True, check_finite=False)
        values, vectors = np.linalg.eigh(half @ half.T)
    except LinAlgError:
        return None
    mu[:size] = np.maximum(values, 0.0)
    psi[free, :size] = solve_triangular(factor, vectors, lower=True, trans=1, check_finite=False)
    return Basis(psi, mu, weights @ psi)


_CACHE: OrderedDict[tuple[bytes, bytes, bytes], Basis | None] = OrderedDict()
