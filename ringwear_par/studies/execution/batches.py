"""Cases of one contact pair, computed side by side where they can be."""

from collections import defaultdict
from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import FloatArray
from ringwear_par.cases.case import Case
from ringwear_par.elasticity.bem.pair import ContactPair
from ringwear_par.history.elastic.bodies import shares_reference, young
from ringwear_par.history.lockstep import batch_key, can_share
from ringwear_par.history.loop import simulate
from ringwear_par.history.observers.stresses import CaseStresses, stress_key
from ringwear_par.history.refusals.cases import stress_numbers
from ringwear_par.results.recorder import Recorder
from ringwear_par.results.result import HistoryColumns, Result
from ringwear_par.results.variables import HISTORIES

#: numbers of a batch, of which a history has about so many fields, and most histories of it: see
#: ``default_batch``
_NUMBERS, _FIELDS, _MOST = 2**21, 32, 2048
#: batches of a block whose cases take very different numbers of steps: as histories end others take
#: their places, until none are left in it. To start them costs more than it gains where all end at
#: about the same time
_BATCHES = 4
#: bytes of the stored histories of a block, in memory until all of them have ended; derivatives add
#: as many times as much as there are: smaller blocks would be slower than these are large
_BLOCK_BYTES = 64e6


class PairResources:
    """A contact pair and the stresses of unit loads on it, integrated once for all cases alike.

    ``stresses`` is collective on the communicator.
    """

    def __init__(self, pair: ContactPair, comm: MPI.Comm) -> None:
        self.pair, self._comm = pair, comm
        self._stresses: CaseStresses | None = None
        self._stress_key: Hashable = None

    def stresses(self, case: Case) -> CaseStresses | None:
        """Return the stresses of a case; None where it asks for none."""
        if case.stress is None:
            return None
        key = stress_key(case)
        if self._stresses is None or key != self._stress_key:
            self._stresses, self._stress_key = CaseStresses(case, self._comm), key
        return self._stresses


def default_batch(cases: Sequence[Case]) -> int:
    """Return how many of some cases to step together by default.

    More histories share the time that Python takes for each operation: 64 elements, one core, 512,
    1,024 and 2,048 of them: 460, 404 and 374 us a history, in 60 kB of memory each. Where moduli
    that are written differ each has matrices of its own, which are to stay in the cache.
    """
    n = cases[0].mesh.contact_elements
    matrices = len({young(case) for case in cases if not shares_reference(case)}) > 1
    fields = max(_FIELDS, n) if matrices else _FIELDS
    return min(max(_NUMBERS // (fields * n), 16), _MOST)


def block_size(case: Case, most: int | None = None) -> int:
    """Return how many histories like a case's to store together.

    Parameters
    ----------
    most : of them that step at a time; None: ``default_batch``.
    """
    most = most or default_batch([case])
    profiles = case.stored_rows if case.output.profiles == "all" else 1.0
    size = 8.0 * profiles * case.mesh.contact_elements * len(case.output.fields)
    size += 8.0 * case.stored_rows * (len(HISTORIES) + 2)  # with their numbers and steps
    if case.stress is not None:
        size += 8.0 * stress_numbers(case)[1]
    uneven = any(ring.face or ring.layers for ring in case.rings)
    return max(min(_BATCHES * most if uneven else most, int(_BLOCK_BYTES / size)), 1)


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

    def results(self) -> list[Result | Exception]:
        """Return the results, or why there are none."""
        return self.recorder.results(self.failures)


def computed(
    cases: Sequence[Case],
    pair: ContactPair | Sequence[ContactPair],
    *,
    resources: PairResources | None = None,
    batch: int | None = None,
    stop: Callable[[], bool] = lambda: False,
    results: bool = False,
    derivatives: Sequence[str] = (),
    step_times: Sequence[Sequence[float]] | None = None,
    paces: Sequence[FloatArray] | None = None,
) -> Iterator[Computed]:
    """Yield blocks of cases as they are computed, on this rank alone, until ``stop`` says so.

    Cases share a contact pair, or contact elements where each has a pair. Each gets the same, to
    the last bit, in whatever company, ``batch`` at a time. Failures are among the blocks. ``stop``
    is called between two steps, and may answer other ranks meanwhile; histories under way are
    thrown away then. Results, derivatives by keys, step times and paces only where asked for, see
    ``history.loop``.
    """
    pairs = [pair] * len(cases) if isinstance(pair, ContactPair) else pair
    resources = resources or PairResources(pairs[0], MPI.COMM_SELF)
    for numbers in _batches(cases):
        numbers.sort(key=lambda n: young(cases[n]))  # those of the same moduli share a matrix
        most = batch or default_batch([cases[number] for number in numbers])
        longest = max((cases[n] for n in numbers), key=lambda case: case.stored_rows)
        blocks = -(-len(numbers) // block_size(longest, most))
        for part in (part.tolist() for part in np.array_split(numbers, blocks)):
            block = [cases[number] for number in part]
            recorder = Recorder(
                block, MPI.COMM_SELF, derivatives=derivatives, stresses=resources.stresses,
                results=results,
            )  # fmt: skip
            outcome = simulate(
                block, MPI.COMM_SELF, pair=[pairs[n] for n in part],
                observers=[recorder, lambda _: stop()], most_together=most, derivatives=derivatives,
                step_times=None if step_times is None else [step_times[n] for n in part],
                paces=None if paces is None else [paces[n] for n in part],
            )  # fmt: skip
            if outcome.interrupted:
                return
            yield Computed(tuple(part), recorder, outcome.failures)


def failed_columns(cases: Sequence[Case], error: Exception, comm: MPI.Comm) -> HistoryColumns:
    """Return the histories of cases that fail before their start, all for the same reason."""
    recorder = Recorder(cases, comm, stresses=lambda case: None, results=False)
    return recorder.columns(dict.fromkeys(range(len(cases)), error))


def _batches(cases: Sequence[Case]) -> list[list[int]]:
    """Return the numbers of cases that step together, and those of cases that step alone."""
    groups: dict[Hashable, list[int]] = defaultdict(list)
    for number, case in enumerate(cases):
        key = batch_key(case)
        groups[("alone", number) if key is None else key].append(number)
    parts: list[list[int]] = []
    for numbers in groups.values():
        alone = len(numbers) > 1 and not can_share(cases[numbers[0]])
        parts += [[number] for number in numbers] if alone else [numbers]
    return parts
