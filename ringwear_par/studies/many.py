"""``rw.simulate_all``: many cases at once, shared out over the ranks."""

import logging
from collections import defaultdict
from collections.abc import Hashable, Iterator, Sequence
from dataclasses import replace

from mpi4py import MPI

from ringwear_par.cases.case import Case
from ringwear_par.elasticity.pair import ContactPair
from ringwear_par.errors import InputError
from ringwear_par.history.bodies import operator_key, young
from ringwear_par.history.limits import check_case
from ringwear_par.history.pairs import assemble
from ringwear_par.history.simulate import simulate
from ringwear_par.parallel import as_ours, together
from ringwear_par.results.recorder import Recorder
from ringwear_par.results.result import FailedResult, Result
from ringwear_par.studies.lending import SolverLender
from ringwear_par.studies.variations import is_whole

log = logging.getLogger(__name__)


def simulate_all(
    cases: Sequence[Case], comm: MPI.Comm | None = None, *, batch: int | None = None
) -> list[Result | FailedResult]:
    """Return the wear histories of many cases, in their order.

    Collective on comm, the world's where none is given; every rank gets all of them. Cases that can
    share a contact pair do; each is simulated by one rank. A case that fails does not disturb the
    others.

    Parameters
    ----------
    cases : the same on all ranks.
    batch : most histories that a rank steps side by side. Results do not depend on it, nor, as
        yet, does the time: they are stepped one after another.

    Raises
    ------
    InputError : ``batch`` is no whole number >= 1.
    """
    if batch is not None and not (is_whole(batch) and batch >= 1):
        raise InputError(f"batch = {batch!r}: must be a whole number >= 1")
    comm = MPI.COMM_WORLD if comm is None else comm
    groups: dict[Hashable, list[int]] = defaultdict(list)
    for number, case in enumerate(cases):
        groups[operator_key(case)].append(number)
    found: dict[int, Result | FailedResult] = {}
    for numbers in groups.values():
        try:
            with together(comm):
                pair = assemble(cases[numbers[0]], comm)
        except Exception as error:
            found.update((n, _failed(cases[n], error)) for n in numbers)
            continue
        numbers.sort(key=lambda n: young(cases[n]))  # those of the same moduli share a solver
        mine = numbers[comm.rank :: comm.size]
        own = dict(zip(mine, _simulated([cases[n] for n in mine], pair), strict=True))
        for part in comm.allgather(own):
            found.update(part)
    return [found[number] for number in range(len(cases))]


def _simulated(cases: Sequence[Case], pair: ContactPair) -> Iterator[Result | FailedResult]:
    """Yield the results of cases that share a pair, computed on this rank alone."""
    alone = MPI.COMM_SELF
    with SolverLender(pair, alone) as lender:
        for case in cases:
            try:
                check_case(case, 1, "case")
                recorder = Recorder(case, alone)
                simulate(case, alone, pair=pair, solver=lender.lend(case), observers=[recorder])
                yield replace(recorder.result(), comm=None)
            except Exception as error:  # of the solver, or of a law that is not ours
                lender.drop()
                yield _failed(case, error)


def _failed(case: Case, error: Exception) -> FailedResult:
    """Return what is told of a case that failed."""
    log.debug("a case failed", exc_info=error)
    told = as_ours(error)
    # they hold the model and its matrices
    told.__traceback__ = told.__cause__ = told.__context__ = None
    return FailedResult(case.told, told)
