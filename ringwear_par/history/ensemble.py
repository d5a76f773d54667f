"""All cases of a simulation, and where those of their histories are that step together."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from mpi4py import MPI

from ringwear_par import batched
from ringwear_par.arrays import FloatArray, IntArray
from ringwear_par.cases.case import Case
from ringwear_par.contact.correction import CorrectedContacts
from ringwear_par.elasticity.bem.pair import ContactPair
from ringwear_par.history.elastic.pairs import assemble
from ringwear_par.history.moving_geometry import MovingGeometry
from ringwear_par.history.physics import Physics
from ringwear_par.history.schemes.step import Scheme
from ringwear_par.history.snapshots import Observer, Snapshot
from ringwear_par.history.start import initial_state
from ringwear_par.history.state import Progress, Start, State
from ringwear_par.history.step_control import Control, FixedSteps
from ringwear_par.parallel import together


class Method(NamedTuple):
    """A ``time.scheme``: how a step is made, and how its length is controlled."""

    scheme: Scheme
    control: type[Control]
    #: how a state within a step is computed, from which no step goes on
    within: Scheme


@dataclass
class Ensemble:
    """All cases of a simulation, and how their histories ended so far."""

    #: see ``loop.simulate``
    cases: Sequence[Case]
    comm: MPI.Comm
    pair: ContactPair | Sequence[ContactPair] | None
    start: Start | None
    observers: Sequence[Observer]
    step_times: Sequence[Sequence[float]] | None
    paces: Sequence[FloatArray] | None
    #: of all cases
    method: Method
    #: why, of the histories that failed, by number
    failures: dict[int, Exception] = field(default_factory=dict)
    #: whether an observer interrupted all
    interrupted: bool = False

    def control(self, numbers: IntArray) -> Control:
        """Return the step control of some histories."""
        cases = [self.cases[i] for i in numbers.tolist()]
        if self.step_times is None:
            return self.method.control.of(cases, None)
        return FixedSteps.of(cases, [self.step_times[i] for i in numbers.tolist()])

    def pace(self, numbers: IntArray, steps: IntArray) -> FloatArray | None:
        """Return factors (2, B) on the rates of histories that have made so many steps."""
        if self.paces is None:
            return None
        present = zip(numbers.tolist(), steps.tolist(), strict=True)
        return np.stack([self.paces[i][:, step] for i, step in present], axis=1)

    def pairs(self, numbers: IntArray) -> ContactPair | Sequence[ContactPair] | None:
        """Return the contact pair of some histories, or one of each; None: none is assembled."""
        pair = self.pair
        if pair is None or isinstance(pair, ContactPair):
            return pair
        return [pair[i] for i in numbers.tolist()]

    def begin(self, numbers: IntArray) -> "Present":
        """Return where some histories start, or the one that continues. Collective."""
        cases, start = [self.cases[i] for i in numbers.tolist()], self.start
        geometry = MovingGeometry(cases[0], self.comm) if cases[0].follows_wear else None
        pair = self.pairs(numbers)
        if pair is None:
            pair = assemble(cases[0], self.comm) if geometry is None else geometry.unworn()
        physics = Physics.of(cases, pair)
        physics = replace(physics, pair_is_shared=self.pair is not None)
        contacts, control = physics.contacts(), self.control(numbers)
        try:
            if start is not None:
                if geometry is not None and start.state.meshed_wear is not None:
                    physics, contacts = geometry.remesh_to(
                        start.state.meshed_wear, physics, contacts
                    )
                physics = replace(physics, gap_offset=start.state.gap_offset, updates=start.updates)
                contacts.warm = start.warm
                state, progress = start.state, start.progress
            else:
                with together(self.comm):
                    state = initial_state(physics, contacts)
                progress = Progress.at_start(len(numbers))
        except BaseException:
            contacts.close()
            raise
        return Present(control, physics, contacts, geometry, state, progress)

    def show(self, snapshots: Sequence[Snapshot]) -> None:
        """Show new states to the observers."""
        for snapshot in snapshots:
            for observer in self.observers:
                self.interrupted |= bool(observer(snapshot))


@dataclass(frozen=True)
class Present:
    """Where the histories of a batch are."""

    #: of their steps
    control: Control
    #: of the histories; the contacts start from here
    physics: Physics
    contacts: CorrectedContacts
    #: of elements that follow the wear; None where they stay
    geometry: MovingGeometry | None
    #: after the last accepted step of each
    state: State
    progress: Progress

    def take(self, histories: IntArray) -> "Present":
        """Return the present of some of the histories."""
        return self._of(histories, self.contacts.take(histories))

    def keep(self, histories: IntArray) -> "Present":
        """Return the present of some of the histories, which ends that of the others."""
        self.contacts.keep(histories)
        return self._of(histories, self.contacts)

    def _of(self, histories: IntArray, contacts: CorrectedContacts) -> "Present":
        return Present(
            batched.take(self.control, histories),
            self.physics.take(histories),
            contacts,
            self.geometry,
            batched.take(self.state, histories),
            batched.take(self.progress, histories),
        )
