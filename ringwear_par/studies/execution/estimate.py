"""The dry run of a sweep: how many cases are left, and about how long they take."""

import time

import numpy as np
from mpi4py import MPI

from ringwear_par.compiled.machine_code import load
from ringwear_par.compiled.modules import LOOPS
from ringwear_par.history.elastic.pairs import assemble
from ringwear_par.history.lockstep import batch_key
from ringwear_par.history.loop import simulate
from ringwear_par.history.snapshots import Snapshot
from ringwear_par.parallel import on_first_rank
from ringwear_par.results.execution.progress import duration
from ringwear_par.results.execution.recorder import Recorder
from ringwear_par.studies.execution.batches import PairResources
from ringwear_par.studies.execution.plan import Plan
from ringwear_par.studies.execution.single_cases import is_batchable

#: memory of a rank without its matrices (Python, MPI, PETSc, compiled code)
_BARE_BYTES = 250e6
#: longest trial, most cases of it, and of all that are to be computed: it is to be short
_TRIAL_SECONDS, _TRIED, _TRIED_OF = 20.0, 64, 1 / 12
#: s, of loading the program and writing the files, and of a case in both: about
_START_SECONDS, _CASE_SECONDS = 0.7, 1e-4


def estimate(plan: Plan, comm: MPI.Intracomm) -> str:
    """Return the numbers of cases and operators, and the time they will take by a trial.

    Collective on comm; the same on all ranks. RingwearError where all of these fail.
    """
    return on_first_rank(comm, lambda: _timed(plan))


def _timed(plan: Plan) -> str:
    """Compute some cases, or the first of their steps, side by side on one rank."""
    study, request, left = plan.study, plan.request, plan.left
    lines = [
        f"{plan.total} cases, {plan.done} done, {plan.failed} failed before",
        f"{len(study.members)} distinct contact pair(s), {len(left)} still needed",
    ]
    if plan.not_in_study:
        lines.insert(
            1,
            f"{plan.not_in_study} cases in {request.folder} are not of this study; they stay "
            'there, with in_study = "no"',
        )
    if not left:
        return "\n".join(lines)
    group, numbers = left[0], plan.todo[left[0]]
    first = plan.first_case(group)
    tried = 1
    if is_batchable(first) and request.ranks_per_case == 1:
        tried = min(len(numbers), _TRIED, max(int(_TRIED_OF * plan.cases_left), 1))
    numbers = numbers[np.linspace(0, len(numbers) - 1, tried).astype(int)]
    cases = [c for c in study.cases_of(numbers) if batch_key(c) == batch_key(first)]
    for loops in LOOPS:  # their first time, which compiles, is no step's
        load(loops)
    t0 = time.perf_counter()
    pair = assemble(first, MPI.COMM_SELF)
    t1 = time.perf_counter()
    resources, reached = PairResources(pair, MPI.COMM_SELF), np.zeros(len(cases))
    recorder = Recorder(cases, MPI.COMM_SELF, stresses=resources.stresses, results=False)

    def enough(snapshot: Snapshot) -> bool:
        reached[snapshot.numbers] = snapshot.state.time
        return snapshot.step is not None and time.perf_counter() - t1 > _TRIAL_SECONDS

    outcome = simulate(cases, MPI.COMM_SELF, pair=pair, observers=[recorder, enough])
    if len(outcome.failures) == len(cases):
        raise next(iter(outcome.failures.values()))
    shares = float((reached / [case.time.end for case in cases]).sum())
    seconds_of_case = (time.perf_counter() - t1) / shares
    assembly = (t1 - t0) * study.assembly / study.assembly[group]
    count, memory = plan.cases_left, _BARE_BYTES * request.ranks + plan.memory_needed()
    todo = np.concatenate([plan.todo[k] for k in left])
    stepping = seconds_of_case * float(study.work[todo].sum() / study.work[numbers].mean())
    seconds = _START_SECONDS + _CASE_SECONDS * count
    seconds += (float(assembly[left].sum()) + stepping) / request.ranks
    size = sum(table.nbytes for table in recorder.columns().histories.values()) / shares
    lines += [
        f"timed on one rank: {t1 - t0:.3g} s for an assembly, {seconds_of_case:.2g} s for the "
        f"{first.time.scheme} steps of a case, of {len(cases)} side by side"
        f"{' (the first of their steps)' if outcome.interrupted else ''}",
        f"estimate for {count} cases on {request.ranks} rank(s) in {request.teams} team(s), from "
        f"these times: about {duration(float(f'{seconds:.2g}'))}, "
        f"about {memory / 1e6:.0f} MB of memory in all ({memory / request.ranks / 1e6:.0f} MB a "
        f"rank), {size * count / 1e6:.3g} MB on disk",
    ]
    return "\n".join(lines)
