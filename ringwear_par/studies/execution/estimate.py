"""The dry run of a sweep: what there is to do, and about how long it will take."""

import heapq
import time
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import FloatArray
from ringwear_par.elasticity.bem.assembly import load_kernels
from ringwear_par.elasticity.pair import ContactPair
from ringwear_par.history.elastic.pairs import assemble
from ringwear_par.history.loop import simulate_one
from ringwear_par.history.snapshots import Snapshot
from ringwear_par.parallel import on_first_rank
from ringwear_par.results.execution.progress import duration
from ringwear_par.results.execution.recorder import Recorder
from ringwear_par.studies.execution.batches import computed
from ringwear_par.studies.execution.plan import Plan
from ringwear_par.studies.execution.scheduling import Board
from ringwear_par.studies.execution.workers import goes_with_others

#: memory of a rank without its matrices (Python, MPI, PETSc, compiled code)
_BARE_BYTES = 250e6
#: longest trial of a case alone, and of some side by side
_TRIAL_SECONDS = 20.0
#: most cases of a trial side by side, and the part of them that tells what any number costs
_TRIED, _FEW = 64, 8
#: and of all that are to be computed: a look is to be short beside them
_TRIED_OF = 1 / 12
#: s, of loading what is needed and writing the files, and of a case in both: about
_START_SECONDS, _CASE_SECONDS = 0.7, 1e-4


@dataclass(frozen=True)
class _Stepping:
    """What some cases that are drawn together take: so much to begin with, and each, s."""

    begin: float
    each: float


def estimate(plan: Plan, comm: MPI.Intracomm) -> str:
    """Return what there is to do, and how long it will take by timed ones.

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
        f"{len(study.members)} distinct operator(s), {len(left)} still needed",
    ]
    if plan.others:
        lines.insert(
            1,
            f"{plan.others} cases in {request.folder} are not of this study; they stay there, "
            'with in_study = "no"',
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
            return False  # adaptive steps grow: what the first ones take says little
        return time.perf_counter() - t2 > _TRIAL_SECONDS

    simulate_one(case, MPI.COMM_SELF, pair=pair, observers=[recorder, enough])
    assert recorder.last is not None
    reached = float(recorder.last.state.time[0])
    t3 = time.perf_counter()
    alone = (t3 - t2) * case.time.end / reached
    stepping = _stepping(plan, group, pair, alone)
    together = ""
    if stepping.begin:
        together = f", {1e3 * stepping.each:.2g} ms more for each case that goes side by side"
    assembly = (t1 - t0) * study.assembly / study.assembly[group]
    count, memory = plan.cases_left, _BARE_BYTES * request.ranks + plan.memory_needed()
    seconds = _START_SECONDS + _CASE_SECONDS * count
    seconds += _dealt(plan, stepping, study.work / study.work[number], assembly)
    size = sum(table.nbytes for table in recorder.columns().histories.values())
    lines += [
        f"first case timed on one rank: {t1 - t0:.3g} s for its operator, {alone:.3g} s for its "
        f"{case.time.scheme} steps{'' if reached >= case.time.end else ' (the first of them)'}"
        f"{together}",
        f"estimate for {count} cases on {request.ranks} rank(s) in {request.teams} team(s), from "
        f"these times: about {duration(float(f'{seconds:.2g}'))}, "
        f"about {memory / 1e6:.0f} MB of memory in all ({memory / request.ranks / 1e6:.0f} MB a "
        f"rank), {size * count / 1e6:.3g} MB on disk",
    ]
    return "\n".join(lines)


def _stepping(plan: Plan, group: int, pair: ContactPair, alone: float) -> _Stepping:
    """Return what cases of a group take side by side where they go so, by some of them.

    Parameters
    ----------
    alone : s, of the first one.
    """
    numbers = plan.todo[group]
    most = min(_TRIED, max(2, int(_TRIED_OF * plan.cases_left)))
    tried = min(len(numbers), most, int(_FEW * _TRIAL_SECONDS / alone))
    case = plan.study.case(int(numbers[0]))
    if plan.request.ranks_per_case > 1 or not goes_with_others(case):
        tried = 1
    few, limit = max(tried // _FEW, 1), time.perf_counter() + _TRIAL_SECONDS
    seconds = []
    for count in (tried, few) if tried > 1 else ():
        cases, _ = plan.study.made(numbers[np.linspace(0, len(numbers) - 1, count).astype(int)])
        begun = time.perf_counter()
        if not list(computed(cases, pair, stop=lambda: time.perf_counter() > limit)):
            return _Stepping(0.0, alone)
        seconds.append(time.perf_counter() - begun)
    if not seconds:
        return _Stepping(0.0, alone)
    many, fewer = seconds
    each = max(many - fewer, 0.0) / (tried - few) or many / tried
    return _Stepping(max(fewer - few * each, 0.0), each)


def _dealt(plan: Plan, stepping: _Stepping, shares: FloatArray, assembly: FloatArray) -> float:
    """Return the seconds until the teams have done all that is dealt to them.

    Parameters
    ----------
    shares : (cases,) of the study, stepping of each over that of the first case.
    assembly : (groups,) s, of each operator on one rank.
    """
    todo, teams = plan.todo, plan.request.teams
    started = assembly[plan.left].sum() / plan.request.ranks if plan.all_assemble else 0.0
    work = plan.study.work
    guesses = [float(work[todo[group][:1]].sum()) for group in range(len(todo))]
    board = Board(todo.sizes, teams, guesses)
    free, last = [(float(started), team) for team in range(teams)], 0.0
    while free:
        now, team = heapq.heappop(free)
        drawn = board.draw(team)
        if drawn is None:
            last = max(last, now)
            continue
        group, first, count = drawn
        cases = todo[group][first : first + count]
        seconds = stepping.begin + stepping.each * float(shares[cases].sum())
        board.count(group, count, 0, seconds)
        if not first and not plan.all_assemble:
            seconds += assembly[group] / plan.request.ranks_per_case
        heapq.heappush(free, (now + seconds, team))
    return last
