"""Shards: blocks of cases end to end, whatever happens while they are written."""

import errno
import os

import numpy as np
import pytest

from ringwear_par.errors import ComputationError
from ringwear_par.studies.storage import shards
from ringwear_par.studies.storage.blocks import Block, Record, unpack_header
from ringwear_par.studies.storage.index import DamagedError, Kind
from ringwear_par.studies.storage.shards import Shard, drop_damaged_blocks, read_shard

pytestmark = pytest.mark.serial


def block_of(*names, version="1", **more):
    """A block of cases whose times are their numbers."""
    records = []
    for n, name in enumerate(names):
        arrays = {"time": np.full(3, float(n)), "step": np.arange(3.0), "r": np.ones(4)}
        arrays["pressure"] = np.full((3, 4), 10.0 * n)
        records.append(Record(name, f"text {name}", "done", "", 1.0 + n, 0.5, arrays, version))
    return Block.of(records, **more)


def test_a_block_comes_back(tmp_path):
    failed = Record("bad", "its text", "failed", "no \N{GREEK SMALL LETTER MU}", 2.0, 0.0, {}, "2")
    flagged = Record("odd", "y", "done", "", 3.0, 0.1, {}, "2", ("one", "two"))
    with Shard(tmp_path / "a.blocks") as shard:
        shard.add(block_of("a", "b"))
        shard.add(Block.of([failed, flagged]))
    index = read_shard(shard.path).index
    assert index["id"].tolist() == [b"a", b"b", b"bad", b"odd"]
    assert index["status"].tolist() == [2, 2, 1, 2]
    assert (index["rows"].tolist(), index["elements"].tolist()) == ([3, 3, 0, 0], [4, 4, 0, 0])
    assert index["seconds"].tolist() == [1.0, 2.0, 2.0, 3.0]
    kinds = [index.kinds[kind] for kind in index["kind"].tolist()]
    assert kinds[0] == kinds[1] == Kind("1")
    assert kinds[2:] == [Kind("2", (), failed.error), Kind("2", ("one", "two"))]
    first, second = index.blocks
    assert (first.fields, first.deep, second.fields) == (("pressure",), True, ())
    pieces = first.read(["time", "pressure", "torque"])
    assert pieces.keys() == {"time", "pressure"}
    assert pieces["time"].values.tolist() == [0, 0, 0, 1, 1, 1]
    assert pieces["pressure"].values.shape == (6, 4)
    assert pieces["time"].offsets.tolist() == [0, 3, 6]
    assert first.texts([1, 0]) == ["text b", "text a"]
    assert second.texts([0]) == ["its text"]


def test_a_packed_block_is_read_from_memory_too(tmp_path):
    packed = block_of("a").packed()
    block, index = unpack_header(packed, 0, tmp_path / "none", packed)
    assert block.stop == len(packed)
    assert index["id"].tolist() == [b"a"]
    assert block.read(["time"])["time"].values.tolist() == [0.0] * 3


@pytest.fixture
def path(tmp_path):
    """A shard of three blocks."""
    with Shard(tmp_path / "a.blocks") as shard:
        for name in "abc":
            shard.add(block_of(name))
    return shard.path


def names(path):
    return b"".join(read_shard(path).index["id"].tolist()).decode()


def test_it_survives_a_kill_at_any_byte(path):
    """Blocks that are whole are there, and the rest is known for what it is."""
    content = path.read_bytes()
    ends = [block.stop for block in read_shard(path).index.blocks]
    for size in range(len(content)):
        path.write_bytes(content[:size])
        contents = read_shard(path)
        whole = [end for end in ends if end <= size]
        assert contents.damaged == 0
        assert contents.end == (whole[-1] if whole else 0)
        assert len(contents.index) == len(whole)


def test_any_flipped_byte_costs_no_more_than_its_block(path, tmp_path):
    content = path.read_bytes()
    ends = [block.stop for block in read_shard(path).index.blocks]
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
    block = read_shard(path).index.blocks[1]
    content = bytearray(path.read_bytes())
    content[block.start + 3] ^= 1
    path.write_bytes(content)
    assert names(path) == "abc"
    with pytest.raises(DamagedError):
        block.read(["step"])


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


def test_a_link_is_not_followed(path, tmp_path):
    (tmp_path / "link.blocks").symlink_to(path)
    with pytest.raises(ComputationError, match="it is a link"):
        Shard(tmp_path / "link.blocks")


def test_something_else_is_no_shard(tmp_path):
    for content in (b"nonsense", b"nonsense" * 1000, bytes(5000)):
        (tmp_path / "a.blocks").write_bytes(content)
        assert read_shard(tmp_path / "a.blocks") is None
    assert read_shard(tmp_path) is None
