"""``rw.simulate_all``: many cases at once, shared out over the ranks."""

import logging
from collections import defaultdict
from collections.abc import Hashable, Mapping, Sequence
from pathlib import Path
from typing import Any, cast

from mpi4py import MPI

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import Case, need_case
from ringwear_par.elasticity.bem.pair import ContactPair
from ringwear_par.errors import InputError, RingwearError
from ringwear_par.history.elastic import operator_key
from ringwear_par.history.refusals import check_case
from ringwear_par.parallel import as_ours, together
from ringwear_par.results.result import FailedResult, Result
from ringwear_par.studies.together import computed, most_together, some
from ringwear_par.studies.variations import is_whole

log = logging.getLogger(__name__)

#: most cases of a block: more would be a little quicker, but leave fewer for other ranks
_MOST = 512


def simulate_all(
    cases: Sequence[Case],
    comm: MPI.Comm | None = None,
    *,
    batch: int | None = None,
) -> list[Result | FailedResult]:
    """Return the wear histories of many cases, in their order.

    Collective on comm, the world's where none is given; every rank gets all of them. Cases that can
    share a contact pair do; blocks of them, each of one rank, are dealt in turn. A case that fails
    does not disturb the others.

    Parameters
    ----------
    cases : the same on all ranks.
    batch : most cases of a block; None: as many as are quickest. Results depend on it by round-off
        only, and not on the number of ranks.

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
    cases: Sequence[Case | RingwearError],
    comm: MPI.Comm,
    *,
    batch: int | None = None,
    step_times: Sequence[Any] | None = None,
    paces: Sequence[FloatArray] | None = None,
) -> list[Result | FailedResult]:
    """Return the histories of cases on all ranks, see ``simulate_all``. Collective on comm.

    Blocks of cases of one contact pair are computed by the ranks in turn. Step times (s) are the
    ends of the steps of each case; paces (2, steps) are factors on the rates of each. A case may be
    an error already.
    """
    groups: dict[Hashable, list[int]] = defaultdict(list)
    blocks: list[list[int]] = []
    for number, case in enumerate(cases):
        try:
            groups[operator_key(cast(Case, case))].append(number)
        except Exception:  # of a case that is no good; its block says why
            blocks.append([number])
    for numbers in groups.values():
        size = batch or min(most_together(cast(Case, cases[numbers[0]])), _MOST)
        blocks += [numbers[i : i + size] for i in range(0, len(numbers), size)]
    pairs: dict[Hashable, ContactPair] = {}

    def computed_block(numbers: Sequence[int]) -> list[Result | FailedResult]:
        """Return the results of cases of a contact pair, by this rank alone."""
        for key in [*pairs][:-1]:  # blocks of the last one may follow
            del pairs[key]
        parts, errors = computed(
            [_checked(cases[n]) for n in numbers], pairs, results=True,
            step_times=some(step_times, numbers), paces=some(paces, numbers),
        )  # fmt: skip
        results: dict[int, Result | Exception] = {**errors}
        for part in parts:
            results |= part.results()
        return [_stored(cases[number], results[i]) for i, number in enumerate(numbers)]

    results: dict[int, Result | FailedResult] = {}
    with together(comm):  # or the others would wait for its results
        mine = [computed_block(numbers) for numbers in blocks[comm.rank :: comm.size]]
    for i, numbers in enumerate(blocks):  # one by one: all might be too much for a message
        part = mine[i // comm.size] if i % comm.size == comm.rank else None
        part = comm.bcast(part, i % comm.size) if comm.size > 1 else part
        results.update(zip(numbers, part or (), strict=True))
    return [results[number] for number in range(len(cases))]


def _checked(case: Case | RingwearError) -> Case | Exception:
    """Return a case, or why it cannot be computed."""
    try:
        if isinstance(case, Case):  # its contact pair is checked with its mesh
            check_case(case, 1, "case", known_mesh=True)
    except Exception as error:
        return error
    return case


def _stored(case: Case | RingwearError, result: Result | Exception) -> Result | FailedResult:
    """Return the result of a case, which may have failed."""
    if isinstance(result, Result):
        return result
    log.debug("a case failed", exc_info=result)
    reason = as_ours(result)
    # they hold the model and its matrices
    reason.__traceback__ = reason.__cause__ = reason.__context__ = None
    return FailedResult(case.stored_text if isinstance(case, Case) else "", reason)
