"""Stresses and boundary fields of the stored states that cases ask for."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import SAME_TIME, Case, Side, Stress
from ringwear_par.cases.stress_points import grid_bodies, point_bodies
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.elasticity.stress.fields import MESH_FIELDS, mises
from ringwear_par.elasticity.stress.recovery import BoundaryRecovery, StressPoints, StressRecovery
from ringwear_par.history.checks import INFINITE_AT_INTERFACE, INFINITE_STRESS
from ringwear_par.history.elastic import boundary_recovery

#: pressure, or stress, of an outermost element over that of the fourth, from which on it is
#: infinite there; and these elements
_RISING, _ENDS = 1.2, ((0, 3), (-1, -4))

_SIDES: dict[Side, float] = {"above": 1.0, "": 0.0, "below": -1.0}
#: where a largest stress is, see ``fields.Largest``
_PLACE = ("r", "z", "layer")


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


def stacked(states: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the arrays that states have, one after another along a new first axis."""
    names = [name for name in states[-1] if name in states[0]] if states else []
    data = {name: np.array([state[name] for state in states]) for name in names}
    return {name: v[0] if name.split("/")[-1] in MESH_FIELDS else v for name, v in data.items()}


def boundary_state(recovery: BoundaryRecovery, case: Case, moment: Moment) -> dict[str, Any]:
    """Return the fields on the boundaries of both bodies by place, see ``results.variables``.

    Collective on the recovery's comm.
    """
    fields = recovery.fields(
        moment.pressure, moment.approach, case.friction_at(moment.time), moment.wear, moment.meshed
    )
    state: dict[str, Any] = {}
    for body, of in zip(BODIES, fields, strict=True):
        values = {**vars(of), "time": moment.time, "steps_made": moment.steps}
        state |= {f"boundary/{body}/{name}": value for name, value in values.items()}
    return state


class Stresses:
    """Stresses of the stored states that B cases ask for. Methods are collective on comm.

    Parameters
    ----------
    cases : of one ``block_key``.
    """

    def __init__(self, cases: Sequence[Case], comm: MPI.Comm) -> None:
        self._cases = cases
        #: arrays of each state so far by name, of each history
        self.states: list[list[dict[str, Any]]] = [[] for _ in cases]
        if cases[0].stress is not None:
            self._recover(cases[0], cases[0].stress, comm)

    def _recover(self, case: Case, stress: Stress, comm: MPI.Comm) -> None:
        """Have the recovery of the stresses at the points of a case, those of its grid last."""
        axes = stress.grid.axes if stress.grid is not None else (np.empty(0), np.empty(0))
        points = np.array([point[:2] for point in stress.points]).reshape(-1, 2)
        names = [side for _, _, side in stress.points]
        on_grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
        every = np.concatenate([points, on_grid])
        sides = np.append([_SIDES[side] for side in names], np.zeros(len(on_grid)))
        #: of which body each point is
        self._body = np.append(np.array(point_bodies(case), int), grid_bodies(case))
        lower, upper = (
            StressPoints(every[self._body == i], sides[self._body == i]) for i in (0, 1)
        )
        boundaries = boundary_recovery(case, comm, fine=True)
        self._recovery = StressRecovery(boundaries, (lower, upper), stress.exclude)
        where: dict[str, Any] = {"grid_r": axes[0], "grid_z": axes[1]}
        for body, (r, z) in zip(BODIES, boundaries.interfaces(), strict=True):
            where |= {f"interface_r_{body}": r, f"interface_z_{body}": z}
        where |= {"point_r": points[:, 0], "point_z": points[:, 1], "point_side": names}
        #: arrays by name that are the same at all states, see ``results.variables``
        self._where = _present({**where, "stress_exclude": np.array(stress.exclude)})

    def __call__(
        self, number: int, moment: Moment, last_stored: float
    ) -> dict[str, tuple[float, ...]]:
        """Compute the stresses of a stored state, if its case wants them.

        Returns
        -------
        dict : the entries of ``INFINITE_STRESS`` and ``INFINITE_AT_INTERFACE``, where the largest
            stress is beside such an edge.

        Raises
        ------
        ComputationError : the wear leaves too little of a body, or a factorisation failed.
        """
        case = self._cases[number]
        if case.stress is None or not selected(case.stress.times, moment, last_stored):
            return {}
        state = self._at(case, case.stress, moment)
        self.states[number].append(state)
        return _infinite(case, self._where, state, moment)

    def _at(self, case: Case, stress: Stress, moment: Moment) -> dict[str, Any]:
        """Return the stresses of a state by name, see ``results.variables``."""
        lower, upper = (
            wear >= (1.0 - 1e-13) * case.layer_ends(i) for i, wear in enumerate(moment.wear)
        )
        friction, gone = case.friction_at(moment.time), (lower, upper)
        both = self._recovery.stresses(moment.pressure, friction, moment.meshed, gone)
        points = np.full((len(self._body), 6), np.nan)
        state: dict[str, Any] = {"stress_time": moment.time, "stress_steps_made": moment.steps}
        for i, (name, body) in enumerate(zip(BODIES, both, strict=True)):
            points[self._body == i] = body.points
            state |= {
                f"surface_stress_{name}": body.surface,
                f"interface_stress_{name}": body.interfaces,
                f"max_mises_{name}_layers": body.layers,
                f"max_mises_{name}": body.largest.mises,
                **{f"max_mises_{name}_{at}": getattr(body.largest, at) for at in _PLACE},
            }
        alone, n = len(stress.points), stress.grid.n if stress.grid is not None else (0, 0)
        grid = points[alone:].reshape(*n, 6)
        return _present({**state, "stress": points[:alone], "stress_grid": grid})

    def arrays(self, number: int) -> dict[str, Any]:
        """Return the stresses of a history so far by name, nothing where it has none."""
        states = self.states[number]
        return stacked(states) | self._where if states else {}


def _present(arrays: Mapping[str, Any]) -> dict[str, Any]:
    """Return the arrays that hold something."""
    return {name: values for name, values in arrays.items() if np.size(values)}


def _infinite(
    case: Case, where: Mapping[str, Any], state: Mapping[str, Any], moment: Moment
) -> dict[str, tuple[float, ...]]:
    """Return the largest stresses of a state that are beside edges, see ``Stresses``.

    There, at edges of contact and at free ends of interfaces, stress rises to the edge. Beyond
    ``stress.exclude`` a few elements are near. Not collective.
    """
    assert case.stress is not None
    found: dict[str, tuple[float, ...]] = {}
    p, line, exclude = moment.pressure, case.line, case.stress.exclude * (1.0 + 1e-6)
    largest = [[state[f"max_mises_{body}{end}"] for end in ("", "_r", "_z")] for body in BODIES]
    stress, at_r, at_z = max(largest, key=lambda of: np.nan_to_num(of[0], nan=-np.inf))
    for end, further in _ENDS:
        r, reach = line.edges[end], exclude + 3.0 * line.width[end]
        height = min(abs(at_z - z) for z in (case.lower.z[1], case.upper.z[0]))
        beside = np.hypot(at_r - r, height) <= reach + moment.wear.max()
        if r > 0.0 and beside and p[end] > _RISING * p[further] and not found:
            found[INFINITE_STRESS] = stress, moment.time, float(r)
    for i, (body, ring) in enumerate(zip(BODIES, case.rings, strict=True)):
        (stress, at_r, at_z), middles = largest[i], where.get(f"interface_r_{body}", np.empty(0))
        for layer, z in enumerate(where.get(f"interface_z_{body}", ())):
            values = mises(state[f"interface_stress_{body}"][layer]).max(axis=0)
            for r, (end, further) in zip(ring.r, _ENDS, strict=True):
                near = np.hypot(at_r - r, at_z - z) <= exclude + 6.0 * abs(middles[end] - r)
                if r > 0.0 and near and values[end] > _RISING * values[further]:
                    edge = (stress, moment.time, r, z, i, layer)
                    found[INFINITE_AT_INTERFACE] = max(found.get(INFINITE_AT_INTERFACE, ()), edge)
    return found
