"""Histories that step together: which cases do, how many at a time, and what comes of them.

Sweeps, lists of cases and fits all compute their histories here.
"""

from collections import defaultdict
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

from mpi4py import MPI

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import Case
from ringwear_par.elasticity.bem.pair import ContactPair
from ringwear_par.errors import InputError
from ringwear_par.history.block import Block, block_key
from ringwear_par.history.elastic import assemble, operator_key
from ringwear_par.history.following import Following
from ringwear_par.history.loop import simulate
from ringwear_par.history.refusals import check_memory, check_mesh, stress_numbers
from ringwear_par.history.stresses import stress_key
from ringwear_par.parallel import together
from ringwear_par.results.recorder import Recorder
from ringwear_par.results.result import HistoryColumns, Result
from ringwear_par.results.variables import HISTORIES

T = TypeVar("T")

#: numbers of histories that step together, of which one has about so many fields, and most of them
_NUMBERS, _FIELDS, MOST = 2**21, 32, 2048
#: bytes of the stored histories of cases that step together: they are in memory until all have
#: ended
_STORED_BYTES = 64e6
#: s, about, of a step of one of many histories of 64 elements, and of one whose elements follow the
#: wear; longest work that is lost with its process
_STEP_SECONDS, _MOVING_STEP_SECONDS, _BLOCK_SECONDS = 5e-6, 5e-2, 10.0


def most_together(case: Case, assembly: float = 0.0) -> int:
    """Return how many histories like a case's are computed together, whatever the ranks.

    More of them share the time that Python takes for each operation: 64 elements, one core, 512,
    1,024 and 2,048 of them: 460, 404 and 374 us a history, in 60 kB of memory each. Fewer where
    they are long, or large.

    Parameters
    ----------
    assembly : s, of contact pairs, for each case.
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


def _side_by_side(cases: Mapping[int, Case]) -> list[list[int]]:
    """Return the numbers of cases that step together."""
    groups: dict[Hashable, list[int]] = defaultdict(list)
    for number, case in cases.items():
        groups[case.stress and stress_key(case), block_key(case)].append(number)
    parts: list[list[int]] = []
    for numbers in groups.values():
        # those of the same moduli share a matrix
        numbers.sort(key=lambda n: (cases[n].lower.young, cases[n].upper.young))
        size = _most_side_by_side(cases[numbers[0]])
        parts += [numbers[i : i + size] for i in range(0, len(numbers), size)]
    return parts


@dataclass(frozen=True)
class Computed:
    """Cases that were computed together."""

    #: of the cases among all
    numbers: tuple[int, ...]
    #: of their histories
    recorder: Recorder
    #: why some of them failed, by place in ``numbers``
    failures: dict[int, Exception]

    @property
    def columns(self) -> HistoryColumns:
        """The histories as they are stored, in the order of the numbers."""
        return self.recorder.columns(self.failures)

    def results(self) -> dict[int, Result | Exception]:
        """Return the results, or why there are none, by number."""
        return dict(zip(self.numbers, self.recorder.results(self.failures), strict=True))


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
    pairs : of earlier cases, by operator; those that these cases lack are added.
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
    errors: dict[int, Exception] = {}
    good: dict[int, Case] = {}
    for number, case in enumerate(cases):
        if isinstance(case, Exception):
            errors[number] = case
        elif (error := _without_pair(case, pairs, comm)) is not None:
            errors[number] = error
        else:
            good[number] = case
    parts = []
    for numbers in _side_by_side(good):
        chosen = [good[number] for number in numbers]
        try:
            following = Following(chosen[0], comm) if chosen[0].follows_wear else None
            pair = [pairs[operator_key(c)] for c in chosen] if not following else [following.pair]
            recorder = Recorder(chosen, comm, results=results, pair_is_shared=not following)
            block = Block.of(chosen, pair, some(step_times, numbers), some(paces, numbers))
            failures = simulate(block, recorder, following=following)
        except InputError:
            raise
        except Exception as error:  # the same for all of them
            errors |= dict.fromkeys(numbers, error)
        else:
            parts.append(Computed(tuple(numbers), recorder, failures))
    return parts, errors


def _without_pair(
    case: Case, pairs: dict[Hashable, ContactPair], comm: MPI.Comm
) -> Exception | None:
    """Have the contact pair of a case among the pairs, or return why it has none. Collective."""
    if (key := operator_key(case)) in pairs:
        return None
    try:
        check_memory(case, comm.size, "case")
        check_mesh(case, "case")
    except InputError as error:
        return error
    try:
        with together(comm):
            pairs[key] = assemble(case, comm)
    except InputError:
        raise
    except Exception as error:
        return error
    return None


def some(values: Sequence[T] | None, numbers: Sequence[int]) -> list[T] | None:
    """Return some of the values, or None where there are none."""
    return None if values is None else [values[number] for number in numbers]
