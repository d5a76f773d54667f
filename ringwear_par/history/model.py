"""The physics of one contact pair: contact (3), rates of wear (4) and what a step wears off.

Nothing here knows of schemes, step control, files or observers: they ask for contact solutions,
rates and increments.

One history or B histories on the same pair: fields are (..., n), numbers of a history float or
(B,); what differs between histories (load, laws, friction, moduli, time) is an array over the first
axis.
"""

import copy
import itertools
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import BoolArray, FloatArray, IntArray, Numbers, columns, inner, rows_of
from ringwear_par.cases.case import Case
from ringwear_par.contact.correction import CorrectedBatch, CorrectedContact
from ringwear_par.contact.problem import ContactState, WarmStart
from ringwear_par.contact.solver import ContactSolver
from ringwear_par.elasticity.pair import (
    BodyCost,
    ContactCompliance,
    ContactPair,
)
from ringwear_par.elasticity.updated import UpdatedGeometry
from ringwear_par.errors import ComputationError, HistoriesError, UnfitError
from ringwear_par.history.bodies import young
from ringwear_par.history.pairs import assemble, updated_geometry
from ringwear_par.history.sensitivity import Sensitivity
from ringwear_par.history.stability import pressed
from ringwear_par.history.state import Start, State
from ringwear_par.history.tangent import Along
from ringwear_par.schedules import Quantity, in_time, integral, largest, stack, take
from ringwear_par.wear.increment import Closing, WearIncrement, averaged_rate, averaging
from ringwear_par.wear.law import LocalState, stack_laws
from ringwear_par.wear.layered import LayeredLaw, worn_through
from ringwear_par.wear.layered_increment import LayeredIncrement

if TYPE_CHECKING:
    from ringwear_par.contact.batch import BatchSolver
    from ringwear_par.history.entering import Entering


class WearModel:
    """Contact and wear of one case, or of B cases that share a pair. A context manager.

    Parameters
    ----------
    cases : a case, or several of one shape and mesh, with laws of the same kinds.
    comm : communicator of the collective methods.
    pair : contact pair of the cases; None: it is assembled here.
    solver : of the pair with the case's moduli, to be used again from cold; None: made here.
    known : compliances of several cases by their moduli, as far as they are known.
    derivatives : keys that states are to have derivatives with respect to, see ``sensitivity``.
    """

    def __init__(
        self,
        cases: Case | Sequence[Case],
        comm: MPI.Comm,
        pair: ContactPair | None = None,
        solver: ContactSolver | None = None,
        known: Mapping[tuple[float, float], ContactCompliance] = MappingProxyType({}),
        derivatives: Sequence[str] = (),
    ) -> None:
        self.cases = (cases,) if isinstance(cases, Case) else tuple(cases)
        self.case, self.comm = self.cases[0], comm
        case, several = self.case, not isinstance(cases, Case)
        given = pair is not None
        self._geometry: UpdatedGeometry | None = None
        if case.follows_wear:
            self._geometry = updated_geometry(case, comm)
            if pair is None:
                pair = self._geometry.update(np.zeros((2, case.line.n)))
        #: the pair as it was before any wear; whether it was assembled elsewhere
        self.pair, self.given_pair = assemble(case, comm) if pair is None else pair, given
        #: what following the wear took so far, and how often it was done
        self.following, self.updates = BodyCost(), 0
        self.line = line = self.pair.line
        self._r, self._arm, self.area = line.r, line.arm, line.area
        self._open_ends = [e for e, cut in zip((0, -1), case.open_ends, strict=True) if cut]
        self._most_wear = np.array([0.5 * (ring.z[1] - ring.z[0]) for ring in case.rings])
        load = case.load
        if several:
            if any(c.follows_wear for c in self.cases):
                raise ValueError("histories with updated geometry cannot be stacked")
            self.initial_gap = _initial_gaps(self.cases)
            loads = [c.load for c in self.cases]
            self.friction: Numbers = np.array([c.friction for c in self.cases])
            self._tolerance: Numbers = np.array([c.time.tolerance for c in self.cases])
            self.omega = stack([each.omega for each in loads])
            self.force = _stacked_loads([each.force for each in loads])
            self.displacement = _stacked_loads([each.displacement for each in loads])
            self.laws = tuple(stack_laws([c.laws[i] for c in self.cases]) for i in (0, 1))
            #: of fields: (n,), or (B, n)
            self.shape: tuple[int, ...] = (len(self.cases), line.n)
        else:
            self.initial_gap = case.initial_gap
            self.friction, self.omega = case.friction, load.omega
            self._tolerance = case.time.tolerance
            self.force, self.displacement = load.force, load.displacement
            self.laws, self.shape = case.laws, (line.n,)
        #: worn volume of lower and upper per dissipated energy, 1/MPa, None where it is not fixed;
        #: of bodies with layers those of all of them and of the body itself, 0 where not fixed
        self.per_energy = tuple(
            None
            if law is None
            else law.layer_ratios(self.friction)
            if isinstance(law, LayeredLaw)
            else law.per_energy(self.friction)
            for law in self.laws
        )
        #: (layers, n) mm, along the axis, depths at which the layers of lower and upper end
        self.layer_ends = tuple(
            case.layer_ends(i) if ring.layers else None for i, ring in enumerate(case.rings)
        )
        #: whether wear goes through layers
        self.layered = any(isinstance(law, LayeredLaw) for law in self.laws)
        #: whether the speed never changes, so that it is its own mean
        self.steady_speed = isinstance(self.omega, float)
        #: whether the rates at the end of an increment are those of the instant: speed and wear
        #: before the increment make no difference
        self.rates_last = self.steady_speed and not any(
            law is not None and law.reads_wear for law in self.laws
        )
        self._wears = any(law is not None for law in self.laws)
        #: whether the wear of each element depends on its own pressure alone
        self.wears_locally = self._wears and not any(
            law is not None and law.length for law in self.laws
        )
        #: what elements are nearer than their profiles say
        self._fit: FloatArray | None = None
        #: the wear that the present elasticity is of
        self._followed = np.zeros((2, *self.shape))
        #: what the numbers act on that there are to be derivatives with respect to, if any
        self.sensitivity: Sensitivity | None = None
        if derivatives:
            self.sensitivity = Sensitivity(derivatives, self.cases, self.pair, several)
        self._lent = solver is not None
        self._warm: WarmStart | None = None  # once the history has ended
        if several:
            self._take_moduli(known)
            return
        if solver is not None:
            solver.cold_start()
        else:
            solver = ContactSolver(self.pair.compliance(young(case)).matrix, self.area, comm)
        #: the contact of a single history, or those of B
        self.contacts: CorrectedContact | CorrectedBatch = CorrectedContact(solver, self.area)
        self._take(self.pair)

    def __enter__(self) -> "WearModel":
        return self

    def __exit__(self, failure: type[BaseException] | None, *_: object) -> None:
        if isinstance(self.contacts, CorrectedBatch):
            self.contacts.solver.destroy()
            return
        if failure is not None:  # where a failed solution ended is no place to start
            self.solver.cold_start()
        self._warm = self.solver.warm()
        if not self._lent:
            self.solver.destroy()

    @property
    def solver(self) -> ContactSolver:
        """The contact solver of a single history."""
        assert isinstance(self.contacts, CorrectedContact)
        return self.contacts.solver

    @property
    def batch(self) -> CorrectedBatch:
        """The contacts of B histories."""
        assert isinstance(self.contacts, CorrectedBatch)
        return self.contacts

    def _take(self, pair: ContactPair) -> None:
        assert isinstance(self.contacts, CorrectedContact)
        self._take_compliance(pair)
        self.contacts.take(self.compliance.matrix, self.compliance.excess)
        self._own_compliance, self.twist_weights = (
            self._yielding(self.compliance),
            self.compliance.twist,
        )
        self._softness: Numbers = self._sum_of(self.compliance)

    def _take_moduli(self, known: Mapping[tuple[float, float], ContactCompliance]) -> None:
        """Take the moduli of B histories: a compliance each, those of the same moduli one."""
        from ringwear_par.contact.batch import BatchSolver  # compiled, and slow to import

        moduli = [young(case) for case in self.cases]
        places = {each: place for place, each in enumerate(dict.fromkeys(moduli))}
        #: (B,) the compliance of each history
        self._which = which = np.array([places[each] for each in moduli])
        every = [known.get(each) or self.pair.compliance(each) for each in places]
        self._take_compliance(self.pair)
        matrices = np.array([each.matrix for each in every])
        stiffness = self.area / np.diagonal(matrices, axis1=1, axis2=2)
        excess = np.array([each.excess for each in every])
        solver = BatchSolver(matrices, which, self.area)
        self.contacts = CorrectedBatch(solver, excess, which, stiffness)
        self._own_compliance = np.array([self._yielding(each) for each in every])[which]
        self._softness = np.array([self._sum_of(each) for each in every])[which]
        self.twist_weights = np.array([each.twist for each in every])[which]
        self._compliances = every
        #: (B,) of the compliance of each history
        self.symmetry_defects = np.array([each.symmetry_defect for each in every])[which]

    def _yielding(self, compliance: ContactCompliance) -> FloatArray:
        return np.diagonal(compliance.matrix) / self.area

    def _sum_of(self, compliance: ContactCompliance) -> float:
        return float(self.area.sum() / compliance.matrix.sum())

    def compliance_of(self, i: int) -> ContactCompliance:
        """Return the compliance of one of B histories."""
        return self._compliances[self._which[i]]

    def gap(self, wear: FloatArray, histories: IntArray) -> FloatArray:
        """Return (h, n) mm, the gaps of some of B histories worn by (2, h, n) mm."""
        return self.initial_gap[histories] + wear[0] + wear[1]

    def approach_rates(self, histories: IntArray) -> FloatArray:
        """Return what the approach does to pressures of some of B histories, (h, n) MPa/mm.

        Where nothing touches, what it would do if all did, from which a search may start.
        """
        rates = self.batch.solver.rates[histories]
        return np.where(rates.any(axis=1, keepdims=True), rates, columns(self._softness[histories]))

    def take(self, histories: IntArray) -> "WearModel":
        """Return the model of some of B histories; its contacts start where these would."""
        taken = copy.copy(self)
        taken.cases = tuple(self.cases[i] for i in histories.tolist())
        taken.case, taken.shape = taken.cases[0], (len(histories), self.line.n)
        taken._followed = np.zeros((2, *taken.shape))
        taken.contacts = self.batch.take(histories)
        for name in (
            "friction", "initial_gap", "_own_compliance", "_softness", "twist_weights",
            "symmetry_defects", "_tolerance", "_which",
        ):  # fmt: skip
            setattr(taken, name, getattr(self, name)[histories])
        for name in ("omega", "force", "displacement"):
            setattr(taken, name, take(getattr(self, name), histories))
        taken.laws = tuple(None if law is None else law.take(histories) for law in self.laws)
        taken.per_energy = tuple(
            [rows_of(ratio, histories) for ratio in each]
            if isinstance(each, list)
            else rows_of(each, histories)
            for each in self.per_energy
        )
        if self.sensitivity is not None:
            taken.sensitivity = self.sensitivity.take(histories)
        return taken

    def joined(self, other: "WearModel") -> "WearModel":
        """Return the model of the histories of both; its contacts start where theirs would."""
        known = {
            young(model.cases[i]): model.compliance_of(i)
            for model in (self, other)
            for i in range(len(model.cases))
        }
        keys = () if self.sensitivity is None else self.sensitivity.keys
        model = WearModel(
            (*self.cases, *other.cases), self.comm, self.pair, known=known, derivatives=keys
        )
        model.batch.go_on(self.batch, other.batch)
        return model

    def _take_compliance(self, pair: ContactPair) -> None:
        self.compliance = pair.compliance(young(self.case))
        true_area = self.area * self.compliance.obliquity
        #: 1 / cos alpha of sloping faces, None where all are flat
        self._obliquity = self.compliance.obliquity if pair.slope.any() else None
        if self.layered:
            self.laws = tuple(
                law.at(self._along_normal(self.layer_ends[i]))
                if isinstance(law, LayeredLaw)
                else law
                for i, law in enumerate(self.laws)
            )
        self._averages = tuple(
            averaging(self._r, true_area, law.length) if law is not None and law.length else None
            for law in self.laws
        )
        self._moment = true_area * self._arm  # torque per unit shear
        # what balances take from the pressure: friction torque / mu, reactions of both bodies
        self._carried = np.vstack(
            [self._moment, self.compliance.force_reaction, self.compliance.torque_reaction]
        )

    def _along_normal(self, axial: Any) -> FloatArray:
        """Return depths along the normal, as laws are told them, from those along the axis."""
        return axial if self._obliquity is None else axial / self._obliquity

    def layer_left(self, body: int, wear: FloatArray) -> FloatArray:
        """Return what is left of all layers of a body, (..., n) mm, worn by (..., n) mm."""
        ends = self.layer_ends[body]
        assert ends is not None
        return np.where(worn_through(ends[-1], wear), 0.0, ends[-1] - wear)

    def layer_volumes(self, body: int, wear: FloatArray) -> FloatArray:
        """Return what is worn off each layer and the body itself, (..., layers + 1) mm3."""
        ends = self.layer_ends[body]
        assert ends is not None
        bounds = [np.zeros(self.line.n), *ends, np.full(self.line.n, np.inf)]
        parts: list[Any] = [
            inner(self.area, np.clip(wear, start, end) - start)
            for start, end in itertools.pairwise(bounds)
        ]
        return np.stack(parts, axis=-1)

    # -- start and going on ------------------------------------------------------------------------

    def initial(self) -> State:
        """Return the contact before any wear. Collective.

        Raises
        ------
        ComputationError : the contact failed.
        UnfitError : the bodies interpenetrate by more than the load presses them together.
        """
        wear = np.zeros((2, *self.shape))
        nothing: Numbers = 0.0 if wear.ndim == 2 else np.zeros(len(self.cases))
        along = None if self.sensitivity is None else Along(self, None)
        try:
            contact = self.contact(nothing, wear, np.zeros(self.shape), exact=True, along=along)
        except HistoriesError:
            raise
        except ComputationError as error:
            raise ComputationError(f"{error}; in step 0, before any wear") from error
        self._check_interpenetration()
        rates = self.rates_at(nothing, wear, contact.pressure)
        worn = np.zeros(wear.shape[:-1])
        tangent = None if along is None else along.reached(contact)
        through = np.full(worn.shape, np.inf) if self.layered else None
        return self.checked(
            State(nothing, wear, worn, nothing, contact, rates, tangent=tangent, through=through)
        )

    def _check_interpenetration(self) -> None:
        """Refuse undeformed bodies that overlap by more than the largest force presses them."""
        if isinstance(self.contacts, CorrectedBatch):
            return self._check_interpenetrations(self.contacts.solver)
        case, overlap = self.case, self.case.interpenetration
        if case.load.force is None or overlap == 0.0:
            return None
        found = pressed(self.solver, case)
        if found.approach < 0.0:
            e = int(case.initial_gap.argmin())
            raise UnfitError(
                f"upper.z, lower.z and contact faces: the undeformed bodies interpenetrate by "
                f"{overlap:.6g} mm at element {e} (r = {self._r[e]:.6g} mm); must be at most "
                f"the {overlap + found.approach:.6g} mm that the load presses them together"
            )
        return None

    def _check_interpenetrations(self, solver: "BatchSolver") -> None:
        if self.force is None or not (self.initial_gap < 0.0).any():
            return
        known: dict[Hashable, float] = {}
        for case in self.cases:
            if (key := _geometry(case)) not in known:
                known[key] = case.interpenetration
        overlapping = np.flatnonzero([known[_geometry(case)] > 0.0 for case in self.cases])
        forces = np.array([largest(case.load.force or 0.0) for case in self.cases])
        found = solver.solve(self.initial_gap, force=forces, histories=overlapping)
        if (apart := found.approach[overlapping] < 0.0).any():
            which = np.zeros(len(self.cases), dtype=bool)
            which[overlapping[apart]] = True
            raise HistoriesError(which)

    def resume(self, start: Start) -> State:
        """Go on from a stored state as if it had just been computed. Collective."""
        if start.state.shape is not None:
            self._follow(start.state.shape)
        self._fit = start.state.fit
        self.updates = start.updates
        self.solver.warm_start(start.warm)
        return start.state

    def warm(self) -> WarmStart:
        """Return where the next contact solution starts, after the end too. Collective."""
        return self.solver.warm() if self._warm is None else self._warm

    # -- elements that follow the wear -------------------------------------------------------------

    def update_geometry(self, state: State) -> State:
        """Let the elements follow the wear, if it is more than the tolerance. Collective.

        What they follow depends on the state alone, so that a restarted history does the same.
        """
        if self._geometry is None:
            return state
        shape = state.shape
        if shape is None:
            shape = np.zeros_like(state.wear)
        if np.abs(state.wear - shape).max() <= self.case.mesh.geometry_tolerance:
            self._follow(shape)
            return replace(state, shape=shape)
        before = self.compliance
        self._follow(state.wear)
        self.updates += 1
        # faces that wear has made to slope alike touch as they are displaced: what the turned slope
        # makes of displacements that there are already is no gap
        turned = self.compliance.slope != before.slope
        gained = (self.compliance.collocated - before.collocated) @ state.contact.pressure
        fit = np.where(turned, gained, 0.0) + (0.0 if state.fit is None else state.fit)
        self._fit = fit
        # the rates at the start of the next step are to be those of the new elasticity
        contact = self.contact(state.time, state.wear, state.contact.pressure, exact=True)
        rates = self.rates_at(state.time, state.wear, contact.pressure)
        return replace(state, shape=state.wear, fit=fit, contact=contact, rates=rates)

    def _follow(self, shape: FloatArray) -> None:
        if self._geometry is None or np.array_equal(shape, self._followed):
            return
        pair = self._geometry.update(shape)
        try:
            self._take(pair)
        except ComputationError as error:
            raise ComputationError(self._slivers(shape) or str(error)) from error
        self.solver.set_compliance(self.compliance.matrix)
        self._followed, self.following = shape, self.following + pair.cost

    def _slivers(self, shape: FloatArray) -> str:
        """Return where a worn face stands out by more than elements are wide; "" for nowhere."""
        line, rises = self.line, np.abs(np.diff(shape, axis=-1))
        steep = rises / np.minimum(line.width[1:], line.width[:-1])
        body, e = np.unravel_index(steep.argmax(), steep.shape)
        if steep[body, e] <= 1.0:
            return ""
        less, more = sorted((e, e + 1), key=lambda place: shape[body, place])
        return (
            f"elements that follow the wear: {('lower', 'upper')[body]} is worn by "
            f"{shape[body, more]:.4g} mm at r = {self._r[more]:.6g} mm and by "
            f"{shape[body, less]:.4g} mm at r = {self._r[less]:.6g} mm beside it; what stands out "
            f"by {steep[body, e]:.2g} times the width of an element is no face that can be computed"
            ': mesh.geometry = "fixed", or laws of wear that differ less, must be used'
        )

    # -- contact, eq. (3) --------------------------------------------------------------------------

    def contact(
        self,
        time: Numbers,
        wear: FloatArray,
        near: FloatArray,
        during: WearIncrement | None = None,
        found: tuple[BoolArray, ContactState] | None = None,
        exact: bool = False,
        along: Along | None = None,
    ) -> ContactState:
        """Return the contact at a time, under the loads of that time. Collective.

        Parameters
        ----------
        time : float or (B,), s.
        wear : (2, ..., n) float, mm, by which the profiles are worn.
        near : (..., n) float, MPa, pressures near the solution, see ``contact.correction``.
        during : wear of an implicit step, which is part of the contact problem.
        found : which of B histories have their solution already, and it.
        exact : whether no other pressures are near, see ``contact.correction``.
        along : derivatives along the step that this contact is of.

        Raises
        ------
        ComputationError : the contact was not found.
        """
        gap = self.initial_gap + wear[0] + wear[1]
        if self._fit is not None:
            gap = gap - self._fit
        force: Numbers = None if self.force is None else in_time(self.force, time)
        approach: Numbers = None
        if self.displacement is not None:
            approach = in_time(self.displacement, time)
        if not self._wears:
            during = None
        how: Any = {"force": force, "approach": approach, "wear": during, "exact": exact}
        if found is not None:
            how["found"] = found
        if along is not None:
            along.pose(during)
            how["along"] = along
        return self.contacts.solve(gap, near, **how)

    def along(self, state: State, enter: "Entering | None" = None) -> Along | None:
        """Return what derivatives are told along a step from a state; None where there are none."""
        return None if self.sensitivity is None else Along(self, state.tangent, enter)

    @property
    def asymmetry(self) -> tuple[Numbers, Any]:
        """What making the compliance symmetric has left of errors of pressure: worst, element.

        Of all contacts so far, see ``contact.correction``; floats or (B,).
        """
        return self.contacts.worst

    def pressure_response(self, gap: FloatArray) -> FloatArray:
        """Return what a small growth (..., n) mm of the gap does to the last pressures, MPa."""
        return self.contacts.response(gap, self.force is not None)

    @property
    def slight_pressure(self) -> Numbers:
        """About what an approach as small as ``time.tolerance`` presses, MPa, float or (B,)."""
        return self._tolerance * self._softness

    def yielding(self, p: FloatArray) -> FloatArray:
        """Return what each element yields, (..., n) mm, to its own pressure alone, MPa."""
        return self._own_compliance * p

    # -- wear, eq. (4) -----------------------------------------------------------------------------

    def local_state(self, time: Numbers, omega: Numbers, wear: FloatArray) -> LocalState:
        """Return what laws may know of a body, its wear being (..., n) mm, at speed omega.

        Laws are told of depths along the normal; everything else here is along the axis.
        """
        angle, arm = integral(self.omega, 0.0, time), self._arm
        if self._obliquity is not None:
            wear = wear / self._obliquity
        return LocalState(
            time, self._r, columns(omega) * arm, self.friction, wear, columns(angle) * arm
        )

    def increment(
        self,
        time: Numbers,
        omega: Numbers,
        wear: FloatArray,
        step: Numbers,
        closing: Closing | None = None,
    ) -> WearIncrement:
        """Return the wear of an implicit step that ends at a time, from wear (2, ..., n) mm on.

        ``closing`` is of elements that come into contact in it.
        """
        lower = self.local_state(time, omega, wear[0])
        upper = self.local_state(time, omega, wear[1]) if self.laws[1] is not None else lower
        kind = LayeredIncrement if self.layered else WearIncrement
        return kind(self.laws, (lower, upper), step, self._averages, self._obliquity, closing)

    def rates(self, time: Numbers, omega: Numbers, wear: FloatArray, p: FloatArray) -> FloatArray:
        """Return the rates of wear of lower and upper, (2, ..., n) mm/s, at pressure and wear."""
        rates = np.zeros((2, *p.shape))
        bodies = zip(rates, self.laws, wear, self._averages, strict=True)
        for rate, law, worn, average in bodies:
            if law is not None:
                rate[:] = averaged_rate(law, self.local_state(time, omega, worn), average, p)
        if self._obliquity is not None:
            rates *= self._obliquity
        return rates

    def rates_at(self, time: Numbers, wear: FloatArray, p: FloatArray) -> FloatArray:
        """Return the rates of wear at an instant, (2, ..., n) mm/s, at the speed of that time."""
        return self.rates(time, in_time(self.omega, time), wear, p)

    def integrals(self, field: FloatArray) -> FloatArray:
        """Return area integrals of a field of both bodies, (2, ..., n) to (2, ...)."""
        return field @ self.area if len(self.shape) == 1 else inner(self.area, field)

    def _sums(self, weights: FloatArray, values: FloatArray) -> Numbers:
        """Return sums over the elements, (...): of one history by BLAS, which is quicker."""
        if len(self.shape) == 1 and values.ndim > 1:
            return values @ weights
        return inner(weights, values)

    def moment(self, p: FloatArray) -> Numbers:
        """Return the friction torque over mu in full slip, N mm, float or (B,), at (..., n)."""
        return self._sums(self._moment, p)

    def torque(self, p: FloatArray) -> Numbers:
        """Return the friction torque in full slip, N mm, float or (B,), at pressure (..., n)."""
        return self.friction * self.moment(p)

    def twist(self, p: FloatArray) -> Numbers:
        """Return the area mean of the circumferential displacement jump, mm, at pressure."""
        return self.friction * self._sums(self.twist_weights, p)

    def reactions(self, p: FloatArray) -> FloatArray:
        """Return friction torque / mu, axial force and torque / mu on both fixed faces, (5, ...).

        At pressure (..., n); N mm and N.
        """
        if p.ndim == 1:
            return self._carried @ p
        return np.array([inner(weights, p) for weights in self._carried])

    # -- what a state must not be ------------------------------------------------------------------

    def checked(self, state: State) -> State:
        """Return a state if the model holds for it.

        Raises
        ------
        ComputationError : contact has reached an end of the contact line that is no edge, or half
            of a body has been worn off.
        """
        if state.wear.ndim > 2:
            return self._all_checked(state)
        for e in self._open_ends:
            if state.contact.pressure[e] > 0.0:
                raise ComputationError(
                    f"time {state.time:g} s: contact has reached the end of mesh.contact "
                    f"at r = {self.line.edges[e]:g} mm; must be wider there"
                )
        most = self._most_wear
        if state.wear.max() > most.min():
            deepest = state.wear.max(axis=1)
            if (deepest > most).any():
                body = "lower" if deepest[0] > most[0] else "upper"
                raise ComputationError(
                    f"time {state.time:g} s: {deepest.max():.4g} mm are worn off {body}, "
                    "more than half of its height"
                )
        return state

    def _all_checked(self, state: State) -> State:
        most = self._most_wear
        off = np.zeros(len(self.cases), dtype=bool)
        if state.wear.max() > most.min():
            off |= (state.wear.max(axis=2) > most[:, None]).any(axis=0)
        for e in self._open_ends:
            off |= state.contact.pressure[:, e] > 0.0
        if off.any():
            raise HistoriesError(off)
        return state


def _geometry(case: Case) -> Hashable:
    """Return what the gap between the unworn faces depends on, among cases of one pair."""
    return (*((ring.r, ring.z, ring.face) for ring in case.rings), case.mesh.contact)


def _initial_gaps(cases: Sequence[Case]) -> FloatArray:
    """Return (B, n) mm, the initial gaps: worked out once for cases that look the same."""
    known: dict[Hashable, FloatArray] = {}
    for case in cases:
        if (key := _geometry(case)) not in known:
            known[key] = case.initial_gap
    return np.array([known[_geometry(case)] for case in cases])


def _stacked_loads(loads: Sequence[Quantity | None]) -> Quantity | None:
    """Return the loads of B histories as one, None where none of them has this kind of load."""
    given = [load for load in loads if load is not None]
    if given and len(given) < len(loads):
        raise ValueError("histories under a force and at a displacement cannot be stacked")
    return stack(given) if given else None
