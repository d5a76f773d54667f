"""The time loop, section 3 of the paper: a block of histories advanced together to their ends.

``pressure``, ``approach``... of a state are the contact solution with the profile worn up to its
time, for every scheme. Each round every history tries a step; one whose try is rejected tries a
shorter one in the next round, while the others go on. What fails is a mask, with reasons.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import BoolArray, FloatArray
from ringwear_par.batched import choose, take
from ringwear_par.cases.case import Case
from ringwear_par.contact.block import BlockSolver
from ringwear_par.contact.problem import Contact
from ringwear_par.contact.tao import TaoContact
from ringwear_par.elasticity.bem.pair import ContactPair
from ringwear_par.history.block import Block
from ringwear_par.history.control import first_length, judge, next_ends, step_error, step_share
from ringwear_par.history.elastic import assemble
from ringwear_par.history.failures import (
    contact_failure,
    deep_wear_failure,
    interpenetration,
    step_failure,
)
from ringwear_par.history.following import Following
from ringwear_par.history.layers import enter_layers, settled
from ringwear_par.history.schemes import BY_NAME, Solver, start
from ringwear_par.history.state import State
from ringwear_par.options import contact_solver
from ringwear_par.parallel import as_on_first_rank, on_any_rank

#: error of gaps in contact, over the tolerance of wear
_GAP = 0.2
#: share of the histories that have ended and yet step along
_IDLE = 0.125
#: fewest elements of which ranks share the contact of one history
SHARED = 512


def _deepest(block: Block, state: State, body: int) -> FloatArray:
    return block.both(state.wear)[body].max(axis=1)


#: quantities of which a limit ends histories, (B,): the keys of [stop] in a case
STOP: Mapping[str, Callable[[Block, State], FloatArray]] = {
    "penetration": lambda block, state: state.approach - state.first_approach,
    "wear_lower": lambda block, state: _deepest(block, state, 0),
    "wear_upper": lambda block, state: _deepest(block, state, 1),
    "energy": lambda block, state: state.energy,
}


@dataclass(frozen=True)
class Instant:
    """New states of some histories of a block, each at a time of its own."""

    #: of these histories, and their states
    block: Block
    state: State
    #: (B,) whether their cases store them, and whether they are the last ones
    stored: BoolArray
    ended: BoolArray
    #: of elements that follow the wear
    following: Following | None = None

    @cached_property
    def gap(self) -> FloatArray:
        """(B, n) mm, between the bodies under pressure."""
        of, state = self.block, self.state
        return of.compliance.gap(of.worn_gap(state.wear), state.pressure, state.approach)


#: takes new states, and says whether to stop all histories there
Save = Callable[[Instant], bool | None]


def simulate(
    block: Block,
    save: Save,
    *,
    solver: Solver | None = None,
    first: State | None = None,
    following: Following | None = None,
    every: bool = False,
    comm: MPI.Comm = MPI.COMM_SELF,
) -> dict[int, Exception]:
    """Advance all histories to their ends; return why some failed, by number.

    Collective on comm, the same on all ranks.

    Parameters
    ----------
    save : is called with the states that are stored; with ``every`` after each step.
    solver : of the contacts; None: a ``BlockSolver``, where it serves.
    first : where an interrupted history continues; None: they start.
    following : elements that follow the wear, of a block of one.
    """
    if solver is None and not (block.is_local and following is None):
        with TaoContact(block.compliance, block.by_force) as tao:
            return simulate(
                block, save, solver=tao, first=first, following=following, every=every, comm=comm
            )
    case = block.cases.every[0]
    scheme = BY_NAME[case.time.scheme]
    share = step_share(block) if not block.given_steps else None
    solver = solver or BlockSolver(block.compliance, block.by_force, _GAP * block.tolerance)
    failures: dict[int, Exception] = {}
    if first is None:
        state, lost = start(block, solver)
        lost = on_any_rank(comm, lost)  # a law may fail on one rank alone
        state = replace(state, length=first_length(block, state, share))
        failures |= interpenetration(block, solver)
        failures |= {i: contact_failure(block, i, comm) for i in np.flatnonzero(lost).tolist()}
        going = np.array([i not in failures for i in range(len(block))])
        if going.any() and save(_instant(block, state, going, going, ~going, following)):
            return failures
    else:
        state, going = first, np.ones(len(block), bool)
    limit = (block.limits <= state.time[:, None]).sum(axis=1)
    going &= limit < block.limits.shape[1]
    limit = np.minimum(limit, block.limits.shape[1] - 1)
    order = 3 if case.time.adaptive else 2
    while going.any():
        if np.count_nonzero(going) < (1.0 - _IDLE) * len(block):
            rows = np.flatnonzero(going)
            block, solver, state, limit, going = take((block, solver, state, limit, going), rows)
            if isinstance(solver, TaoContact):  # no dataclass, which ``take`` would cut
                solver = solver.with_compliance(block.compliance)
        if following is not None:
            assert isinstance(solver, TaoContact)
            block, solver, state = following.follow(block, solver, state)
            if share is not None:
                state = replace(state, length=_meshed_length(block, state))
        end, is_cut = as_on_first_rank(comm, next_ends(block, state, limit, going))
        if block.paces is not None:
            block = replace(block, pace=block.paces[:, np.arange(len(block)), limit, None])
        step = scheme(block, solver, state, end)
        if block.layered:
            step = enter_layers(block, state, step)
        # ranks may differ by round-off, or by their processor: all go on with the first one's
        step = as_on_first_rank(comm, replace(step, failed=on_any_rank(comm, step.failed)))
        accepted, stuck, length = judge(block, state, step, share, is_cut, going, order)
        before = state
        state = _after(block, state, step.state, accepted, step_error(block, step, share))
        if block.layered and (entered := state.layer != before.layer).any():
            state = settled(block, solver, state, entered.any(axis=(0, 2)))
        state = replace(state, length=length, interface=np.where(going, step.interface, np.inf))
        off = accepted & _is_off(block, state)
        for row in np.flatnonzero(stuck & going).tolist():
            failures[int(block.number[row])] = step_failure(block, state, step, row, share, comm)
        for row in np.flatnonzero(off).tolist():
            failures[int(block.number[row])] = deep_wear_failure(block, state, row)
        passed = accepted & (state.time >= block.limits[np.arange(len(block)), limit])
        done = accepted if share is not None else passed
        state = replace(state, steps=state.steps + done)
        ended = accepted & (state.time >= block.limits[:, -1])
        for name, most in block.stop.items():
            ended |= done & (STOP[name](block, state) >= most)
        ended &= ~off
        stored = ended | (passed & block.stored[np.arange(len(block)), limit])
        by_steps = block.every > 0
        if by_steps.any():
            stored |= done & by_steps & (state.steps % np.maximum(block.every, 1) == 0)
        stored &= ~off
        going = going & ~(ended | stuck | off)
        new = (done if every else stored) & ~off
        if new.any() and save(_instant(block, state, new, stored, ended, following)):
            break
        limit = limit + (passed & going)
    return failures


def first_contact(case: Case, comm: MPI.Comm) -> Contact:
    """Return the contact of a case before any wear, as of a block of one. Collective on comm."""
    block = Block.of([case], [assemble(case, comm)])
    with TaoContact(block.compliance, block.by_force) as solver:
        zero = np.zeros(1)
        return solver.solve(block.gap, block.load.at(zero), None, np.zeros_like(block.gap), zero)


def simulate_one(
    case: Case,
    comm: MPI.Comm,
    save: Save,
    *,
    pair: ContactPair | None = None,
    first: State | None = None,
    every: bool = False,
) -> None:
    """Advance one history to its end, see ``simulate``: its contacts are solved by TAO.

    Collective on comm, the same on all ranks.

    Parameters
    ----------
    pair : contact pair of the case; None: it is assembled.

    Raises
    ------
    ComputationError : a step could not be made; it is named with its time.
    UnfitError : the case's own numbers do not go together, as its first contact shows.
    """
    following = Following(case, comm) if case.follows_wear else None
    if pair is None:
        pair = assemble(case, comm) if following is None else following.pair
    block = Block.of([case], [pair])
    if block.is_local and following is None and contact_solver() == "block":
        failures = simulate(block, save, first=first, every=every, comm=comm)
    else:
        # rows of small systems are not worth messages
        own = comm if case.line.n >= SHARED else MPI.COMM_SELF
        with TaoContact(block.compliance, block.by_force, own) as solver:
            failures = simulate(
                block, save, solver=solver, first=first, following=following, every=every,
                comm=comm,
            )  # fmt: skip
    for error in failures.values():
        raise error


def _after(
    block: Block, before: State, after: State, accepted: BoolArray, error: FloatArray
) -> State:
    """Return the states after a round, in which some steps were accepted."""
    tried = after.iterations  # those of rejected tries count, too
    after = replace(after, error=np.maximum(before.error, error * block.tolerance))
    state = after if accepted.all() else choose(accepted, after, before)
    return replace(state, iterations=tried)


def _meshed_length(block: Block, state: State) -> FloatArray:
    """Return the lengths of tries that wear about the tolerance of the geometry at most."""
    most = block.cases.every[0].mesh.geometry_tolerance
    fastest = state.rates.max(axis=(0, 2), initial=0.0)
    with np.errstate(divide="ignore"):
        return np.minimum(state.length, most / fastest)


def _is_off(block: Block, state: State) -> BoolArray:
    """Return whether too much is worn off, or contact has reached an end that is no edge, (B,)."""
    off = (block.deepest < state.wear.max(axis=2, initial=0.0).T).any(axis=1)
    for element in block.open_ends:
        off |= state.pressure[:, element] > 0.0
    return off


def _instant(
    block: Block,
    state: State,
    new: BoolArray,
    stored: BoolArray,
    ended: BoolArray,
    following: Following | None,
) -> Instant:
    """Return the new states of a block."""
    if new.all():
        return Instant(block, state, stored, ended, following)
    rows = np.flatnonzero(new)
    return Instant(*take((block, state, stored, ended), rows), following)
