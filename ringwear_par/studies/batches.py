"""Cases of one contact pair, computed: in lock step where they can be, the others alone."""

import time
from collections import defaultdict
from collections.abc import Callable, Hashable, Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass

from mpi4py import MPI

from ringwear_par.cases.case import Case
from ringwear_par.contact.batch import has_own_options
from ringwear_par.elasticity.pair import ContactPair
from ringwear_par.history.batch import batch_key, can_share, simulate_batch
from ringwear_par.history.bodies import young
from ringwear_par.history.limits import stress_numbers
from ringwear_par.history.simulate import simulate
from ringwear_par.history.snapshots import Snapshot
from ringwear_par.results.batch import Alone, BatchRecorder
from ringwear_par.results.columns import HistoryColumns
from ringwear_par.results.recorder import Recorder
from ringwear_par.results.result import Result
from ringwear_par.results.variables import HISTORIES
from ringwear_par.studies.lending import Lender

#: numbers of a batch's Hessians, and most histories of it: see ``default_batch``
_NUMBERS, _MOST = 2**21, 512
#: batches of a block: as histories end others take their places, until none are left in it
_BATCHES = 4
#: of what is stored of a block, which waits in memory until all of it has ended; derivatives come
#: on top, as many times as much as there are: smaller blocks would be slower than these are large
_BLOCK_BYTES = 64e6


def default_batch(case: Case) -> int:
    """Return how many histories to step together, where nobody says.

    More histories share what Python takes for each operation, but their factors are to stay in the
    cache.
    """
    return min(max(_NUMBERS // case.mesh.contact_elements**2, 16), _MOST)


def _block(case: Case, most: int) -> int:
    """Return how many histories to store together, of which ``most`` step at a time."""
    profiles = case.stored_rows if case.output.profiles == "all" else 1.0
    each = 8.0 * profiles * case.mesh.contact_elements * len(case.output.fields)
    each += 8.0 * case.stored_rows * (len(HISTORIES) + 2)  # with their numbers and steps
    if case.stress is not None:
        each += 8.0 * stress_numbers(case)[1]
    return max(min(_BATCHES * most, int(_BLOCK_BYTES / each)), 1)


@dataclass(frozen=True)
class Computed:
    """Cases that were computed together.

    Parameters
    ----------
    numbers : of the cases among those that were given.
    recorder : what is stored of them.
    alone : those that were computed alone, by place in ``numbers``.
    """

    numbers: tuple[int, ...]
    recorder: BatchRecorder
    alone: dict[int, Alone]

    @property
    def columns(self) -> HistoryColumns:
        """What is stored, in the order of the numbers."""
        return self.recorder.columns(self.alone)

    def results(self) -> list[Result | Exception]:
        """Return the results, or why there are none."""
        together = self.recorder.results(self.alone)
        found: list[Result | Exception] = []
        for place in range(len(self.numbers)):
            one = self.alone.get(place)
            if one is None:
                found.append(together[place])
            elif one.error is not None:
                found.append(one.error)
            else:
                assert one.recorder is not None
                found.append(one.recorder.result())
        return found


def computed(
    cases: Sequence[Case],
    pair: ContactPair,
    *,
    lender: Lender | None = None,
    batch: int | None = None,
    stop: Callable[[], bool] = lambda: False,
    keep_ends: bool = False,
    derivatives: Sequence[str] = (),
    step_times: Sequence[Sequence[float]] | None = None,
) -> Iterator[Computed]:
    """Yield blocks of cases as they are computed, on this rank alone, until ``stop`` says so.

    Each case gets the same, to the last bit, in whatever company. Failures are among what is
    computed. What was begun when all are stopped is thrown away.

    Parameters
    ----------
    cases : that share a contact pair.
    lender : of the pair, to one rank; None: there is one for these cases alone.
    batch : most histories that step at a time; a block has some times as many.
    stop : asked between two steps, and may answer others meanwhile.
    keep_ends : whether there are to be results.
    derivatives : keys that the histories are to have derivatives with respect to.
    step_times : s, ends of the steps of each case, its own end the last; None: as cases say.
    """
    together: dict[Hashable, list[int]] = defaultdict(list)
    singles: list[int] = []
    own_options = has_own_options()  # they are of the solver of single contacts
    for number, case in enumerate(cases):
        key = None if own_options else batch_key(case)
        (singles if key is None else together[key]).append(number)
    for key, numbers in list(together.items()):
        if not can_share(cases[numbers[0]]):
            singles += together.pop(key)
    with nullcontext(lender) if lender else Lender(pair, MPI.COMM_SELF) as lent:
        for numbers in together.values():
            numbers.sort(key=lambda n: young(cases[n]))  # those of the same moduli share a matrix
            most = batch or default_batch(cases[numbers[0]])
            longest = max((cases[n] for n in numbers), key=lambda case: case.stored_rows)
            size = _block(longest, most)
            for first in range(0, len(numbers), size):
                part = numbers[first : first + size]
                own = [cases[number] for number in part]
                times = None if step_times is None else [step_times[n] for n in part]
                recorder = BatchRecorder(own, pair, lent.stresses, keep_ends, derivatives)
                left = simulate_batch(own, pair, recorder, stop, most, derivatives, times)
                if left is None:
                    return
                alone = {}
                for place in sorted(left, key=lambda i: young(own[i])):
                    grid = None if times is None else times[place]
                    if (one := _alone(own[place], lent, stop, derivatives, grid)) is None:
                        return
                    alone[place] = one
                yield Computed(tuple(part), recorder, alone)
        for number in sorted(singles, key=lambda n: young(cases[n])):
            grid = None if step_times is None else step_times[number]
            if (one := _alone(cases[number], lent, stop, derivatives, grid)) is None:
                return
            recorder = BatchRecorder([cases[number]], pair, lent.stresses, derivatives=derivatives)
            yield Computed((number,), recorder, {0: one})


def _alone(
    case: Case,
    lender: Lender,
    stop: Callable[[], bool],
    derivatives: Sequence[str],
    step_times: Sequence[float] | None,
) -> Alone | None:
    """Return a case computed by itself; None if it was stopped."""
    begun, recorder = time.perf_counter(), None
    stopped = False

    def asked(_: Snapshot) -> bool:
        nonlocal stopped
        stopped = stop()
        return stopped

    error: Exception | None = None
    try:
        recorder = Recorder(
            case, MPI.COMM_SELF, derivatives=derivatives, stresses=lender.stresses(case)
        )
        simulate(
            case, MPI.COMM_SELF, pair=lender.pair, solver=lender.solver(case),
            observers=[recorder, asked], derivatives=derivatives, step_times=step_times,
        )  # fmt: skip
    except Exception as failure:  # of the solver, or of a law that is not ours
        lender.drop()
        error = failure
    if stopped and (recorder is None or recorder.last is None or not recorder.last.finished):
        return None
    return Alone(recorder, error, time.perf_counter() - begun)
