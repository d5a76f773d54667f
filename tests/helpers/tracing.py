"""Wear histories with all their states."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

from mpi4py import MPI

from ringwear_par.history.block import Block
from ringwear_par.history.checks import Worst
from ringwear_par.history.elastic import assemble
from ringwear_par.history.following import Following
from ringwear_par.history.loop import first_contact as of_block
from ringwear_par.history.loop import simulate

ALONE = MPI.COMM_SELF


@dataclass
class History:
    """The states of one history, without the axis of histories; wear and rates of both bodies."""

    block: Block
    worst: Worst
    states: list[SimpleNamespace]
    following: Following | None

    @property
    def line(self):
        """The contact elements."""
        return self.block.line

    @property
    def last(self):
        """The state at the end."""
        return self.states[-1]

    @property
    def steps(self):
        """How many were made."""
        return int(self.last.steps)

    @property
    def balances(self):
        """Their largest defects."""
        return SimpleNamespace(**self.worst.balances(0))

    @property
    def times(self):
        """Those of the states, s."""
        return [state.time for state in self.states]

    def at(self, time):
        """Return the state at a time, s."""
        return next(s for s in self.states if abs(s.time - time) <= 1e-9 * time)

    def torque_over_friction(self, p):
        """Return the torque of pressures (n,) at mu = 1, N mm."""
        return self.block.moment(p[None])[0]


def state_of(block, state, number=0):
    """Return one of the states of a block."""
    both = replace(state, wear=block.both(state.wear), rates=block.both(state.rates))
    meshed = None if state.meshed is None else block.both(state.meshed)[:, number]
    own = {}
    for name, values in vars(both).items():
        if values is not None:
            values = values[number] if values.ndim == 1 else values[..., number, :]
            own[name] = values if values.ndim else float(values)
    p = own["pressure"]
    gap = block.compliance.gap(block.worn_gap(state.wear), state.pressure, state.approach)[number]
    force = float(block.line.area @ p)
    return SimpleNamespace(**{**own, "meshed": meshed, "gap": gap, "force": force})


def traces(cases, pairs=None, *, step_times=None, paces=None):
    """Return the histories of a block of cases, and why some failed."""
    pairs = pairs or [assemble(cases[0], ALONE)] * len(cases)
    whole = Block.of(cases, pairs, step_times, paces)
    found = [History(whole, Worst(1), [], None) for _ in cases]

    def save(instant):
        for place, number in enumerate(instant.block.number.tolist()):
            found[number].states.append(state_of(instant.block, instant.state, place))

    return found, simulate(whole, save, every=True)


def trace(case, pair=None, *, tao=False, step_times=None):
    """Return a history with all its states; raise what ends it early.

    Parameters
    ----------
    tao : whether contacts are solved by TAO rather than as in blocks.
    """
    following = Following(case, ALONE) if case.follows_wear else None
    pair = following.pair if following is not None else pair or assemble(case, ALONE)
    block = Block.of([case], [pair], None if step_times is None else [step_times])
    history = History(block, Worst(1), [], following)

    def save(instant):
        history.block = instant.block
        history.worst(instant)
        history.states.append(state_of(instant.block, instant.state))

    failures = simulate(block, save, tao=tao, following=following, every=True)
    for error in failures.values():
        raise error
    return history


def first_contact(case, comm=ALONE):
    """Return the contact of a case before any wear, by TAO, with its force (N)."""
    contact = of_block(case, comm)
    p = contact.pressure[0]
    return SimpleNamespace(pressure=p, approach=float(contact.approach[0]),
                           force=float(case.line.area @ p))  # fmt: skip
