"""The stresses that a case asks for, at any of its states, and the observer that keeps them."""

from collections.abc import Hashable

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import Case
from ringwear_par.cases.stress import Side, grid_bodies, point_bodies, point_depths
from ringwear_par.elasticity.stress.fields import StressHistory, StressState
from ringwear_par.elasticity.stress.recovery import StressPoints, StressRecovery, interfaces
from ringwear_par.history.elastic.bodies import bodies, operator_key
from ringwear_par.history.observers.selection import Asked
from ringwear_par.history.snapshots import Instant
from ringwear_par.history.state import State
from ringwear_par.wear.layered import worn_through

_SIDES: dict[Side, float] = {"above": 1.0, "": 0.0, "below": -1.0}


def stress_key(case: Case) -> Hashable:
    """Return what the stresses of unit loads depend on; equal for cases that can share them."""
    return operator_key(case), case.mesh, case.lower.z[1], case.upper.z[0], case.stress


class CaseStresses:
    """Stresses in lower and upper where a case asks for them, for it and all of its ``stress_key``.

    Parameters
    ----------
    case : one with [stress].
    comm : communicator; ``at`` is collective.
    """

    def __init__(self, case: Case, comm: MPI.Comm) -> None:
        assert case.stress is not None
        grid = case.stress.grid
        axes = grid.axes if grid is not None else (np.empty(0), np.empty(0))
        #: (p, 2) mm, the points, and their sides; radii and heights of the grid
        self.points = np.array([point[:2] for point in case.stress.points]).reshape(-1, 2)
        self.sides = tuple(side for _, _, side in case.stress.points)
        self.grid, self._exclude = axes, case.stress.exclude
        #: (p,) bodies of the points, and mm, how deep these are under the unworn faces
        self.of_points = np.array(point_bodies(case), int)
        self.depths = point_depths(case, self.of_points)
        self._of_grid = grid_bodies(case)
        on_grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
        sides = np.array([_SIDES[side] for side in self.sides])

        def of(i: int) -> StressPoints:
            own, grid = self.of_points == i, on_grid[self._of_grid == i]
            return StressPoints(
                np.concatenate([self.points[own], grid]),
                np.concatenate([sides[own], np.zeros(len(grid))]),
            )

        both, planes = bodies(case), (case.lower.z[1], case.upper.z[0])
        self._recovery = StressRecovery(
            both, case.line, case.mesh, planes, (of(0), of(1)), case.stress.exclude, comm
        )
        #: of lower and upper
        self.interfaces = (
            interfaces(both[0], case.line, case.mesh, "lower", planes[0]),
            interfaces(both[1], case.line, case.mesh, "upper", planes[1]),
        )

    def at(self, case: Case, step: int, state: State) -> StressState:
        """Return the stresses of a state after so many steps. Collective on comm.

        Raises
        ------
        ComputationError : the wear leaves too little of a body, or a factorisation failed.
        """
        lower, upper = (worn_through(case.layer_ends(i), wear) for i, wear in enumerate(state.wear))
        gone = lower, upper
        found = self._recovery.stresses(
            state.contact.pressure, case.friction, state.meshed_wear, gone
        )
        points = np.empty((len(self.points), 6))
        grid = np.full((*self._of_grid.shape, 6), np.nan)
        for i, body in enumerate(found):
            own = np.count_nonzero(self.of_points == i)
            points[self.of_points == i] = body.points[:own]
            grid[self._of_grid == i] = body.points[own:]
        surface, largest = (
            (found[0].surface, found[1].surface),
            (found[0].largest, found[1].largest),
        )
        along = found[0].interfaces, found[1].interfaces
        layers = found[0].layers, found[1].layers
        return StressState(step, float(state.time), points, grid, surface, largest, along, layers)

    def history(self, states: tuple[StressState, ...]) -> StressHistory:
        """Return the stresses of some states, and where they are."""
        return StressHistory(
            self.points, self.sides, self.grid, self._exclude, self.interfaces, states
        )


class StressObserver:
    """Keeps the stresses of the stored states that a case asks for.

    Parameters
    ----------
    case : one with [stress].
    stresses : of it; calls are collective on their communicator.
    last_stored : s, time of the last stored state of an interrupted history; negative: none.
    points_only : keep no grids and no faces.
    """

    def __init__(
        self,
        case: Case,
        stresses: CaseStresses,
        last_stored: float = -1.0,
        *,
        points_only: bool = False,
    ) -> None:
        assert case.stress is not None
        self._case, self._points_only = case, points_only
        #: of the case
        self.stresses = stresses
        self._asked = Asked(case, case.stress.times, last_stored)
        #: what was asked for so far
        self.states: list[StressState] = []
        #: (2, n) mm, the wear of lower and upper in the last of it, of an interrupted history too;
        #: None: not known
        self.wear: FloatArray | None = None

    def __call__(self, instant: Instant) -> None:
        """Compute the stresses of a state, if the case wants them. Collective."""
        if self._asked(instant):
            state = self.stresses.at(self._case, instant.steps, instant.state)
            self.states.append(state.without_fields() if self._points_only else state)
            self.wear = instant.state.wear

    def history(self, earlier: tuple[StressState, ...] = ()) -> StressHistory:
        """Return what was asked for so far, after what an interrupted history had."""
        return self.stresses.history((*earlier, *self.states))
