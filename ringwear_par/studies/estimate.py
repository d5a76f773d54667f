"""The dry run of a sweep: what there is to do, and how long it will take."""

import time

from mpi4py import MPI

from ringwear_par.elasticity.assembly import load_kernels
from ringwear_par.history.pairs import assemble
from ringwear_par.history.simulate import simulate
from ringwear_par.history.snapshots import Snapshot
from ringwear_par.parallel import on_first_rank
from ringwear_par.results.progress import duration
from ringwear_par.results.recorder import Recorder
from ringwear_par.studies.plan import Plan

#: memory of a rank without its matrices (Python, MPI, PETSc, compiled code)
_BARE_BYTES = 250e6
#: longest trial
_TRIAL_SECONDS = 20.0


def estimate(plan: Plan, comm: MPI.Intracomm) -> str:
    """Return what there is to do, and how long it will take by a timed first case.

    Collective on comm; the same on all ranks.

    Raises
    ------
    RingwearError : the first case fails.
    """
    load_kernels(comm)
    return on_first_rank(comm, lambda: _timed(plan))


def _timed(plan: Plan) -> str:
    """Compute the first case, or the first of its steps, on one rank."""
    study, request, left = plan.study, plan.request, plan.left
    lines = [
        f"{plan.total} cases, {plan.done} done, {plan.failed} failed before",
        f"{len(study.members)} distinct operator(s), {len(left)} still needed",
    ]
    if not left:
        return "\n".join(lines)
    group, number = left[0], int(plan.todo[left[0]][0])
    case = study.case(number)
    t0 = time.perf_counter()
    pair = assemble(case, MPI.COMM_SELF, use_kept=False)  # others may be unknown
    t1 = time.perf_counter()
    recorder = Recorder(case, MPI.COMM_SELF)
    t2 = time.perf_counter()

    def enough(snapshot: Snapshot) -> bool:
        if snapshot.step is None or case.time.adaptive:
            return False  # adaptive steps grow: what the first ones take says little
        return time.perf_counter() - t2 > _TRIAL_SECONDS

    state = simulate(case, MPI.COMM_SELF, pair=pair, observers=[recorder, enough])
    t3 = time.perf_counter()
    stepping = (t3 - t2) * case.time.end / state.time
    assembly = (t1 - t0) * study.assembly[left].sum() / study.assembly[group]
    cases = plan.todo.cases
    steps = stepping * study.work[cases].sum() / study.work[number]
    size = sum(table.nbytes for table in recorder.arrays().values())
    memory = _BARE_BYTES * request.ranks + plan.memory_needed()
    lines += [
        f"first case timed on one rank: {t1 - t0:.3g} s for its operator, {stepping:.3g} s for its "
        f"{case.time.scheme} steps{'' if state.time >= case.time.end else ' (the first of them)'}",
        f"estimate for {len(cases)} cases on {request.ranks} rank(s) in {request.teams} team(s): "
        f"{duration((assembly + steps) / request.teams)}, about {memory / 1e6:.0f} MB of memory in "
        f"all ({memory / request.ranks / 1e6:.0f} MB a rank), {size * len(cases) / 1e6:.3g} MB on "
        "disk",
    ]
    return "\n".join(lines)
