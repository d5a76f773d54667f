"""The dry run of a sweep: how many cases are left, and about how long they take."""

import time

import numpy as np
from mpi4py import MPI

from ringwear_par.elasticity.bem.assembly import load_kernels
from ringwear_par.elasticity.bem.pair import ContactPair
from ringwear_par.history.elastic.pairs import assemble
from ringwear_par.history.loop import simulate_one
from ringwear_par.history.snapshots import Snapshot
from ringwear_par.parallel import on_first_rank
from ringwear_par.results.execution.progress import duration
from ringwear_par.results.execution.recorder import Recorder
from ringwear_par.studies.execution.batches import computed
from ringwear_par.studies.execution.plan import Plan
from ringwear_par.studies.execution.single_cases import is_batchable

#: memory of a rank without its matrices (Python, MPI, PETSc, compiled code)
_BARE_BYTES = 250e6
#: longest trial of a case alone, and of some side by side
_TRIAL_SECONDS = 20.0
#: most cases of a trial side by side, and of all that are to be computed: it is to be short
_TRIED, _TRIED_OF = 64, 1 / 12
#: s, of loading the program and writing the files, and of a case in both: about
_START_SECONDS, _CASE_SECONDS = 0.7, 1e-4


def estimate(plan: Plan, comm: MPI.Intracomm) -> str:
    """Return the numbers of cases and operators, and the time they will take by timed ones.

    Collective on comm; the same on all ranks.

    Raises
    ------
    RingwearError : the first case fails.
    """
    load_kernels(comm)
    return on_first_rank(comm, lambda: _timed(plan))


def _timed(plan: Plan) -> str:
    """Compute the first case, or the first of its steps, on one rank, then some side by side."""
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
    group, number = left[0], int(plan.todo[left[0]][0])
    case = study.case(number)
    t0 = time.perf_counter()
    pair = assemble(case, MPI.COMM_SELF, use_kept=False)  # others may be unknown
    t1 = time.perf_counter()
    recorder = Recorder([case], MPI.COMM_SELF)
    t2 = time.perf_counter()

    def enough(snapshot: Snapshot) -> bool:
        if snapshot.step is None or case.time.adaptive:
            return False  # adaptive steps grow: the first ones say little
        return time.perf_counter() - t2 > _TRIAL_SECONDS

    simulate_one(case, MPI.COMM_SELF, pair=pair, observers=[recorder, enough])
    assert recorder.last is not None
    reached = float(recorder.last.state.time[0])
    t3 = time.perf_counter()
    alone = (t3 - t2) * case.time.end / reached
    seconds_of_case = _side_by_side(plan, group, pair, alone)
    together = (
        ""
        if seconds_of_case == alone
        else f", {1e3 * seconds_of_case:.2g} ms for each case side by side with others"
    )
    assembly = (t1 - t0) * study.assembly / study.assembly[group]
    count, memory = plan.cases_left, _BARE_BYTES * request.ranks + plan.memory_needed()
    cases = np.concatenate([plan.todo[k] for k in left])
    stepping = seconds_of_case * float(study.work[cases].sum()) / study.work[number]
    seconds = _START_SECONDS + _CASE_SECONDS * count
    seconds += (float(assembly[left].sum()) + stepping) / request.ranks
    size = sum(table.nbytes for table in recorder.columns().histories.values())
    lines += [
        f"first case timed on one rank: {t1 - t0:.3g} s for its assembly, {alone:.3g} s for its "
        f"{case.time.scheme} steps{'' if reached >= case.time.end else ' (the first of them)'}"
        f"{together}",
        f"estimate for {count} cases on {request.ranks} rank(s) in {request.teams} team(s), from "
        f"these times: about {duration(float(f'{seconds:.2g}'))}, "
        f"about {memory / 1e6:.0f} MB of memory in all ({memory / request.ranks / 1e6:.0f} MB a "
        f"rank), {size * count / 1e6:.3g} MB on disk",
    ]
    return "\n".join(lines)


def _side_by_side(plan: Plan, group: int, pair: ContactPair, alone: float) -> float:
    """Return the seconds of a case of a group among others, as long as it steps with others.

    Parameters
    ----------
    alone : s, of the first one alone.
    """
    numbers = plan.todo[group]
    most = min(_TRIED, int(_TRIED_OF * plan.cases_left), int(_TRIAL_SECONDS / alone))
    tried, case = min(len(numbers), most), plan.study.case(int(numbers[0]))
    if tried < 2 or plan.request.ranks_per_case > 1 or not is_batchable(case):
        return alone
    cases = plan.study.cases_of(numbers[np.linspace(0, len(numbers) - 1, tried).astype(int)])
    begun = time.perf_counter()
    done = list(computed(cases, pair, stop=lambda: time.perf_counter() > begun + _TRIAL_SECONDS))
    return (time.perf_counter() - begun) / tried if done else alone
