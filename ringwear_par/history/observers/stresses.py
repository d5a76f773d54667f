"""The stresses that a case asks for, at any of its states, and the observer that keeps them."""

from collections.abc import Callable, Hashable, Sequence
from typing import NamedTuple

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import Case, Side
from ringwear_par.cases.stress_points import grid_bodies, point_bodies, point_depths
from ringwear_par.elasticity.stress.fields import StressHistory, StressState
from ringwear_par.elasticity.stress.recovery import StressPoints, StressRecovery, interfaces
from ringwear_par.history.elastic.bodies import bodies, operator_key
from ringwear_par.history.observers.selection import Selection
from ringwear_par.history.snapshots import Instant, Snapshot
from ringwear_par.history.state import State
from ringwear_par.wear.layered import worn_through

#: pressure, or stress, of an outermost element over that of the fourth, from which on it is
#: infinite there
RISING = 1.2

_SIDES: dict[Side, float] = {"above": 1.0, "": 0.0, "below": -1.0}


def stress_key(case: Case) -> Hashable:
    """Return the key of the stresses of unit loads; equal for cases that can share them."""
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
            of_body, grid = self.of_points == i, on_grid[self._of_grid == i]
            return StressPoints(
                np.concatenate([self.points[of_body], grid]),
                np.concatenate([sides[of_body], np.zeros(len(grid))]),
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
        friction = case.friction_at(float(state.time))
        bodies = self._recovery.stresses(state.contact.pressure, friction, state.meshed_wear, gone)
        points = np.empty((len(self.points), 6))
        grid = np.full((*self._of_grid.shape, 6), np.nan)
        for i, body in enumerate(bodies):
            count = np.count_nonzero(self.of_points == i)
            points[self.of_points == i] = body.points[:count]
            grid[self._of_grid == i] = body.points[count:]
        surface, largest = (
            (bodies[0].surface, bodies[1].surface),
            (bodies[0].largest, bodies[1].largest),
        )
        along = bodies[0].interfaces, bodies[1].interfaces
        layers = bodies[0].layers, bodies[1].layers
        return StressState(step, float(state.time), points, grid, surface, largest, along, layers)

    def history(self, states: tuple[StressState, ...]) -> StressHistory:
        """Return the stresses of some states, and where they are."""
        return StressHistory(
            self.points, self.sides, self.grid, self._exclude, self.interfaces, states
        )


class InfiniteEdge(NamedTuple):
    """A largest stress (MPa) beside an edge where it is infinite, its time (s) and radius (mm)."""

    mises: float = 0.0
    time: float = 0.0
    r: float = 0.0


class StressObserver:
    """Stresses of the stored states that B cases ask for.

    Parameters
    ----------
    cases : on one contact pair; they ask for the same stresses, or for none.
    stresses : returns those of a case, None where it asks for none; calls of an observer are
        collective on their communicator.
    last_stored : s, time of the last stored state of an interrupted history; negative: none.
    points_only : keep no grids and no faces.
    """

    def __init__(
        self,
        cases: Sequence[Case],
        stresses: Callable[[Case], CaseStresses | None],
        last_stored: float = -1.0,
        *,
        points_only: bool = False,
    ) -> None:
        self._cases, self._points_only = cases, points_only
        #: by the number of the history
        self._stresses: dict[int, CaseStresses] = {}
        self._selections: dict[int, Selection] = {}
        for number, case in enumerate(cases):
            if case.stress is not None and (shared := stresses(case)) is not None:
                self._stresses[number] = shared
                self._selections[number] = Selection(case, case.stress.times, last_stored)
        self._states: dict[int, list[StressState]] = {number: [] for number in self._stresses}
        #: (2, n) mm, the wear of lower and upper in the last of the states, where it is known
        self._wear: dict[int, FloatArray] = {}
        self._infinite: dict[int, InfiniteEdge] = {}
        #: why stresses of some histories could not be computed
        self.failures: dict[int, Exception] = {}

    def restore(
        self,
        before: StressHistory | None,
        stored: FloatArray,
        finished: bool,
        infinite: Sequence[float],
    ) -> None:
        """Take the states of an interrupted single history, see ``Selection.of_interrupted``.

        Parameters
        ----------
        infinite : entries of ``infinite``.
        """
        mises, time, r, *_ = infinite
        self._infinite[0] = InfiniteEdge(mises, time, r)
        if before is not None and 0 in self._states:
            self._states[0] = self._selections[0].of_interrupted(before.states, stored, finished)

    def restore_wear(self, times: FloatArray, wear: FloatArray) -> None:
        """Take the wear (2, s, n), mm, at the stored times (s,), s, of an interrupted history."""
        if states := self._states.get(0):
            self._wear[0] = wear[:, times.tolist().index(states[-1].time)]

    def __call__(self, snapshot: Snapshot) -> bool:
        """Compute the stresses of new stored states, if their cases want them. Collective.

        Raises
        ------
        Exception : those of a single history cannot be computed.
        """
        if not self._stresses or not snapshot.stored.any():
            return False
        for place in np.flatnonzero(snapshot.stored).tolist():
            number = int(snapshot.numbers[place])
            if number not in self._stresses or number in self.failures:
                continue
            instant = snapshot.instant(place)
            if not self._selections[number](instant):
                continue
            try:
                self._add(number, instant)
            except Exception as error:
                if len(self._cases) == 1:
                    raise
                self.failures[number] = error
        return False

    def _add(self, number: int, instant: Instant) -> None:
        case, state = self._cases[number], instant.state
        stresses = self._stresses[number].at(case, instant.steps, state)
        self._states[number].append(stresses.without_fields() if self._points_only else stresses)
        self._wear[number] = state.wear
        infinite = infinite_edge(case, stresses, state)
        if infinite is not None:
            self._infinite[number] = infinite

    def places(self, number: int) -> CaseStresses | None:
        """Return where a history has stresses, None where it has none."""
        return self._stresses.get(number)

    def history(self, number: int = 0) -> StressHistory | None:
        """Return the stresses of a history so far, None where its case asks for none."""
        stresses = self._stresses.get(number)
        return None if stresses is None else stresses.history(tuple(self._states[number]))

    def wear(self, number: int = 0) -> FloatArray | None:
        """Return the wear (2, n), mm, in the last state of stress; None where it is not known."""
        return self._wear.get(number)

    def infinite(self, number: int = 0) -> InfiniteEdge:
        """Return the last largest stress beside an edge where it is infinite; 0 where none is."""
        return self._infinite.get(number, InfiniteEdge())


def infinite_edge(case: Case, stresses: StressState, state: State) -> InfiniteEdge | None:
    """Return the largest stress of a state if it is beside an edge where it is infinite.

    None where the largest stress is elsewhere. Not collective.
    """
    assert case.stress is not None
    largest, p, line = stresses.of_both, state.contact.pressure, case.line
    for end, further in ((0, 3), (-1, -4)):
        r, reach = line.edges[end], case.stress.exclude * (1.0 + 1e-6) + 3.0 * line.width[end]
        height = min(abs(largest.z - z) for z in (case.lower.z[1], case.upper.z[0]))
        beside = np.hypot(largest.r - r, height) <= reach + state.wear.max()
        if r > 0.0 and beside and p[end] > RISING * p[further]:
            return InfiniteEdge(largest.mises, float(state.time), float(r))
    return None
