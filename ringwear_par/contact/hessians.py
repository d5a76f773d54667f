"""The Hessians of B contact problems, A of each history and what its wear adds, and their inverses.

They are diagonal in bases that histories share (see ``bases``). Where the slope of wear over
pressure has another shape, the basis of all elements preconditions conjugate gradients. Non-local
wear and large systems have Cholesky factors of their own.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.linalg.lapack import dpotrf

from ringwear_par.arrays import BoolArray, FloatArray, IntArray, inner
from ringwear_par.batched import along, take
from ringwear_par.contact.bases import Bases, Basis, products
from ringwear_par.contact.newton import solve_rows
from ringwear_par.petsc import PETSc

#: largest systems that have bases: a basis takes as long as 12 factors, and as much memory as two
LARGEST_WITH_BASES = 256
#: what slopes may differ by from their shape, relative: round-off
_ROUND_OFF = 1e-12
#: instead of the number of a basis: a factor of its own, conjugate gradients, and none of them,
#: where a block is not positive definite
_FACTOR, _ITERATIVE, _BROKEN = -1, -2, -3
#: residuals, relative to the first, at which conjugate gradients end: within Newton's method, whose
#: next step corrects what this one left, and of solutions
_NEAR, SOLVED = 1e-6, 1e-13
_MOST_ITERATIONS = 200


class Hessians:
    """Context of a Mat of type "python". What a block is depends on its own history alone.

    Parameters
    ----------
    matrices : (m, n, n) float, scaled compliances.
    bases : (m,) of these.
    speed : (m, n) float, the shape of the slope of most wear on all elements, see ``bases``.
    which : (B,) int, the matrix of each history.
    weights : (B, n) float, what the approach has in the gradient.
    """

    def __init__(
        self,
        matrices: FloatArray,
        bases: Sequence[Bases],
        speed: FloatArray,
        which: IntArray,
        weights: FloatArray,
    ) -> None:
        count, n = weights.shape
        self._matrices, self._bases, self.which = matrices, bases, which
        self._per_speed, self._weights = 1.0 / speed, weights
        #: (B, n) what wear adds to the diagonal
        self.slope = np.zeros((count, n))
        #: (B, n, n) what non-local wear adds, its diagonal included in it; (0, n, n): wear is local
        self.coupling = np.zeros((0, n, n))
        # what the inverses are of
        self._slope, self._free = np.zeros((count, n)), np.zeros((count, n), dtype=bool)
        self._valid = np.zeros(count, dtype=bool)
        #: packed bits of the elements in contact and of those that wear
        self._sets = np.zeros((count, -(-2 * n // 8)), dtype=np.uint8)
        #: bases by their sets, the number of that of each history, and its inverse there, diagonal
        self._numbers: dict[tuple[int, bytes], int] = {}
        self._used: list[Basis] = []
        self._number = np.full(count, _BROKEN)
        self._preconditioner = np.full(count, _BROKEN)
        self._inverse = np.zeros((count, n))
        self._factors: dict[int, FloatArray] = {}

    def mult(self, matrix: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Set y to H x."""
        q = x.getArray(readonly=True).reshape(self.slope.shape)
        product = products(q, self._matrices, self.which) + self.slope * q
        if len(self.coupling):
            product += np.einsum("bij,bj->bi", self.coupling, q)
        y.getArray()[:] = product.ravel()

    def forget(self, histories: IntArray) -> None:
        """Let nothing touch in some histories."""
        self._free[histories], self._valid[histories] = False, False
        self._number[histories] = _FACTOR
        for history in histories.tolist():
            self._factors[history] = np.zeros((0, 0))

    def refresh(self, histories: IntArray, free: BoolArray) -> None:
        """Invert the blocks of those histories that have changed, on their free elements, (B, n).

        What is not positive definite has NaN as its solutions.
        """
        slope, own = self.slope[histories], free[histories]
        new = ~self._valid[histories]
        new |= (slope != self._slope[histories]).any(axis=1)
        new |= (own != self._free[histories]).any(axis=1)
        coupled, n = bool(len(self.coupling)), slope.shape[1]
        if coupled:
            new[:] = True
        if not new.all():
            if not new.any():
                return
            histories, slope, own = histories[new], slope[new], own[new]
        self._slope[histories], self._free[histories] = slope, own
        self._valid[histories] = not coupled
        if coupled or n > LARGEST_WITH_BASES:
            for history in histories.tolist():
                self._number[history] = self._factorise(history)
            return
        rate = np.where(own, slope * self._per_speed[self.which[histories]], 0.0)
        wearing = rate > 0.0
        most = rate.max(axis=1)
        least = np.where(wearing, rate, np.inf).min(axis=1)
        regular = ~(most - least > _ROUND_OFF * most)
        if regular.all():
            self._choose_bases(histories, own, wearing, most)
            return
        if regular.any():
            rows = np.flatnonzero(regular)
            self._choose_bases(histories[rows], own[rows], wearing[rows], most[rows])
        rows = np.flatnonzero(~regular)
        middle = np.sqrt(most[rows] * least[rows])
        self._precondition(
            histories[rows], np.where((wearing | ~own)[rows].all(axis=1), middle, most[rows])
        )

    def _choose_bases(
        self, histories: IntArray, free: BoolArray, wearing: BoolArray, rate: FloatArray
    ) -> None:
        """Take the bases of histories, (h, n) and (h,) being their sets and slope over speed."""
        wearing[~wearing.any(axis=1)] = True  # so as not to need one without wear
        sets = np.packbits(np.concatenate([free, wearing & free], axis=1), axis=1)
        new = (sets != self._sets[histories]).any(axis=1) | (self._number[histories] < 0)
        self._sets[histories] = sets
        for place in np.flatnonzero(new).tolist():
            history = int(histories[place])
            name = int(self.which[history]), sets[place].tobytes()
            self._number[history] = self._number_of(name, free[place], wearing[place])
        self._inverse[histories] = 1.0 / (1.0 + rate[:, None] * self._mu(self._number[histories]))

    def _number_of(self, name: tuple[int, bytes], free: BoolArray, wearing: BoolArray) -> int:
        """Return the number of the basis of a matrix and its sets."""
        number = self._numbers.get(name)
        if number is None:
            basis = self._bases[name[0]].basis(free, wearing)
            number = _BROKEN
            if basis is not None:
                number = len(self._used)
                self._used.append(basis)
            self._numbers[name] = number
        return number

    def _mu(self, numbers: IntArray) -> FloatArray:
        """Return ``Basis.mu`` of bases by their numbers, (h, n) or (n,)."""
        first = int(numbers[0])
        if first >= 0 and (numbers == first).all():
            return self._used[first].mu
        every = [np.ones(self.slope.shape[1]), *(basis.mu for basis in self._used)]
        return np.array(every)[np.maximum(numbers, -1) + 1]

    def _precondition(self, histories: IntArray, rate: FloatArray) -> None:
        """Take the bases of all elements, at slopes over speed (h,), for conjugate gradients."""
        every = np.ones(self.slope.shape[1], dtype=bool)
        name = np.packbits(np.concatenate([every, every])).tobytes()
        numbers = np.array(
            [self._number_of((k, name), every, every) for k in self.which[histories].tolist()]
        )
        self._inverse[histories] = 1.0 / (1.0 + rate[:, None] * self._mu(numbers))
        self._preconditioner[histories] = numbers
        self._number[histories] = np.where(numbers < 0, _BROKEN, _ITERATIVE)

    def _factorise(self, history: int) -> int:
        """Factor a block; return the number that says whether it has a factor."""
        block = self._matrices[self.which[history]].copy()
        if len(self.coupling):
            block += self.coupling[history]
        block[np.diag_indices(len(block))] += self._slope[history]
        free = self._free[history]
        if not free.all():
            block = block[np.ix_(free, free)]
        self._factors[history], info = dpotrf(block, lower=1, clean=0)
        return _FACTOR if info == 0 else _BROKEN

    def _parts(self, histories: IntArray) -> Iterator[tuple[int, IntArray | slice]]:
        """Return numbers of bases and the rows that have them; rows with factors one by one."""
        number = self._number[histories]
        if len(number) and number[0] >= 0 and (number == number[0]).all():
            yield int(number[0]), slice(None)
            return
        for k in np.unique(number).tolist():
            rows = np.flatnonzero(number == k)
            if k == _FACTOR:
                yield from ((k, rows[i : i + 1]) for i in range(len(rows)))
            else:
                yield k, rows

    def solve(self, histories: IntArray, right: FloatArray) -> FloatArray:
        """Return H^-1 right, (..., h, n), of some histories; 0 off their sets."""
        out = np.zeros_like(right)
        for k, rows in self._parts(histories):
            if k >= 0:
                basis, inverse = self._used[k], self._inverse[histories[rows]]
                modal = products(right[..., rows, :], basis.psi) * inverse
                out[..., rows, :] = products(modal, basis.psi_t)
            elif k == _BROKEN:
                out[..., rows, :] = np.nan
            elif k == _ITERATIVE:
                sides = right[..., rows, :].reshape(-1, right.shape[-1])
                repeated = np.tile(histories[rows], len(sides) // max(len(histories[rows]), 1))
                solved, _ = self._iterate(repeated, sides, None, SOLVED)
                out[..., rows, :] = solved.reshape(right[..., rows, :].shape)
            else:
                place = int(np.arange(len(histories))[rows][0])
                history = int(histories[place])
                own, factor = self._free[history], self._factors[history]
                if len(factor):
                    sides = right[..., place, :][..., own]
                    solved = solve_rows(factor, sides.reshape(-1, len(factor)))
                    out[..., place, own] = solved.reshape(sides.shape)
        return out

    def steps(
        self,
        histories: IntArray,
        gradient: FloatArray,
        missing: FloatArray,
        tolerance: float = _NEAR,
    ) -> tuple[FloatArray, FloatArray]:
        """Return the steps (h, n) against gradients, and of the approaches, (h,).

        The approach follows so that the steps carry the force that is missing.

        Parameters
        ----------
        gradient : (h, n) float.
        missing : (h,) float, N.
        tolerance : of the residual, relative to the first, where steps are iterated for.
        """
        steps, approach = np.zeros_like(gradient), np.zeros(len(gradient))
        for k, rows in self._parts(histories):
            if k >= 0:
                basis, inverse = self._used[k], self._inverse[histories[rows]]
                modal = products(gradient[rows], basis.psi) * inverse
                border = inverse * basis.force
                carried, stiffness = inner(basis.force, modal), inner(basis.force, border)
                change = _divided(missing[rows] + carried, stiffness)
                modal = change[:, None] * border - modal
                steps[rows], approach[rows] = products(modal, basis.psi_t), change
            elif k == _BROKEN:
                steps[rows], approach[rows] = np.nan, np.nan
            elif k == _ITERATIVE:
                steps[rows], approach[rows] = self._iterate(
                    histories[rows], -gradient[rows], missing[rows], tolerance
                )
            else:
                weights = self._weights[histories[rows]]
                both = self.solve(histories[rows], np.array([gradient[rows], weights]))
                carried, stiffness = (inner(weights, each) for each in both)
                change = _divided(missing[rows] + carried, stiffness)
                steps[rows], approach[rows] = change[:, None] * both[1] - both[0], change
        return steps, approach

    def _iterate(
        self,
        histories: IntArray,
        right: FloatArray,
        missing: FloatArray | None,
        tolerance: float,
    ) -> tuple[FloatArray, FloatArray]:
        """Return H^-1 right, (h, n), by conjugate gradients, and changes of approaches, (h,).

        With a force that is missing, (h,) N, solutions carry it, and so does each iterate: the
        approach is the multiplier of that condition.
        """
        x, approach = np.zeros_like(right), np.zeros(len(right))
        numbers, whole = self._preconditioner[histories], self._free[histories].all(axis=1)
        for number in np.unique(numbers).tolist():
            for modal in (True, False):
                rows = np.flatnonzero((numbers == number) & (whole == modal))
                if not len(rows):
                    continue
                system = _System(
                    self._used[number],
                    self._matrices[self.which[histories[rows[0]]]],
                    self._slope[histories[rows]],
                    self._inverse[histories[rows]],
                    None if modal else self._free[histories[rows]].astype(float),
                    self._weights[histories[rows]],
                )
                x[rows], approach[rows] = _conjugate_gradients(
                    system, right[rows], None if missing is None else missing[rows], tolerance
                )
        return x, approach


def _divided(force: FloatArray, stiffness: FloatArray) -> FloatArray:
    """Return forces over stiffnesses, (h,); 0 where nothing touches."""
    return np.divide(force, stiffness, out=np.zeros_like(force), where=stiffness > 0.0)


@dataclass(frozen=True)
class _System:
    """Systems of rows with slopes of any shape, preconditioned by a basis of all elements.

    Parameters
    ----------
    basis, matrix : of the rows.
    slope, inverse : (h, n) float, of the wear, and of the preconditioner in the basis.
    free : (h, n) float, 1 on elements in contact, else 0; None: all are, and unknowns are those in
        the basis.
    weights : (h, n) float, what the approach has in the gradient.
    """

    basis: Basis = field(metadata=along(None))
    matrix: FloatArray = field(metadata=along(None))
    slope: FloatArray
    inverse: FloatArray
    free: FloatArray | None
    weights: FloatArray

    def into(self, right: FloatArray) -> FloatArray:
        """Return right sides of the unknowns."""
        return products(right, self.basis.psi) if self.free is None else right * self.free

    def back(self, x: FloatArray) -> FloatArray:
        """Return solutions from the unknowns."""
        return products(x, self.basis.psi_t) if self.free is None else x

    @property
    def border(self) -> FloatArray:
        """What the approach has in the unknowns' gradient, (h, n)."""
        if self.free is None:
            return np.broadcast_to(self.basis.force, self.slope.shape)
        return self.weights * self.free

    def apply(self, x: FloatArray) -> FloatArray:
        """Return the matrices times x."""
        basis = self.basis
        if self.free is None:
            return x + products(self.slope * products(x, basis.psi_t), basis.psi)
        return (products(x, self.matrix) + self.slope * x) * self.free

    def precondition(self, r: FloatArray) -> FloatArray:
        """Return about the inverse matrices times r."""
        if self.free is None:
            return self.inverse * r
        basis = self.basis
        return products(products(r, basis.psi) * self.inverse, basis.psi_t) * self.free


def _conjugate_gradients(
    system: _System, right: FloatArray, missing: FloatArray | None, tolerance: float
) -> tuple[FloatArray, FloatArray]:
    """Return solutions (h, n), and multipliers (h,), see ``Hessians._iterate``.

    Projected conjugate gradients: Gould, Hribar and Nocedal, SIAM J. Sci. Comput. 23 (2001).
    """
    every, found, multipliers = system, np.zeros_like(right), np.zeros(len(right))
    rows, r = np.arange(len(right)), system.into(right)
    force = system.border
    response = system.precondition(force)
    stiffness, multiplier = inner(force, response), np.zeros(len(right))
    x = np.zeros_like(r)
    if missing is not None:
        x = response * _divided(missing, stiffness)[:, None]
        r = r - system.apply(x)

    def projected(r: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        z = system.precondition(r)
        if missing is None:
            return r, z, multiplier
        more = _divided(inner(force, z), stiffness)
        return r - force * more[:, None], z - response * more[:, None], multiplier + more

    r, z, multiplier = projected(r)
    direction, size = z, inner(r, z)
    small = tolerance * tolerance * size
    for _ in range(_MOST_ITERATIONS):
        going = size > small
        if not going.all():
            ended = ~going
            found[rows[ended]], multipliers[rows[ended]] = x[ended], -multiplier[ended]
            if not going.any():
                break
            system = take(system, np.flatnonzero(going))
            rows, x, r, z, direction, size, small, multiplier = (
                a[going] for a in (rows, x, r, z, direction, size, small, multiplier)
            )
            force, response, stiffness = force[going], response[going], stiffness[going]
        product = system.apply(direction)
        length = (size / inner(direction, product))[:, None]
        x, r = x + length * direction, r - length * product
        r, z, multiplier = projected(r)
        before, size = size, inner(r, z)
        direction = z + (size / before)[:, None] * direction
    else:
        found[rows], multipliers[rows] = x, -multiplier
    return every.back(found), multipliers
