"""Why histories of a block cannot go on, each in one sentence."""

import numpy as np
from mpi4py import MPI

from ringwear_par.cases.plausible import wear_question
from ringwear_par.elasticity.sections import BODIES
from ringwear_par.errors import ComputationError, UnfitError
from ringwear_par.history.block import Block
from ringwear_par.history.schemes import Solver
from ringwear_par.history.state import State, Step


def _law_fault(block: Block, row: int, comm: MPI.Comm) -> str:
    """Return what a user's law did wrong in a history on any rank, "" for nothing. Collective."""
    number = int(block.number[row])
    mine = (faults[number] for faults in block.cases.faults.values() if number in faults)
    return next(filter(None, comm.allgather(next(mine, ""))), "")


def contact_failure(block: Block, row: int, comm: MPI.Comm) -> ComputationError:
    """Return why a history has no contact before any wear. Collective on comm."""
    why = _law_fault(block, row, comm) or "contact: is not solved"
    return ComputationError(f"{why}; in step 0, before any wear")


def step_failure(
    block: Block, state: State, step: Step, row: int, comm: MPI.Comm
) -> ComputationError:
    """Return why no step of a history is short enough. Collective on comm."""
    if fault := _law_fault(block, row, comm):
        why = fault
    elif step.failed[row]:
        why = "contact: is not solved, and no step is short enough"
    elif step.too_far[row]:
        why = "no step ends where an element comes to the end of its layer"
    elif not np.isfinite(step.error[row]).all():
        why = "the estimated error of the step is not a number, and no step is short enough"
    else:
        why = (
            f"errors exceed {block.tolerance[row]:g} mm (time.tolerance; try a larger one), and no "
            "step is short enough"
        )
    where = f"in step {int(state.steps[row]) + 1}, from time {state.time[row]:g} s"
    return ComputationError(f"{why}; {where}")


def deep_wear_failure(block: Block, state: State, row: int) -> ComputationError:
    """Return why a state does not hold: wear is too deep, or contact at an end of the mesh."""
    case, time = block.cases.every[int(block.number[row])], state.time[row]
    where = f"; in step {int(state.steps[row]) + 1}"
    for body, wear, most in zip(block.wearing, state.wear, block.deepest[row], strict=True):
        if (deepest := wear[row].max()) > most:
            name = BODIES[body.body]
            return ComputationError(
                f"time {time:g} s: {deepest:.4g} mm are worn off {name}, more than half of its "
                f"height{wear_question(case, name)}{where}"
            )
    e = next(e for e in block.open_ends if state.pressure[row, e] > 0.0)
    return ComputationError(
        f"time {time:g} s: contact has reached the end of mesh.contact at "
        f"r = {case.line.edges[e]:g} mm; mesh.contact must be wider there{where}"
    )


def interpenetration(block: Block, solver: Solver) -> dict[int, Exception]:
    """Return which undeformed bodies overlap by more than the largest force presses them."""
    if not block.by_force or not (block.gap < 0.0).any():
        return {}
    p, zero = np.zeros_like(block.gap), np.zeros(len(block))
    approach = solver.solve(block.gap, block.load.y.max(axis=1), None, p, zero).approach
    failures: dict[int, Exception] = {}
    for i in np.flatnonzero(approach < 0.0).tolist():
        if (overlap := block.cases.every[i].interpenetration) == 0.0:
            continue
        e = int(block.gap[i].argmin())
        failures[i] = UnfitError(
            f"upper.z, lower.z and contact faces: the undeformed bodies interpenetrate by "
            f"{overlap:.6g} mm at element {e} (r = {block.line.r[e]:.6g} mm); must be at most "
            f"the {overlap + approach[i]:.6g} mm that the load presses them together"
        )
    return failures
