"""The scheduler of a sweep: teams of ranks draw cases from shared counters, without a master.

Every team first takes whole groups of cases, longest first, so that an operator is assembled once,
by the team that takes its group. When no group is left untaken, a team that is free helps with the
group that has most cases left. The counters are one MPI window, read and changed by Fetch_and_op.
"""

from collections.abc import Sequence

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import IntArray

#: places of the counters before the groups' counters
_GROUP, _STOP, _DONE, _FAILED = range(4)
_PLACES = 4


class Scheduler:
    """Shared counters on rank 0 of a communicator. Making and destroying it is collective.

    Parameters
    ----------
    sizes : number of cases to be computed of each group.
    comm : communicator.
    """

    def __init__(self, sizes: Sequence[int], comm: MPI.Intracomm) -> None:
        self._sizes = np.array(sizes, dtype=np.int64)
        places = _PLACES + 2 * len(sizes)
        self._window = MPI.Win.Allocate(8 * places if comm.rank == 0 else 0, 8, comm=comm)
        if comm.rank == 0:
            self._window.Lock(0, MPI.LOCK_EXCLUSIVE)
            self._window.Put(np.zeros(places, dtype=np.int64), 0)
            self._window.Unlock(0)
        comm.Barrier()
        self._group: int | None = None

    def draw(self) -> tuple[int, int] | None:
        """Return group and number in the group of a case that nobody else draws. Not collective.

        None if there is none left, or all are asked to stop.
        """
        if self.stopped:
            return None
        while True:
            if self._group is not None:
                number = self._add(_PLACES + self._group, 1)
                if number < self._sizes[self._group]:
                    return self._group, number
                self._group = None
            group = self._add(_GROUP, 1)
            if group >= len(self._sizes):
                left = self._sizes - self._read()[_PLACES : _PLACES + len(self._sizes)]
                group = int(left.argmax()) if len(left) else 0
                if not len(left) or left[group] <= 0:
                    return None
            self._group = group

    def ask_to_stop(self) -> None:
        """Let nobody draw any more. Not collective."""
        self._add(_STOP, 1)

    @property
    def stopped(self) -> bool:
        """Whether somebody asked to stop."""
        return self._add(_STOP, 0) > 0

    def count(self, group: int, failed: bool) -> bool:
        """Count a case that has ended; tell whether it was the group's last. Not collective."""
        self._add(_FAILED if failed else _DONE, 1)
        ended = self._add(_PLACES + len(self._sizes) + group, 1) + 1
        return ended == int(self._sizes[group])

    def ended(self) -> tuple[int, int]:
        """Return how many cases are done, and how many have failed. Not collective."""
        places = self._read()
        return int(places[_DONE]), int(places[_FAILED])

    def destroy(self) -> None:
        """Free the window. Collective."""
        self._window.Free()

    def _add(self, place: int, more: int) -> int:
        before = np.zeros(1, dtype=np.int64)
        self._window.Lock(0, MPI.LOCK_SHARED)
        self._window.Fetch_and_op(np.array([more], dtype=np.int64), before, 0, place, MPI.SUM)
        self._window.Unlock(0)
        return int(before[0])

    def _read(self) -> IntArray:
        places = np.zeros(_PLACES + 2 * len(self._sizes), dtype=np.int64)
        self._window.Lock(0, MPI.LOCK_SHARED)
        self._window.Get(places, 0)
        self._window.Unlock(0)
        return places
