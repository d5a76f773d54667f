"""Compiled code that was kept."""

from types import SimpleNamespace

import pytest
from mpi4py import MPI

from ringwear_par.elasticity.bem import compiling


def test_what_an_older_version_kept_is_forgotten(tmp_path, monkeypatch):
    """Numba pickles the types that a function was compiled for; they may have moved since."""
    own, other = tmp_path / "rows.place-7.py311.nbi", tmp_path / "theirs.place-7.py311.nbi"
    own.touch()
    other.touch()
    function = SimpleNamespace(
        __module__="ringwear_par.rows", __name__="place",
        stats=SimpleNamespace(cache_path=str(tmp_path)),
    )  # fmt: skip
    monkeypatch.setattr(compiling, "_functions", [function])

    def load():
        if own.exists():
            raise AttributeError("Can't get attribute 'Mesh'")

    compiling.load_compiled(MPI.COMM_SELF, load)
    assert not own.exists()
    assert other.exists()


@pytest.mark.parametrize("kept", [False, True])
def test_a_fault_of_the_code_is_not_taken_for_it(kept, monkeypatch):
    calls = []
    monkeypatch.setattr(compiling, "_IS_STORED", kept)
    monkeypatch.setattr(compiling, "_functions", [])

    def load():
        calls.append(1)
        raise AttributeError("of a fault")

    with pytest.raises(AttributeError, match="of a fault"):
        compiling.load_compiled(MPI.COMM_SELF, load)
    assert len(calls) == 1 + kept
