"""``rw.simulate_all``: many cases at once, shared out over the ranks."""

import logging
from collections import defaultdict
from collections.abc import Hashable, Iterator, Mapping, Sequence
from pathlib import Path

from mpi4py import MPI

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import Case, need_case
from ringwear_par.elasticity.bem.pair import ContactPair
from ringwear_par.errors import InputError
from ringwear_par.history.elastic.bodies import operator_key
from ringwear_par.history.elastic.pairs import assemble
from ringwear_par.history.refusals.cases import check_case
from ringwear_par.parallel import as_ours, together
from ringwear_par.results.result import FailedResult, Result
from ringwear_par.studies.definition.variations import is_whole
from ringwear_par.studies.execution.batches import computed

log = logging.getLogger(__name__)


def simulate_all(
    cases: Sequence[Case],
    comm: MPI.Comm | None = None,
    *,
    batch: int | None = None,
) -> list[Result | FailedResult]:
    """Return the wear histories of many cases, in their order.

    Collective on comm, the world's where none is given; every rank gets all of them. Cases that can
    share a contact pair do; each is simulated by one rank. A case that fails does not disturb the
    others.

    Parameters
    ----------
    cases : the same on all ranks.
    batch : most histories that a rank steps side by side; None: as many as are quickest. Results
        do not depend on it.

    Returns
    -------
    list : a Result or a FailedResult for each case.

    Raises
    ------
    InputError : ``batch`` is no whole number >= 1, or there is something else than cases.

    Examples
    --------
    >>> import ringwear_par as rw
    >>> case = rw.read_case("scripts/cases/paper.toml")
    >>> cases = [case.replace({"load.pressure": pressure}) for pressure in (60, 80)]
    >>> [f"{1e3 * one.histories['penetration'][-1]:.2f} um" for one in rw.simulate_all(cases)]
    ['5.17 um', '9.73 um']
    """
    if batch is not None and not (is_whole(batch) and batch >= 1):
        raise InputError(f"batch = {batch!r}: must be a whole number >= 1")
    if isinstance(cases, Case | Mapping | str | Path):
        raise InputError(
            f"simulate_all: a list of cases is needed, not {type(cases).__name__}; simulate "
            "takes one case"
        )
    cases = list(cases)
    for number, case in enumerate(cases):
        need_case(case, f"simulate_all: cases[{number}]")
    comm = MPI.COMM_WORLD if comm is None else comm
    return results_of(cases, comm, batch=batch)


def results_of(
    cases: Sequence[Case],
    comm: MPI.Comm,
    *,
    batch: int | None = None,
    step_times: Sequence[Sequence[float]] | None = None,
    paces: Sequence[FloatArray] | None = None,
) -> list[Result | FailedResult]:
    """Return the histories of cases on all ranks, see ``simulate_all``. Collective on comm.

    Step times (s) are the ends of the steps of each case; paces (2, steps) are factors on the rates
    of each.
    """
    results: dict[int, Result | FailedResult] = {}
    groups: dict[Hashable, list[int]] = defaultdict(list)
    for number, checked in enumerate(_checked(cases, comm)):
        if isinstance(checked, FailedResult):
            results[number] = checked
        else:
            groups[checked].append(number)
    dealt: list[int] = []  # in turn to all ranks, whatever the groups
    waiting: list[tuple[ContactPair, list[int]]] = []
    for numbers in groups.values():
        try:
            with together(comm):
                pair = assemble(cases[numbers[0]], comm)
        except Exception as error:
            results.update((n, _failed(cases[n], error)) for n in numbers)
            continue
        rounds = len(dealt) // comm.size
        mine = numbers[(comm.rank - len(dealt)) % comm.size :: comm.size]
        dealt += numbers
        if mine:
            waiting.append((pair, mine))
        if len(dealt) // comm.size > rounds:  # every rank has something to do
            with together(comm):
                results.update(_simulated(cases, waiting, batch, step_times, paces))
            waiting = []
    with together(comm):  # or the others would wait for its results
        results.update(_simulated(cases, waiting, batch, step_times, paces))
    if comm.size > 1:
        for place, number in enumerate(dealt):  # one by one: all might be too much for a message
            results[number] = comm.bcast(results.get(number), place % comm.size)
    return [results[number] for number in range(len(cases))]


def _checked(cases: Sequence[Case], comm: MPI.Comm) -> list[Hashable | FailedResult]:
    """Return the key of the pair of each case, or the failure of a case that is refused.

    Collective on comm: every rank checks its share.
    """
    checked: list[Hashable | FailedResult] = []
    known: set[Hashable] = set()
    for case in cases[comm.rank :: comm.size]:
        try:
            key = operator_key(case)
            check_case(case, 1, "case", known_mesh=key in known)
            known.add(key)
            checked.append(key)
        except Exception as error:
            checked.append(_failed(case, error))
    parts = comm.allgather(checked)
    return [parts[number % comm.size][number // comm.size] for number in range(len(cases))]


def _simulated(
    cases: Sequence[Case],
    work: Sequence[tuple[ContactPair, Sequence[int]]],
    batch: int | None,
    step_times: Sequence[Sequence[float]] | None,
    paces: Sequence[FloatArray] | None,
) -> Iterator[tuple[int, Result | FailedResult]]:
    """Yield numbers and results of cases, by the pair that they share, on this rank alone."""
    for pair, numbers in work:
        chosen = [cases[number] for number in numbers]
        blocks = computed(
            chosen, pair, batch=batch, results=True,
            step_times=None if step_times is None else [step_times[n] for n in numbers],
            paces=None if paces is None else [paces[n] for n in numbers],
        )  # fmt: skip
        for block in blocks:
            for place, result in zip(block.numbers, block.results(), strict=True):
                if isinstance(result, Exception):
                    yield numbers[place], _failed(chosen[place], result)
                else:
                    yield numbers[place], result


def _failed(case: Case, error: Exception) -> FailedResult:
    """Return the result of a case that failed."""
    log.debug("a case failed", exc_info=error)
    reason = as_ours(error)
    # they hold the model and its matrices
    reason.__traceback__ = reason.__cause__ = reason.__context__ = None
    return FailedResult(case.stored_text, reason)
