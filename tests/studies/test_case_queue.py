"""Drawing cases: each exactly once, whoever draws."""

import math

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


def draws(size, estimate, seconds, **kinds):
    """Draw all cases of a group, two teams in turns, and return how many at once.

    By what one took of late, they take 0.5 s, or up to 2 s where they are at most twice as many as
    before. In a round, a team has at most three quarters of its share of what is left, but not
    less than 0.1 s takes.
    """
    board, drawn, left, late = CaseQueue([size], 2, [estimate], **kinds), [], [size], [estimate]
    while (cases := board.draw(len(drawn) % 2)) is not None:
        count, began = cases.number, len(drawn) - len(drawn) % 2  # of the round
        assert cases == Stretch(0, sum(drawn), count)
        share, least = math.ceil(left[began] / 2), int(case_queue._LEAST_SECONDS / late[began])
        assert count <= max(0.75 * share, min(share, least), 1)
        if drawn:
            longest, busy = case_queue._LONGEST_SECONDS, case_queue._BUSY_SECONDS
            assert count <= max(busy / late[-1], min(2 * drawn[-1], longest / late[-1]), 1)
            assert count >= min(share, least, left[-1])
        assert seconds(count) <= case_queue._LONGEST_SECONDS
        drawn.append(count)
        left.append(left[-1] - count)
        late.append(seconds(count) / count)
        board.count(0, count, 0, seconds(count))
    assert (left[-1], board.done) == (0, size)
    return drawn


def test_what_is_drawn_at_once_keeps_a_team_busy_and_shrinks_towards_the_end():
    first, *drawn = draws(1001, 1.0, lambda count: 0.01 * count)
    assert first == 1  # nothing is known of its time
    assert drawn[0] == round(case_queue._BUSY_SECONDS / 0.01)
    assert max(drawn) == round(case_queue._LONGEST_SECONDS / 0.01)
    shrinking = drawn[drawn.index(max(drawn)) :]
    assert shrinking == sorted(shrinking, reverse=True)


def test_cases_that_go_side_by_side_are_drawn_as_many_as_that_takes():
    """Where many start in the time of one, each team draws few times; or one takes long."""
    assert len(draws(4096, 1e-2, lambda n: 0.05 + 4e-4 * n, block=1024)) <= 10
    drawn = draws(10_000, 1.0, lambda count: 0.6 + 0.005 * count)
    assert drawn[:4] == [1, 2, 4, 8]
    assert max(drawn) > 256
