"""The Hessians of B contact problems, A of each history and what its wear adds, and their inverses.

They are diagonal in bases that histories share (see ``scaled_compliances``). Of compliances that
deviate from their references, or where the slope of wear over pressure has another shape, such a
basis preconditions projected conjugate gradients (Gould, Hribar and Nocedal, SIAM J. Sci. Comput.
23 (2001) 1376-1395). Wear that gets through layers, non-local wear and large systems have Cholesky
factors of their own.
"""

from collections import defaultdict
from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotrs

from ringwear_par.arrays import BoolArray, FloatArray, IntArray, inner
from ringwear_par.batched import keep
from ringwear_par.compiled import contact_rows
from ringwear_par.compiled.machine_code import load
from ringwear_par.contact.basis_stack import BROKEN, BasisStack
from ringwear_par.contact.problem import LARGEST_WITH_BASES
from ringwear_par.contact.row_products import RowProducts
from ringwear_par.contact.scaled_compliances import ScaledCompliances
from ringwear_par.wear.increment import WearIncrement

#: what slopes may differ by from their shape, relative: round-off
_ROUND_OFF = 1e-12
#: instead of the number of a basis: a factor of its own
_FACTOR = -1
#: residuals, relative to the first, at which conjugate gradients end: where slopes have another
#: shape than the bases, and where they have that. Of estimates, of solutions, and within Newton's
#: method, whose next step corrects what this one left; slopes of that shape are linear, so that
#: this step is the last
ROUGH, SOLVED = (1e-3, 1e-3), (1e-13, 1e-13)
NEAR = 1e-6, 1e-13
_MOST_ITERATIONS = 200
#: where nothing touches
_NO_FACTOR = np.zeros((0, 0))


class Hessians:
    """The blocks of the Hessian; what one is depends on its own history alone.

    Parameters
    ----------
    compliances : of the contact line.
    which : (B,) int, the compliance of each history.
    """

    def __init__(self, compliances: ScaledCompliances, which: IntArray) -> None:
        self._compliances, self._which = compliances, which
        count, n = len(which), len(compliances.area)
        self._per_speed = (1.0 / compliances.speed)[compliances.reference]
        more, self._loops = compliances.deviations, load(contact_rows)
        #: (B,) from the references, see ``Deviations``
        self._deviation = np.zeros(count) if more is None else more.deviation[which]
        #: (B, n) what wear adds to the diagonal
        self.slope = np.zeros((count, n))
        #: (B, n) the diagonal
        self.diagonal = np.ones((count, n))
        #: (B, n, n) what non-local wear adds, its diagonal included in it; (0, n, n): wear is local
        self.coupling = np.zeros((0, n, n))
        #: whether wear gets through layers: slopes then are of several laws, far apart, and a
        #: factor takes less time than conjugate gradients
        self.through_layers = False
        #: elements that the inverses are of, and whether they are of the slopes
        self._free = np.zeros((count, n), dtype=bool)
        self._valid = np.zeros(count, dtype=bool)
        #: (B, n) elements that bases take to wear
        self._wearing = np.zeros((count, n), dtype=bool)
        #: bases, and the number of that of each history
        self._stack, self._number = BasisStack(compliances), np.full(count, BROKEN)
        #: (B, n) inverses in the bases, exact where the slope has the shape, else preconditioners
        self._inverse, self._regular = np.ones((count, n)), np.ones(count, dtype=bool)
        #: (B, n) in the bases, what unknowns grow by with the approach, and (B,) the force with it,
        #: by the weights of the reference
        self._response, self._stiffness = np.zeros((count, n)), np.zeros(count)
        self._factors: dict[int, FloatArray] = {}
        #: how all histories are solved (True), and how some of them are
        self._rows: dict[bool, tuple[IntArray, _Rows]] = {}

    def keep(self, histories: IntArray) -> None:
        """Go on with some of the histories."""
        self.slope, self.diagonal = self.slope[histories], self.diagonal[histories]
        self.coupling = self.coupling[histories] if len(self.coupling) else self.coupling
        keep(
            self,
            ("_which", "_deviation", "_free", "_valid", "_wearing", "_number",
             "_inverse", "_regular", "_response", "_stiffness"),
            histories,
        )  # fmt: skip
        if self._factors:
            places = {history: place for place, history in enumerate(histories.tolist())}
            factors = self._factors.items()
            self._factors = {places[h]: factor for h, factor in factors if h in places}
        self._rows.clear()

    def pose(self, wear: WearIncrement | None) -> None:
        """Make room for what the wear of an implicit step adds; none adds nothing."""
        if wear is None:
            self.set_slopes(slice(None), np.zeros_like(self.slope), None)
        self.through_layers = wear is not None and wear.layered
        coupled, (count, n) = wear is not None and not wear.local, self.slope.shape
        if coupled != bool(len(self.coupling)):
            self.coupling = np.zeros((count if coupled else 0, n, n))

    def set_slopes(
        self, rows: IntArray | slice, slope: FloatArray, coupling: FloatArray | None
    ) -> None:
        """Set what wear adds in some rows, see ``ContactProblem.slopes``."""
        if slope is not self.slope:
            self._valid[rows] &= (slope == self.slope[rows]).all(axis=1)
            if isinstance(rows, slice):
                self.slope, self.diagonal = slope, 1.0 + slope
            else:
                self.slope = self.slope.copy()
                self.slope[rows] = slope
                self.diagonal[rows] = 1.0 + slope
        if coupling is not None:
            self.coupling[rows] = coupling

    def matrix(self, history: int) -> FloatArray:
        """Return the Hessian of a history, (n, n)."""
        block = self._compliances.matrix(int(self._which[history]))
        if len(self.coupling):
            block += self.coupling[history]
        block.reshape(-1)[:: len(block) + 1] += self.slope[history]
        return block

    def forget(self, histories: IntArray) -> None:
        """Let nothing touch in some histories."""
        self._free[histories], self._valid[histories] = False, False
        self._number[histories] = _FACTOR
        self._rows.clear()
        for history in histories.tolist():
            self._factors[history] = _NO_FACTOR

    def refresh(self, histories: IntArray, free: BoolArray, in_bases: bool = True) -> None:
        """Invert the blocks of those histories that have changed, on their free elements, (B, n).

        What is not positive definite has NaN as its solutions.

        Parameters
        ----------
        in_bases : whether sets are worth a basis; those that come and go are not.
        """
        count, n = len(histories), free.shape[1]
        new, new_sets = np.empty((2, count), dtype=bool)
        rates = np.empty(count)
        coupled = bool(len(self.coupling))
        if coupled:
            self._valid[histories] = False
        self._loops.compare_slopes(
            count, n, histories, self._which, self.slope, self._per_speed, free, self._valid,
            self._free, self._wearing, rates, new, new_sets, self._regular, _ROUND_OFF,
        )  # fmt: skip
        if not new.any():
            return
        if not new.all():
            histories, new_sets, rates = histories[new], new_sets[new], rates[new]
        self._valid[histories] = not coupled
        if coupled or not in_bases or n > LARGEST_WITH_BASES:
            self._factorise(histories)
            return
        irregular = ~self._regular[histories]
        if irregular.any():
            if self.through_layers:
                self._factorise(histories[irregular])
                histories, new_sets = histories[~irregular], new_sets[~irregular]
                rates = rates[~irregular]
                if not len(histories):
                    return
            else:
                rates[irregular] = self._median_rates(histories[irregular])
        new_sets |= self._number[histories] < 0
        if new_sets.any():
            self._choose_bases(histories[new_sets])
            valid = self._number[histories] >= 0
            histories, rates = histories[valid], rates[valid]
        self._loops.invert(
            len(histories), n, histories, self._number, rates, self._stack.mu, self._stack.force,
            self._inverse, self._response, self._stiffness,
        )  # fmt: skip

    def _median_rates(self, histories: IntArray) -> FloatArray:
        """Return the medians of slopes over speeds on elements in contact, (h,)."""
        per_speed, free = self._per_speed[self._which[histories]], self._free[histories]
        rates = self.slope[histories] * per_speed
        ordered = np.sort(np.where(free, rates, np.inf), axis=1)
        return ordered[np.arange(len(ordered)), free.sum(axis=1) // 2]

    def _choose_bases(self, histories: IntArray) -> None:
        """Take the bases of the sets of histories."""
        self._rows.clear()
        free, wearing = self._free[histories], self._wearing[histories]
        sets = np.packbits(np.concatenate([free, wearing], axis=1), axis=1)
        alike: dict[tuple[int, bytes], list[int]] = defaultdict(list)
        which, width = self._compliances.reference[self._which[histories]].tolist(), sets.shape[1]
        packed = sets.tobytes()
        for place, compliance in enumerate(which):
            alike[compliance, packed[place * width : (place + 1) * width]].append(place)
        for (compliance, name), places in alike.items():
            if self._stack.is_full:
                self._stack.make_room(self._number)
            self._number[histories[places]] = self._stack.number_of(
                compliance, name, free[places[0]], wearing[places[0]]
            )

    def _factorise(self, histories: IntArray) -> None:
        """Factor blocks one by one."""
        self._rows.clear()
        for history in histories.tolist():
            block, free = self.matrix(history), self._free[history]
            if not free.all():
                block = block[np.ix_(free, free)]
            self._factors[history], info = dpotrf(block, lower=1, clean=0)
            self._number[history] = _FACTOR if info == 0 else BROKEN

    def _rows_of(self, histories: IntArray) -> "_Rows":
        """Return how some histories are solved, remembered for the same ones."""
        whole = len(histories) == len(self._number)
        known = self._rows.get(whole)
        if known is None or (known[0] is not histories and not whole):
            every = self._number[histories]
            modal = np.flatnonzero(every >= 0)
            places: IntArray | slice = modal
            if len(modal) == len(every):
                places = slice(None)
            numbers = every[places]
            more, root = self._compliances.deviations, None
            if more is not None:
                root = more.root[self._which[histories[places]]]
            rows = _Rows(places, histories[places], numbers, RowProducts(numbers), root)
            known = self._rows[whole] = histories, rows
        return known[1]

    def solve(self, histories: IntArray, right: FloatArray) -> FloatArray:
        """Return H^-1 right, (..., h, n), of some histories; 0 off their sets."""
        return -self.steps(histories, right, None, SOLVED)[0]

    def steps(
        self,
        histories: IntArray,
        gradient: FloatArray,
        missing: FloatArray | None,
        tolerance: tuple[float, float],
    ) -> tuple[FloatArray, FloatArray]:
        """Return the steps (..., h, n) against gradients, and of the approaches, (..., h).

        The approach follows so that the steps carry the force that is missing.

        Parameters
        ----------
        gradient : (..., h, n) float.
        missing : (..., h) float, N; None: approaches stay.
        tolerance : ``ROUGH``, ``NEAR`` or ``SOLVED``.
        """
        rows = self._rows_of(histories)
        products = rows.groups.of
        if len(rows.numbers) == len(histories):
            modal = products(gradient, self._stack.psi)
            solved, approach = self._modal_steps(rows, modal, missing, tolerance)
            return products(solved, self._stack.psi_t), approach
        steps, approach = np.zeros_like(gradient), np.zeros(gradient.shape[:-1])
        if len(rows.numbers):
            places = rows.places
            modal = products(gradient[..., places, :], self._stack.psi)
            left = None if missing is None else np.ascontiguousarray(missing[..., places])
            solved, approach[..., places] = self._modal_steps(rows, modal, left, tolerance)
            steps[..., places, :] = products(solved, self._stack.psi_t)
        self._set_factored(histories, gradient, missing, (steps, approach))
        return steps, approach

    def _modal_steps(
        self,
        rows: "_Rows",
        modal: FloatArray,
        missing: FloatArray | None,
        tolerance: tuple[float, float],
    ) -> tuple[FloatArray, FloatArray]:
        """Return steps in the bases, (..., h, n), where ``modal`` was, and of approaches, (..., h).

        Parameters
        ----------
        modal : (..., h, n) float, the gradients in the bases.
        """
        change, stack, n = np.empty(modal.shape[:-1]), self._stack, modal.shape[-1]
        with_forces, count, histories = missing is not None, len(rows.histories), rows.histories
        if missing is None:
            missing = change
        elif rows.root is not None:
            missing = missing * rows.root
        diagonal = self._inverse, self._response, self._stiffness
        kinds = self._regular, self._deviation
        iterated = np.flatnonzero(~self._regular[histories] | (self._deviation[histories] != 0.0))
        if len(iterated):
            # those of a basis one after another
            among = histories[iterated]
            order = np.argsort(2 * self._number[among] + self._regular[among], kind="stable")
            times = np.arange(0, change.size, count)
            places = (iterated[order][:, None] + times).ravel()
            deviates = stack.derivatives.size > 0
            self._loops.conjugate_gradients(
                len(places), n, places, count, histories, self._number, stack.psi, stack.psi_t,
                stack.derivatives if deviates else stack.psi, deviates, stack.force, self.slope,
                *kinds, *diagonal, missing, with_forces, *tolerance, _MOST_ITERATIONS, modal,
                change, *np.empty((2, 4), dtype=np.int64), *np.empty((3, 4)), *np.empty((6, 7, n)),
            )  # fmt: skip
        if len(iterated) < count:
            self._loops.solve_in_bases(
                change.size, n, count, histories, self._number, stack.force, *diagonal, *kinds,
                missing, with_forces, modal, change,
            )  # fmt: skip
        if rows.root is not None:
            change *= rows.root
        return modal, change

    def _set_factored(
        self,
        histories: IntArray,
        gradient: FloatArray,
        missing: FloatArray | None,
        out: tuple[FloatArray, FloatArray],
    ) -> None:
        """Set steps and changes of approaches of histories that have factors of their own."""
        places = np.flatnonzero(self._number[histories] < 0)
        weights = self._compliances.weights[self._which[histories[places]]]
        sides = gradient[..., places, :]
        right = np.concatenate([sides.reshape(-1, *weights.shape), weights[None]])
        solved = np.zeros_like(right)
        whole = self._free[histories[places]].all(axis=1).tolist()
        for place, history in enumerate(histories[places].tolist()):
            factor = self._factors.get(history, _NO_FACTOR)
            if self._number[history] == BROKEN:
                solved[:, place] = np.nan
            elif len(factor):
                free = slice(None) if whole[place] else self._free[history]
                solved[:, place, free] = dpotrs(factor, right[:, place, free].T, lower=1)[0].T
        by_gradient, response = solved[:-1].reshape(sides.shape), solved[-1]
        change = np.zeros(sides.shape[:-1])
        if missing is not None:
            carried, stiffness = inner(weights, by_gradient), inner(weights, response)
            change = _divided(missing[..., places] + carried, stiffness)
        out[0][..., places, :] = change[..., None] * response - by_gradient
        out[1][..., places] = change


class _Rows(NamedTuple):
    """Which rows are solved in bases, and in which."""

    #: of these rows among those that are solved
    places: IntArray | slice
    #: (h,) int, of the rows
    histories: IntArray
    #: (h,) int, of their bases
    numbers: IntArray
    #: of the rows by basis
    groups: RowProducts
    #: (h,) float, see ``Deviations``; None: compliances are references
    root: FloatArray | None


def _divided(force: FloatArray, stiffness: FloatArray) -> FloatArray:
    """Return forces over stiffnesses, (h,); 0 where nothing touches."""
    return np.divide(force, stiffness, out=np.zeros_like(force), where=stiffness > 0.0)
