"""The contact problem, eq. (3) of the paper, of B histories on one contact line.

    p >= 0,   g = gap - approach + C p + depth(p) >= 0,   one of them 0 on every element,

at an approach, or at a force ``area . p``. C is the compliance as collocation gives it, and depth
the wear of an implicit step (``wear.step``), absent otherwise.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray, IntArray
from ringwear_par.elasticity.bem.pair import ContactPair
from ringwear_par.wear.step import Elements


class Contact(NamedTuple):
    """Solutions of B contact problems."""

    #: (B, n) MPa, and (B,) mm
    pressure: FloatArray
    approach: FloatArray
    #: (B,) whether there is none, and how many iterations, or sets of elements, it took
    failed: BoolArray
    iterations: IntArray


@dataclass(frozen=True, kw_only=True)
class Line(Elements):
    """The contact elements of a block, and what pairs of bodies give way there."""

    #: the pairs, f of them, on the same elements
    pairs: tuple[ContactPair, ...]
    #: (f, 2, n, n) mm/MPa of lower and upper at Young's modulus 1, as collocation gives them
    units: FloatArray
    #: the matrix that was asked for last, by pair and softness
    _matrix: dict[tuple[float, ...], FloatArray] = field(
        default_factory=dict, compare=False, repr=False
    )

    @classmethod
    def of(cls, pairs: Sequence[ContactPair]) -> "Line":
        """Return the line of some pairs."""
        first, units = pairs[0], np.array([pair.normal for pair in pairs])
        secant = np.hypot(1.0, first.slope)
        return cls(
            pairs=tuple(pairs),
            r=first.line.r,
            area=first.line.area.copy(),  # C code takes none that is read-only
            obliquity=secant if (secant > 1.0).any() else None,
            units=units,
        )

    @cached_property
    def columns(self) -> FloatArray:
        """(f, 2, n, n) mm/MPa, the transposes of ``units``, as loops in C run through them."""
        return np.ascontiguousarray(self.units.swapaxes(2, 3))

    def matrix(self, pair: int, softness: FloatArray) -> FloatArray:
        """Return the compliance of a pair, (n, n) mm/MPa."""
        key = pair, *softness.tolist()
        if key not in self._matrix:
            self._matrix.clear()  # histories of a block mostly have the same
            self._matrix[key] = np.asfortranarray(np.tensordot(softness, self.units[pair], 1))
        return self._matrix[key]


@dataclass(frozen=True)
class Compliance:
    """What the elements of B histories give way under pressure: C = C1 / E1 + C2 / E2."""

    line: Line
    #: (B,) which of the pairs, and (B, 2) 1/MPa, one over the moduli of lower and upper
    pair: IntArray
    softness: FloatArray
    #: (B, n) mm/MPa, of elements under their own pressures
    diagonal: FloatArray

    @classmethod
    def of(cls, line: Line, pair: IntArray, softness: FloatArray) -> "Compliance":
        """Return the compliance of histories."""
        own = np.diagonal(line.units, axis1=2, axis2=3)[pair]
        return cls(line, pair, softness, np.einsum("bj,bjn->bn", softness, own))

    @property
    def asymmetry(self) -> FloatArray:
        """(B,) largest ``|m C - (m C)'|`` over the largest ``|m C|``, of the areas m.

        By reciprocity it vanishes with the mesh.
        """
        keys = np.column_stack([self.pair, self.softness])
        _, rows, which = np.unique(keys, axis=0, return_index=True, return_inverse=True)
        weighted = (self.line.area[:, None] * self.matrix(row) for row in rows.tolist())
        return np.array([np.abs(m - m.T).max() / np.abs(m).max() for m in weighted])[which.ravel()]

    def matrix(self, row: int) -> FloatArray:
        """Return the compliance of one history, (n, n) mm/MPa."""
        return self.line.matrix(int(self.pair[row]), self.softness[row])

    def deflection(self, p: FloatArray) -> FloatArray:
        """Return what elements give way under pressures, (B, n) mm."""
        lower, upper = self.of_pairs(self.line.units, p).swapaxes(0, 1)
        return self.softness[:, :1] * lower + self.softness[:, 1:] * upper

    def of_pairs(self, matrices: FloatArray, p: FloatArray) -> FloatArray:
        """Return products of matrices of pairs (f, ..., n) with pressures (B, n), (B, ...)."""
        products = np.empty((len(p), *matrices.shape[1:-1]))
        for number, matrix in enumerate(matrices):
            rows = self.pair == number if len(matrices) > 1 else slice(None)
            products[rows] = np.moveaxis(matrix @ p[rows].T, -1, 0)
        return products

    def gap(self, gap: FloatArray, p: FloatArray, approach: FloatArray) -> FloatArray:
        """Return gaps (B, n) mm of bodies under pressures, from those of the undeformed ones."""
        return gap - approach[:, None] + self.deflection(p)

    def residual(self, gap: FloatArray, p: FloatArray) -> FloatArray:
        """Return natural residuals of eq. (3), (B,), over the largest pressure of the history.

        Parameters
        ----------
        gap : (B, n) mm, of the bodies under the pressures.
        """
        miss = np.abs(np.minimum(p, gap / self.diagonal)).max(axis=1)
        largest = p.max(axis=1)
        return np.divide(miss, largest, out=np.zeros_like(miss), where=largest > 0.0)
