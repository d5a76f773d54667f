"""The queue of a sweep: teams of ranks draw cases from it; rank 0 has it.

Every team first takes whole groups of cases, longest first, so that an operator is assembled once,
by the team that takes its group. When no group is left untaken, a team that is free helps with the
group that has most cases left; it assembles the operator once more, if that is not cached.

Rank 0 computes cases like all others, and answers them between two steps of its own. Questions with
answers work on every network; memory that other ranks change without rank 0's doing does not (Open
MPI 4 offers it over TCP and fails). A team draws as many cases at once as keep it busy for some
time, and fewer towards the end; but not few, as cases that step side by side take hardly longer
than one. The first cases are dealt without a question: rank 0 may be in the middle of its first
assembly.
"""

import math
import time
from collections.abc import Callable, Sequence
from enum import IntEnum, auto
from typing import Any, NamedTuple

import numpy as np
from mpi4py import MPI

from ringwear_par.arrays import IntArray

#: how long the cases that a team draws are to take, s; it may be so much longer with twice as many
#: as before: cases that step side by side take less time each; and how short they may become
_BUSY_SECONDS, _LONGEST_SECONDS, _LEAST_SECONDS = 0.5, 2.0, 0.1
#: least time of a case, s: all cases that are drawn together are held in memory
_QUICKEST = 2.5e-4
#: factor by which each of many cases side by side is faster than one alone, at least; part of a
#: block from which on a whole one is drawn, and part that takes about twice as long as one case
_QUICKER, _MOST_OF_BLOCK, _LEAST_OF_BLOCK = 8.0, 1 / 3, 1 / 8
#: part of the cases left that all teams share in a round; the rest evens out what they differ by
_ROUND = 0.75
#: how long a rank that waits for an answer sleeps between two looks
_NAP_SECONDS = 0.0005
_QUESTION_TAG, _ANSWER_TAG = 1, 2


class _Question(IntEnum):
    """A question to rank 0: for more cases, or that no rank shall draw any more."""

    DRAW = auto()
    STOP = auto()


class Stretch(NamedTuple):
    """Some cases of a group, from a place in it on."""

    group: int
    first: int
    number: int


_NO_CASES = Stretch(0, 0, 0)


class CaseQueue:
    """Which cases of groups of some sizes teams have drawn, and how many have ended.

    A case of each group is estimated to take some seconds, until its time is known. Where cases
    step side by side, at most a ``block`` of them, many take much less time each than one.
    """

    def __init__(
        self,
        sizes: Sequence[int] | IntArray,
        teams: int,
        seconds: Sequence[float],
        block: int = 1,
    ) -> None:
        self._sizes = np.array(sizes, dtype=np.int64)
        self._left = self._sizes.copy()
        self._seconds, self._ended = np.array(seconds, dtype=float), np.zeros_like(self._sizes)
        self._all_left, self._untaken = int(self._sizes.sum()), 0
        self._teams, self._block, self._quicker = teams, block, _QUICKER if block > 1 else 1.0
        #: how many teams have yet to draw in this round, and how many cases each
        self._in_round, self._share = 0, 0
        self._groups: dict[int, int] = {}
        self.done, self.failed, self.stopped = 0, 0, False

    def draw(self, team: int) -> Stretch | None:
        """Return cases that nobody else draws; None if none are left, or all are to stop."""
        if self.stopped or not self._all_left:
            return None
        group = self._groups.get(team)
        if group is None or not self._left[group]:
            group = self._groups[team] = self._next_group()
        left, seconds = int(self._left[group]), max(float(self._seconds[group]), _QUICKEST)
        twice = min(2 * int(self._ended[group]), int(_LONGEST_SECONDS / seconds))
        busy = _BUSY_SECONDS / seconds * (1.0 if self._ended[group] else self._quicker)
        least = int(min(_LEAST_OF_BLOCK * self._block, _LONGEST_SECONDS / seconds))
        least = max(int(_LEAST_SECONDS / seconds), least)
        number = max(int(busy), twice, least, 1)
        # blocks are as large as each other
        if self._block > 1 and number > _MOST_OF_BLOCK * self._block:
            number = math.ceil(left / math.ceil(left / self._block))
        # as long as there are other groups to take, teams need not share this one
        if self._untaken == len(self._sizes) and self._teams > 1:
            share = math.ceil(self._all_left / self._teams)
            if not self._in_round:
                self._in_round = self._teams
                self._share = min(share, max(int(_ROUND * share), least, 1))
            self._in_round -= 1
            # less of cases whose time is not known yet
            known = self._share if self._ended[group] else max(share // 2, min(share, least))
            number = max(min(number, known), 1)
        number = min(number, left)
        self._left[group] -= number
        self._all_left -= number
        return Stretch(group, int(self._sizes[group]) - left, number)

    def _next_group(self) -> int:
        while self._untaken < len(self._sizes):
            group = self._untaken
            self._untaken += 1
            if self._left[group]:
                return group
        return int(self._left.argmax())

    def count(self, group: int, done: int, failed: int, seconds: float) -> None:
        """Count cases that have ended."""
        self.done += done
        self.failed += failed
        if done + failed:
            # of late: cases that step side by side take less than a first one
            self._seconds[group] = seconds / (done + failed)
            self._ended[group] = done + failed


class SharedQueue:
    """The queue as every rank has it: the first rank of each team draws, rank 0 answers.

    Making and destroying it is collective. Rank 0 has to ``serve`` as long as others may ask.
    """

    def __init__(
        self,
        sizes: Sequence[int] | IntArray,
        comm: MPI.Intracomm,
        teams: int,
        seconds: Sequence[float],
        block: int = 1,
    ) -> None:
        self._comm = comm.Dup()  # no message of anybody else
        queue = CaseQueue(sizes, teams, seconds, block)  # every rank knows it
        dealt = {leader: queue.draw(leader) for leader in range(0, comm.size, comm.size // teams)}
        self._queue = queue if comm.rank == 0 else None
        self._status = MPI.Status()
        self._dealt, self._group = dealt.get(comm.rank) or _NO_CASES, 0
        self._stopped = False
        self._done, self._failed, self._seconds = 0, 0, 0.0

    def draw(self) -> Stretch | None:
        """Return cases of a group that nobody else draws, or None to end. Not collective."""
        if not self._dealt.number and not self._stopped:
            self._ask(_Question.DRAW)
        drawn, self._dealt = self._dealt, _NO_CASES
        self._group = drawn.group
        return drawn if drawn.number and not self._stopped else None

    def count(self, done: int, failed: int, seconds: float) -> None:
        """Count cases of those drawn last, which have ended after so long. Not collective."""
        self._done += done
        self._failed += failed
        self._seconds += seconds

    def stop(self) -> None:
        """Let no rank draw any more. Not collective."""
        if not self._stopped or self._done + self._failed:
            self._ask(_Question.STOP)

    def ended(self) -> tuple[int, int]:
        """Return how many cases are done, and how many have failed: (0, 0) but on rank 0."""
        return (0, 0) if self._queue is None else (self._queue.done, self._queue.failed)

    def serve(self, _: Any = None) -> bool:
        """Answer questions of other ranks, on rank 0: an observer. Not collective."""
        if self._queue is not None and self._comm.size > 1:
            while self._comm.Iprobe(MPI.ANY_SOURCE, _QUESTION_TAG, self._status):
                source, question = self._status.Get_source(), np.empty(5, dtype=np.int64)
                self._comm.Recv(question, source, _QUESTION_TAG)
                self._comm.Send(self._answer(source, question), source, _ANSWER_TAG)
        return False

    def wait_for_all(self, meanwhile: Callable[[], None]) -> None:
        """Wait for others, asleep; ``meanwhile``, called now and then, may stop all. Collective."""
        everybody = self._comm.Ibarrier()
        while not everybody.Test():
            self.serve()
            meanwhile()
            time.sleep(_NAP_SECONDS)
        # questions until then are still to be answered
        everybody = self._comm.Ibarrier()
        while not everybody.Test():
            self.serve()
            time.sleep(_NAP_SECONDS)

    def destroy(self) -> None:
        """Free the communicator. Collective."""
        self._comm.Free()

    def _ask(self, kind: _Question) -> None:
        """Say how many cases have ended since; note the answer of rank 0."""
        ended = self._done, self._failed, round(1e6 * self._seconds)
        question = np.array([kind, self._group, *ended], dtype=np.int64)
        if self._queue is not None:
            answer = self._answer(0, question)
        else:
            answer = np.empty(4, dtype=np.int64)
            answered = self._comm.Irecv(answer, 0, _ANSWER_TAG)
            self._comm.Send(question, 0, _QUESTION_TAG)
            while not answered.Test():
                time.sleep(_NAP_SECONDS)
        self._done, self._failed, self._seconds = 0, 0, 0.0
        *drawn, stopped = answer.tolist()
        self._stopped = bool(stopped)
        if kind == _Question.DRAW:
            self._dealt = Stretch(*drawn)

    def _answer(self, rank: int, question: IntArray) -> IntArray:
        """Return the answer to a rank: the cases that it has drawn, and whether all are to stop."""
        queue = self._queue
        assert queue is not None
        kind, group, done, failed, microseconds = question.tolist()
        queue.count(group, done, failed, 1e-6 * microseconds)
        queue.stopped |= kind == _Question.STOP
        drawn = queue.draw(rank) if kind == _Question.DRAW else None
        return np.array([*(drawn or _NO_CASES), queue.stopped], dtype=np.int64)
