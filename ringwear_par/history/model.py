"""The physics of one contact pair: contact (3), rates of wear (4) and what a step wears off.

Nothing here knows of schemes, step control, files or observers: they ask for contact solutions,
rates and increments.

There are B >= 1 histories on the pair: fields are (B, n), numbers of histories (B,). Loads, laws
and gaps are ``inputs``, moduli ``compliances``; elements that follow the wear are the matter of
``following``, states that the model does not hold for that of ``admissible``.
"""

import copy
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import BoolArray, FloatArray, IntArray, columns, inner
from ringwear_par.cases.case import Case
from ringwear_par.contact.correction import CorrectedContacts, Tangents
from ringwear_par.contact.problem import ContactState, WarmStart
from ringwear_par.elasticity.bem.pair import ContactCompliance, ContactPair
from ringwear_par.history.elastic.bodies import young
from ringwear_par.history.elastic.compliances import Compliances
from ringwear_par.history.elastic.moving import MovingGeometry
from ringwear_par.history.elastic.pairs import assemble
from ringwear_par.history.inputs import HistoryInputs
from ringwear_par.history.sensitivity import Sensitivity
from ringwear_par.history.state import Start, State
from ringwear_par.schedules import in_time, integral
from ringwear_par.wear.increment import Closing, WearIncrement, averaged_rate, averaging
from ringwear_par.wear.law import LocalState
from ringwear_par.wear.layered_increment import LayeredIncrement


class WearModel:
    """Contact and wear of B cases that share a pair. A context manager, which frees the contacts.

    Parameters
    ----------
    cases : of one shape and mesh, with laws of the same kinds; one alone if its elements follow
        the wear.
    comm : communicator on which bodies are assembled; contacts are of each rank itself.
    pair : contact pair of the cases; None: it is assembled here.
    known : compliances by moduli, as far as they are known.
    derivatives : keys that states are to have derivatives with respect to, see ``sensitivity``.
    """

    def __init__(
        self,
        cases: Sequence[Case],
        comm: MPI.Comm,
        pair: ContactPair | None = None,
        known: Mapping[tuple[float, float], ContactCompliance] = MappingProxyType({}),
        derivatives: Sequence[str] = (),
    ) -> None:
        #: loads, laws and gaps of the cases
        self.inputs, self.comm = HistoryInputs.of(cases), comm
        case = self.case
        #: elasticity that follows the wear; None where elements stay
        self.geometry = MovingGeometry(case, comm) if case.follows_wear else None
        #: whether the pair was assembled elsewhere
        self.pair_is_shared = pair is not None
        if pair is None:
            pair = assemble(case, comm) if self.geometry is None else self.geometry.unworn()
        #: the pair as it was before any wear
        self.pair, self.line = pair, pair.line
        self._r, self._arm, self.area = pair.line.r, pair.line.arm, pair.line.area
        #: (layers, n) mm, along the axis, depths at which the layers of lower and upper end
        self.layer_ends = tuple(
            case.layer_ends(i) if ring.layers else None for i, ring in enumerate(case.rings)
        )
        #: (B, n) mm, what elements are nearer than their profiles say, see ``State``
        self.gap_offset: FloatArray | None = None
        #: what the numbers act on that there are to be derivatives with respect to, if any
        self.sensitivity: Sensitivity | None = None
        if derivatives:
            self.sensitivity = Sensitivity(derivatives, self.inputs.cases, pair)
        self._warm: WarmStart | None = None  # once the contacts are freed
        self._adopt(Compliances.of([young(each) for each in cases], pair, known))
        #: the contacts of the B histories
        self.contacts: CorrectedContacts = self.compliances.contacts()

    def __enter__(self) -> "WearModel":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Free the contacts; where they would start stays known. Not collective."""
        if self._warm is None:
            self._warm = self.contacts.solver.warm
            self.contacts.solver.destroy()

    @property
    def case(self) -> Case:
        """The first case."""
        return self.inputs.cases[0]

    def _adopt(self, compliances: Compliances) -> None:
        """Adopt the numbers of rates and balances that follow from an elasticity."""
        #: of all histories
        self.compliances, first = compliances, compliances.every[0]
        #: 1 / cos alpha of sloping faces, None where all are flat
        self._obliquity = first.obliquity if first.slope.any() else None
        if self.inputs.layered:
            self.inputs = self.inputs.with_layers(self.layer_ends, self._obliquity)
        true_area = self.area * first.obliquity
        self._averages = tuple(
            averaging(self._r, true_area, law.length) if law is not None and law.length else None
            for law in self.inputs.laws
        )
        self._moment = true_area * self._arm  # torque per unit shear
        # what balances take from the pressure: friction torque / mu, reactions of both bodies;
        # boundary elements turn with tractions that are constant on each
        turned = first.torque_reaction * (self._arm / self.line.uniform_arm)
        self._carried = np.vstack([self._moment, first.force_reaction, turned])

    def remesh_to(self, wear: FloatArray) -> None:
        """Take the elasticity of elements that have followed a wear, (2, 1, n) mm. Collective."""
        if self.geometry is None or np.array_equal(wear[:, 0], self.geometry.meshed_wear):
            return
        warm, worst = self.warm, self.contacts.worst
        self._adopt(Compliances.of_each([self.geometry.compliance(wear[:, 0])]))
        self.contacts.solver.destroy()
        before, self.contacts = self.contacts, self.compliances.contacts()
        rescaled = self.contacts.solver.scale / before.solver.scale
        self.contacts.solver.warm = WarmStart(warm.scaled_pressure * rescaled, warm.approach)
        self.contacts.worst = worst

    # -- start and continuation --------------------------------------------------------------------

    def resume(self, start: Start) -> State:
        """Return a stored state to continue from, as if it had just been computed. Collective."""
        if self.geometry is not None:
            if start.state.meshed_wear is not None:
                self.remesh_to(start.state.meshed_wear)
            self.geometry.updates = start.updates
        self.gap_offset = start.state.gap_offset
        self.warm = start.warm
        return start.state

    @property
    def warm(self) -> WarmStart:
        """Where the next contact solutions start, also after the contacts are freed."""
        return self.contacts.solver.warm if self._warm is None else self._warm

    @warm.setter
    def warm(self, warm: WarmStart) -> None:
        self.contacts.solver.warm = warm

    # -- contact, eq. (3) --------------------------------------------------------------------------

    def contact(
        self,
        time: FloatArray,
        wear: FloatArray,
        pressure_guess: FloatArray,
        increment: WearIncrement | None = None,
        already_solved: tuple[BoolArray, ContactState] | None = None,
        exact: bool = False,
        along: Tangents | None = None,
    ) -> ContactState:
        """Return the contact at a time, under the loads of that time. Collective.

        Parameters
        ----------
        time : (B,) float, s.
        wear : (2, B, n) float, mm, by which the profiles are worn.
        pressure_guess : (B, n) float, MPa, near the solution, see ``contact.correction``.
        increment : wear of an implicit step, which is part of the contact problem.
        already_solved : which of B histories have their solution already, and it.
        exact : whether no other pressures are pressure_guess, see ``contact.correction``.
        along : derivatives along the step of this contact.

        Raises
        ------
        ComputationError : the contact was not found.
        """
        gap = self.inputs.initial_gap + wear[0] + wear[1]
        if self.gap_offset is not None:
            gap = gap - self.gap_offset
        force = None if self.inputs.force is None else in_time(self.inputs.force, time)
        approach = None
        if self.inputs.displacement is not None:
            approach = in_time(self.inputs.displacement, time)
        if not self.inputs.wears:
            increment = None
        how: Any = {"force": force, "approach": approach, "wear": increment, "exact": exact}
        if already_solved is not None:
            how["already_solved"] = already_solved
        if along is not None:
            along.pose(increment)
            how["along"] = along
        return self.contacts.solve(gap, pressure_guess, **how)

    @property
    def asymmetry(self) -> tuple[FloatArray, IntArray]:
        """The worst errors of pressure, (B,), that a symmetric compliance has left; their elements.

        Of all contacts so far, see ``contact.correction``.
        """
        return self.contacts.worst

    def pressure_response(self, gap: FloatArray) -> FloatArray:
        """Return what a small growth (B, n) mm of the gap does to the last pressures, MPa."""
        return self.contacts.response(gap, self.inputs.force is not None)

    @property
    def slight_pressure(self) -> FloatArray:
        """About what an approach as small as ``time.tolerance`` presses, MPa, (B,)."""
        return self.inputs.tolerance * self.compliances.stiffness

    def yielding(self, p: FloatArray) -> FloatArray:
        """Return what each element yields, (B, n) mm, to its own pressure alone, MPa."""
        return self.compliances.own * p

    # -- wear, eq. (4) -----------------------------------------------------------------------------

    def local_state(self, time: FloatArray, omega: FloatArray, wear: FloatArray) -> LocalState:
        """Return what laws may know of a body, its wear being (B, n) mm, at speed omega.

        Laws are told of depths along the normal; everything else here is along the axis.
        """
        angle, arm = integral(self.inputs.omega, 0.0, time), self._arm
        if self._obliquity is not None:
            wear = wear / self._obliquity
        return LocalState(
            time, self._r, columns(omega) * arm, self.inputs.friction, wear, columns(angle) * arm
        )

    def increment(
        self,
        time: FloatArray,
        omega: FloatArray,
        wear: FloatArray,
        step: FloatArray,
        closing: Closing | None = None,
    ) -> WearIncrement:
        """Return the wear of an implicit step that ends at a time, from wear (2, B, n) mm on.

        ``closing`` is of elements that come into contact in it.
        """
        lower = self.local_state(time, omega, wear[0])
        upper = self.local_state(time, omega, wear[1]) if self.inputs.laws[1] is not None else lower
        kind = LayeredIncrement if self.inputs.layered else WearIncrement
        return kind(
            self.inputs.laws, (lower, upper), step, self._averages, self._obliquity, closing
        )

    def rates(
        self, time: FloatArray, omega: FloatArray, wear: FloatArray, p: FloatArray
    ) -> FloatArray:
        """Return the rates of wear of lower and upper, (2, B, n) mm/s, at pressure and wear."""
        rates = np.zeros((2, *p.shape))
        bodies = zip(rates, self.inputs.laws, wear, self._averages, strict=True)
        for rate, law, worn, average in bodies:
            if law is not None:
                rate[:] = averaged_rate(law, self.local_state(time, omega, worn), average, p)
        if self._obliquity is not None:
            rates *= self._obliquity
        return rates

    def rates_at(self, time: FloatArray, wear: FloatArray, p: FloatArray) -> FloatArray:
        """Return the rates of wear at an instant, (2, B, n) mm/s, at the speed of that time."""
        return self.rates(time, in_time(self.inputs.omega, time), wear, p)

    def integrals(self, field: FloatArray) -> FloatArray:
        """Return area integrals of a field of both bodies, (2, ..., n) to (2, ...)."""
        return np.asarray(inner(self.area, field))

    def moment(self, p: FloatArray) -> FloatArray:
        """Return the friction torque over mu in full slip, N mm, (B,), at (B, n)."""
        return inner(self._moment, p)

    def torque(self, p: FloatArray) -> FloatArray:
        """Return the friction torque in full slip, N mm, (B,), at pressure (B, n)."""
        return self.inputs.friction * self.moment(p)

    def twist(self, p: FloatArray) -> FloatArray:
        """Return the area mean of the circumferential displacement jump, mm, at pressure."""
        return self.inputs.friction * inner(self.compliances.twist, p)

    def reactions(self, p: FloatArray) -> FloatArray:
        """Return friction torque / mu, axial force and torque / mu on both fixed faces, (5, B).

        At pressure (B, n); N mm and N.
        """
        return np.array([inner(weights, p) for weights in self._carried])

    # -- some of the histories ---------------------------------------------------------------------

    def take(self, histories: IntArray) -> "WearModel":
        """Return the model of some of the histories; its contacts start where these would."""
        part = copy.copy(self)
        part.inputs = self.inputs.take(histories)
        part.compliances = self.compliances.take(histories)
        part.contacts = self.contacts.take(histories)
        if self.sensitivity is not None:
            part.sensitivity = self.sensitivity.take(histories)
        return part

    def joined(self, other: "WearModel") -> "WearModel":
        """Return the model of the histories of both; its contacts start where theirs would."""
        known = {
            young(case): model.compliances.history(i)
            for model in (self, other)
            for i, case in enumerate(model.inputs.cases)
        }
        model = WearModel(
            (*self.inputs.cases, *other.inputs.cases),
            self.comm,
            self.pair,
            known=known,
            derivatives=() if self.sensitivity is None else self.sensitivity.keys,
        )
        model.contacts.start_from(self.contacts, other.contacts)
        return model
