"""Compliances as contact problems have them: scaled, with the bases of their Hessians.

The slope of wear over pressure of most laws is one number times the sliding speed, on all elements
that wear. With A the scaled compliance of the elements in contact and W their speeds,

    Psi' A Psi = 1,   Psi' W Psi = mu,   (A + alpha W)^-1 = Psi diag(1 / (1 + alpha mu)) Psi',

so that one basis serves every step of every history with the same elements in contact and wearing.
Compliances may differ a little from references, whose bases they share.
"""

from collections import OrderedDict
from dataclasses import dataclass, field, replace
from functools import cached_property
from hashlib import blake2b
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, cholesky, solve_triangular

from ringwear_par.arrays import BoolArray, FloatArray, IntArray
from ringwear_par.batched import along, take
from ringwear_par.compiled.contact_rows import Compliances
from ringwear_par.compiled.product_rows import Matrices
from ringwear_par.contact.row_products import RowProducts

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
class Deviations:
    """How m compliances deviate from f references, K = share (K_ref + deviation K').

    Unscaled or, as A of K, scaled.
    """

    #: (m,) float; nothing but the reference is 1 and 0
    share: FloatArray
    deviation: FloatArray
    #: (f, n, n) float, K'
    derivatives: FloatArray = field(metadata=along(None))
    #: (f, n, n) float, mm/MPa, what K' has more than the same of collocated compliances, transposed
    transposed_excess: FloatArray = field(metadata=along(None))


@dataclass(frozen=True, eq=False)
class ScaledCompliances:
    """m compliances of one contact line, each equal or near to one of f references."""

    #: (n,) float, mm^2
    area: FloatArray = field(metadata=along(None))
    #: (f, n, n) float, A of the references, symmetric with a unit diagonal
    matrices: FloatArray = field(metadata=along(None))
    #: (m,) int, the reference of each
    reference: IntArray
    #: (m, n) float, 1/MPa, pressure times this is the unknown
    scale: FloatArray
    #: (m, n) float, gap times this is the gradient
    weights: FloatArray
    #: (f, n) float, these weights of the references
    reference_weights: FloatArray = field(metadata=along(None))
    #: (f, n) float, positive, W on elements that wear, but for a factor
    speed: FloatArray = field(metadata=along(None))
    #: (m, n) float, MPa/mm, of each element alone
    stiffness: FloatArray
    #: (f, n, n) float, mm/MPa, what the references have more than the collocated ones, transposed
    transposed_excess: FloatArray = field(metadata=along(None))
    #: (f,) bytes, different if anything is that a basis depends on
    names: Any = field(metadata=along(None))
    #: None: all of them are references
    deviations: Deviations | None

    @classmethod
    def of(
        cls,
        symmetric: FloatArray,
        area: FloatArray,
        speed: FloatArray | None = None,
        excess: FloatArray | None = None,
        reference: IntArray | None = None,
        deviations: Deviations | None = None,
    ) -> "ScaledCompliances":
        """Return compliances scaled.

        Parameters
        ----------
        symmetric : (f, n, n) float, mm^3/MPa, symmetric area-weighted compliances.
        speed : (f, n) float, what the slopes of most wear over pressure are in proportion to, where
            elements wear: sliding speeds, along the axis; None: they are uniform.
        excess : (f, n, n) float, mm/MPa, what these have more than the collocated ones; None: no
            more.
        reference : (m,) int, those that compliances are near to; None: they are these.
        deviations : from the references, not scaled; None: they are these.
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
        every = np.arange(len(symmetric)) if reference is None else reference
        root, stiffness, scaled = np.ones((len(every), 1)), (area / diagonal)[every], None
        if deviations is not None:
            root = np.sqrt(deviations.share)[:, None]
            stiffness = stiffness / deviations.share[:, None]
            scaled = replace(
                deviations,
                derivatives=deviations.derivatives / (scale[:, :, None] * scale[:, None, :]),
            )
        return cls(
            area, matrices, every, scale[every] * root, weights[every] / root, weights, speed,
            stiffness, np.ascontiguousarray(excess.transpose(0, 2, 1)),
            np.array(names, dtype=object), scaled,
        )  # fmt: skip

    @cached_property
    def record(self) -> Compliances:
        """The compliances as loops have them."""
        more = self.deviations
        return Compliances(
            Matrices.of(self.matrices, None if more is None else more.derivatives),
            self.reference,
            self.reference_weights,
            self.weights,
            1.0 / self.scale,
            self.weights / self.scale,
            (1.0 / self.speed)[self.reference],
            np.ones(len(self.reference)) if more is None else np.sqrt(more.share),
        )

    @cached_property
    def excess(self) -> Matrices:
        """(f, n, n) mm/MPa, ``transposed_excess``, and that of deviations."""
        more = self.deviations
        return Matrices.of(self.transposed_excess, None if more is None else more.transposed_excess)

    def deviation(self, which: IntArray) -> FloatArray:
        """Return how compliances (h,) deviate from their references, (h,)."""
        more = self.deviations
        return np.zeros(len(which)) if more is None else more.deviation[which]

    def take(self, numbers: IntArray) -> "ScaledCompliances":
        """Return some of the compliances, in ascending order."""
        return self if len(numbers) == len(self.reference) else take(self, numbers)

    def products(self, which: IntArray) -> "ComplianceProducts":
        """Return the products of rows with these compliances, (h,) int."""
        return ComplianceProducts(self, which)

    def matrix(self, number: int) -> FloatArray:
        """Return A of one of the compliances, (n, n)."""
        at, more = self.reference[number], self.deviations
        if more is None:
            return self.matrices[at].copy()
        return self.matrices[at] + more.deviation[number] * more.derivatives[at]

    def basis(self, number: int, free: BoolArray, wearing: BoolArray) -> Basis:
        """Return the basis of elements of a reference in contact and wearing, (n,).

        NaN if that is not positive definite. It is kept for whoever needs it next.
        """
        sets = np.packbits(free).tobytes(), np.packbits(wearing & free).tobytes()
        name = self.names[number], *sets
        if name in _CACHE:
            _CACHE.move_to_end(name)
            return _CACHE[name]
        basis = _CACHE[name] = _basis(
            self.matrices[number], self.speed[number] * wearing,
            self.reference_weights[number], np.flatnonzero(free),
        )  # fmt: skip
        most = max(2, _MOST_BYTES // self.matrices[number].nbytes)
        while len(_CACHE) > most:
            _CACHE.popitem(last=False)
        return basis


def _basis(matrix: FloatArray, speed: FloatArray, weights: FloatArray, free: IntArray) -> Basis:
    n, size = len(matrix), len(free)
    psi, mu = np.zeros((n, n)), np.zeros(n)
    try:
        factor = cholesky(matrix[np.ix_(free, free)], lower=True, check_finite=False)
        roots = np.diag(np.sqrt(speed[free]))
        half = solve_triangular(factor, roots, lower=True, check_finite=False)
        values, vectors = np.linalg.eigh(half @ half.T)
    except LinAlgError:
        return Basis(*(np.full_like(part, np.nan) for part in (psi, mu, mu)))
    mu[:size] = np.maximum(values, 0.0)
    psi[free, :size] = solve_triangular(factor, vectors, lower=True, trans=1, check_finite=False)
    return Basis(psi, mu, weights @ psi)


class ComplianceProducts:
    """Products of rows with compliances, whose digits do not depend on the other rows.

    Parameters
    ----------
    compliances : of which each row has one.
    which : (h,) int, its number.
    """

    def __init__(self, compliances: ScaledCompliances, which: IntArray) -> None:
        self._compliances, self._which = compliances, which
        self._rows = RowProducts(compliances.reference[which], compliances.deviation(which))

    def symmetric(self, q: FloatArray) -> FloatArray:
        """Return A q, (..., h, n)."""
        return self._rows.of(q, self._compliances.record.matrices)

    def gap_of_excess(self, p: FloatArray) -> FloatArray:
        """Return the gap that the excess opens at pressures (..., h, n) MPa, mm."""
        gap, more = self._rows.of(p, self._compliances.excess), self._compliances.deviations
        if more is not None:
            gap *= more.share[self._which][:, None]
        return gap


_CACHE: OrderedDict[tuple[bytes, bytes, bytes], Basis] = OrderedDict()
