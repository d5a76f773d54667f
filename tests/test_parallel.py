"""Errors of one rank reach all alike."""

from contextlib import closing
from functools import partial

import numpy as np
import pytest

import ringwear_par as rw
from ringwear_par.parallel import on_first_rank, results_of_tasks, together, with_help_of_all


@pytest.mark.parametrize(
    ("error", "kind", "told"),
    [
        (rw.InputError("one", "two"), rw.InputError, "one\ntwo"),
        (OSError(28, "No space left", "a.h5"), Exception, "No space left"),
        (ZeroDivisionError("oh"), Exception, "oh"),
        (MemoryError("no more"), Exception, "no more"),
    ],
)
def test_an_error_of_the_last_rank_is_raised_on_all(comm, error, kind, told):
    with pytest.raises(kind, match=told), together(comm):  # noqa: PT012
        if comm.rank == comm.size - 1:
            raise error


def test_the_first_rank_acts_for_all(comm):
    def fail():
        raise OSError(28, "No space left", "a.h5")

    assert on_first_rank(comm, lambda: comm.rank) == 0
    with pytest.raises(rw.ComputationError, match=r"a\.h5: No space left"):
        on_first_rank(comm, fail)
    if comm.size > 1:
        with pytest.raises(Exception, match="pickle"):
            on_first_rank(comm, lambda: fail)


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
        with pytest.raises(rw.ComputationError, match=f"no square of {failing}"):
            with_help_of_all(comm, squares)


def _square(number, failing):
    if number == failing:
        raise rw.ComputationError(f"no square of {number}")
    return np.full(100_000, number * number)  # too large to be on its way unread
