"""Many cases at once: which step together, how many at a time, and what comes of them.

Sweeps and fits compute their histories here, by ``computed``; ``rw.simulate_all``, functions and
predictions share lists of cases out over the ranks.
"""

import logging
from collections import defaultdict
from collections.abc import Hashable, Sequence
from typing import Any, NamedTuple, TypeVar, cast

from mpi4py import MPI

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import Case, need_case
from ringwear_par.elasticity.bem.pair import ContactPair
from ringwear_par.errors import InputError, RingwearError
from ringwear_par.history.block import Block, block_key
from ringwear_par.history.elastic import assemble, operator_key
from ringwear_par.history.following import Following
from ringwear_par.history.loop import simulate
from ringwear_par.history.refusals import check_case, check_memory, check_mesh, stress_numbers
from ringwear_par.parallel import as_ours, together
from ringwear_par.results.recorder import Recorder
from ringwear_par.results.result import FailedResult, Result
from ringwear_par.results.variables import HISTORIES

log = logging.getLogger(__name__)
T = TypeVar("T")

#: numbers of histories that step together, of which one has about so many fields, and most of them
_NUMBERS, _FIELDS, MOST = 2**21, 32, 2048
#: most cases of a block of a list: more would be a little quicker, but leave fewer for other ranks
_MOST_OF_LIST = 512
#: bytes of the stored histories of cases that step together: they are in memory until all have
#: ended
_STORED_BYTES = 64e6
#: s, about, of a step of one of many histories of 64 elements, and of one whose elements follow the
#: wear; longest work that is lost with its process
_STEP_SECONDS, _MOVING_STEP_SECONDS, _BLOCK_SECONDS = 5e-6, 5e-2, 10.0


def simulate_all(
    cases: Sequence[Case], comm: MPI.Comm | None = None, *, batch: int | None = None
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
    if batch is not None and not (isinstance(batch, int) and batch >= 1):
        raise InputError(f"batch = {batch!r}: must be a whole number >= 1")
    if isinstance(cases, Case):
        raise InputError("simulate_all: a list of cases is needed; simulate takes one case")
    cases = list(cases)
    for number, case in enumerate(cases):
        need_case(case, f"simulate_all: cases[{number}]")
    return results_of(cases, MPI.COMM_WORLD if comm is None else comm, batch=batch)


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
    for number, case in enumerate(cases):
        try:
            groups[operator_key(cast(Case, case))].append(number)
        except Exception:  # of a case that is no good; its block says why
            groups[number].append(number)
    blocks: list[list[int]] = []
    for numbers in groups.values():
        first = cases[numbers[0]]
        most = min(most_together(first), _MOST_OF_LIST) if isinstance(first, Case) else 1
        blocks += [numbers[i : i + (batch or most)] for i in range(0, len(numbers), batch or most)]
    pairs: dict[Hashable, ContactPair] = {}

    def block_of(numbers: Sequence[int]) -> dict[int, Result | FailedResult]:
        """Return the results of cases of a contact pair, by this rank alone."""
        parts, found = computed(
            [_checked(cases[n]) for n in numbers], pairs, results=True,
            step_times=_some(step_times, numbers), paces=_some(paces, numbers),
        )  # fmt: skip
        outcomes: dict[int, Result | Exception] = {**found}
        for part in parts:
            outcomes |= zip(part.numbers, part.recorder.results(part.failures), strict=True)
        return {numbers[i]: _outcome(cases[numbers[i]], of) for i, of in outcomes.items()}

    results: dict[int, Result | FailedResult] = {}
    with together(comm):  # or the others would wait for its results
        mine = [block_of(numbers) for numbers in blocks[comm.rank :: comm.size]]
    for i in range(len(blocks)):  # one by one: all might be too much for a message
        part = mine[i // comm.size] if i % comm.size == comm.rank else {}
        results |= comm.bcast(part, i % comm.size) if comm.size > 1 else part
    return [results[number] for number in range(len(cases))]


def _checked(case: Case | RingwearError) -> Case | Exception:
    """Return a case, or why it cannot be computed; its mesh is checked with its contact pair."""
    try:
        if isinstance(case, Case):
            check_case(case, 1, "case", known_mesh=True)
    except Exception as error:
        return error
    return case


def _outcome(case: Case | RingwearError, result: Result | Exception) -> Result | FailedResult:
    """Return the result of a case, or the failed one of a case without a history."""
    if isinstance(result, Result):
        return result
    log.debug("a case failed", exc_info=result)
    reason = as_ours(result)
    # they hold the model and its matrices
    reason.__traceback__ = reason.__cause__ = reason.__context__ = None
    return FailedResult(case.stored_text if isinstance(case, Case) else "", reason)


# -- cases of one rank, or of ranks that share each ------------------------------------------------


def most_together(case: Case, assembly: float = 0.0) -> int:
    """Return how many histories like a case's are computed together, whatever the ranks.

    More of them share the time that Python takes for each operation: 64 elements, one core, 512,
    1,024 and 2,048 of them: 460, 404 and 374 us a history, in 60 kB of memory each. Fewer where
    they are long, or large, or where the ``assembly`` of contact pairs takes so many s of each.
    """
    n, rows = case.mesh.contact_elements, case.stored_rows
    size = 8.0 * rows * (len(HISTORIES) + 2)  # with their numbers and steps
    size += 8.0 * n * len(case.output.fields) * (rows if case.output.profiles == "all" else 1.0)
    if case.stress is not None:
        size += 8.0 * stress_numbers(case)[1]
    step = _MOVING_STEP_SECONDS if case.follows_wear else _STEP_SECONDS
    seconds = assembly + step * case.about_steps * (1.0 + (n / 64.0) ** 2)
    most = min(_most_side_by_side(case), _STORED_BYTES / size, _BLOCK_SECONDS / seconds)
    return max(int(most), 1)


def _most_side_by_side(case: Case) -> int:
    """Return how many histories like a case's step at a time, for their fields to stay in cache."""
    return min(max(_NUMBERS // (_FIELDS * case.mesh.contact_elements), 16), MOST)


class Computed(NamedTuple):
    """Cases that were computed together."""

    #: of the cases among all
    numbers: Sequence[int]
    #: of their histories
    recorder: Recorder
    #: why some of them failed, by place in ``numbers``
    failures: dict[int, Exception]


def computed(
    cases: Sequence[Case | Exception],
    pairs: dict[Hashable, ContactPair],
    comm: MPI.Comm = MPI.COMM_SELF,
    *,
    results: bool = False,
    step_times: Sequence[Sequence[float]] | None = None,
    paces: Sequence[FloatArray] | None = None,
) -> tuple[list[Computed], dict[int, Exception]]:
    """Compute cases, those that can side by side. Collective on comm.

    Parameters
    ----------
    cases : or why there is none.
    pairs : of earlier cases, by operator; become those of these cases.
    results : whether there are to be results, beside columns.
    step_times, paces : of each case, see ``Block.of``.

    Returns
    -------
    parts : cases that were computed together; some may have failed.
    errors : why others have no history, by number.

    Raises
    ------
    InputError : an option for PETSc, which no case can do with.
    """
    errors = {number: case for number, case in enumerate(cases) if isinstance(case, Exception)}
    good = {number: case for number, case in enumerate(cases) if isinstance(case, Case)}
    keys = {number: operator_key(case) for number, case in good.items()}
    for key in pairs.keys() - {*keys.values()}:
        del pairs[key]
    groups: dict[Hashable, list[int]] = defaultdict(list)
    for number, case in good.items():
        if keys[number] not in pairs and (failure := _add_pair(case, pairs, comm)) is not None:
            errors[number] = failure
        else:
            groups[block_key(case)].append(number)
    blocks: list[list[int]] = []
    for numbers in groups.values():
        # those of the same moduli share a matrix
        numbers.sort(key=lambda n: (good[n].lower.young, good[n].upper.young))
        size = _most_side_by_side(good[numbers[0]])
        blocks += [numbers[i : i + size] for i in range(0, len(numbers), size)]
    parts = []
    for numbers in blocks:
        chosen = [good[number] for number in numbers]
        try:
            following = Following(chosen[0], comm) if chosen[0].follows_wear else None
            pair = [following.pair] if following else [pairs[keys[n]] for n in numbers]
            recorder = Recorder(chosen, comm, results=results, pair_is_shared=not following)
            block = Block.of(chosen, pair, _some(step_times, numbers), _some(paces, numbers))
            failures = simulate(block, recorder, following=following, comm=comm)
            parts.append(Computed(numbers, recorder, failures))
        except InputError:
            raise
        except Exception as error:  # the same for all of them
            errors |= dict.fromkeys(numbers, error)
    return parts, errors


def _add_pair(case: Case, pairs: dict[Hashable, ContactPair], comm: MPI.Comm) -> Exception | None:
    """Add the contact pair of a case, or return why it has none. Collective on comm."""
    try:
        check_memory(case, comm.size, "case")
        check_mesh(case, "case")
    except InputError as error:
        return error
    try:
        with together(comm):
            pairs[operator_key(case)] = assemble(case, comm)
    except InputError:
        raise
    except Exception as error:
        return error
    return None


def _some(values: Sequence[T] | None, numbers: Sequence[int]) -> list[T] | None:
    """Return some of the values, or None where there are none."""
    return None if values is None else [values[number] for number in numbers]
