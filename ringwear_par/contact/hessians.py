"""The Hessians of B contact problems, A of each history and what its wear adds, and their inverses.

They are diagonal in bases that histories share (see ``bases``). Where the slope of wear over
pressure has another shape, such a basis preconditions conjugate gradients. Wear that gets through
layers, non-local wear and large systems have Cholesky factors of their own.
"""

from collections.abc import Sequence

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotrs

from ringwear_par.arrays import BoolArray, FloatArray, IntArray, inner
from ringwear_par.contact.bases import Bases, Basis, RowGroups
from ringwear_par.petsc import PETSc

#: largest systems that have bases: a basis takes as long as 26 to 31 factors (0.67, 3.1 and 14.8 ms
#: with 64, 128 and 256 elements), and as much memory as two
LARGEST_WITH_BASES = 256
#: what slopes may differ by from their shape, relative: round-off
_ROUND_OFF = 1e-12
#: instead of the number of a basis: a factor of its own, and what is not positive definite
_FACTOR, _BROKEN = -1, -2
#: residuals, relative to the first, at which conjugate gradients end: within Newton's method, whose
#: next step corrects what this one left, and of solutions
NEAR, SOLVED = 1e-6, 1e-13
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
        self._matrices, self._bases, self._which = matrices, bases, which
        self._per_speed, self._weights = 1.0 / speed, weights
        #: (B, n) what wear adds to the diagonal
        self.slope = np.zeros((count, n))
        #: (B, n, n) what non-local wear adds, its diagonal included in it; (0, n, n): wear is local
        self.coupling = np.zeros((0, n, n))
        #: whether wear gets through layers: slopes then are of several laws, far apart, and a
        #: factor takes less time than conjugate gradients
        self.through_layers = False
        # what the inverses are of
        self._slope, self._free = np.zeros((count, n)), np.zeros((count, n), dtype=bool)
        self._valid = np.zeros(count, dtype=bool)
        #: packed bits of the elements in contact and of those that wear
        self._sets = np.zeros((count, -(-2 * n // 8)), dtype=np.uint8)
        #: bases by their matrices and sets, the number of that of each history
        self._numbers: dict[tuple[int, bytes], int] = {}
        #: (m, n, n) and (m, n) each, of the bases, room for more included; see ``Basis``
        self._psi, self._mu, self._force = np.empty((0, n, n)), np.empty((0, n)), np.empty((0, n))
        self._count = 0
        self._number = np.full(count, _BROKEN)
        #: (B, n) inverses in the bases, exact where the slope has the shape, else preconditioners
        self._inverse, self._regular = np.ones((count, n)), np.ones(count, dtype=bool)
        #: (B, n) inverses times the force in the bases, and (B,) the force that these carry
        self._border, self._stiffness = np.zeros((count, n)), np.zeros(count)
        self._factors: dict[int, FloatArray] = {}
        self._rows: tuple[IntArray, _Rows] | None = None

    def mult(self, matrix: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Set y to H x."""
        q = x.getArray(readonly=True).reshape(self.slope.shape)
        product = RowGroups(self._which).products(q, self._matrices) + self.slope * q
        if len(self.coupling):
            product += np.einsum("bij,bj->bi", self.coupling, q)
        y.getArray()[:] = product.ravel()

    def forget(self, histories: IntArray) -> None:
        """Let nothing touch in some histories."""
        self._free[histories], self._valid[histories] = False, False
        self._number[histories], self._rows = _FACTOR, None
        for history in histories.tolist():
            self._factors[history] = np.zeros((0, 0))

    def refresh(self, histories: IntArray, free: BoolArray) -> None:
        """Invert the blocks of those histories that have changed, on their free elements, (B, n).

        What is not positive definite has NaN as its solutions.
        """
        slope, touching = self.slope[histories], free[histories]
        new = ~self._valid[histories]
        new |= (slope != self._slope[histories]).any(axis=1)
        new |= (touching != self._free[histories]).any(axis=1)
        coupled = bool(len(self.coupling))
        if coupled:
            new[:] = True
        if not new.all():
            if not new.any():
                return
            histories, slope, touching = histories[new], slope[new], touching[new]
        self._slope[histories], self._free[histories] = slope, touching
        self._valid[histories] = not coupled
        if coupled or slope.shape[1] > LARGEST_WITH_BASES:
            self._factorise(histories)
            return
        rate = np.where(touching, slope * self._per_speed[self._which[histories]], 0.0)
        wearing = rate > 0.0
        most = rate.max(axis=1)
        least = np.where(wearing, rate, np.inf).min(axis=1)
        regular = ~(most - least > _ROUND_OFF * most)
        if self.through_layers and not regular.all():
            self._factorise(histories[~regular])
            histories, touching, wearing, most = (
                values[regular] for values in (histories, touching, wearing, most)
            )
            regular = regular[regular]
            if not len(histories):
                return
        self._regular[histories] = regular
        if not regular.all():
            places = np.flatnonzero(~regular)
            wearing[places] = True
            ordered = np.sort(np.where(touching[places], rate[places], np.inf), axis=1)
            middle = touching[places].sum(axis=1) // 2
            most[places] = ordered[np.arange(len(places)), middle]  # the median
        wearing[~wearing.any(axis=1)] = True  # so as not to need a basis without wear
        self._choose_bases(histories, touching, wearing)
        numbers = self._number[histories]
        if numbers.min() < 0:
            valid = numbers >= 0
            histories, most, numbers = histories[valid], most[valid], numbers[valid]
        inverse, force = 1.0 / (1.0 + most[:, None] * self._mu[numbers]), self._force[numbers]
        self._inverse[histories], border = inverse, inverse * force
        self._border[histories], self._stiffness[histories] = border, inner(force, border)

    def _choose_bases(self, histories: IntArray, free: BoolArray, wearing: BoolArray) -> None:
        """Take the bases of the sets of histories, (h, n)."""
        sets = np.packbits(np.concatenate([free, wearing & free], axis=1), axis=1)
        new = (sets != self._sets[histories]).any(axis=1) | (self._number[histories] < 0)
        if not new.any():
            return
        self._sets[histories], self._rows = sets, None
        for place in np.flatnonzero(new).tolist():
            history = int(histories[place])
            name = int(self._which[history]), sets[place].tobytes()
            number = self._numbers.get(name)
            if number is None:
                basis = self._bases[name[0]].basis(free[place], wearing[place])
                number = self._numbers[name] = _BROKEN if basis is None else self._add(basis)
            self._number[history] = number

    def _add(self, basis: Basis) -> int:
        """Add a basis to those of the histories; return its number."""
        if self._count == len(self._mu):
            self._make_room()
        number, self._count = self._count, self._count + 1
        self._psi[number], self._mu[number], self._force[number] = basis
        return number

    def _make_room(self) -> None:
        """Forget the bases that no history has any more, and make room for as many again."""
        used = np.unique(self._number[self._number >= 0])
        room = max(4, len(used))
        self._psi, self._mu, self._force = (
            np.concatenate([values[used], np.empty((room, *values.shape[1:]))])
            for values in (self._psi, self._mu, self._force)
        )
        new = {int(number): place for place, number in enumerate(used)}
        self._numbers = {
            name: new.get(number, number)
            for name, number in self._numbers.items()
            if number in new or number < 0
        }
        modal = self._number >= 0
        self._number[modal] = np.searchsorted(used, self._number[modal])
        self._count, self._rows = len(used), None

    def _factorise(self, histories: IntArray) -> None:
        """Factor blocks one by one."""
        self._rows = None
        for history in histories.tolist():
            block = self._matrices[self._which[history]].copy()
            if len(self.coupling):
                block += self.coupling[history]
            block[np.diag_indices(len(block))] += self._slope[history]
            free = self._free[history]
            if not free.all():
                block = block[np.ix_(free, free)]
            self._factors[history], info = dpotrf(block, lower=1, clean=0)
            self._number[history] = _FACTOR if info == 0 else _BROKEN

    def _rows_of(self, histories: IntArray) -> "_Rows":
        """Return how some histories are solved, remembered for the same ones."""
        if self._rows is None or self._rows[0] is not histories:
            every = self._number[histories]
            modal = np.flatnonzero(every >= 0)
            whole = len(modal) == len(every)
            numbers = every if whole else every[modal]
            places = slice(None) if whole else modal
            ours: IntArray | slice = histories[places]
            if len(numbers) == len(self._number):
                ours = slice(None)
            self._rows = histories, _Rows(places, ours, numbers, self._force[numbers])
        return self._rows[1]

    def solve(self, histories: IntArray, right: FloatArray) -> FloatArray:
        """Return H^-1 right, (..., h, n), of some histories; 0 off their sets."""
        return -self.steps(histories, right, None, SOLVED)[0]

    @property
    def _psi_t(self) -> FloatArray:
        return self._psi.transpose(0, 2, 1)

    def _solve_factored(self, histories: IntArray, right: FloatArray, out: FloatArray) -> None:
        """Set the solutions of histories that have factors of their own."""
        for place, history in enumerate(histories.tolist()):
            if self._number[history] == _BROKEN:
                out[..., place, :] = np.nan
            elif self._number[history] == _FACTOR and len(self._factors[history]):
                free, factor = self._free[history], self._factors[history]
                sides = right[..., place, :][..., free]
                solved = dpotrs(factor, sides.reshape(-1, len(factor)).T, lower=1)[0].T
                out[..., place, free] = solved.reshape(sides.shape)

    def steps(
        self,
        histories: IntArray,
        gradient: FloatArray,
        missing: FloatArray | None,
        tolerance: float,
    ) -> tuple[FloatArray, FloatArray]:
        """Return the steps (..., h, n) against gradients, and of the approaches, (..., h).

        The approach follows so that the steps carry the force that is missing.

        Parameters
        ----------
        gradient : (..., h, n) float.
        missing : (..., h) float, N; None: approaches stay.
        tolerance : of the residual, relative to the first, where steps are iterated for.
        """
        rows = self._rows_of(histories)
        products = rows.groups.products
        if len(rows.numbers) == len(histories):
            modal = products(gradient, self._psi)
            solved, approach = self._modal_steps(rows, modal, missing, tolerance)
            return products(solved, self._psi_t), approach
        steps, approach = np.zeros_like(gradient), np.zeros(gradient.shape[:-1])
        if len(rows.numbers):
            places = rows.places
            modal = products(gradient[..., places, :], self._psi)
            solved, approach[..., places] = self._modal_steps(
                rows, modal, None if missing is None else missing[..., places], tolerance
            )
            steps[..., places, :] = products(solved, self._psi_t)
        self._set_factored(histories, gradient, missing, (steps, approach))
        return steps, approach

    def _modal_steps(
        self, rows: "_Rows", modal: FloatArray, missing: FloatArray | None, tolerance: float
    ) -> tuple[FloatArray, FloatArray]:
        """Return steps in the bases, (..., h, n), and of approaches, (..., h)."""
        solved = modal * self._inverse[rows.ours]
        if missing is None:
            change = np.zeros(modal.shape[:-1])
            np.negative(solved, out=solved)
        else:
            change = _divided(missing + inner(rows.force, solved), self._stiffness[rows.ours])
            solved = change[..., None] * self._border[rows.ours] - solved
        irregular = np.flatnonzero(~self._regular[rows.ours])
        if len(irregular):
            sides = modal[..., irregular, :]
            many = np.broadcast_to(
                np.arange(len(self._number))[rows.ours][irregular], sides.shape[:-1]
            )
            x, more = self._iterate(
                many.ravel(),
                -sides.reshape(many.size, -1),
                None if missing is None else missing[..., irregular].ravel(),
                tolerance,
            )
            solved[..., irregular, :] = x.reshape(sides.shape)
            change[..., irregular] = more.reshape(many.shape)
        return solved, change

    def _set_factored(
        self,
        histories: IntArray,
        gradient: FloatArray,
        missing: FloatArray | None,
        out: tuple[FloatArray, FloatArray],
    ) -> None:
        """Set steps and changes of approaches of histories that have factors of their own."""
        places = np.flatnonzero(self._number[histories] < 0)
        weights, sides = self._weights[histories[places]], gradient[..., places, :]
        right = np.concatenate([sides.reshape(-1, *weights.shape), weights[None]])
        solved = np.zeros_like(right)
        self._solve_factored(histories[places], right, solved)
        by_gradient, border = solved[:-1].reshape(sides.shape), solved[-1]
        change = np.zeros(sides.shape[:-1])
        if missing is not None:
            carried, stiffness = inner(weights, by_gradient), inner(weights, border)
            change = _divided(missing[..., places] + carried, stiffness)
        out[0][..., places, :] = change[..., None] * border - by_gradient
        out[1][..., places] = change

    def _iterate(
        self,
        histories: IntArray,
        right: FloatArray,
        missing: FloatArray | None,
        tolerance: float,
    ) -> tuple[FloatArray, FloatArray]:
        """Return solutions (h, n) in the bases, and changes of approaches, (h,).

        With a force that is missing, (h,) N, solutions carry it, and so does each iterate of
        projected conjugate gradients: the change of approach is the multiplier of that condition.
        Gould, Hribar and Nocedal, SIAM J. Sci. Comput. 23 (2001) 1376-1395.
        """
        numbers, count = self._number[histories], len(histories)
        slope, inverse = self._slope[histories], self._inverse[histories]
        force, border = self._force[numbers], self._border[histories]
        groups, psi, psi_t = RowGroups(numbers), self._psi, self._psi_t
        solutions, multipliers = np.zeros_like(right), np.zeros(count)
        stiffness, multiplier = self._stiffness[histories], np.zeros(count)

        def apply(x: FloatArray) -> FloatArray:
            return x + groups.products(slope * groups.products(x, psi_t), psi)

        def project(r: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
            z = inverse * r
            if missing is None:
                return r, z, multiplier
            more = _divided(inner(force, z), stiffness)
            return r - force * more[:, None], z - border * more[:, None], multiplier + more

        rows, x, r = np.arange(count), np.zeros_like(right), right
        if missing is not None:
            x = border * _divided(missing, stiffness)[:, None]
            r = r - apply(x)
        r, z, multiplier = project(r)
        direction, size = z, inner(r, z)
        small = tolerance * tolerance * size
        for _ in range(_MOST_ITERATIONS):
            going = size > small
            if not going.all():
                solutions[rows[~going]], multipliers[rows[~going]] = x[~going], -multiplier[~going]
                if not going.any():
                    break
                rows, x, r, direction, size, small, multiplier, numbers = (
                    a[going] for a in (rows, x, r, direction, size, small, multiplier, numbers)
                )
                slope, inverse, force, border, stiffness = (
                    a[going] for a in (slope, inverse, force, border, stiffness)
                )
                groups = RowGroups(numbers)
            product = apply(direction)
            length = (size / inner(direction, product))[:, None]
            x, r = x + length * direction, r - length * product
            r, z, multiplier = project(r)
            before, size = size, inner(r, z)
            direction = z + (size / before)[:, None] * direction
        else:
            solutions[rows], multipliers[rows] = x, -multiplier
        return solutions, multipliers


class _Rows:
    """Which rows are solved in bases, and in which.

    Parameters
    ----------
    places : of these rows among those asked for.
    ours : their histories.
    numbers : (h,) int, of their bases.
    force : (h, n) float, see ``Basis``.
    """

    def __init__(
        self, places: IntArray | slice, ours: IntArray | slice, numbers: IntArray, force: FloatArray
    ) -> None:
        self.places, self.ours, self.numbers, self.force = places, ours, numbers, force
        self.groups = RowGroups(numbers)


def _divided(force: FloatArray, stiffness: FloatArray) -> FloatArray:
    """Return forces over stiffnesses, (h,); 0 where nothing touches."""
    return np.divide(force, stiffness, out=np.zeros_like(force), where=stiffness > 0.0)
