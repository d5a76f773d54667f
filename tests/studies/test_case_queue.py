"""Drawing cases: each exactly once, whoever draws."""

import pytest

from ringwear_par.studies.execution.case_queue import SharedQueue


@pytest.fixture
def scheduler(comm):
    """Make a scheduler, each rank a team."""
    made = []

    def scheduler(sizes):
        made.append(SharedQueue(sizes, comm, comm.size, [1.0] * len(sizes)))
        return made[-1]

    yield scheduler
    for each in made:
        each.destroy()


def test_each_case_is_drawn_once(comm, scheduler):
    sizes = [50, 0, 7, 1, 300]
    board, drawn = scheduler(sizes), []
    while (cases := board.draw()) is not None:
        for case in range(cases.first, cases.first + cases.number):
            drawn.append((cases.group, case))
            failed = case % 10 == 9
            board.count(not failed, failed, 1e-3)
            board.serve()
    board.wait_for_all(lambda: None)
    everything = sorted(case for part in comm.allgather(drawn) for case in part)
    assert everything == [(g, i) for g, size in enumerate(sizes) for i in range(size)]
    assert board.ended() == ((358 - 35, 35) if comm.rank == 0 else (0, 0))


def test_nobody_draws_after_a_stop(comm, scheduler):
    board = scheduler([1000])
    if comm.rank == comm.size - 1:
        board.stop()
    while board.draw() is not None:
        board.serve()
    board.wait_for_all(lambda: None)
    assert board.draw() is None
