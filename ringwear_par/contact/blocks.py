"""The Hessian of B contact problems: a block each, factored where it has changed."""

import math

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotrs

from ringwear_par.arrays import BoolArray, FloatArray, IntArray
from ringwear_par.contact import interleaved
from ringwear_par.contact.newton import solve_rows
from ringwear_par.petsc import PETSc

#: largest blocks that are factored eight at a time: a factor and 3.5 solutions, as many as steps
#: ask for, took a history 21 us against LAPACK's 37 of 64 elements, 134 against 152 of 128, 291
#: against 372 of 192, but 1,180 against 680 of 256
LARGEST_INTERLEAVED = 192
#: factors of blocks that are gone, for the next ones: as histories end blocks follow each other
#: every few rounds, and memory that is new costs as much as a tenth of the steps
_SPARE: list[FloatArray] = []
_MOST_SPARE = 2


class HessianBlocks:
    """Context of a Mat of type "python": A of each history, and what its wear adds.

    Blocks are never put together; factors are of the elements that are free, the rest being unit
    rows. What a block is depends on its own history alone.

    Parameters
    ----------
    matrices : (m, n, n) float, scaled compliances.
    which : (B,) int, the matrix of each history.
    """

    def __init__(self, matrices: FloatArray, which: IntArray) -> None:
        count, n = len(which), matrices.shape[1]
        self._matrices, self._count = matrices, count
        padded = -(-count // interleaved.GROUP) * interleaved.GROUP
        self.which = np.append(which, np.full(padded - count, which[-1])).astype(np.int64)
        #: (B, n) what wear adds to the diagonal
        self.slope = np.zeros((count, n))
        #: (B, n, n) what non-local wear adds, its diagonal included in it; (0, n, n): wear is local
        self.coupling = np.zeros((0, n, n))
        # what the factors are of
        self._slope, self._free = np.zeros((padded, n)), np.zeros((padded, n), dtype=bool)
        self._coupling = self.coupling
        self._valid = np.zeros(count, dtype=bool)
        #: (B, n) and (B,): H^-1 times the weights, and what the weights make of it
        self.border, self.sums = np.zeros((count, n)), np.zeros(count)
        self._factors: FloatArray | list[FloatArray | None]
        if n <= LARGEST_INTERLEAVED:
            size = -(-n // interleaved.PANEL) * interleaved.PANEL
            groups = padded // interleaved.GROUP
            shape = (groups, size, size, interleaved.GROUP)
            self._memory = _memory(math.prod(shape))
            self._factors = self._memory[: math.prod(shape)].reshape(shape)
        else:
            self._factors = [None] * count

    def mult(self, matrix: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Set y to H x."""
        q = x.getArray(readonly=True).reshape(self.slope.shape)
        product = y.getArray().reshape(self.slope.shape)
        every = np.arange(self._count)
        interleaved.multiply(every, self._matrices, self.which, q, product)
        product += self.slope * q
        if len(self.coupling):
            product += np.einsum("bij,bj->bi", self.coupling, q)

    def destroy(self, matrix: PETSc.Mat) -> None:
        """Leave the memory to others, with the end of the Mat."""
        if not isinstance(self._factors, list):
            _SPARE.append(self._memory)
            del _SPARE[:-_MOST_SPARE]
        self._factors = []

    def forget(self, histories: IntArray) -> None:
        """Make sure that the factors of some histories are of no element."""
        self._free[histories] = False
        self._valid[histories] = False
        self.border[histories], self.sums[histories] = 0.0, 0.0

    def refresh(self, histories: IntArray, free: BoolArray, weights: FloatArray) -> None:
        """Factor the blocks of those histories that have changed, on their free elements, (B, n).

        What is not positive definite becomes NaN.
        """
        slope, own = self.slope[histories], free[histories]
        new = ~self._valid[histories]
        new |= (slope != self._slope[histories]).any(axis=1)
        new |= (own != self._free[histories]).any(axis=1)
        if len(self.coupling) or len(self._coupling):
            new[:] = True
        if not new.any():
            return
        changed = histories[new]
        self._slope[changed], self._free[changed] = slope[new], own[new]
        if len(self.coupling):
            if not len(self._coupling):
                self._coupling = np.zeros((len(self.which), *self.coupling.shape[1:]))
            self._coupling[changed] = self.coupling[changed]
        else:
            self._coupling = self.coupling
        self._valid[changed] = True
        if isinstance(self._factors, list):
            for history in changed:
                self._factors[history] = self._factor(history)
        else:
            interleaved.factor(
                np.unique(changed // interleaved.GROUP), self._matrices, self.which, self._slope,
                self._free, self._coupling, self._factors,
            )  # fmt: skip
        right = weights[changed]
        border = self.solve(changed, right)
        self.border[changed], self.sums[changed] = border, (right * border).sum(axis=1)

    def _factor(self, history: int) -> FloatArray | None:
        """Return the factor of a large block, None if it has none."""
        block = self._matrices[self.which[history]].copy()
        if len(self._coupling):
            block += self._coupling[history]
        block[np.diag_indices(len(block))] += self._slope[history]
        free = self._free[history]
        if not free.all():
            block = block[np.ix_(free, free)]
        factor, info = dpotrf(block, lower=1, clean=0)
        return factor if info == 0 else None

    def solve(self, histories: IntArray, right: FloatArray) -> FloatArray:
        """Return H^-1 right, (h, n), of some histories in increasing order; 0 off their sets."""
        out = np.zeros_like(right)
        if isinstance(self._factors, list):
            for place, history in enumerate(histories):
                free, factor = self._free[history], self._factors[history]
                if factor is None:
                    out[place, free] = np.nan
                elif free.any():
                    out[place, free], _ = dpotrs(factor, right[place, free], lower=1)
        else:
            interleaved.solve(histories, self._free, self._factors, right, out)
        return out

    def solve_more(self, histories: IntArray, right: FloatArray) -> FloatArray:
        """Return the same for several right sides, (k, h, n), to round-off."""
        if isinstance(self._factors, list):
            out = np.zeros_like(right)
            for place, history in enumerate(histories):
                free, factor = self._free[history], self._factors[history]
                if factor is None:
                    out[:, place, free] = np.nan
                elif free.any():
                    out[:, place, free] = solve_rows(factor, right[:, place, free])
        else:
            out = np.empty_like(right)
            interleaved.solve_more(histories, self._free, self._factors, right, out)
        return out


def _memory(numbers: int) -> FloatArray:
    """Return memory for so many numbers, or more, whatever is in it."""
    for place, memory in enumerate(_SPARE):
        if numbers <= len(memory) <= 4 * numbers:
            return _SPARE.pop(place)
    return np.empty(numbers)
