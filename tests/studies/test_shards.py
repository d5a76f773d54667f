"""Shards: blocks of cases end to end, whatever happens while they are written."""

import numpy as np
import pytest
from stored_cases import StoredCase, block_of

from ringwear_par.studies.storage.blocks import DamagedError, Kind
from ringwear_par.studies.storage.shards import Shard, read_shard


def case_of(name, number):
    """A case whose times are a number."""
    columns = {"time": np.full(3, float(number)), "r": np.ones(4)}
    columns["pressure"] = np.full((3, 4), 10.0 * number)
    return StoredCase(name, f"text {name}", "done", "", 1.0 + number, 0.5, columns)


@pytest.fixture
def path(tmp_path):
    """A shard of three blocks."""
    failed = StoredCase("bad", "its text", "failed", "no \N{GREEK SMALL LETTER MU}", 2.0)
    flagged = StoredCase("odd", "y", "done", "", 3.0, 0.1, {}, ("one", "two"))
    with Shard(tmp_path / "a.blocks") as shard:
        shard.add(block_of([case_of("a", 0), case_of("b", 1)]))
        shard.add(block_of([failed, flagged], "2"))
        shard.add(block_of([case_of("c", 2)]))
    return shard.path


def test_blocks_come_back(path):
    first, second, _ = read_shard(path).blocks
    assert first.cases["id"].tolist() == [b"a", b"b"]
    assert first.cases["seconds"].tolist() == [1.0, 2.0]
    columns = first.read(["time", "pressure", "torque"])
    assert columns.keys() == {"time", "pressure"}
    assert columns["time"].tolist() == [0, 0, 0, 1, 1, 1]
    assert columns["pressure"].shape == (6, 4)
    assert first.texts([1, 0]) == ["text b", "text a"]
    kinds = [second.kinds[kind] for kind in second.cases["kind"].tolist()]
    assert kinds == [Kind("2", (), "no \N{GREEK SMALL LETTER MU}"), Kind("2", ("one", "two"))]
    assert second.texts([0]) == ["its text"]


def test_whole_blocks_survive_a_kill_at_any_byte(path):
    content = path.read_bytes()
    ends = [block.stop for block in read_shard(path).blocks]
    for size in range(0, len(content), 29):
        path.write_bytes(content[:size])
        contents = read_shard(path)
        whole = [end for end in ends if end <= size]
        assert contents.damaged == 0
        assert contents.end == (whole[-1] if whole else 0)
        assert len(contents.blocks) == len(whole)


def test_damaged_data_are_not_taken_for_numbers(path):
    block = read_shard(path).blocks[2]
    content = bytearray(path.read_bytes())
    content[block.start + 3] ^= 1
    path.write_bytes(content)
    with pytest.raises(DamagedError):
        block.read(["time"])
