"""A wear history: contact and wear stepped in time, section 3 of the paper.

``pressure[n]``, ``approach[n]``... are the contact solution with the profile worn up to
``time[n]``, for both schemes. The explicit one, (6) of the paper, lets the pressure at the start
of a step wear throughout it; the implicit one (backward Euler) the pressure at its end, which is
found together with the wear inside the contact problem.
"""

from collections.abc import Callable
from dataclasses import dataclass
from operator import sub

import numpy as np

from ringwear_par.case import Case
from ringwear_par.contact import ContactSolver, ContactState
from ringwear_par.errors import ComputationError
from ringwear_par.geometry import FloatArray
from ringwear_par.pair import ContactPair, largest_stable_step
from ringwear_par.wear import StepWear


@dataclass(frozen=True)
class Balances:
    """Relative defects of balances.

    All hold to round-off, but for torque and reaction, which vanish with the mesh.

    Parameters
    ----------
    force : contact pressure against the applied force (0 at given displacement).
    torque : torque on the held faces against the friction torque, the worse of both bodies.
    reaction : axial force on the held faces against that of the contact pressure, likewise.
    volume : worn volume of the profiles against the time integral of its rate.
    energy : worn volume against k times the dissipated energy, where p0 = 0 (else 0).
    residual : KKT residual of the contact solution.
    """

    force: float = 0.0
    torque: float = 0.0
    reaction: float = 0.0
    volume: float = 0.0
    energy: float = 0.0
    residual: float = 0.0

    def worse(self, other: "Balances") -> "Balances":
        """Return the larger of each defect."""
        return Balances(*map(max, self.values(), other.values()))

    @property
    def worst(self) -> float:
        """The worst of those that hold to round-off."""
        return max(self.force, self.volume, self.energy, self.residual)

    def values(self) -> tuple[float, ...]:
        """Return the defects in their order."""
        return self.force, self.torque, self.reaction, self.volume, self.energy, self.residual


@dataclass(frozen=True)
class State:
    """A history after ``step`` steps.

    Parameters
    ----------
    step : number of steps made.
    wear : (2, n) float, mm, loss of lower and upper.
    worn : (2,) float, mm^3, time integrals of the rates of the worn volumes.
    energy : N mm, dissipated by friction.
    contact : the contact solution.
    balances : the worst so far.
    """

    step: int
    wear: FloatArray
    worn: FloatArray
    energy: float
    contact: ContactState
    balances: Balances


class WearHistory:
    """A case on its contact pair, step by step.

    Parameters
    ----------
    case : the case.
    pair : its contact pair.
    solver : contact solver of the pair; its communicator is that of the collective methods.
    """

    def __init__(self, case: Case, pair: ContactPair, solver: ContactSolver) -> None:
        self.case, self.pair, self.solver = case, pair, solver
        line = pair.line
        self._area = line.area
        self._moment = line.area * line.arm  # torque per unit shear
        self._power = case.friction * case.load.omega * line.arm  # mu V, mm/s
        active = tuple(law for law in case.laws if law is not None)
        # what balances take from the pressure: friction torque / mu, reactions of both bodies
        self._sums = np.vstack([self._moment, pair.force_reaction, pair.torque_reaction])
        self._zero = np.zeros(line.n)
        self._initial_gap = case.gap_at(line.gap_point)
        self._implicit = (
            StepWear(active, self._power, case.time.step)
            if active and case.time.scheme == "implicit"
            else None
        )

    def stable_step(self) -> float:
        """Return the largest stable step of the explicit scheme, s. Not collective."""
        steepest = np.full(self.pair.line.n, np.inf)
        slopes = [law.slope(steepest, self._power) for law in self.case.laws if law is not None]
        return largest_stable_step(self.pair, sum(slopes, self._zero))

    def start(self) -> State:
        """Return the contact before any wear. Collective."""
        try:
            contact = self._contact(self._initial_gap, None)
        except ComputationError as error:
            raise ComputationError(f"step 0 (before any wear): {error}") from error
        return self._balanced(
            0, np.zeros((2, len(self._zero))), np.zeros(2), 0.0, contact, Balances()
        )

    def advance(self, state: State) -> State:
        """Return the state one step later. Collective.

        Raises
        ------
        ComputationError : the contact failed; the step and its time are named.
        """
        step = self.case.time.step
        try:
            if self._implicit is not None:
                contact = self._contact(
                    self._initial_gap + state.wear[0] + state.wear[1], self._implicit
                )
                wearing = contact.pressure
                rates = self._rates(wearing)
                wear = state.wear + step * rates
            else:
                wearing = state.contact.pressure
                rates = self._rates(wearing)
                wear = state.wear + step * rates
                contact = self._contact(self._initial_gap + wear[0] + wear[1], None)
        except ComputationError as error:
            number = state.step + 1
            raise ComputationError(f"step {number} (time {number * step:g} s): {error}") from error
        return self._balanced(
            state.step + 1,
            wear,
            state.worn + step * (rates @ self._area),
            state.energy + step * self.case.load.omega * self.torque(wearing),
            contact,
            state.balances,
        )

    def _contact(self, gap: FloatArray, wear: StepWear | None) -> ContactState:
        load = self.case.load
        return self.solver.solve(gap, force=load.force, approach=load.displacement, wear=wear)

    def _rates(self, p: FloatArray) -> FloatArray:
        rates = np.zeros((2, len(p)))
        for rate, law in zip(rates, self.case.laws, strict=True):
            if law is not None:
                rate[:] = law.rate(p, self._power)
        return rates

    def torque(self, p: FloatArray) -> float:
        """Return the friction torque, N mm, at pressure p (MPa)."""
        return self.case.friction * float(self._moment @ p)

    def twist(self, p: FloatArray) -> float:
        """Return the area mean of the circumferential displacement jump, mm, at pressure p."""
        return self.case.friction * float(self.pair.twist @ p)

    def worn_volumes(self, wear: FloatArray) -> FloatArray:
        """Return the volumes lost by lower and upper, (2,) mm^3, from their profiles, (2, n) mm."""
        return wear @ self._area

    def _balanced(
        self,
        step: int,
        wear: FloatArray,
        worn: FloatArray,
        energy: float,
        contact: ContactState,
        before: Balances,
    ) -> State:
        """Return the state with its balances."""
        force, pushed = self.case.load.force, contact.force
        turned, *reactions = (self._sums @ contact.pressure).tolist()
        volumes = self.worn_volumes(wear).tolist()
        total = max(volumes)
        identity = 0.0
        for law, volume in zip(self.case.laws, volumes, strict=True):
            if law is not None and law.proportional and energy > 0.0:
                identity = max(identity, abs(volume / (law.proportional * energy) - 1.0))
        now = Balances(
            abs(pushed / force - 1.0) if force is not None else 0.0,
            max(abs(t / turned - 1.0) for t in reactions[2:]) if turned > 0.0 else 0.0,
            max(abs(f / pushed - 1.0) for f in reactions[:2]) if pushed > 0.0 else 0.0,
            max(map(abs, map(sub, volumes, worn.tolist()))) / total if total > 0.0 else 0.0,
            identity,
            contact.residual,
        )
        return State(step, wear, worn, energy, contact, before.worse(now))


def run(history: WearHistory, state: State, watch: Callable[[State], bool]) -> State:
    """Step from a state to the last step of the case, or until ``watch`` says stop.

    Collective. ``watch`` is called with every new state, the same on all ranks, and must answer
    the same on all ranks.
    """
    while state.step < history.case.time.steps:
        state = history.advance(state)
        if watch(state):
            break
    return state
