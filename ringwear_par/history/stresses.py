"""Stresses and boundary fields of the stored states that cases ask for."""

from collections.abc import Callable, Hashable, Sequence
from typing import NamedTuple

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import SAME_TIME, Case, Side
from ringwear_par.cases.stress_points import grid_bodies, point_bodies, point_depths
from ringwear_par.elasticity.stress.fields import BoundaryState, StressHistory, StressState
from ringwear_par.elasticity.stress.recovery import StressPoints, StressRecovery
from ringwear_par.history.elastic import boundary_recovery, operator_key

#: pressure, or stress, of an outermost element over that of the fourth, from which on it is
#: infinite there
RISING = 1.2

_SIDES: dict[Side, float] = {"above": 1.0, "": 0.0, "below": -1.0}


class Moment(NamedTuple):
    """A stored state of one history."""

    #: s, steps made, and whether it is the last one
    time: float
    steps: int
    ended: bool
    #: (n,) MPa, mm
    pressure: FloatArray
    approach: float
    #: (2, n) mm, of lower and upper; and the wear that elements are meshed on, None: none
    wear: FloatArray
    meshed: FloatArray | None


def selected(which: str | tuple[float, ...], moment: Moment, last_stored: float) -> bool:
    """Return whether a stored state is among those that a case asks for.

    Parameters
    ----------
    which : "none", "last", "all", or times (s) from each of which on the first stored state is.
    last_stored : s, time of the stored state before; negative: there is none.
    """
    if isinstance(which, str):
        return which == "all" or (which == "last" and moment.ended)
    near = SAME_TIME * moment.time
    return any(last_stored + near < t <= moment.time + near for t in which)


class Boundaries:
    """Fields on the boundaries of lower and upper, of a case that has a history of its own.

    Methods are collective on comm.
    """

    def __init__(self, case: Case, comm: MPI.Comm) -> None:
        self._case, self._which = case, case.output.boundary
        self._recovery = boundary_recovery(case, comm) if self._which != "none" else None
        #: the states so far
        self.states: list[BoundaryState] = []

    def __call__(self, moment: Moment, last_stored: float) -> None:
        """Recover the fields of a stored state, if the case wants them."""
        if self._recovery is None or not selected(self._which, moment, last_stored):
            return
        fields = self._recovery.fields(
            moment.pressure, moment.approach, self._case.friction_at(moment.time), moment.wear,
            moment.meshed,
        )  # fmt: skip
        self.states.append(BoundaryState(moment.steps, moment.time, fields))


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

        boundaries = boundary_recovery(case, comm, fine=True)
        self._recovery = StressRecovery(boundaries, (of(0), of(1)), case.stress.exclude)
        #: of lower and upper
        self.interfaces = boundaries.interfaces()

    def at(self, case: Case, moment: Moment) -> StressState:
        """Return the stresses of a state. Collective on comm.

        Raises
        ------
        ComputationError : the wear leaves too little of a body, or a factorisation failed.
        """
        lower, upper = (
            wear >= (1.0 - 1e-13) * case.layer_ends(i) for i, wear in enumerate(moment.wear)
        )
        friction, gone = case.friction_at(moment.time), (lower, upper)
        both = self._recovery.stresses(moment.pressure, friction, moment.meshed, gone)
        points = np.empty((len(self.points), 6))
        grid = np.full((*self._of_grid.shape, 6), np.nan)
        for i, body in enumerate(both):
            count = np.count_nonzero(self.of_points == i)
            points[self.of_points == i] = body.points[:count]
            grid[self._of_grid == i] = body.points[count:]
        return StressState(
            moment.steps, moment.time, points, grid,
            (both[0].surface, both[1].surface), (both[0].largest, both[1].largest),
            (both[0].interfaces, both[1].interfaces), (both[0].layers, both[1].layers),
        )  # fmt: skip

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


class Stresses:
    """Stresses of the stored states that B cases ask for.

    Parameters
    ----------
    cases : on one contact pair; they ask for the same stresses, or for none.
    of : returns those of a case; calls are collective on their communicator.
    points_only : keep no grids and no faces.
    """

    def __init__(
        self,
        cases: Sequence[Case],
        of: Callable[[Case], CaseStresses],
        *,
        points_only: bool = False,
    ) -> None:
        self._cases, self._points_only, count = cases, points_only, len(cases)
        self._of = of
        self.states: list[list[StressState]] = [[] for _ in range(count)]
        self.infinite = [InfiniteEdge()] * count
        #: why stresses of some histories could not be computed
        self.failures: dict[int, Exception] = {}

    def __call__(self, number: int, moment: Moment, last_stored: float) -> None:
        """Compute the stresses of a stored state, if its case wants them.

        Raises
        ------
        Exception : those of a single history cannot be computed.
        """
        case = self._cases[number]
        if case.stress is None or number in self.failures:
            return
        if not selected(case.stress.times, moment, last_stored):
            return
        try:
            state = self._of(case).at(case, moment)
        except Exception as error:
            if len(self._cases) == 1:
                raise
            self.failures[number] = error
            return
        self.states[number].append(state.without_fields() if self._points_only else state)
        self.infinite[number] = infinite_edge(case, state, moment) or self.infinite[number]

    def history(self, number: int = 0) -> StressHistory | None:
        """Return the stresses of a history so far, None where its case asks for none."""
        if self._cases[number].stress is None:
            return None
        return self._of(self._cases[number]).history(tuple(self.states[number]))


def infinite_edge(case: Case, stresses: StressState, moment: Moment) -> InfiniteEdge | None:
    """Return the largest stress of a state if it is beside an edge where it is infinite.

    None where the largest stress is elsewhere. Not collective.
    """
    assert case.stress is not None
    largest, p, line = stresses.of_both, moment.pressure, case.line
    for end, further in ((0, 3), (-1, -4)):
        r, reach = line.edges[end], case.stress.exclude * (1.0 + 1e-6) + 3.0 * line.width[end]
        height = min(abs(largest.z - z) for z in (case.lower.z[1], case.upper.z[0]))
        beside = np.hypot(largest.r - r, height) <= reach + moment.wear.max()
        if r > 0.0 and beside and p[end] > RISING * p[further]:
            return InfiniteEdge(largest.mises, moment.time, float(r))
    return None
