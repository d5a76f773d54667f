"""Statements that hold at every instant of a history, and how far it is off them."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from ringwear_par.arrays import FloatArray, larger, relative
from ringwear_par.history.layers import layer_volumes
from ringwear_par.history.model import WearModel
from ringwear_par.history.snapshots import Snapshot
from ringwear_par.history.state import State
from ringwear_par.schedules import in_time


@dataclass(frozen=True)
class Balances:
    """Relative defects of balances, and the error of time steps.

    Force, volume, energy and residual hold to round-off; torque and reaction vanish with the mesh,
    the step error with the steps.

    Parameters
    ----------
    force : contact pressure against the applied force (0 at given displacement).
    torque : torque on the fixed faces against the friction torque, the worse of both bodies.
    reaction : axial force on the fixed faces against that of the contact pressure, likewise.
    volume : worn volume of the profiles against the time integral of the rate at the contact
        pressures, which implicit schemes evaluate apart from the depths (a check of bookkeeping for
        explicit steps, whose depths are the rates times the step).
    energy : worn volume against k times the dissipated energy, where p0 = 0 (else 0); with layers
        what the volumes of all of them took of it.
    residual : KKT residual of the contact solution.
    step_error : mm, estimated error of wear that time steps make: over the whole history with
        adaptive ones, in one step with fixed ones.
    """

    force: float = 0.0
    torque: float = 0.0
    reaction: float = 0.0
    volume: float = 0.0
    energy: float = 0.0
    residual: float = 0.0
    step_error: float = 0.0

    @property
    def worst(self) -> float:
        """The worst of those that hold to round-off."""
        return max(getattr(self, name) for name in TO_ROUND_OFF)


#: the balances that hold to round-off on any mesh, by any steps
TO_ROUND_OFF = ("force", "volume", "energy", "residual")


def balances(model: WearModel, state: State) -> dict[str, Any]:
    """Return the defects of a state by name, each a float, or (B,) of B histories. Not collective.

    All but ``step_error``, which is that of a step.
    """
    contact = state.contact
    turned, lower, upper, turned_lower, turned_upper = _parts(model.reactions(contact.pressure))
    volumes, worn = _parts(model.integrals(state.wear)), _parts(state.worn)
    identity: Any = 0.0
    for body, (ratio, volume) in enumerate(zip(model.given.per_energy, volumes, strict=True)):
        if isinstance(ratio, list):
            identity = larger(identity, _layers_defect(model, state, body, ratio))
        elif ratio is not None:
            identity = larger(identity, _defect(volume, ratio * state.energy))
    force = None if model.given.force is None else in_time(model.given.force, state.time)
    off = larger(abs(volumes[0] - worn[0]), abs(volumes[1] - worn[1]))
    total = larger(*volumes)
    return {
        "force": 0.0 if force is None else _defect(contact.force, force),
        "torque": larger(_defect(turned_lower, turned), _defect(turned_upper, turned)),
        "reaction": larger(_defect(lower, contact.force), _defect(upper, contact.force)),
        "volume": relative(off, total),
        "energy": identity,
        "residual": contact.residual,
    }


def _layers_defect(model: WearModel, state: State, body: int, ratios: list[Any]) -> Any:
    """Return how far the energy is off what volumes worn off the layers of a body took of it.

    0 where a law of them has no fixed volume by energy.
    """
    volumes = layer_volumes(model, body, state.wear[body])
    known = np.all([np.asarray(ratio) > 0.0 for ratio in ratios], axis=0)
    took = sum(
        np.divide(volumes[..., number], ratio, where=known, out=np.zeros(volumes.shape[:-1]))
        for number, ratio in enumerate(ratios)
    )
    exact = np.where(known, state.energy, 0.0)
    if exact.ndim == 0:
        return _defect(float(took), float(exact))
    return _defect(took, exact)


def _parts(values: FloatArray) -> Any:
    """Return numbers of one history as floats, which are quicker, those of B as (B,) each."""
    return values.tolist() if values.ndim == 1 else values


def _defect(value: Any, exact: Any) -> Any:
    """Return |value - exact| / exact, 0 where nothing is expected."""
    return relative(abs(value - exact), exact)


class WorstBalances:
    """Observer that keeps the worst of all balances of a history.

    Parameters
    ----------
    before : those of an interrupted history.
    step_error_time, closing_contact : of the same, see below.
    """

    def __init__(
        self,
        before: Balances | None = None,
        step_error_time: float = 0.0,
        closing_contact: bool = False,
    ) -> None:
        self._worst = vars(before or Balances()).copy()
        #: s, end of the step at which ``step_error`` is the largest
        self.step_error_time = step_error_time
        #: whether elements came into contact within steps, which ``step_error`` does not know of
        self.closing_contact = closing_contact

    def __call__(self, snapshot: Snapshot) -> bool:
        """Take those of a new state."""
        if snapshot.passing:
            return False
        now, worst = balances(snapshot.model, snapshot.state), self._worst
        if snapshot.step is not None:
            now["step_error"] = float(snapshot.step.history_error)
            self.closing_contact |= bool(snapshot.step.closing)
        for name, value in now.items():
            if not value <= worst[name]:  # nor NaN
                worst[name] = value
                if name == "step_error":
                    self.step_error_time = snapshot.state.time
        return False

    @property
    def worst(self) -> Balances:
        """The worst so far."""
        return Balances(**self._worst)
