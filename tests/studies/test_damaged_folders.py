"""Folders of sweeps in which somebody has removed, damaged or left behind files."""

import json
import os
import shutil
import signal
import sqlite3
import subprocess
import sys
from contextlib import closing

import h5py
import numpy as np
import pytest
import try_faults as faults
from conftest import SHELL_ENVIRONMENT
from swept import write_study

import ringwear_par
from ringwear_par.errors import ComputationError, InputError
from ringwear_par.results.variables import HISTORIES, LINE, PROFILES
from ringwear_par.studies import earlier, scheduling, shards, store, sweep, workers
from ringwear_par.studies.index import join_flags
from ringwear_par.studies.sweep import run_sweep

pytestmark = [pytest.mark.serial, pytest.mark.slow]
STUDY = """
[vary]
"wear.lower.k" = { log = [1e-8, 1e-6], count = 3 }
"upper.young" = { values = [5e4, 1e5] }
[design]
method = "grid"
"""
CASES = 6


#: what says how many cases are drawn at once
DRAWS = ("_BUSY_SECONDS", "_LONGEST_SECONDS", "_LEAST_SECONDS")


def draw_one_by_one(patch):
    for name in DRAWS:
        patch.setattr(scheduling, name, 0.0)


@pytest.fixture(scope="module")
def swept(tmp_path_factory, comm):
    """A study, its folder, and the folder of all cases before merging."""
    folder = tmp_path_factory.mktemp("swept")
    study = write_study(folder, comm, STUDY)
    run_sweep(study, folder / "reference", comm)
    with pytest.MonkeyPatch.context() as patch:
        draw_one_by_one(patch)
        run_sweep(study, folder / "slice", comm, part=(1, 1))
    return study, folder / "reference", folder / "slice"


@pytest.fixture
def output(tmp_path, swept):
    """A folder of shards that are not merged."""
    shutil.copytree(swept[2], tmp_path / "out")
    return tmp_path / "out"


@pytest.fixture
def told(caplog):
    """Function that returns what has been said of damage since it was asked last."""

    def told():
        found = [m for m in caplog.messages if "damaged" in m or "anew" in m]
        caplog.clear()
        return found

    return told


def shard_of(output):
    (path,) = (output / "shards").glob("*.sqlite")
    return path


def poison(path, statement, *values, rows=1):
    connection = sqlite3.connect(path)
    with connection:
        assert connection.execute(statement, values).rowcount == rows
    connection.close()


def poison_block(path, number, changes):
    """Change what is told of a block, whose checksum is right all the same."""
    poison(path, f"UPDATE blocks SET {changes} WHERE number = ?", number)
    connection = sqlite3.connect(path)
    with connection:
        names = ", ".join(name for name in shards._BLOCKS if name not in ("number", "crc"))
        row = connection.execute(f"SELECT {names} FROM blocks WHERE number = {number}").fetchone()
        if all(isinstance(value, str | bytes) for value in row):
            checksum = shards._checksum(row)
            connection.execute(f"UPDATE blocks SET crc = {checksum} WHERE number = {number}")
    connection.close()


def blocks(path):
    """The ids of the cases of each block."""
    connection = sqlite3.connect(path)
    found = dict(connection.execute("SELECT number, ids FROM blocks"))
    connection.close()
    return {number: ids.split("\n") for number, ids in found.items()}


def as_earlier(path):
    """Make the shard one of an earlier version: a row a case, in another table."""
    index, _ = shards.read_index(path)
    kinds = {"id": "TEXT PRIMARY KEY", "seconds": "REAL", "imbalance": "REAL", "data": "BLOB"}
    rows = []
    for i, identity in enumerate(index.ids):
        source, block, place = index.sources[0], int(index.block[i]), int(index.place[i])
        arrays = {}
        for name in ("step", *HISTORIES, *LINE, *PROFILES):
            piece = source.read(block, name)
            if piece is None:
                continue
            there = slice(place, place + 1)
            if piece.offsets is not None:
                there = slice(*piece.offsets[place : place + 2])
            values = piece.values[there if len(piece.values) > 1 else slice(None)]
            arrays[name] = values if piece.offsets is not None else values[0]
        layout = json.dumps({name: array.shape for name, array in arrays.items()})
        data = b"".join(np.asarray(array, dtype=float).tobytes() for array in arrays.values())
        rows.append((
            identity.decode(), source.texts(block, [place])[0], "done", "",
            float(index.seconds[i]), float(index.imbalance[i]), layout, data,
            index.kinds[index.kind[i]].version, join_flags(index.kinds[index.kind[i]].flags),
        ))  # fmt: skip
    index.sources[0].close()
    path.unlink()
    connection = sqlite3.connect(path)
    with connection:
        table = ", ".join(f"{name} {kinds.get(name, 'TEXT')}" for name in earlier.COLUMNS)
        connection.execute(f"CREATE TABLE cases ({table})")
        marks = ", ".join("?" for _ in earlier.COLUMNS)
        connection.executemany(f"INSERT INTO cases VALUES ({marks})", rows)
    connection.close()


@pytest.mark.parametrize("moment", range(6))
def test_a_sweep_killed_while_it_makes_its_shard(tmp_path, swept, comm, told, moment):
    """Before each of its statements, before its first PRAGMA as the first."""
    study, reference, _ = swept
    (tmp_path / "out" / "shards").mkdir(parents=True)
    path = tmp_path / "out" / "shards" / "all_0000.sqlite"
    script = f"""
import os, signal, sqlite3, sys
from pathlib import Path
from ringwear_par.studies import shards

class Connection(sqlite3.Connection):
    moments = iter(range({moment + 1}))

    def execute(self, *words):
        if next(self.moments) == {moment}:
            os.kill(os.getpid(), signal.SIGKILL)
        return super().execute(*words)

connect = sqlite3.connect
sqlite3.connect = lambda *words, **more: connect(*words, factory=Connection, **more)
shards.Shard(Path(sys.argv[1]))
"""
    killed = subprocess.run(
        [sys.executable, "-c", script, path], env=SHELL_ENVIRONMENT, timeout=60, check=False
    )
    assert killed.returncode == -signal.SIGKILL
    if moment < 3:
        assert path.stat().st_size == 0
    else:
        assert path.stat().st_size > 0
    run_sweep(study, tmp_path / "out", comm)
    assert not told()
    assert not faults.differences(tmp_path / "out", reference)


@pytest.mark.parametrize(
    ("file", "function", "call"),
    [
        ("operators.py", "write_operator", 1),  # assembly
        ("pathlib.py", "replace", 1),  # the operator's file has not its name yet
        ("shards.py", "add", 2),
        ("dataset.py", "write_ensemble", 1),  # merging
        ("pathlib.py", "replace", 2),  # results.h5 is whole, but has not its name yet
        ("pathlib.py", "replace", 3),  # it has, cases.csv has not
        ("store.py", "forget_shards", 1),
        ("locks.py", "forget_slices", 1),  # shards are gone, their folder is not
    ],
)
def test_a_sweep_killed_at_a_moment_of_note(tmp_path, swept, comm, file, function, call):
    """What had been computed by then is not computed again, and nothing is left over."""
    study, reference, _ = swept
    script = f"""
import os, signal, sys
from pathlib import Path
from mpi4py import MPI
from ringwear_par.studies import scheduling
from ringwear_par.studies.sweep import run_sweep

for name in {DRAWS}:  # one by one
    setattr(scheduling, name, 0.0)
calls = iter(range({call}, 0, -1))

def kill(frame, event, _):
    code = frame.f_code
    if event == "call" and code.co_name == {function!r} and code.co_filename.endswith({file!r}):
        if next(calls) == 1:
            os.kill(os.getpid(), signal.SIGKILL)

sys.setprofile(kill)
run_sweep(*map(Path, sys.argv[1:]), MPI.COMM_SELF)
"""
    killed = subprocess.run(
        [sys.executable, "-c", script, study, tmp_path / "out"],
        env=SHELL_ENVIRONMENT, timeout=100, check=False, capture_output=True,
    )  # fmt: skip
    assert killed.returncode == -signal.SIGKILL, killed.stderr
    before = faults.done_before(tmp_path / "out")
    run_sweep(study, tmp_path / "out", comm)
    assert not faults.differences(tmp_path / "out", reference)
    after = faults.seconds_by_id(tmp_path / "out")
    assert all(after[identity] == seconds for identity, seconds in before.items())
    left = {path.name for path in (tmp_path / "out").rglob("*")}
    assert left == {path.name for path in reference.rglob("*")}


@pytest.mark.parametrize("seen_under_way", [False, True])
def test_shards_that_are_removed_under_a_sweep(tmp_path, swept, comm, monkeypatch, seen_under_way):
    study, reference, _ = swept
    output, store_one = tmp_path / "out", workers.Worker._store
    stored = []

    def storing(self, block, *more):
        store_one(self, block, *more)
        stored.extend(block.ids)
        if len(stored) == 2:
            shutil.rmtree(output / "shards")

    with monkeypatch.context() as patch:
        patch.setattr(workers.Worker, "_store", storing)
        draw_one_by_one(patch)
        patch.setattr(shards, "_SYNC_SECONDS", 0.0 if seen_under_way else 1e9)
        patch.setattr(sweep, "PATIENCE_SECONDS", 0.3)
        with pytest.raises(ComputationError) as trouble:
            run_sweep(study, output, comm)
    assert len(str(trouble.value).splitlines()) == 1
    if seen_under_way:
        assert len(stored) == 2
        assert "all_0000.sqlite: was removed while it was written to; 0 of 6" in str(trouble.value)
        assert not (output / "results.h5").exists()
    else:
        assert f"{output}: 6 of 6 cases that have ended are not stored any more" in str(
            trouble.value
        )
        with h5py.File(output / "results.h5") as file:
            assert file.attrs["status"] == "incomplete"
            assert set(file["status"].asstr()[:]) == {"incomplete"}
    assert "the same command" in str(trouble.value)
    run_sweep(study, output, comm)
    assert not faults.differences(output, reference)


@pytest.fixture
def looks(monkeypatch):
    """Looks for what is stored."""
    looks, scan = [], store.Store.scan
    monkeypatch.setattr(store.Store, "scan", lambda *a, **b: (looks.append(a), scan(*a, **b))[1])
    return looks


def test_a_shard_that_comes_to_light_late(output, swept, comm, monkeypatch):
    """As on a disk of the network: not there at the first look, and nothing is lost."""
    study, reference, _ = swept
    before = faults.done_before(output)
    looks, scan = [], store.Store.scan

    def late(self, *words, **more):
        looks.append(words)
        index, notes = scan(self, *words, **more)
        return index if len(looks) != 2 else index.only(np.arange(2)), notes

    monkeypatch.setattr(store.Store, "scan", late)
    run_sweep(study, output, comm)
    assert len(looks) == 3
    assert faults.seconds_by_id(output) == before
    assert not faults.differences(output, reference)


def test_slices_leave_nothing(tmp_path, swept, comm):
    study, reference, _ = swept
    for part in ((1, 3), (2, 3), (3, 3)):
        run_sweep(study, tmp_path / "out", comm, part=part)
    assert {path.name for path in tmp_path.glob("out/lock*")} == {
        "lock", "lock1-3", "lock2-3", "lock3-3",
    }  # fmt: skip
    run_sweep(study, tmp_path / "out", comm)
    assert not faults.differences(tmp_path / "out", reference)


def test_damaged_files_are_kept_side_by_side(output, swept, comm, told):
    study, reference, _ = swept
    shard = shard_of(output)
    (output / "results.h5").write_bytes(b"")
    asides = ["results.damaged.h5", "1-1_0000.damaged", "1-1_0000.damaged2", "results.damaged2.h5"]
    shard.write_bytes(b"")
    shard.with_name(f"{shard.name}-wal").write_bytes(b"its journal")
    run_sweep(study, output, comm)
    assert told() == [
        f"{path}: is damaged (kept as {aside}); its cases run again"
        for path, aside in zip((output / "results.h5", shard), asides, strict=False)
    ]
    shard.write_bytes(b"two" * 1000)
    run_sweep(study, output, comm)
    assert told() == [f"{shard}: is damaged (kept as {asides[2]}); its cases run again"]
    (output / "results.h5").write_bytes(b"three")
    run_sweep(study, output, comm)
    assert told() == [
        f"{output / 'results.h5'}: is damaged (kept as {asides[3]}); its cases run again"
    ]
    kept = {path.name: path.read_bytes() for path in output.rglob("*damaged*")}
    assert kept.pop("1-1_0000.damaged-wal") == b"its journal"
    assert [kept.pop(name) for name in asides] == [b"", b"", b"two" * 1000, b"three"]
    assert not kept
    for path in output.rglob("*damaged*"):
        path.unlink()
    (output / "shards").rmdir()
    assert not faults.differences(output, reference)


@pytest.mark.parametrize(
    "change",
    [
        "layout = '{'",
        "layout = '[1, 2]'",
        """layout = '{"time": 3}'""",
        """layout = '{"time": [3], "r": [-1]}'""",
        """layout = '{"time": [3, 3]}'""",
        """layout = '{"unknown": [3]}'""",
        f"layout = '{'[' * 5000}'",
        "layout = CAST(x'ff' AS TEXT)",
        "layout = NULL",
        "data = x'00'",
        "data = NULL",
        "data = 'text'",
        "status = NULL",
        "status = 'incomplete'",
        "toml = NULL",
        "error = x'00'",
        "seconds = NULL",
        "seconds = 'long'",
        "imbalance = 'much'",
        "version = NULL",
        "id = NULL",
        "id = x'00'",
    ],
    ids=lambda change: change[:30],
)
def test_a_damaged_row_does_not_block_the_others(output, swept, comm, told, change):
    """Of a shard of an earlier version."""
    study, reference, _ = swept
    before, shard = faults.done_before(output), shard_of(output)
    as_earlier(shard)
    victim = sorted(before)[2]
    poison(shard, f"UPDATE cases SET {change} WHERE id = ?", victim)
    run_sweep(study, output, comm)
    aside = shard.with_suffix(".damaged")
    assert told() == [
        f"{shard}: 1 of its rows are damaged (kept in {aside.name}); their cases run again"
    ]
    assert faults.seconds_by_id(output).pop(victim) != before.pop(victim)
    shutil.rmtree(aside.parent)
    assert not faults.differences(output, reference)
    after = faults.seconds_by_id(output)
    assert all(after[identity] == seconds for identity, seconds in before.items())


def test_a_shard_of_an_earlier_version_is_merged(output, swept, comm, told):
    study, reference, _ = swept
    before = faults.done_before(output)
    as_earlier(shard_of(output))
    run_sweep(study, output, comm)
    assert not told()
    assert faults.seconds_by_id(output) == before
    assert not faults.differences(output, reference)


@pytest.mark.parametrize(
    "changes",
    [
        "ids = 'a\nb\nc\nd\ne\nf\ng'",
        "ids = NULL",
        "texts = NULL",
        "about = '{'",
        "about = '[1]'",
        f"about = '{'[' * 5000}'",
        "about = json_set(about, '$.layout.time', 'often')",
        "about = json_set(about, '$.layout.unknown', 'rows')",
        "about = json_set(about, '$.elements', -1)",
        "about = json_set(about, '$.elements', 'many')",
        "about = json_set(about, '$.version', 3)",
        "about = json_set(about, '$.flags', json('{\"0\": 3}'))",
        "about = json_set(about, '$.errors', json('[3]'))",
        "about = json_set(about, '$.longest', 'long')",
        "status = x'07'",
        "status = 'text'",
        "rows = x'00'",
        "rows = zeroblob(length(rows))",
        "seconds = x''",
        "imbalance = NULL",
    ],
    ids=lambda change: repr(change[:50]),
)
def test_a_damaged_block_does_not_block_the_others(output, swept, comm, told, changes):
    """Whether its checksum tells of it or not."""
    study, reference, _ = swept
    before, shard = faults.done_before(output), shard_of(output)
    there = blocks(shard)
    assert len(there) > 1
    number, lost = next(iter(there.items()))
    poison_block(shard, number, changes)
    run_sweep(study, output, comm)
    aside = shard.with_suffix(".damaged")
    assert told() == [
        f"{shard}: 1 of its rows are damaged (kept in {aside.name}); their cases run again"
    ]
    shutil.rmtree(aside.parent)
    assert not faults.differences(output, reference)
    after = faults.seconds_by_id(output)
    assert {identity for identity in before if after[identity] != before[identity]} == set(lost)


@pytest.mark.parametrize(
    "statement",
    [
        "DELETE FROM arrays WHERE block = 1 AND name = 'time'",
        "UPDATE arrays SET data = x'00' WHERE block = 1 AND name = 'time'",
        "UPDATE arrays SET data = 'text' WHERE block = 1 AND name = 'time'",
        "UPDATE blocks SET texts = 'other' WHERE number = 1",
    ],
)
def test_damaged_arrays_of_a_block(output, swept, comm, told, statement):
    study, reference, _ = swept
    shard = shard_of(output)
    poison(shard, statement)
    run_sweep(study, output, comm)
    assert len(told()) == 1
    shutil.rmtree(output / "shards")
    assert not faults.differences(output, reference)


@pytest.mark.parametrize("what", ["texts", "numbers"])
def test_what_is_damaged_within_a_block_takes_its_file_along(
    output, swept, comm, told, looks, what
):
    """That is seen only when it is read; what is lost with it is not waited for."""
    study, reference, _ = swept
    shard = shard_of(output)
    if what == "texts":
        poison_block(shard, 1, "texts = '[[], [], []]'")
    else:  # as by a single flipped bit
        where = "block = 1 AND name = 'torque'"
        poison(shard, f"UPDATE arrays SET data = zeroblob(length(data)) WHERE {where}")
    with pytest.raises(ComputationError, match="6 of 6 cases that have ended are not stored"):
        run_sweep(study, output, comm)
    assert told() == [f"{shard}: is damaged (kept as 1-1_0000.damaged); its cases run again"]
    assert len(looks) == 3
    run_sweep(study, output, comm)
    shutil.rmtree(output / "shards")
    assert not faults.differences(output, reference)


def test_a_block_is_stored_as_a_whole_or_not_at_all(output, swept, comm, told):
    """Killed before each of the statements that store it."""
    shard, copy = shard_of(output), output.parent / "copy.sqlite"
    before = faults.done_before(output)
    script = f"""
import os, signal, sqlite3, sys
from pathlib import Path
from ringwear_par.studies import shards
from ringwear_par.studies.blocks import Block, Record
import numpy as np

class Connection(sqlite3.Connection):
    left = None

    def execute(self, *words):
        if self.left == 0:
            os.kill(os.getpid(), signal.SIGKILL)
        self.left = None if self.left is None else self.left - 1
        return super().execute(*words)

connect = sqlite3.connect
sqlite3.connect = lambda *words, **more: connect(*words, factory=Connection, **more)
arrays = {{"time": np.zeros(3), "step": np.zeros(3), "r": np.ones(4)}}
record = Record("stranger", "", "done", "", 1.0, 0.0, arrays, "{ringwear_par.__version__}")
shard = shards.Shard(Path(sys.argv[1]))
shard._connection.left = int(sys.argv[2])
shard.add(Block.of([record]))
"""
    for moment in range(6):  # BEGIN, the block, its three arrays, COMMIT
        shutil.copy(shard, copy)
        killed = subprocess.run(
            [sys.executable, "-c", script, copy, str(moment)],
            env=SHELL_ENVIRONMENT, timeout=60, check=False,
        )  # fmt: skip
        assert killed.returncode == -signal.SIGKILL
        index, damaged = shards.read_index(copy)
        assert (len(index), damaged) == (CASES, 0)
        copy.unlink()
    assert faults.done_before(output) == before


def test_a_case_that_is_no_number(output, swept, comm, told):
    """SQLite stores NaN as NULL, in shards of earlier versions."""
    as_earlier(shard_of(output))
    with closing(sqlite3.connect(shard_of(output))) as connection:
        victim = min(identity for (identity,) in connection.execute("SELECT id FROM cases"))
    poison(shard_of(output), "UPDATE cases SET imbalance = ? WHERE id = ?", float("nan"), victim)
    run_sweep(swept[0], output, comm)
    assert not told()
    with h5py.File(output / "results.h5") as file:
        found = dict(zip(file["case"].asstr()[:], file["imbalance"][:], strict=True))
    assert [identity for identity, value in found.items() if value != value] == [victim]


def test_a_case_of_nobody(output, swept, comm, told):
    """A row that the study does not know, and whose text says nothing, is listed and no more."""
    study, reference, _ = swept
    as_earlier(shard_of(output))
    row = "'stranger', 'no = case =', 'done', '', 1.0, 0.0, '{}', x'', '1', ''"
    poison(shard_of(output), f"INSERT INTO cases VALUES ({row})")
    run_sweep(study, output, comm, mix_versions=True)
    assert not told()
    rows = faults.table(output)
    (last,) = [row for row in rows if row["case"] == "stranger"]
    assert (last["in_study"], last["wear.lower.k"]) == ("no", "")
    assert [row for row in rows if row is not last] == faults.table(reference)


@pytest.mark.parametrize("contents", ["no columns", "no table"])
def test_other_tables(output, swept, comm, told, contents):
    study, reference, _ = swept
    shard = shard_of(output)
    shard.unlink()
    connection = sqlite3.connect(shard)
    connection.execute(f"CREATE TABLE {'cases' if contents == 'no columns' else 'x'} (id TEXT)")
    connection.close()
    run_sweep(study, output, comm)
    if contents == "no columns":
        assert told() == [f"{shard}: is damaged (kept as 1-1_0000.damaged); its cases run again"]
        (output / "shards" / "1-1_0000.damaged").unlink()
        (output / "shards").rmdir()
    assert not told()
    assert not faults.differences(output, reference)


@pytest.fixture
def interrupted(tmp_path, swept, comm, stopped_after):
    """A folder whose first case was interrupted; the name of its checkpoint."""
    output = tmp_path / "out"
    with stopped_after(7), pytest.raises(ComputationError, match="stopped by SIGTERM"):
        run_sweep(swept[0], output, comm)
    (path,) = (output / "inflight").iterdir()
    return path


@pytest.mark.parametrize("kind", ["whole", "empty", "text", "truncated", "no checkpoint", "other"])
def test_checkpoints_in_flight(tmp_path, interrupted, swept, comm, told, one_by_one, kind):
    study, reference, output = swept[0], tmp_path / "reference", interrupted.parents[1]
    run_sweep(study, reference, comm)
    spoilt = interrupted
    if kind == "empty":
        interrupted.write_bytes(b"")
    elif kind == "text":
        interrupted.write_text("precious")
    elif kind == "truncated":
        os.truncate(interrupted, interrupted.stat().st_size // 2)
    elif kind == "no checkpoint":
        with h5py.File(interrupted, "r+") as file:
            del file["checkpoint"]
    elif kind == "other":
        other = sorted(faults.seconds_by_id(reference).keys() - {interrupted.stem})[0]
        spoilt = interrupted.with_name(f"{other}.h5")
        shutil.copy(interrupted, spoilt)
    run_sweep(study, output, comm)
    notes = told()
    if kind == "whole":
        assert not notes
    else:
        (note,) = notes
        assert note.startswith(f"{spoilt}: ")
        assert note.endswith("; this case starts anew")
        assert ("is of another case than its name says" in note) == (kind == "other")
    assert not faults.differences(output, reference)


def test_a_checkpoint_of_a_case_that_has_ended_goes(interrupted, swept, comm, told, one_by_one):
    """As after a kill between storing the case and removing its checkpoint."""
    study, output, content = swept[0], interrupted.parents[1], interrupted.read_bytes()
    run_sweep(study, output, comm)
    before = faults.seconds_by_id(output)
    interrupted.parent.mkdir()
    interrupted.write_bytes(content)
    run_sweep(study, output, comm)
    assert not told()
    assert not interrupted.parent.exists()
    assert faults.seconds_by_id(output) == before


def test_results_that_fail_only_when_they_are_read(swept, tmp_path, comm, told, looks, monkeypatch):
    """Then they are set aside, the rest is merged, and another sweep computes what was in them."""
    study, reference, _ = swept
    output = tmp_path / "out"
    shutil.copytree(reference, output)
    changed = tmp_path / "study.toml"
    shutil.copy(study.with_name("paper.toml"), tmp_path)
    text = study.read_text(encoding="utf-8").replace("[5e4, 1e5]", "[5e4, 1e5, 2e5]")
    changed.write_text(text, encoding="utf-8")

    def damaged(self, block, name):
        raise InputError(f"{self.path}: a block of it cannot be read")

    with monkeypatch.context() as patch:  # the index of cases is as it was
        patch.setattr(store.results_file.Results, "read", damaged)
        with pytest.raises(ComputationError, match="6 of 9 cases that have ended are not stored"):
            run_sweep(changed, output, comm)
    assert len(looks) == 3
    (note,) = told()
    assert note.startswith(f"{output / 'results.h5'}: is damaged (kept as results.damaged.h5)")
    run_sweep(changed, output, comm)
    assert [row["status"] for row in faults.table(output)] == ["done"] * 9


ENDLESS = (
    "SELECT 1 AS number, x AS ids, x AS texts, x AS about, x AS status, x AS rows, "
    "x AS seconds, x AS imbalance, 0 AS crc FROM "
    "(WITH RECURSIVE n(x) AS (SELECT 0 UNION ALL SELECT x + 1 FROM n) SELECT x FROM n)"
)


@pytest.mark.parametrize(
    "statements",
    [
        ["ALTER TABLE blocks RENAME TO others", f"CREATE VIEW blocks AS {ENDLESS}"],
        ["CREATE TRIGGER t AFTER INSERT ON blocks BEGIN DELETE FROM blocks; END"],
        ["ALTER TABLE blocks ADD COLUMN more AS (length(zeroblob(1e9)))"],
    ],
    ids=["view", "trigger", "computed column"],
)
def test_a_shard_of_more_than_tables_is_set_aside(output, statements):
    """Whose view has no end, or whose trigger does things of its own."""
    path = shard_of(output)
    assert shards.read_index(path) is not None
    with closing(sqlite3.connect(path)) as connection:
        for statement in statements:
            connection.execute(statement)
        connection.commit()
    assert shards.read_index(path) is None


def test_a_pipe_in_the_place_of_a_shard_or_a_lock(output, swept, comm):
    path = shard_of(output)
    path.unlink()
    os.mkfifo(path)
    assert shards.read_index(path) is None
    (output / "lock").unlink()
    os.mkfifo(output / "lock")
    with pytest.raises(InputError, match=r"lock: cannot be opened: it is a pipe or a device"):
        run_sweep(swept[0], output, comm)
