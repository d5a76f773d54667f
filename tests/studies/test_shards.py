"""Shards: blocks of cases end to end, whatever happens while they are written."""

import errno
import os

import numpy as np
import pytest
from stored_cases import StoredCase
from stored_cases import block_of as block_of_cases

from ringwear_par.errors import ComputationError
from ringwear_par.studies.storage import shards
from ringwear_par.studies.storage.blocks import BY_STATE, DamagedError, Kind
from ringwear_par.studies.storage.shards import Shard, drop_damaged_blocks, read_shard

pytestmark = pytest.mark.serial


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
    assert first.cases["status"].tolist() == [2, 2]
    assert second.cases["status"].tolist() == [1, 2]
    assert (first.cases["rows"].tolist(), first.cases["elements"].tolist()) == ([3, 3], [4, 4])
    assert (second.cases["rows"].tolist(), second.cases["elements"].tolist()) == ([0, 0], [0, 0])
    assert first.cases["seconds"].tolist() == [1.0, 2.0]
    assert second.cases["seconds"].tolist() == [2.0, 3.0]
    assert first.kinds == (Kind("1"),)
    assert first.cases["kind"].tolist() == [0, 0]
    kinds = [second.kinds[kind] for kind in second.cases["kind"].tolist()]
    assert kinds == [Kind("2", (), error), Kind("2", ("one", "two"))]
    assert first.axes["pressure"] == BY_STATE
    assert (first.deep, second.deep) == (True, False)
    columns = first.read(["time", "pressure", "torque"])
    assert columns.keys() == {"time", "pressure"}
    assert columns["time"].tolist() == [0, 0, 0, 1, 1, 1]
    assert columns["pressure"].shape == (6, 4)
    assert first.offsets.tolist() == [0, 3, 6]
    assert first.texts([1, 0]) == ["text b", "text a"]
    assert second.texts([0]) == ["its text"]


@pytest.fixture
def path(tmp_path):
    """A shard of three blocks."""
    with Shard(tmp_path / "a.blocks") as shard:
        for name in "abc":
            shard.add(block_of(name))
    return shard.path


def names(path):
    return b"".join(name for b in read_shard(path).blocks for name in b.cases["id"]).decode()


def test_it_survives_a_kill_at_any_byte(path):
    """Blocks that are whole are there, and the rest is known for what it is."""
    content = path.read_bytes()
    ends = [block.stop for block in read_shard(path).blocks]
    for size in range(len(content)):
        path.write_bytes(content[:size])
        contents = read_shard(path)
        whole = [end for end in ends if end <= size]
        assert contents.damaged == 0
        assert contents.end == (whole[-1] if whole else 0)
        assert len(contents.blocks) == len(whole)


def test_any_flipped_byte_costs_no_more_than_its_block(path, tmp_path):
    content = path.read_bytes()
    ends = [block.stop for block in read_shard(path).blocks]
    for at in range(0, len(content), 11):
        changed = bytearray(content)
        changed[at] ^= 0x55
        path.write_bytes(changed)
        drop_damaged_blocks(path, tmp_path / "copy")
        lost = "abc"[sum(at >= end for end in ends)]
        assert names(path) == "abc".replace(lost, "")
        assert read_shard(path).damaged == 0
        assert (tmp_path / "copy").read_bytes() == changed


def test_damaged_data_are_not_taken_for_numbers(path):
    block = read_shard(path).blocks[1]
    content = bytearray(path.read_bytes())
    content[block.start + 3] ^= 1
    path.write_bytes(content)
    assert names(path) == "abc"
    with pytest.raises(DamagedError):
        block.read(["time"])


def test_what_does_not_fit_is_taken_back(path, monkeypatch):
    """Half of a block has been written when the disk is full."""
    size, pwrite = path.stat().st_size, os.pwrite

    def full(handle, data, at):
        if at > size:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return pwrite(handle, data[:50], at)

    with Shard(path) as shard:
        with monkeypatch.context() as patch:
            patch.setattr(os, "pwrite", full)
            with pytest.raises(ComputationError, match="cannot be written: No space left"):
                shard.add(block_of("d"))
        assert path.stat().st_size == size
        shard.add(block_of("e"))
    assert names(path) == "abce"


def test_a_shard_that_another_process_writes_to_is_not_read(path, monkeypatch):
    monkeypatch.setattr(shards, "_BUSY_SECONDS", 0.1)
    with Shard(path):
        with pytest.raises(ComputationError, match="in use by a process of another sweep"):
            read_shard(path)
        with pytest.raises(ComputationError, match="in use by a process of another sweep"):
            Shard(path)
    assert names(path) == "abc"


def test_something_else_is_no_shard(tmp_path):
    for content in (b"nonsense", b"nonsense" * 1000, bytes(5000)):
        (tmp_path / "a.blocks").write_bytes(content)
        assert read_shard(tmp_path / "a.blocks") is None
    assert read_shard(tmp_path) is None
