"""Errors of one rank reach all alike."""

import pytest

import ringwear_par as rw
from ringwear_par.parallel import on_first_rank, together


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
