"""What a sweep's queue costs with many more ranks than there are here, simulated.

    python scripts/queue_at_scale.py [--cases 1e6 1e8] [--ranks 1 64 4096]

The queue is the program's own; ranks, their work and messages are events. A draw of n cases takes a
rank BEGIN + (CASE + STORE) n, give or take a few per cent. Rank 0 works like the others, and
answers between two of its rounds, one question after another; what an answer takes is measured
here. The start of processes and what follows the last case are not in it. Efficiency is that of
cases which cost CASE + STORE each, and nothing else.
"""

import argparse
import heapq
import time

import numpy as np

from ringwear_par.studies.execution.case_queue import _NAP_SECONDS, CaseQueue

#: s, of a draw however small, of each of its cases, and of storing it: adaptive histories on 64
#: elements, measured by ``benchmark.py --ensembles``
BEGIN, CASE, STORE = 0.05, 1.1e-3, 3e-5
#: s, between two looks of rank 0 for questions while it works, and of a message there and back
ROUND, MESSAGE = 0.01, 1e-5
#: of the time of draws; s, what the study thinks of a case before one is known
SPREAD, GUESS = 0.05, 0.01
#: cases that step together
BLOCK = 1024


def answer_seconds(ranks: int) -> float:
    """Return what the queue takes to answer a question of one of so many ranks, measured."""
    queue, count = CaseQueue([10**9], ranks, [GUESS], BLOCK), 20_000
    begun = time.perf_counter()
    for i in range(count):
        queue.count(0, 1, 0, 1e-3)
        queue.draw(i % ranks)
    return (time.perf_counter() - begun) / count


def simulated(cases: int, ranks: int, rng: np.random.Generator) -> tuple[float, float, int]:
    """Return the seconds of a sweep, the share of work in the ranks' time, and the questions."""
    queue, answer = (
        CaseQueue([cases], ranks, [GUESS], BLOCK),
        answer_seconds(ranks) + MESSAGE,
    )
    #: when a rank has ended so many cases, and how long they took
    ends: list[tuple[float, int, int, float]] = []
    work = end = free = own_end = 0.0  # rank 0 is free to answer; its own cases end
    questions = 0

    def draw(rank: int, now: float) -> None:
        nonlocal work, end, own_end
        drawn = queue.draw(rank)
        if drawn is None:
            end = max(end, now)
            return
        seconds = BEGIN + (CASE + STORE) * drawn.number
        seconds *= 1.0 + SPREAD * rng.standard_normal()
        work += seconds
        if rank == 0:
            own_end = now + seconds
        heapq.heappush(ends, (now + seconds, rank, drawn.number, seconds))

    for rank in range(ranks):
        draw(rank, 0.0)
    while ends:
        now, rank, ended, seconds = heapq.heappop(ends)
        questions += 1
        heard = min(now + ROUND * rng.random(), own_end) if rank and now < own_end else now
        free = max(free, heard) + answer
        queue.count(0, ended, 0, seconds)
        draw(rank, free + (_NAP_SECONDS * rng.random() if rank else 0.0))
    return end, work / (ranks * end), questions


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=float, nargs="+", default=[1e6, 1e8])
    parser.add_argument("--ranks", type=int, nargs="+", default=[1, 64, 4096])
    args = parser.parse_args()
    rng = np.random.default_rng(1)
    print("   cases  ranks   seconds  at work  efficiency  questions")
    for cases in map(int, args.cases):
        for ranks in args.ranks:
            seconds, work, questions = simulated(cases, ranks, rng)
            efficiency = cases * (CASE + STORE) / (ranks * seconds)
            print(f"{cases:8.0e}{ranks:7}{seconds:10.4g}{work:9.1%}{efficiency:12.1%}", end="")
            print(f"{questions:11}", flush=True)


if __name__ == "__main__":
    main()
