"""Shards: how many are open at the same time."""

import numpy as np
import pytest

from ringwear_par.studies import connections
from ringwear_par.studies.blocks import Block, Record
from ringwear_par.studies.connections import ReadFile
from ringwear_par.studies.shards import Shard, read_index

pytestmark = pytest.mark.serial


def test_many_shards_are_read_with_few_open(tmp_path, monkeypatch):
    """There is one a team: they are more than a process may open."""
    monkeypatch.setattr(connections, "_MOST_OPEN", 2)
    sources = []
    for n in range(5):
        arrays = {"time": np.full(3, float(n)), "step": np.arange(3.0), "r": np.ones(4)}
        with Shard(tmp_path / f"all_{n}.sqlite") as shard:
            shard.add(Block.of([Record(f"{n}", "text", "done", "", 1.0, 0.0, arrays, "1")]))
        sources += read_index(shard.path)[0].sources
    opened, connect = [], connections.connect
    monkeypatch.setattr(
        connections, "connect", lambda path: (opened.append(path), connect(path))[1]
    )
    for n in (0, 1, 2, 3, 4, 4, 3, 0):
        assert sources[n].read(1, "time").values.tolist() == [n] * 3
        assert len(ReadFile._connections) <= 2
    assert len(opened) == 6
    for source in sources:
        source.close()
    assert not ReadFile._connections
