"""The Hessians of B contact problems, A of each history and what its wear adds, and their inverses.

They are diagonal in bases that histories share (see ``scaled_compliances``). Of compliances that
deviate from their references, or where the slope of wear over pressure has another shape, such a
basis preconditions projected conjugate gradients (Gould, Hribar and Nocedal, SIAM J. Sci. Comput.
23 (2001) 1376-1395). Wear that gets through layers, non-local wear and large systems have Cholesky
factors of their own.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray, IntArray
from ringwear_par.batched import keep
from ringwear_par.compiled import contact_rows
from ringwear_par.compiled.machine_code import load
from ringwear_par.contact.basis_stack import BasisStack
from ringwear_par.contact.problem import LARGEST_WITH_BASES, ContactProblem
from ringwear_par.contact.row_products import ROOM
from ringwear_par.contact.scaled_compliances import ScaledCompliances
from ringwear_par.wear.increment import WearIncrement

#: what slopes may differ by from their shape, relative: round-off
_ROUND_OFF = 1e-12
#: residuals, relative to the first, at which conjugate gradients end: where slopes have another
#: shape than the bases, and where they have that. Of estimates, of solutions, and within Newton's
#: method, whose next step corrects what this one left; slopes of that shape are linear, so that
#: this step is the last
ROUGH, SOLVED = (1e-2, 1e-2), (1e-13, 1e-13)
NEAR = 1e-6, 1e-13
_MOST_ITERATIONS = 200


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
        #: (B, n, n) what non-local wear adds off the diagonal; (0, n, n): wear is local
        self.coupling = np.zeros((0, n, n))
        #: whether wear gets through layers: slopes then are of several laws, far apart, and a
        #: factor takes less time than conjugate gradients
        self.through_layers = False
        #: elements that the inverses are of, and whether they are of the slopes
        self._free = np.zeros((count, n), dtype=bool)
        self._valid = np.zeros(count, dtype=bool)
        #: (B, n) elements that bases take to wear
        self._wearing = np.zeros((count, n), dtype=bool)
        #: bases, and the number of that of each history, -1 of none
        self._stack, self._basis = BasisStack(compliances), np.full(count, -1)
        #: (B, n, n) inverses of factors, of those without a basis; (0, n, n): all have one
        self._factors = np.empty((0, n, n))
        #: (B, n) inverses in the bases, exact where the slope has the shape, else preconditioners
        self._inverse, self._regular = np.ones((count, n)), np.ones(count, dtype=bool)
        #: (B, n) in the bases, if any, what unknowns grow by with the approach, and (B,) the force
        #: with it, by the weights of the reference
        self._response, self._stiffness = np.zeros((count, n)), np.zeros(count)
        #: the histories solved last, and in which bases
        self._rows: tuple[IntArray, _BasisRows] | None = None
        self._order: tuple[IntArray, IntArray] | None = None
        #: of the histories at work: rates of slopes, whether inverses are to be new, whether these
        #: are of new sets, whether steps are left to be taken, and how many are
        self._rates, (self._new, self._new_sets, self._left), self._n_left = (
            np.empty(count), np.empty((3, count), dtype=bool), np.zeros(1, dtype=np.int64),
        )  # fmt: skip
        #: room of loops
        self._room = np.empty((24, n)), np.empty(8)
        self._room_of_steps = (
            *np.empty((2, count), dtype=np.int64), *self._room, np.empty((count + ROOM, n)),
            np.empty(count),
        )  # fmt: skip
        self._missing = np.empty(count)

    def keep(self, histories: IntArray) -> None:
        """Go on with some of the histories."""
        self.slope, self.diagonal = self.slope[histories], self.diagonal[histories]
        self.coupling = self.coupling[histories] if len(self.coupling) else self.coupling
        keep(
            self,
            ("_which", "_deviation", "_free", "_valid", "_wearing", "_basis",
             "_inverse", "_regular", "_response", "_stiffness"),
            histories,
        )  # fmt: skip
        self._factors = self._factors[histories] if len(self._factors) else self._factors
        self._forget_order()

    def pose(self, wear: WearIncrement | None) -> None:
        """Make room for what the wear of an implicit step adds; none adds nothing."""
        if wear is None:
            self.set_slopes(np.arange(len(self.slope)), np.zeros_like(self.slope), None)
        self.through_layers = wear is not None and wear.layered
        coupled, (count, n) = wear is not None and not wear.local, self.slope.shape
        if coupled != bool(len(self.coupling)):
            self.coupling = np.zeros((count if coupled else 0, n, n))

    def set_slopes(
        self, histories: IntArray, depth_slopes: FloatArray, coupling: FloatArray | None
    ) -> None:
        """Set what wear adds in some histories, see ``ContactProblem.slopes``."""
        self._loops.set_slopes(
            *depth_slopes.shape, histories, self._which, depth_slopes,
            self._compliances.slope_scale, self.slope, self.diagonal, self._valid,
        )  # fmt: skip
        if coupling is not None:
            self.coupling[histories] = coupling

    def _forget_order(self) -> None:
        """Forget how histories are solved, after their bases have changed."""
        self._rows = self._order = None

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
        self._factorise(histories)

    def refresh(self, histories: IntArray, free: BoolArray, in_bases: bool = True) -> None:
        """Invert the blocks of those histories that have changed, on their free elements, (B, n).

        What is not positive definite has NaN as its solutions.

        Parameters
        ----------
        in_bases : whether sets are worth a basis; those that come and go are not.
        """
        count, n = len(histories), free.shape[1]
        (new, new_sets), rates = np.empty((2, count), dtype=bool), np.empty(count)
        self._loops.compare_slopes(
            count, n, histories, self._which, self.slope, self._per_speed, free, self._valid,
            self._free, self._wearing, rates, new, new_sets, self._regular, _ROUND_OFF,
        )  # fmt: skip
        self._renew(histories, new, new_sets, rates, in_bases)

    def _renew(
        self, histories: IntArray, new: BoolArray, new_sets: BoolArray, rates: FloatArray,
        in_bases: bool = True,
    ) -> None:  # fmt: skip
        """Invert the blocks of histories that are new, as ``compare_slopes`` says of them."""
        coupled, n = bool(len(self.coupling)), self.slope.shape[1]
        if coupled:
            new[:] = True
        if not new.any():
            return
        if not new.all():
            histories, new_sets, rates = histories[new], new_sets[new], rates[new]
        self._valid[histories] = not coupled
        if coupled or not in_bases or n > LARGEST_WITH_BASES:
            self._factorise(histories)
            return
        if self.through_layers and not (regular := self._regular[histories]).all():
            self._factorise(histories[~regular])
            histories, new_sets, rates = histories[regular], new_sets[regular], rates[regular]
            if not len(histories):
                return
        new_sets |= self._basis[histories] < 0
        if new_sets.any():
            self._choose_bases(histories[new_sets])
        self._loops.invert(
            len(histories), n, histories, self._basis, rates, self._stack.mu, self._stack.bends,
            self._deviation, self._stack.force, self._inverse, self._response, self._stiffness,
        )  # fmt: skip

    def _choose_bases(self, histories: IntArray) -> None:
        """Take the bases of the sets of histories."""
        self._forget_order()
        free, wearing = self._free[histories], self._wearing[histories]
        sets = np.packbits(np.concatenate([free, wearing], axis=1), axis=1)
        which = self._compliances.reference[self._which[histories]]
        names = [*zip(which.tolist(), sets.view(f"V{sets.shape[1]}")[:, 0].tolist(), strict=True)]
        numbers = self._basis[histories] = self._stack.numbers_of(names)
        for place in np.flatnonzero(numbers < 0).tolist():
            if self._stack.is_full:
                self._stack.make_room(self._basis)
            self._basis[histories[place]] = self._stack.number_of(
                names[place], free[place], wearing[place]
            )

    def _factorise(self, histories: IntArray) -> None:
        """Factor the blocks of histories, which have no bases then."""
        if (self._basis[histories] >= 0).any():
            self._forget_order()
        compliances, (count, n), self._basis[histories] = self._compliances, self.slope.shape, -1
        if not len(self._factors):
            self._factors = np.empty((count, n, n))
        more, coupled = compliances.deviations, len(self.coupling) > 0
        self._loops.factorise(
            len(histories), n, histories, self._which, compliances.reference, compliances.matrices,
            self._deviation, compliances.matrices if more is None else more.derivatives,
            more is not None, self.slope, self.coupling if coupled else self.slope, coupled,
            self._free, compliances.reference_weights, self._factors, self._response,
            self._stiffness, np.empty((n, 2 * n)),
        )  # fmt: skip

    def _rows_of(self, histories: IntArray) -> "_BasisRows":
        """Return how some histories are solved, remembered for the same ones."""
        if self._rows is None or self._rows[0] is not histories:
            bases = self._basis[histories]
            order, factored = np.argsort(bases, kind="stable"), np.count_nonzero(bases < 0)
            self._rows = (
                histories,
                _BasisRows(
                    histories,
                    bases,
                    self._which[histories],
                    order,
                    order[factored:],
                    order[:factored],
                ),
            )
        return self._rows[1]

    def take_steps(self, problem: ContactProblem, free: BoolArray) -> None:
        """Take the steps of the histories at work of a problem, and of their approaches.

        Parameters
        ----------
        free : (B, n), the elements in contact.
        """
        histories, (depth_slopes, coupling) = problem.at_work, problem.slopes()
        (count, n), compliances, stack = depth_slopes.shape, self._compliances, self._stack
        rates, new, new_sets, forces = self._rates, self._new, self._new_sets, problem.forces
        pressures = np.empty((count, n))

        def step(places: IntArray, are_inverted: bool) -> None:
            self._loops.take_steps(
                len(places), n, len(problem.every), histories, places, problem.every, self._which,
                depth_slopes, compliances.slope_scale, self.slope, self.diagonal, self._per_speed,
                free, self._valid, self._free, self._wearing, rates, new, new_sets, self._regular,
                _ROUND_OFF, coupling is None, self.through_layers, are_inverted, self._basis,
                stack.mu, stack.extents, stack.psi, stack.psi_t,
                stack.derivatives if stack.derivatives.size else stack.psi, stack.bends,
                stack.force, self._deviation, self._inverse, self._response, self._stiffness,
                self._factors, compliances.reference, compliances.reference_weights, *NEAR,
                _MOST_ITERATIONS, problem.unknowns, problem.gradients, problem.approaches,
                problem.is_known, compliances.weights, compliances.roots,
                problem.approaches if forces is None else forces, forces is not None,
                self._missing, compliances.per_scale, pressures, self._left, self._n_left,
                *self._room_of_steps,
            )  # fmt: skip

        if self._order is None or self._order[0] is not histories:
            self._order = histories, np.argsort(self._basis[histories], kind="stable")
        step(self._order[1], are_inverted=False)
        if self._n_left[0]:
            if coupling is not None:
                self.coupling[histories] = coupling
            places = self._left[:count].nonzero()[0]
            left = histories[places]
            self._renew(left, new[places], new_sets[places], rates[places])
            step(places[np.argsort(self._basis[left], kind="stable")], are_inverted=True)
        problem.pressures_at_work = pressures

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
        return self._steps(self._rows_of(histories), gradient, missing, tolerance)

    def responses(self, histories: IntArray, gaps: FloatArray, with_forces: bool) -> FloatArray:
        """Return about the changes of pressures, MPa, with gaps (..., h, n) mm, to some 1e-2.

        Parameters
        ----------
        with_forces : whether forces stay, or approaches.
        """
        rows, missing = self._rows_of(histories), None
        if with_forces:
            missing = np.zeros(gaps.shape[:-1])
        return self._steps(rows, gaps, missing, ROUGH, with_scales=True)[0]

    def propagate_errors(
        self, histories: IntArray, with_forces: bool, slope: FloatArray,
        closing: BoolArray | None, estimates: Sequence[FloatArray], formula: Sequence[Any],
        outcome: Sequence[FloatArray],
    ) -> IntArray:  # fmt: skip
        """Do the loop of this name, and return the histories that it leaves.

        Parameters
        ----------
        with_forces : whether forces stay, or approaches.
        slope : (B, n) mm/MPa, derivatives of depths with respect to pressure.
        closing : (B, n) elements whose errors of the step are 0.
        estimates, formula, outcome : see the loop.
        """
        rows, stack, compliances = self._rows_of(histories), self._stack, self._compliances
        ready, left, room, *_ = self._room_of_steps
        self._loops.propagate_errors(
            len(histories), slope.shape[1], len(histories), rows.every, self._basis, stack.extents,
            stack.psi, stack.psi_t, stack.force, self._regular, self._deviation, self._inverse,
            self._response, self._stiffness, with_forces, self.slope, self._which,
            compliances.slope_scale,
            compliances.weights, compliances.per_scale, *estimates,
            self._regular if closing is None else closing, closing is not None, slope, *formula,
            ready, left, self._n_left, room, *outcome,
        )  # fmt: skip
        return left[: self._n_left[0]].copy()

    def _steps(
        self,
        rows: "_BasisRows",
        gradient: FloatArray,
        missing: FloatArray | None,
        tolerance: tuple[float, float],
        with_scales: bool = False,
    ) -> tuple[FloatArray, FloatArray]:
        """Return steps and those of approaches; rows that are not solved are left unset.

        Parameters
        ----------
        with_scales : whether gradients are gaps instead, mm, and steps are to be pressures, MPa.
        """
        gradient = np.ascontiguousarray(gradient)
        size, n, stack, which = len(rows.histories), gradient.shape[-1], self._stack, rows.which
        compliances, count = self._compliances, gradient.size // n
        steps, changes = np.empty((count + ROOM, n)), np.zeros(gradient.shape[:-1])
        lacking = changes if missing is None else np.ascontiguousarray(missing)
        self._loops.steps(
            size, len(rows.factored), n, count // max(size, 1), size, rows.in_bases, rows.factored,
            rows.histories, rows.bases, stack.extents, stack.psi, stack.psi_t,
            stack.derivatives if stack.derivatives.size else stack.psi, stack.bends, stack.force,
            self.slope, self._regular, self._deviation, self._inverse, self._response,
            self._stiffness, self._factors, compliances.reference, compliances.reference_weights,
            *tolerance, _MOST_ITERATIONS, lacking, missing is not None, gradient, which,
            compliances.weights, compliances.per_scale, compliances.roots, with_scales, *self._room,
            steps, changes,
        )  # fmt: skip
        return steps[:count].reshape(gradient.shape), changes


class _BasisRows(NamedTuple):
    """Which rows are solved in bases, and in which."""

    #: (h,) int, of the rows, of their bases, and of their compliances
    histories: IntArray
    bases: IntArray
    which: IntArray
    #: all rows, one basis after the other; which are solved in bases, and which by factors
    every: IntArray
    in_bases: IntArray
    factored: IntArray
