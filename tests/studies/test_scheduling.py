"""Drawing cases: each exactly once, whoever draws."""

from ringwear_par.studies.scheduling import Scheduler


def test_each_case_is_drawn_once(comm):
    sizes = [50, 0, 7, 1, 300]
    board = Scheduler(sizes, comm)
    drawn, last = [], 0
    while (case := board.draw()) is not None:
        drawn.append(case)
        last += board.count(case[0], failed=case[1] % 10 == 9)
    everything = sorted(case for part in comm.allgather(drawn) for case in part)
    assert everything == [(g, i) for g, size in enumerate(sizes) for i in range(size)]
    assert comm.allreduce(last) == 4  # groups that have cases end once each
    comm.Barrier()
    assert board.ended() == (358 - 35, 35)
    comm.Barrier()
    board.destroy()


def test_nobody_draws_after_a_stop(comm):
    board = Scheduler([10], comm)
    if comm.rank == comm.size - 1:
        board.ask_to_stop()
    comm.Barrier()
    assert board.stopped
    assert board.draw() is None
    comm.Barrier()
    board.destroy()


def test_a_board_without_cases(comm):
    board = Scheduler([], comm)
    assert board.draw() is None
    comm.Barrier()
    board.destroy()
