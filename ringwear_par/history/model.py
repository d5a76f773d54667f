"""A wear history: contact and wear stepped in time, section 3 of the paper.

``pressure[n]``, ``approach[n]``... are the contact solution with the profile worn up to
``time[n]``, for every scheme. The explicit one, (6) of the paper, lets the pressure at the start
of a step wear throughout it; the implicit one (backward Euler) the pressure at its end, which is
found together with the wear inside the contact problem; the adaptive one (see ``adaptive``) takes
two such stages a step.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from operator import sub

import numpy as np

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import SAME_TIME, Case
from ringwear_par.contact.solver import ContactSolver, ContactState, WarmStart
from ringwear_par.elasticity.pair import BodyCost, ContactCompliance, largest_stable_step
from ringwear_par.elasticity.recovery import BoundaryFields, BoundaryRecovery
from ringwear_par.elasticity.updated import UpdatedGeometry
from ringwear_par.errors import ComputationError, UnfitError
from ringwear_par.history import sdirk2 as adaptive
from ringwear_par.history.pairs import updated_geometry, young
from ringwear_par.history.saving import wants_boundary
from ringwear_par.schedules import Quantity, in_time, integral, largest, mean
from ringwear_par.wear.increment import WearIncrement, averaged_rate, averaging
from ringwear_par.wear.law import LocalState


@dataclass(frozen=True)
class Balances:
    """Relative defects of balances.

    All hold to round-off, but for torque and reaction, which vanish with the mesh.

    Parameters
    ----------
    force : contact pressure against the applied force (0 at given displacement).
    torque : torque on the fixed faces against the friction torque, the worse of both bodies.
    reaction : axial force on the fixed faces against that of the contact pressure, likewise.
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
    time : s.
    wear : (2, n) float, mm, loss of lower and upper.
    worn : (2,) float, mm^3, time integrals of the rates of the worn volumes.
    energy : N mm, dissipated by friction.
    contact : the contact solution.
    balances : the worst so far.
    iterations : of TAO so far.
    next_step : s, what an adaptive history tries next; 0 before its first step.
    rejected : adaptive steps that were repeated with a smaller one, so far.
    shape : (2, n) float, mm, the wear that the elements have followed; None where they do not.
    assemblies : how often they were assembled anew for it, so far.
    stored : whether the case stores this state.
    stored_before : s, time of the last state stored before this one; negative: none.
    boundary : fields on the whole boundaries of lower and upper, where the case stores them.
    """

    step: int
    time: float
    wear: FloatArray
    worn: FloatArray
    energy: float
    contact: ContactState
    balances: Balances
    iterations: int = 0
    next_step: float = 0.0
    rejected: int = 0
    shape: FloatArray | None = None
    assemblies: int = 0
    stored: bool = True
    stored_before: float = -1.0
    boundary: tuple[BoundaryFields, BoundaryFields] | None = None


def _same(time: float, *others: float) -> bool:
    """Tell whether a time is one of others but for round-off."""
    return any(abs(time - other) <= SAME_TIME * time for other in others)


class WearHistory:
    """A case on its contact pair, step by step.

    Parameters
    ----------
    case : the case.
    pair : the compliance of its contact.
    solver : contact solver of the pair; its communicator is that of the collective methods. Where
        ``mesh.geometry`` is "updated" it is given another compliance as wear goes on.
    elasticity : of the moving elements, if the caller has it already.
    boundary : makes the whole-boundary fields that the case asks for; None: there are none.
    """

    def __init__(
        self,
        case: Case,
        pair: ContactCompliance,
        solver: ContactSolver,
        elasticity: UpdatedGeometry | None = None,
        boundary: BoundaryRecovery | None = None,
    ) -> None:
        self.case, self.solver = case, solver
        self._boundary = boundary
        line = pair.line
        self._elasticity = elasticity
        if elasticity is None and case.follows_wear:
            self._elasticity = updated_geometry(case, solver.comm)
        #: the wear that the present elasticity is of
        self.shape = np.zeros((2, line.n))
        #: what following it took so far
        self.following = BodyCost()
        self._r, self._arm, self.area = line.r, line.arm, line.area
        self._moment = self.area * self._arm  # torque per unit shear
        self._laws = case.laws
        self._wears = any(law is not None for law in case.laws)
        self._averages = tuple(
            averaging(line.r, line.area, law.length) if law is not None and law.length else None
            for law in case.laws
        )
        self._take(pair)
        self._zero = np.zeros(line.n)
        self._initial_gap = case.gap_at(line.gap_point)
        self._open_ends = [e for e, cut in zip((0, -1), case.open_ends, strict=True) if cut]
        self._most_wear = np.array([0.5 * (ring.z[1] - ring.z[0]) for ring in case.rings])

    def _take(self, pair: ContactCompliance) -> None:
        self.pair = pair
        # what balances take from the pressure: friction torque / mu, reactions of both bodies
        self._sums = np.vstack([self._moment, pair.force_reaction, pair.torque_reaction])

    def _followed(self, state: State) -> State:
        """Let the elements follow the wear, if it is more than the tolerance. Collective.

        What they follow depends on the state alone, so that a restarted run does the same.
        """
        if self._elasticity is None:
            return state
        shape = state.shape
        if shape is None:
            shape = np.zeros_like(state.wear)
        if np.abs(state.wear - shape).max() <= self.case.mesh.geometry_tolerance:
            self._follow(shape)
            return replace(state, shape=shape)
        self._follow(state.wear)
        # the rates at the start of the next step are to be those of the new elasticity
        contact = self.contact(state.time, state.wear, None)
        return replace(
            state, shape=state.wear, assemblies=state.assemblies + 1, contact=contact,
            iterations=state.iterations + contact.iterations,
        )  # fmt: skip

    def _follow(self, shape: FloatArray) -> None:
        if self._elasticity is None or np.array_equal(shape, self.shape):
            return
        pair = self._elasticity.update(shape)
        self._take(pair.compliance(young(self.case)))
        self.solver.set_compliance(self.pair.matrix)
        self.shape, self.following = shape, self.following + pair.cost

    def resume(self, state: State, warm: WarmStart) -> None:
        """Go on from a stored state as if it had just been computed. Collective."""
        if state.shape is not None:
            self._follow(state.shape)
        self.solver.warm_start(warm)

    def longest_step(self, state: State) -> float:
        """Return the longest step, s, in which wear stays about the tolerance of the geometry."""
        if self._elasticity is None:
            return np.inf
        fastest = self.fastest(state)
        return self.case.mesh.geometry_tolerance / fastest if fastest > 0.0 else np.inf

    def fastest(self, state: State) -> float:
        """Return the largest rate of wear of either body at a state, mm/s."""
        omega = in_time(self.case.load.omega, state.time)
        return float(self.rates(state.time, omega, state.wear, state.contact.pressure).max())

    def finished(self, state: State) -> bool:
        """Tell whether a state is the last one of the case."""
        return self.case.time.finished(state.step, state.time)

    def stable_step(self) -> float:
        """Return the largest stable step of the explicit scheme, s. Collective.

        Unworn, under the largest load and speed, with the steepest of what laws do in time.
        """
        contact = self._pressed(self._initial_gap, largest)
        p = np.full_like(self._zero, contact.pressure.max(initial=0.0))
        slopes = np.zeros_like(p)
        for time in (0.0, *self.case.knots):
            at = self.sliding(time, largest(self.case.load.omega), self._zero)
            every = [law.slope(p, at) for law in self.case.laws if law is not None]
            slopes = np.maximum(slopes, sum(every, self._zero))
        return largest_stable_step(self.pair, slopes)

    def start(self) -> State:
        """Return the contact before any wear. Collective.

        Raises
        ------
        ComputationError : the contact failed.
        UnfitError : the bodies interpenetrate too much.
        """
        try:
            contact = self.contact(0.0, np.zeros((2, len(self._zero))), None)
        except ComputationError as error:
            raise ComputationError(f"step 0 (before any wear): {error}") from error
        self._check_interpenetration()
        wear, worn = np.zeros((2, len(self._zero))), np.zeros(2)
        balances = self._balances(0.0, wear, worn, 0.0, contact)
        return self._with_boundary(State(0, 0.0, wear, worn, 0.0, contact, balances), None)

    def _check_interpenetration(self) -> None:
        """Refuse undeformed bodies that overlap by more than the largest force presses them."""
        overlap = self.case.interpenetration
        if self.case.load.force is None or overlap == 0.0:
            return
        pressed = self._pressed(self._initial_gap, largest)
        if pressed.approach < 0.0:
            e = int(self._initial_gap.argmin())
            raise UnfitError(
                f"upper.z, lower.z and contact faces: the undeformed bodies interpenetrate by "
                f"{overlap:.6g} mm at element {e} (r = {self.pair.line.r[e]:.6g} mm); must be at "
                f"most the {overlap + pressed.approach:.6g} mm that the load presses them together"
            )

    def advance(self, state: State) -> State:
        """Return the state one step later. Collective.

        Raises
        ------
        ComputationError : the contact failed; the step and its time are named.
        """
        try:
            state = self._followed(state)
            if self.case.time.adaptive:
                after = adaptive.advance(self, state)
            else:
                after = self.stepped(state, (state.step + 1) * self.case.time.step)
        except ComputationError as error:
            raise ComputationError(
                f"step {state.step + 1} (from time {state.time:g} s): {error}"
            ) from error
        stored = self.stores(after.step, after.time)
        return self._with_boundary(
            after if after.stored == stored else replace(after, stored=stored), state
        )

    def between(self, state: State, time: float) -> State:
        """Return the state at a time within the step that follows a state. Collective.

        A step of the same formula, so of the same accuracy, that the history does not go on from.
        """
        state = self._followed(state)
        step = adaptive.between if self.case.time.adaptive else WearHistory.stepped
        return self._with_boundary(replace(step(self, state, time), stored=True), state)

    def moments(self, before: State, after: State) -> list[float]:
        """Return the times of output strictly between two states."""
        return [
            t
            for t in self.case.output.times
            if before.time < t < after.time and not _same(t, before.time, after.time)
        ]

    def stores(self, step: int, time: float) -> bool:
        """Tell whether the case stores a state after so many steps, at a time (s)."""
        output = self.case.output
        if step == 0 or self.case.time.finished(step, time):
            return True
        if output.times:
            return any(_same(t, time) for t in output.times)
        return step % output.every == 0

    def _with_boundary(self, state: State, earlier: State | None) -> State:
        """Return a state with the boundary fields that the case wants of it. Collective.

        ``earlier`` is the one that it follows; None at the start.
        """
        if self._boundary is None:
            return state
        output, last = self.case.output, -1.0
        if earlier is not None:
            last = earlier.time if earlier.stored else earlier.stored_before
        before = last
        if output.times:  # those within a step are stored, but not gone on from
            times = (t for t in (0.0, *output.times) if not _same(t, state.time))
            before = max((t for t in times if t < state.time), default=-1.0)
        elif not self.case.time.adaptive and state.step > 0:
            # a shorter run's last state, from which this one may have been restarted, is forgotten
            before = (state.step - 1) // output.every * output.every * self.case.time.step
        fields = None
        if state.stored and wants_boundary(self.case, state.time, self.finished(state), before):
            fields = self._boundary.fields(
                state.contact.pressure, state.contact.approach, self.case.friction, state.wear,
                state.shape,
            )  # fmt: skip
        return replace(state, stored_before=last, boundary=fields)

    # -- what schemes are made of ------------------------------------------------------------------

    def sliding(self, time: float, omega: float, wear: FloatArray) -> LocalState:
        """Return what wear laws may know of a body at a time, its wear being (n,) mm."""
        angle, arm = integral(self.case.load.omega, 0.0, time), self._arm
        return LocalState(time, self._r, omega * arm, self.case.friction, wear, angle * arm)

    def step_wear(self, time: float, omega: float, wear: FloatArray, step: float) -> WearIncrement:
        """Return the wear of an implicit step that ends at a time, from wear (2, n) mm on."""
        lower = self.sliding(time, omega, wear[0])
        upper = self.sliding(time, omega, wear[1]) if self.case.wear_upper is not None else lower
        return WearIncrement(self._laws, (lower, upper), step, self._averages)

    def rates(self, time: float, omega: float, wear: FloatArray, p: FloatArray) -> FloatArray:
        """Return the rates of wear of lower and upper, (2, n) mm/s, at pressure p and wear."""
        rates = np.zeros((2, len(p)))
        bodies = zip(rates, self.case.laws, wear, self._averages, strict=True)
        for rate, law, worn, average in bodies:
            if law is not None:
                rate[:] = averaged_rate(law, self.sliding(time, omega, worn), average, p)
        return rates

    def contact(self, time: float, wear: FloatArray, during: WearIncrement | None) -> ContactState:
        """Return the contact at a time, with profiles worn by (2, n) mm. Collective."""
        gap = self._initial_gap + wear[0] + wear[1]
        return self._pressed(gap, lambda q: in_time(q, time), during if self._wears else None)

    def _pressed(
        self, gap: FloatArray, at: Callable[[Quantity], float], during: WearIncrement | None = None
    ) -> ContactState:
        """Return the contact under the load of the case, its table taken ``at``. Collective."""
        force, displacement = self.case.load.force, self.case.load.displacement
        return self.solver.solve(
            gap,
            force=None if force is None else at(force),
            approach=None if displacement is None else at(displacement),
            wear=during,
        )

    def stepped(self, state: State, time: float) -> State:
        """Return the state after one implicit or explicit step to a time. Collective."""
        step = time - state.time
        omega = mean(self.case.load.omega, state.time, time)
        if self.case.time.scheme == "implicit":
            during = self.step_wear(time, omega, state.wear, step)
            contact = self.contact(time, state.wear, during)
            p = contact.pressure
            depths = during.depths(p)
            volumes = during.volumes(depths, p, self.area)
        else:
            p = state.contact.pressure
            depths = step * self.rates(state.time, omega, state.wear, p)
            contact = self.contact(time, state.wear + depths, None)
            volumes = depths @ self.area
        return self.after(state, time, depths, volumes, step * omega * self.torque(p), contact)

    def after(
        self,
        state: State,
        time: float,
        depths: FloatArray,
        volumes: FloatArray,
        energy: float,
        contact: ContactState,
    ) -> State:
        """Return the state after a step.

        Parameters
        ----------
        depths : (2, n) float, mm, worn off in it.
        volumes : (2,) float, mm^3, integrals of the rates of the worn volumes over it.
        energy : N mm, dissipated in it.

        Raises
        ------
        ComputationError : contact has reached an end of the contact line that is no edge, or half
            of a body has been worn off.
        """
        wear, worn = state.wear + depths, state.worn + volumes
        if wear.max() > self._most_wear.min() and (wear.max(axis=1) > self._most_wear).any():
            deepest = wear.max(axis=1)
            body = "lower" if deepest[0] > self._most_wear[0] else "upper"
            raise ComputationError(
                f"time {time:g} s: {deepest.max():.4g} mm are worn off {body}, more than half of "
                "its height"
            )
        energy = state.energy + energy
        now = self._balances(time, wear, worn, energy, contact)
        return State(
            state.step + 1, time, wear, worn, energy, contact, state.balances.worse(now),
            state.iterations + contact.iterations, state.next_step, state.rejected, state.shape,
            state.assemblies, state.stored,
        )  # fmt: skip

    def torque(self, p: FloatArray) -> float:
        """Return the friction torque in full slip, N mm, at pressure p (MPa)."""
        return self.case.friction * float(self._moment @ p)

    def twist(self, p: FloatArray) -> float:
        """Return the area mean of the circumferential displacement jump, mm, at pressure p."""
        return self.case.friction * float(self.pair.twist @ p)

    def worn_volumes(self, wear: FloatArray) -> FloatArray:
        """Return the volumes lost by lower and upper, (2,) mm^3, from their profiles, (2, n) mm."""
        return wear @ self.area

    def _balances(
        self, time: float, wear: FloatArray, worn: FloatArray, energy: float, contact: ContactState
    ) -> Balances:
        """Return the balances at a time, of what a state holds.

        Raises
        ------
        ComputationError : contact has reached an end of the contact line that is no edge.
        """
        for e in self._open_ends:
            if contact.pressure[e] > 0.0:
                raise ComputationError(
                    f"time {time:g} s: contact has reached the end of mesh.contact at "
                    f"r = {self.pair.line.edges[e]:g} mm; must be wider there"
                )
        given, pushed = self.case.load.force, contact.force
        force = in_time(given, time) if given is not None else 0.0
        turned, *reactions = (self._sums @ contact.pressure).tolist()
        volumes = self.worn_volumes(wear).tolist()
        total = max(volumes)
        identity = 0.0
        for law, volume in zip(self.case.laws, volumes, strict=True):
            ratio = law.per_energy(self.case.friction) if law is not None else None
            if ratio and energy > 0.0:
                identity = max(identity, abs(volume / (ratio * energy) - 1.0))
        return Balances(
            abs(pushed / force - 1.0) if force > 0.0 else 0.0,
            max(abs(t / turned - 1.0) for t in reactions[2:]) if turned > 0.0 else 0.0,
            max(abs(f / pushed - 1.0) for f in reactions[:2]) if pushed > 0.0 else 0.0,
            max(map(abs, map(sub, volumes, worn.tolist()))) / total if total > 0.0 else 0.0,
            identity,
            contact.residual,
        )


def run(
    history: WearHistory,
    state: State,
    watch: Callable[[State], bool],
    show: Callable[[State], None] | None = None,
) -> State:
    """Step from a state to the end of the case, or until ``watch`` says stop.

    Collective. ``watch`` is called with every new state, the same on all ranks, and must answer
    the same on all ranks; before it ``show`` is called with the states at times of output within
    the step.
    """
    while not history.finished(state):
        before, state = state, history.advance(state)
        for time in history.moments(before, state):
            passing = history.between(before, time)
            if show is not None:
                show(passing)
        if watch(state):
            break
    return state
