"""Errors of one rank reach all alike."""

from contextlib import closing
from functools import partial

import numpy as np
import pytest

from ringwear_par.errors import ComputationError, InputError, RingwearError
from ringwear_par.parallel import on_first_rank, results_of_tasks, together, with_help_of_all


@pytest.mark.parametrize(
    ("error", "kind", "told"),
    [
        (InputError("one", "two"), InputError, "one\ntwo"),
        (ComputationError("no contact"), ComputationError, "no contact"),
        (OSError(28, "No space left", "a.h5"), Exception, "No space left"),
        (ZeroDivisionError("oh"), Exception, "oh"),
    ],
)
def test_an_error_of_the_last_rank_is_raised_on_all(comm, error, kind, told):
    with pytest.raises(kind, match=told), together(comm):  # noqa: PT012
        if comm.rank == comm.size - 1:
            raise error
    comm.Barrier()


def test_nothing_happens_without_an_error(comm):
    with together(comm):
        value = comm.rank
    assert value == comm.rank


def test_an_error_of_the_first_rank_is_raised_on_all(comm):
    def fail():
        raise OSError(28, "No space left", "a.h5")

    with pytest.raises(ComputationError, match=r"a\.h5: No space left"):
        on_first_rank(comm, fail)
    comm.Barrier()


class _Closed:
    """What cannot be packed, or cannot be unpacked."""

    def __init__(self, packed):
        self.packed = packed

    def __reduce__(self):
        if not self.packed:
            raise TypeError("cannot be packed")
        return _open, ()


def _open():
    raise TypeError("cannot be unpacked")


@pytest.mark.parametrize("packed", [False, True])
def test_a_result_that_cannot_be_sent_is_an_error_on_all(comm, packed):
    if comm.size == 1:
        assert on_first_rank(comm, lambda: _Closed(packed)).packed == packed
        return
    for action in (lambda: _Closed(packed), partial(_result_of_last, comm, packed)):
        with pytest.raises(RingwearError, match="cannot be"):
            with_help_of_all(comm, action)
        comm.Barrier()


def _result_of_last(comm, packed):
    with closing(results_of_tasks(comm, [partial(_Closed, packed)] * comm.size)) as results:
        return len(list(results))


@pytest.mark.parametrize("failing", [None, 0, 1, 5])
def test_tasks_of_all_ranks(comm, failing):
    """Results come in order; an error ends them, and nobody is left with one that he sends."""
    tasks = [partial(_square, number, failing) for number in range(7)]

    def squares():
        with closing(results_of_tasks(comm, tasks)) as results:
            return [int(square[0]) for square in results]

    if failing is None:
        assert with_help_of_all(comm, squares) == [n * n for n in range(7)]
    else:
        with pytest.raises(ComputationError, match=f"no square of {failing}"):
            with_help_of_all(comm, squares)
    comm.Barrier()


def _square(number, failing):
    if number == failing:
        raise ComputationError(f"no square of {number}")
    return np.full(100_000, number * number)  # too large to be on its way unread
