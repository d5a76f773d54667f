"""Statements that hold at every instant of a history, and how far it is off them."""

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from ringwear_par.arrays import FloatArray, relative
from ringwear_par.history.physics import Physics
from ringwear_par.history.snapshots import Snapshot
from ringwear_par.history.state import State
from ringwear_par.schedules import in_time


@dataclass(frozen=True)
class Balances:
    """Relative defects of balances, and the error of time steps.

    Force, volume, energy and residual hold to round-off; torque and reaction vanish with the mesh,
    the step error with the steps.
    """

    #: contact pressure against the applied force (0 at given displacement)
    force: float = 0.0
    #: torque on the fixed faces against the friction torque, the worse of both bodies
    torque: float = 0.0
    #: axial force on the fixed faces against that of the contact pressure, the worse of both bodies
    reaction: float = 0.0
    #: worn volume of the profiles against the time integral of the rate at the contact pressures,
    #: which implicit schemes evaluate apart from the depths (a check of bookkeeping for explicit
    #: steps, whose depths are the rates times the step)
    volume: float = 0.0
    #: worn volume against k times the dissipated energy, where p0 = 0 (else 0); with layers what
    #: the volumes of all of them took of it
    energy: float = 0.0
    #: KKT residual of the contact solution
    residual: float = 0.0
    #: mm, estimated error of wear that time steps make: over the whole history with adaptive ones,
    #: in one step with fixed ones
    step_error: float = 0.0

    @property
    def worst(self) -> float:
        """The worst of those that hold to round-off."""
        return max(getattr(self, name) for name in TO_ROUND_OFF)


#: the balances that hold to round-off on any mesh, by any steps
TO_ROUND_OFF = ("force", "volume", "energy", "residual")
_NAMES = [declared.name for declared in fields(Balances)]


def balances(physics: Physics, state: State) -> dict[str, Any]:
    """Return the defects of a state by name, each a float, or (B,) of B histories. Not collective.

    All but ``step_error``, which is that of a step.
    """
    contact = state.contact
    turned, lower, upper, turned_lower, turned_upper = physics.reactions(contact.pressure)
    volumes, worn = physics.integrals(state.wear), state.worn
    identity: Any = 0.0
    for body, (ratio, volume) in enumerate(zip(physics.inputs.per_energy, volumes, strict=True)):
        if ratio is None:
            continue
        if ratio.ndim > 1:
            identity = np.maximum(identity, _layers_defect(physics, state, body, ratio))
        else:
            identity = np.maximum(identity, _defect(volume, ratio * state.energy))
    force = None if physics.inputs.force is None else in_time(physics.inputs.force, state.time)
    off = np.maximum(abs(volumes[0] - worn[0]), abs(volumes[1] - worn[1]))
    total = np.maximum(volumes[0], volumes[1])
    return {
        "force": 0.0 if force is None else _defect(contact.force, force),
        "torque": np.maximum(_defect(turned_lower, turned), _defect(turned_upper, turned)),
        "reaction": np.maximum(_defect(lower, contact.force), _defect(upper, contact.force)),
        "volume": relative(off, total),
        "energy": identity,
        "residual": contact.residual,
    }


def _layers_defect(physics: Physics, state: State, body: int, ratios: FloatArray) -> Any:
    """Return how far the energy is off what volumes worn off the layers of a body took of it.

    0 where a law of them has no fixed volume by energy.
    """
    volumes = physics.layer_volumes(body, state.wear[body])
    known = (ratios > 0.0).all(axis=0)
    took = sum(
        np.divide(volumes[..., number], ratio, where=known, out=np.zeros(volumes.shape[:-1]))
        for number, ratio in enumerate(ratios)
    )
    exact = np.where(known, state.energy, 0.0)
    return _defect(took, exact)


def _defect(value: Any, exact: Any) -> Any:
    """Return |value - exact| / exact, 0 where nothing is expected."""
    return relative(abs(value - exact), exact)


class WorstBalances:
    """The worst of all balances of B histories so far."""

    def __init__(self, count: int = 1) -> None:
        #: (balances, B), by the order of ``Balances``
        self._worst = np.zeros((len(_NAMES), count))
        #: (balances, B) s, when they were the worst
        self._times = np.zeros((len(_NAMES), count))
        #: (B,) whether elements came into contact within steps, which ``step_error`` leaves out
        self.closing_contact = np.zeros(count, dtype=bool)

    def restore(
        self,
        before: Balances,
        closing_contact: bool,
        reaction_time: float,
    ) -> None:
        """Take the balances of an interrupted single history; times are in s."""
        self._worst[:, 0] = [getattr(before, name) for name in _NAMES]
        self._times[:, 0] = reaction_time
        self.closing_contact[0] = closing_contact

    def __call__(self, snapshot: Snapshot) -> bool:
        """Take the balances of new states: an observer."""
        if snapshot.passing:
            return False
        new = np.flatnonzero(snapshot.accepted)
        values, numbers = balances(snapshot.physics, snapshot.state), snapshot.numbers[new]
        if snapshot.step is not None:
            values["step_error"] = snapshot.progress.step_error
            closing = np.broadcast_to(snapshot.step.closing, snapshot.accepted.shape)[new]
            self.closing_contact[numbers] |= closing
        table = np.zeros((len(_NAMES), len(snapshot.numbers)))
        for name, value in values.items():
            table[_NAMES.index(name)] = value
        now, before = table[:, new], self._worst[:, numbers]
        worse = ~(now <= before)  # NaN too
        self._worst[:, numbers] = np.where(worse, now, before)
        self._times[:, numbers] = np.where(worse, snapshot.state.time[new], self._times[:, numbers])
        return False

    def history(self, number: int = 0) -> Balances:
        """Return the worst balances of one history."""
        return Balances(*self._worst[:, number].tolist())

    @property
    def reactions(self) -> FloatArray:
        """(2, B) the worst ``torque`` or ``reaction`` of each, and its time, s."""
        rows = [_NAMES.index("torque"), _NAMES.index("reaction")]
        worst = self._worst[rows].argmax(axis=0)[None]
        return np.stack(
            [np.take_along_axis(values[rows], worst, 0)[0] for values in (self._worst, self._times)]
        )

    @property
    def worst(self) -> Balances:
        """The worst balances of a single history."""
        return self.history()

    @property
    def imbalance(self) -> FloatArray:
        """(B,) the worst of those that hold to round-off."""
        return self._worst[[_NAMES.index(name) for name in TO_ROUND_OFF]].max(axis=0)
