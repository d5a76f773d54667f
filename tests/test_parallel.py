"""Errors of one rank reach all alike."""

import pytest

from ringwear_par.errors import ComputationError, InputError
from ringwear_par.parallel import on_first_rank, together


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
