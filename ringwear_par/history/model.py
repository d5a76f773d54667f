"""The physics of one contact pair: contact (3), rates of wear (4) and what a step wears off.

Nothing here knows of schemes, step control, files or observers: they ask for contact solutions,
rates and increments.

One history or B histories on the same pair: fields are (..., n), numbers of a history float or
(B,). What differs between histories is an array over the first axis: see ``given`` for loads, laws
and gaps, ``compliances`` for moduli. Elements that follow the wear are the matter of ``following``,
states that the model does not hold for that of ``admissible``.
"""

import copy
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import BoolArray, FloatArray, IntArray, Numbers, columns, inner
from ringwear_par.cases.case import Case
from ringwear_par.contact.correction import CorrectedBatch, CorrectedContact
from ringwear_par.contact.problem import ContactState, WarmStart
from ringwear_par.contact.solver import ContactSolver
from ringwear_par.elasticity.pair import ContactCompliance, ContactPair
from ringwear_par.errors import ComputationError, HistoriesError
from ringwear_par.history.admissible import check_interpenetration, checked
from ringwear_par.history.bodies import young
from ringwear_par.history.compliances import Compliances
from ringwear_par.history.following import Following
from ringwear_par.history.given import Given
from ringwear_par.history.pairs import assemble
from ringwear_par.history.sensitivity import Sensitivity
from ringwear_par.history.state import Start, State
from ringwear_par.history.tangent import Along
from ringwear_par.schedules import in_time, integral
from ringwear_par.wear.increment import Closing, WearIncrement, averaged_rate, averaging
from ringwear_par.wear.law import LocalState
from ringwear_par.wear.layered_increment import LayeredIncrement

if TYPE_CHECKING:
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
        #: loads, laws and gaps of the cases
        self.given, self.comm = Given.of(cases), comm
        case = self.case
        #: elasticity that follows the wear; None where elements stay
        self.following = Following(case, comm) if case.follows_wear else None
        #: whether the pair was assembled elsewhere
        self.lent_pair = pair is not None
        if pair is None:
            pair = assemble(case, comm) if self.following is None else self.following.unworn()
        #: the pair as it was before any wear
        self.pair, self.line = pair, pair.line
        self._r, self._arm, self.area = pair.line.r, pair.line.arm, pair.line.area
        #: (layers, n) mm, along the axis, depths at which the layers of lower and upper end
        self.layer_ends = tuple(
            case.layer_ends(i) if ring.layers else None for i, ring in enumerate(case.rings)
        )
        #: (n,) mm, what elements are nearer than their profiles say, see ``State``
        self.fit: FloatArray | None = None
        #: what the numbers act on that there are to be derivatives with respect to, if any
        self.sensitivity: Sensitivity | None = None
        if derivatives:
            self.sensitivity = Sensitivity(derivatives, self.given.cases, pair, self.given.several)
        self._lent = solver is not None
        self._warm: WarmStart | None = None  # once the history has ended
        #: the contact of a single history, or those of B
        self.contacts: CorrectedContact | CorrectedBatch
        if self.given.several:
            moduli = [young(each) for each in self.given.cases]
            self._adopt(Compliances.of_many(moduli, pair, known))
            self.contacts = self.compliances.contacts()
            return
        self._adopt(Compliances.of_one(pair.compliance(young(case))))
        if solver is not None:
            solver.cold_start()
        else:
            solver = ContactSolver(self.compliance.matrix, self.area, comm)
        self.contacts = CorrectedContact(solver, self.area)
        self.contacts.take(self.compliance.matrix, self.compliance.excess)

    def __enter__(self) -> "WearModel":
        return self

    def __exit__(self, failure: type[BaseException] | None, *_: object) -> None:
        if isinstance(self.contacts, CorrectedBatch):
            self.contacts.solver.destroy()
            return
        if failure is None:
            self._warm = self.solver.warm()
        else:  # where a failed solution ended is no place to start
            self.solver.cold_start()
            self._warm = self.solver.cold()
            if self.solver.distributed:  # ranks that have not failed would have to free it, too
                return
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

    @property
    def case(self) -> Case:
        """The case, or the first of B."""
        return self.given.cases[0]

    @property
    def compliance(self) -> ContactCompliance:
        """The compliance of a single history."""
        return self.compliances.every[0]

    def _adopt(self, compliances: Compliances) -> None:
        """Adopt what rates and balances have of an elasticity; contacts are to take theirs."""
        #: of all histories
        self.compliances, first = compliances, compliances.every[0]
        #: 1 / cos alpha of sloping faces, None where all are flat
        self._obliquity = first.obliquity if first.slope.any() else None
        if self.given.layered:
            self.given = self.given.with_layers(self.layer_ends, self._obliquity)
        true_area = self.area * first.obliquity
        self._averages = tuple(
            averaging(self._r, true_area, law.length) if law is not None and law.length else None
            for law in self.given.laws
        )
        self._moment = true_area * self._arm  # torque per unit shear
        # what balances take from the pressure: friction torque / mu, reactions of both bodies;
        # boundary elements turn with tractions that are constant on each
        turned = first.torque_reaction * (self._arm / self.line.uniform_arm)
        self._carried = np.vstack([self._moment, first.force_reaction, turned])

    def follow(self, shape: FloatArray) -> None:
        """Take the elasticity of elements that have followed a wear, (2, n) mm. Collective."""
        if self.following is None or np.array_equal(shape, self.following.shape):
            return
        self._adopt(Compliances.of_one(self.following.compliance(shape)))
        assert isinstance(self.contacts, CorrectedContact)
        self.contacts.take(self.compliance.matrix, self.compliance.excess)
        self.solver.set_compliance(self.compliance.matrix)

    # -- start and going on ------------------------------------------------------------------------

    def initial(self) -> State:
        """Return the contact before any wear. Collective.

        Raises
        ------
        ComputationError : the contact failed.
        UnfitError : the bodies interpenetrate by more than the load presses them together.
        """
        wear = np.zeros((2, *self.given.shape))
        nothing: Numbers = 0.0 if wear.ndim == 2 else np.zeros(len(self.given.cases))
        along = None if self.sensitivity is None else Along(self, None)
        try:
            contact = self.contact(
                nothing, wear, np.zeros(self.given.shape), exact=True, along=along
            )
        except HistoriesError:
            raise
        except ComputationError as error:
            raise ComputationError(f"{error}; in step 0, before any wear") from error
        check_interpenetration(self)
        rates = self.rates_at(nothing, wear, contact.pressure)
        worn = np.zeros(wear.shape[:-1])
        tangent = None if along is None else along.reached(contact)
        through = np.full(worn.shape, np.inf) if self.given.layered else None
        state = State(
            nothing, wear, worn, nothing, contact, rates, np.zeros(self.given.shape),
            tangent=tangent, through=through,
        )  # fmt: skip
        return checked(self.case, state)

    def resume(self, start: Start) -> State:
        """Go on from a stored state as if it had just been computed. Collective."""
        if self.following is not None:
            if start.state.shape is not None:
                self.follow(start.state.shape)
            self.following.updates = start.updates
        self.fit = start.state.fit
        self.solver.warm_start(start.warm)
        return start.state

    def warm(self) -> WarmStart:
        """Return where the next contact solution starts, after the end too. Collective."""
        return self.solver.warm() if self._warm is None else self._warm

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
        gap = self.given.initial_gap + wear[0] + wear[1]
        if self.fit is not None:
            gap = gap - self.fit
        force: Numbers = None if self.given.force is None else in_time(self.given.force, time)
        approach: Numbers = None
        if self.given.displacement is not None:
            approach = in_time(self.given.displacement, time)
        if not self.given.wears:
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
        return self.contacts.response(gap, self.given.force is not None)

    @property
    def slight_pressure(self) -> Numbers:
        """About what an approach as small as ``time.tolerance`` presses, MPa, float or (B,)."""
        return self.given.tolerance * self.compliances.stiffness

    def yielding(self, p: FloatArray) -> FloatArray:
        """Return what each element yields, (..., n) mm, to its own pressure alone, MPa."""
        return self.compliances.own * p

    # -- wear, eq. (4) -----------------------------------------------------------------------------

    def local_state(self, time: Numbers, omega: Numbers, wear: FloatArray) -> LocalState:
        """Return what laws may know of a body, its wear being (..., n) mm, at speed omega.

        Laws are told of depths along the normal; everything else here is along the axis.
        """
        angle, arm = integral(self.given.omega, 0.0, time), self._arm
        if self._obliquity is not None:
            wear = wear / self._obliquity
        return LocalState(
            time, self._r, columns(omega) * arm, self.given.friction, wear, columns(angle) * arm
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
        upper = self.local_state(time, omega, wear[1]) if self.given.laws[1] is not None else lower
        kind = LayeredIncrement if self.given.layered else WearIncrement
        return kind(self.given.laws, (lower, upper), step, self._averages, self._obliquity, closing)

    def rates(self, time: Numbers, omega: Numbers, wear: FloatArray, p: FloatArray) -> FloatArray:
        """Return the rates of wear of lower and upper, (2, ..., n) mm/s, at pressure and wear."""
        rates = np.zeros((2, *p.shape))
        bodies = zip(rates, self.given.laws, wear, self._averages, strict=True)
        for rate, law, worn, average in bodies:
            if law is not None:
                rate[:] = averaged_rate(law, self.local_state(time, omega, worn), average, p)
        if self._obliquity is not None:
            rates *= self._obliquity
        return rates

    def rates_at(self, time: Numbers, wear: FloatArray, p: FloatArray) -> FloatArray:
        """Return the rates of wear at an instant, (2, ..., n) mm/s, at the speed of that time."""
        return self.rates(time, in_time(self.given.omega, time), wear, p)

    def integrals(self, field: FloatArray) -> FloatArray:
        """Return area integrals of a field of both bodies, (2, ..., n) to (2, ...)."""
        return inner(self.area, field) if self.given.several else field @ self.area

    def _sums(self, weights: FloatArray, values: FloatArray) -> Numbers:
        """Return sums over the elements, (...): of one history by BLAS, which is quicker."""
        if not self.given.several and values.ndim > 1:
            return values @ weights
        return inner(weights, values)

    def moment(self, p: FloatArray) -> Numbers:
        """Return the friction torque over mu in full slip, N mm, float or (B,), at (..., n)."""
        return self._sums(self._moment, p)

    def torque(self, p: FloatArray) -> Numbers:
        """Return the friction torque in full slip, N mm, float or (B,), at pressure (..., n)."""
        return self.given.friction * self.moment(p)

    def twist(self, p: FloatArray) -> Numbers:
        """Return the area mean of the circumferential displacement jump, mm, at pressure."""
        return self.given.friction * self._sums(self.compliances.twist, p)

    def reactions(self, p: FloatArray) -> FloatArray:
        """Return friction torque / mu, axial force and torque / mu on both fixed faces, (5, ...).

        At pressure (..., n); N mm and N.
        """
        if p.ndim == 1:
            return self._carried @ p
        return np.array([inner(weights, p) for weights in self._carried])

    # -- of B histories ----------------------------------------------------------------------------

    def approach_rates(self, histories: IntArray) -> FloatArray:
        """Return what the approach does to pressures of some of B histories, (h, n) MPa/mm.

        Where nothing touches, what it would do if all did, from which a search may start.
        """
        rates = self.batch.solver.rates[histories]
        all_touching = columns(self.compliances.stiffness[histories])
        return np.where(rates.any(axis=1, keepdims=True), rates, all_touching)

    def take(self, histories: IntArray) -> "WearModel":
        """Return the model of some of B histories; its contacts start where these would."""
        taken = copy.copy(self)
        taken.given = self.given.take(histories)
        taken.compliances = self.compliances.take(histories)
        taken.contacts = self.batch.take(histories)
        if self.sensitivity is not None:
            taken.sensitivity = self.sensitivity.take(histories)
        return taken

    def joined(self, other: "WearModel") -> "WearModel":
        """Return the model of the histories of both; its contacts start where theirs would."""
        known = {
            young(case): model.compliances.history(i)
            for model in (self, other)
            for i, case in enumerate(model.given.cases)
        }
        model = WearModel(
            (*self.given.cases, *other.given.cases),
            self.comm,
            self.pair,
            known=known,
            derivatives=() if self.sensitivity is None else self.sensitivity.keys,
        )
        model.batch.go_on(self.batch, other.batch)
        return model
