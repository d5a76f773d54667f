"""The time loop, section 3 of the paper: a block of histories advanced together to their ends.

``pressure``, ``approach``... of a state are the contact solution with the profile worn up to its
time, for every scheme. Each round every history tries a step; one whose try is rejected tries a
shorter one in the next round, while the others go on. What fails is a mask, with reasons.
"""

from collections.abc import Callable, Mapping
from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import BoolArray, FloatArray
from ringwear_par.batched import choose, take
from ringwear_par.cases.case import Case
from ringwear_par.contact.block import BlockSolver
from ringwear_par.contact.tao import TaoContact
from ringwear_par.elasticity.bem.pair import ContactPair
from ringwear_par.history.block import Block
from ringwear_par.history.control import first_length, judge, next_ends
from ringwear_par.history.elastic import assemble
from ringwear_par.history.failures import (
    contact_failure,
    deep_wear_failure,
    interpenetration,
    step_failure,
)
from ringwear_par.history.following import Following
from ringwear_par.history.layers import enter_layers
from ringwear_par.history.schemes import BY_NAME, Solver, settled, start
from ringwear_par.history.state import State
from ringwear_par.options import contact_solver
from ringwear_par.parallel import as_on_first_rank, on_any_rank

#: error of gaps in contact, over the tolerance of wear
_GAP = 0.2
#: share of the histories that have ended and yet step along
_IDLE = 0.125
#: fewest elements of which ranks share the contact of one history
SHARED = 512


#: quantities of which a limit ends histories, (B,): the keys of [stop] in a case
STOP: Mapping[str, Callable[[Block, State], FloatArray]] = {
    "penetration": lambda block, state: state.approach - state.first_approach,
    "wear_lower": lambda block, state: block.both(state.wear)[0].max(axis=1),
    "wear_upper": lambda block, state: block.both(state.wear)[1].max(axis=1),
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
    tao: bool = False,
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
    tao : solve contacts by TAO, not by a ``BlockSolver`` where that serves.
    first : where an interrupted history continues; None: they start.
    following : elements that follow the wear, of a block of one.
    """
    # rows of small systems are not worth messages
    own = comm if len(block.line.r) >= SHARED else MPI.COMM_SELF
    is_local = not any(body.length for body in block.wearing)
    needed = tao or following is not None or not is_local
    with TaoContact(block.compliance, block.by_force, own) if needed else nullcontext() as by_tao:
        scheme = BY_NAME[block.cases.every[0].time.scheme]
        failures: dict[int, Exception] = {}
        state, going = first, np.ones(len(block), bool)
        if state is None:
            state, failures = _start(block, _solver(block, by_tao), comm)
            going[list(failures)] = False
            if going.any() and save(_instant(block, state, going, going, ~going, following)):
                return failures
        limit = (block.limits <= state.time[:, None]).sum(axis=1)
        going &= limit < block.limits.shape[1]
        limit = np.minimum(limit, block.limits.shape[1] - 1)
        while going.any():
            if np.count_nonzero(going) < (1.0 - _IDLE) * len(block):
                some = np.flatnonzero(going)
                block, state, limit, going = take((block, state, limit, going), some)
            if following is not None and by_tao is not None:
                block, state = following.follow(block, by_tao, state)
            rows, solver = np.arange(len(block)), _solver(block, by_tao)
            if block.paces is not None:
                block = replace(block, pace=block.paces[:, rows, limit, None])
            end, is_cut = next_ends(block, state, limit, going)
            step = scheme(block, solver, state, end)
            if block.layered:
                step = enter_layers(block, state, step)
            step, before = replace(step, failed=on_any_rank(comm, step.failed)), state
            # ranks may differ by round-off, or by their processor: all take the first one's
            accepted, stuck, state = as_on_first_rank(
                comm, judge(block, state, step, is_cut, going)
            )
            if block.layered and (entered := state.layer != before.layer).any():
                new, lost = settled(block, solver, state)
                state = choose(entered.any(axis=(0, 2)) & ~lost, new, state)
            off = accepted & _is_off(block, state)
            for row in np.flatnonzero(stuck | off).tolist():
                failures[int(block.number[row])] = (
                    step_failure(block, state, step, row, comm) if stuck[row]
                    else deep_wear_failure(block, state, row)
                )  # fmt: skip
            passed = accepted & (state.time >= block.limits[rows, limit])
            done = passed if block.given_steps else accepted
            state = replace(state, steps=state.steps + done)
            ended = accepted & ~off & (state.time >= block.limits[:, -1])
            for name, most in block.stop.items():
                ended |= done & ~off & (STOP[name](block, state) >= most)
            due = done & (block.every > 0) & (state.steps % np.maximum(block.every, 1) == 0)
            due |= passed & block.stored[rows, limit]
            stored = ended | (due & ~off)
            going = going & ~(ended | stuck | off)
            shown = done & ~off if every else stored
            if shown.any() and save(_instant(block, state, shown, stored, ended, following)):
                break
            limit = limit + (passed & going)
    return failures


def _solver(block: Block, tao: TaoContact | None) -> Solver:
    if tao is not None:
        return tao.with_compliance(block.compliance)
    return BlockSolver(block.compliance, block.by_force, _GAP * block.tolerance)


def _start(block: Block, solver: Solver, comm: MPI.Comm) -> tuple[State, dict[int, Exception]]:
    """Return the states before any wear, and why some histories have none, by number."""
    state, lost = start(block, solver)
    lost = on_any_rank(comm, lost)  # a law may fail on one rank alone
    state = as_on_first_rank(comm, replace(state, length=first_length(block, state)))
    failures = interpenetration(block, solver)
    failures |= {i: contact_failure(block, i, comm) for i in np.flatnonzero(lost).tolist()}
    return state, failures


def first_contact(case: Case, comm: MPI.Comm) -> State:
    """Return the contact of a case before any wear, as of a block of one. Collective on comm."""
    block = Block.of([case], [assemble(case, comm)])
    with TaoContact(block.compliance, block.by_force) as solver:
        return start(block, solver)[0]


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
    failures = simulate(
        Block.of([case], [pair]), save, tao=contact_solver() == "tao", first=first,
        following=following, every=every, comm=comm,
    )  # fmt: skip
    for error in failures.values():
        raise error


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
