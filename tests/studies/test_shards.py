"""Shards: blocks of cases end to end, whatever happens while they are written."""

import numpy as np
import pytest
from stored_cases import StoredCase
from stored_cases import block_of as block_of_cases

from ringwear_par.studies.storage.blocks import DamagedError, Kind
from ringwear_par.studies.storage.shards import Shard, read_shard


def block_of(*names):
    """A block of cases whose times are their numbers."""
    cases = []
    for n, name in enumerate(names):
        columns = {"time": np.full(3, float(n)), "r": np.ones(4)}
        columns["pressure"] = np.full((3, 4), 10.0 * n)
        cases.append(StoredCase(name, f"text {name}", "done", "", 1.0 + n, 0.5, columns))
    return block_of_cases(cases)


def test_a_block_comes_back(tmp_path):
    error = "no \N{GREEK SMALL LETTER MU}"
    failed = StoredCase("bad", "its text", "failed", error, 2.0)
    flagged = StoredCase("odd", "y", "done", "", 3.0, 0.1, {}, ("one", "two"))
    with Shard(tmp_path / "a.blocks") as shard:
        shard.add(block_of("a", "b"))
        shard.add(block_of_cases([failed, flagged], "2"))
    first, second = read_shard(shard.path).blocks
    assert first.cases["id"].tolist() == [b"a", b"b"]
    assert second.cases["id"].tolist() == [b"bad", b"odd"]
    assert first.cases["seconds"].tolist() == [1.0, 2.0]
    kinds = [second.kinds[kind] for kind in second.cases["kind"].tolist()]
    assert kinds == [Kind("2", (), error), Kind("2", ("one", "two"))]
    columns = first.read(["time", "pressure", "torque"])
    assert columns.keys() == {"time", "pressure"}
    assert columns["time"].tolist() == [0, 0, 0, 1, 1, 1]
    assert columns["pressure"].shape == (6, 4)
    assert first.texts([1, 0]) == ["text b", "text a"]
    assert second.texts([0]) == ["its text"]


@pytest.fixture
def path(tmp_path):
    """A shard of three blocks."""
    with Shard(tmp_path / "a.blocks") as shard:
        for name in "abc":
            shard.add(block_of(name))
    return shard.path


def test_it_survives_a_kill_at_any_byte(path):
    """Blocks that are whole are there, and the rest is known for what it is."""
    content = path.read_bytes()
    ends = [block.stop for block in read_shard(path).blocks]
    for size in range(0, len(content), 7):
        path.write_bytes(content[:size])
        contents = read_shard(path)
        whole = [end for end in ends if end <= size]
        assert contents.damaged == 0
        assert contents.end == (whole[-1] if whole else 0)
        assert len(contents.blocks) == len(whole)


def test_damaged_data_are_not_taken_for_numbers(path):
    block = read_shard(path).blocks[1]
    content = bytearray(path.read_bytes())
    content[block.start + 3] ^= 1
    path.write_bytes(content)
    with pytest.raises(DamagedError):
        block.read(["time"])
