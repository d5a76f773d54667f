"""Drawing cases: each exactly once, whoever draws."""

import pytest

from ringwear_par.studies.execution import case_queue
from ringwear_par.studies.execution.case_queue import CaseQueue, SharedQueue, Stretch


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


def work(scheduler):
    """Draw, count and answer until nothing is left; return what was drawn, case by case."""
    drawn = []
    while (cases := scheduler.draw()) is not None:
        for case in range(cases.first, cases.first + cases.number):
            drawn.append((cases.group, case))
            failed = case % 10 == 9
            scheduler.count(not failed, failed, 1e-3)
            scheduler.serve()
    return drawn


@pytest.mark.parametrize("busy", [0.0, case_queue._BUSY_SECONDS])
def test_each_case_is_drawn_once(comm, scheduler, monkeypatch, busy):
    monkeypatch.setattr(case_queue, "_BUSY_SECONDS", busy)
    sizes = [50, 0, 7, 1, 300]
    board = scheduler(sizes)
    drawn = work(board)
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


@pytest.mark.mpi(min_size=2)
def test_nobody_waits_for_rank_0_to_get_a_first_group(comm, scheduler):
    """It assembles its own."""
    board = scheduler([0, *[5] * comm.size])
    assert board.draw() == Stretch(1 + comm.rank, 0, 1)
    comm.Barrier()
    board.stop()
    board.wait_for_all(lambda: None)


@pytest.mark.mpi(min_size=2)
def test_who_waits_may_ask_all_to_stop(comm, scheduler):
    board = scheduler([10**6])
    if comm.rank == 0:
        board.wait_for_all(board.stop)
    else:
        while board.draw() is not None:
            pass
        board.wait_for_all(lambda: None)
    assert board.draw() is None


def test_what_was_counted_before_a_stop_is_told(comm, scheduler):
    board = scheduler([10**6])
    mine = 0
    while mine < 5 and (cases := board.draw()) is not None:
        mine += cases.number
        board.count(cases.number, 0, 1e-4 * cases.number)
        board.serve()
    board.stop()
    board.wait_for_all(lambda: None)
    done = comm.allreduce(mine)
    assert comm.bcast(board.ended()) == (done, 0)


def test_teams_take_groups_before_they_share_one():
    board = CaseQueue([4, 6, 2], 3, [1.0] * 3)
    taken = [board.draw(team) for team in (0, 1, 2)]
    assert taken == [Stretch(0, 0, 1), Stretch(1, 0, 1), Stretch(2, 0, 1)]
    assert board.draw(2) == Stretch(2, 1, 1)
    assert board.draw(2) == Stretch(1, 1, 1)  # the most are left there


def draws(board, seconds):
    """Draw everything, two teams in turns; return how much at once, after the first."""
    drawn = []
    while (cases := board.draw(len(drawn) % 2)) is not None:
        drawn.append(cases.number)
        board.count(0, cases.number, 0, seconds(cases.number))
    assert sum(drawn) == board.done
    return drawn[1:]


def test_what_is_drawn_at_once_keeps_a_team_busy_and_shrinks_towards_the_end():
    drawn = draws(CaseQueue([1001], 2, [1.0]), lambda count: 0.01 * count)
    assert drawn[0] == round(case_queue._BUSY_SECONDS / 0.01)
    assert max(drawn) == round(case_queue._LONGEST_SECONDS / 0.01)
    shrinking = drawn[drawn.index(max(drawn)) :]
    assert shrinking == sorted(shrinking, reverse=True)
    assert min(drawn[:-2]) >= case_queue._LEAST_SECONDS / 0.01


def test_cases_that_go_side_by_side_are_drawn_as_many_as_that_takes():
    """Where many start in the time of one, each team draws few times."""
    drawn = draws(
        CaseQueue([4096], 2, [1e-2], side_by_side=True), lambda count: 0.05 + 4e-4 * count
    )
    assert len(drawn) <= 9
    assert min(drawn[:-2]) >= 128
