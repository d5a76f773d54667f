"""The Hessians of B contact problems, A of each history and what its wear adds, and their inverses.

They are diagonal in bases that histories share (see ``scaled_compliances``). Of compliances that
deviate from their references, or where the slope of wear over pressure has another shape, such a
basis preconditions projected conjugate gradients (Gould, Hribar and Nocedal, SIAM J. Sci. Comput.
23 (2001) 1376-1395). Wear that gets through layers, non-local wear and large systems have Cholesky
factors of their own.
"""

from typing import NamedTuple

import numpy as np

from ringwear_par.arrays import BoolArray, FloatArray, IntArray
from ringwear_par.compiled import error_rows, hessian_rows, system_rows
from ringwear_par.compiled.error_rows import Errors, Estimates, Formula
from ringwear_par.compiled.hessian_rows import Blocks, Renewals
from ringwear_par.compiled.machine_code import load
from ringwear_par.compiled.product_rows import SPARE_ROWS
from ringwear_par.compiled.system_rows import Scratch, Systems
from ringwear_par.contact.basis_stack import BasisStack
from ringwear_par.contact.problem import LARGEST_WITH_BASES, ContactProblem
from ringwear_par.contact.scaled_compliances import ScaledCompliances
from ringwear_par.wear.increment import WearIncrement

#: residuals, relative to the first, at which conjugate gradients end: where slopes have another
#: shape than the bases, and where they have that. Of estimates, of solutions, and within Newton's
#: method, whose next step corrects what this one left; slopes of that shape are linear, so that
#: this step is the last
ROUGH, SOLVED = (1e-2, 1e-2), (1e-13, 1e-13)
NEAR = 1e-6, 1e-13


class Hessians:
    """The blocks of the Hessian; what one is depends on its own history alone.

    Parameters
    ----------
    compliances : of the contact line.
    which : (B,) int, the compliance of each history.
    """

    def __init__(self, compliances: ScaledCompliances, which: IntArray) -> None:
        self._compliances = compliances
        self._loops, self._solvers = load(hessian_rows), load(system_rows)
        count, n = len(which), len(compliances.area)
        #: as loops have them; there are no factors (0, n, n) while all have bases
        self.blocks = Blocks(
            compliances=which,
            deviations=compliances.deviation(which),
            slopes=np.zeros((count, n)),
            diagonals=np.ones((count, n)),
            free=np.zeros((count, n), dtype=bool),
            wearing=np.zeros((count, n), dtype=bool),
            are_valid=np.zeros(count, dtype=bool),
            are_regular=np.ones(count, dtype=bool),
            bases=np.full(count, -1),
            inverses=np.ones((count, n)),
            responses=np.zeros((count, n)),
            stiffness=np.zeros(count),
            factors=np.empty((0, n, n)),
        )
        #: (B, n, n) what non-local wear adds off the diagonal; (0, n, n): wear is local
        self.coupling = np.zeros((0, n, n))
        #: whether wear gets through layers: slopes then are of several laws, far apart, and a
        #: factor takes less time than conjugate gradients
        self.through_layers = False
        self._stack = BasisStack(compliances)
        #: the histories solved last, and in which bases
        self._rows: tuple[IntArray, _BasisRows] | None = None
        self._order: tuple[IntArray, IntArray] | None = None
        self._renewals = Renewals(
            rates=np.empty(count),
            are_new=np.empty(count, dtype=bool),
            have_new_sets=np.empty(count, dtype=bool),
            are_left=np.empty(count, dtype=bool),
            n_left=np.zeros(1, dtype=np.int64),
        )
        self._scratch = Scratch(
            rows=np.empty((24, n)),
            sizes=np.empty(8),
            in_bases=np.empty(count, dtype=np.int64),
            not_in_bases=np.empty(count, dtype=np.int64),
        )
        #: those of steps of Newton's method under forces, of the gradients of the problem last
        self._systems: Systems | None = None

    def keep(self, histories: IntArray) -> None:
        """Go on with some of the histories."""
        self.blocks = Blocks(
            *(values[histories] if len(values) else values for values in self.blocks)
        )
        self.coupling = self.coupling[histories] if len(self.coupling) else self.coupling
        self._systems = None
        self._forget_order()

    def pose(self, wear: WearIncrement | None) -> None:
        """Make room for what the wear of an implicit step adds; none adds nothing."""
        slopes = self.blocks.slopes
        if wear is None:
            self.set_slopes(np.arange(len(slopes)), np.zeros_like(slopes), None)
        self.through_layers = wear is not None and wear.layered
        coupled, (count, n) = wear is not None and not wear.local, slopes.shape
        if coupled != bool(len(self.coupling)):
            self.coupling = np.zeros((count if coupled else 0, n, n))

    def set_slopes(
        self, histories: IntArray, depth_slopes: FloatArray, coupling: FloatArray | None
    ) -> None:
        """Set what wear adds in some histories, see ``ContactProblem.slopes``."""
        self._loops.set_slopes(
            *depth_slopes.shape, histories, self._compliances.record, self.blocks, depth_slopes
        )
        if coupling is not None:
            self.coupling[histories] = coupling

    def _forget_order(self) -> None:
        """Forget how histories are solved, after their bases have changed."""
        self._rows = self._order = None

    def matrix(self, history: int) -> FloatArray:
        """Return the Hessian of a history, (n, n)."""
        block = self._compliances.matrix(int(self.blocks.compliances[history]))
        if len(self.coupling):
            block += self.coupling[history]
        block.reshape(-1)[:: len(block) + 1] += self.blocks.slopes[history]
        return block

    def forget(self, histories: IntArray) -> None:
        """Let nothing touch in some histories."""
        self.blocks.free[histories] = self.blocks.are_valid[histories] = False
        self._factorise(histories)

    def refresh(self, histories: IntArray, free: BoolArray, in_bases: bool = True) -> None:
        """Invert the blocks of those histories that have changed, on their free elements, (B, n).

        What is not positive definite has NaN as its solutions.

        Parameters
        ----------
        in_bases : whether sets are worth a basis; those that come and go are not.
        """
        self._loops.compare_slopes(
            len(histories), free.shape[1], histories, self._compliances.record, self.blocks,
            self._renewals, free,
        )  # fmt: skip
        self._renew(histories, np.arange(len(histories)), in_bases)

    def _renew(self, histories: IntArray, places: IntArray, in_bases: bool = True) -> None:
        """Invert the blocks of histories that are new, as renewals say of their places."""
        blocks, n, coupled = self.blocks, self.blocks.slopes.shape[1], len(self.coupling) > 0
        if not coupled:
            new = self._renewals.are_new[places]
            histories, places = histories[new], places[new]
        blocks.are_valid[histories] = not coupled
        if coupled or not in_bases or n > LARGEST_WITH_BASES:
            self._factorise(histories)
            return
        if self.through_layers:
            regular = blocks.are_regular[histories]
            self._factorise(histories[~regular])
            histories, places = histories[regular], places[regular]
        new_sets = self._renewals.have_new_sets[places] | (blocks.bases[histories] < 0)
        if new_sets.any():
            self._choose_bases(histories[new_sets])
        self._loops.invert(
            len(histories), n, histories, self._stack.bases, blocks, self._renewals.rates[places]
        )

    def _choose_bases(self, histories: IntArray) -> None:
        """Take the bases of the sets of histories."""
        self._forget_order()
        blocks, stack = self.blocks, self._stack
        free, wearing = blocks.free[histories], blocks.wearing[histories]
        sets = np.packbits(np.concatenate([free, wearing], axis=1), axis=1)
        which = self._compliances.reference[blocks.compliances[histories]]
        names = [*zip(which.tolist(), sets.view(f"V{sets.shape[1]}")[:, 0].tolist(), strict=True)]
        numbers = blocks.bases[histories] = stack.numbers_of(names)
        for place in np.flatnonzero(numbers < 0).tolist():
            if stack.is_full:
                stack.make_room(blocks.bases)
            blocks.bases[histories[place]] = stack.number_of(
                names[place], free[place], wearing[place]
            )

    def _factorise(self, histories: IntArray) -> None:
        """Factor the blocks of histories, which have no bases then."""
        if not len(histories):
            return
        (count, n), coupled = self.blocks.slopes.shape, len(self.coupling) > 0
        if (self.blocks.bases[histories] >= 0).any():
            self._forget_order()
        self.blocks.bases[histories] = -1
        if not len(self.blocks.factors):
            self.blocks = self.blocks._replace(factors=np.empty((count, n, n)))
        self._loops.factorise(
            len(histories), n, histories, self._compliances.record, self.blocks, self.coupling,
            coupled, np.empty((n, 2 * n)),
        )  # fmt: skip

    def _rows_of(self, histories: IntArray) -> "_BasisRows":
        """Return how some histories are solved, remembered for the same ones."""
        if self._rows is None or self._rows[0] is not histories:
            bases = self.blocks.bases[histories]
            order, factored = np.argsort(bases, kind="stable"), np.count_nonzero(bases < 0)
            self._rows = (
                histories,
                _BasisRows(histories, bases, order, order[factored:], order[:factored]),
            )
        return self._rows[1]

    def take_steps(self, problem: ContactProblem, free: BoolArray) -> None:
        """Take the steps of the histories at work of a problem, and of their approaches.

        Parameters
        ----------
        free : (B, n), the elements in contact.
        """
        histories, (depth_slopes, coupling) = problem.at_work, problem.slopes()
        (count, n), forces, renewals = depth_slopes.shape, problem.forces, self._renewals
        pressures, systems = np.empty((count, n)), self._systems_of(problem)

        def step(places: IntArray, are_inverted: bool) -> None:
            self._solvers.take_steps(
                len(places), n, len(problem.every), histories, places, problem.every,
                self._compliances.record, problem.contacts, self._stack.bases, self.blocks,
                renewals, systems, self._scratch, depth_slopes, free, coupling is None,
                self.through_layers, are_inverted, *NEAR, problem.approaches,
                problem.approaches if forces is None else forces, pressures,
            )  # fmt: skip

        if self._order is None or self._order[0] is not histories:
            self._order = histories, np.argsort(self.blocks.bases[histories], kind="stable")
        step(self._order[1], are_inverted=False)
        if renewals.n_left[0]:
            if coupling is not None:
                self.coupling[histories] = coupling
            places = renewals.are_left[:count].nonzero()[0]
            left = histories[places]
            self._renew(left, places)
            step(places[np.argsort(self.blocks.bases[left], kind="stable")], are_inverted=True)
        problem.pressures_at_work = pressures

    def _systems_of(self, problem: ContactProblem) -> Systems:
        """Return the systems of the steps of a problem."""
        systems, with_forces = self._systems, problem.forces is not None
        if (
            systems is None
            or systems.gradients is not problem.gradients
            or systems.with_forces != with_forces
        ):
            count, n = problem.gradients.shape
            systems = self._systems = Systems(
                problem.gradients, np.empty(count), with_forces, False,
                np.empty((count + SPARE_ROWS, n)), np.empty(count),
            )  # fmt: skip
        return systems

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
        closing: BoolArray | None, estimates: Estimates, formula: Formula, errors: Errors,
    ) -> IntArray:  # fmt: skip
        """Do the loop of this name, and return the histories that it leaves.

        Parameters
        ----------
        histories : (B,) int, all of them.
        with_forces : whether forces stay, or approaches.
        slope : (B, n) mm/MPa, derivatives of depths with respect to pressure.
        closing : (B, n) elements whose errors of the step are 0.
        estimates, formula, errors : see the loop.
        """
        n_left = self._renewals.n_left
        load(error_rows).propagate_errors(
            *slope.shape, len(histories), self._rows_of(histories).every, self._compliances.record,
            self._stack.bases, self.blocks, self._scratch, with_forces, estimates, formula,
            self.blocks.free if closing is None else closing, closing is not None, slope, n_left,
            errors,
        )  # fmt: skip
        left: IntArray = self._scratch.not_in_bases[: n_left[0]]
        return left.copy()

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
        size, n = len(rows.histories), gradient.shape[-1]
        count, changes = gradient.size // n, np.zeros(gradient.shape[:-1])
        systems = Systems(
            gradient, changes if missing is None else np.ascontiguousarray(missing),
            missing is not None, with_scales, np.empty((count + SPARE_ROWS, n)), changes,
        )  # fmt: skip
        self._solvers.steps(
            size, len(rows.factored), n, count // max(size, 1), size, rows.in_bases, rows.factored,
            rows.histories, rows.bases, self._compliances.record, self._stack.bases, self.blocks,
            systems, self._scratch, *tolerance,
        )  # fmt: skip
        return systems.steps[:count].reshape(gradient.shape), changes


class _BasisRows(NamedTuple):
    """Which rows are solved in bases, and in which."""

    #: (h,) int, of the rows, and of their bases
    histories: IntArray
    bases: IntArray
    #: all rows, one basis after the other; which are solved in bases, and which by factors
    every: IntArray
    in_bases: IntArray
    factored: IntArray
