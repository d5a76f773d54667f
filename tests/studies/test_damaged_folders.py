"""Folders of sweeps in which somebody has removed, damaged or left behind files."""

import itertools
import json
import os
import shutil
import signal
import subprocess
import sys
import zlib
from dataclasses import replace

import h5py
import numpy as np
import pytest
import try_faults as faults
from commands import SHELL_ENVIRONMENT
from swept import write_study

from ringwear_par.errors import ComputationError
from ringwear_par.studies.execution import (
    case_queue,
    merging,
    plan,
    single_cases,
    team_store,
)
from ringwear_par.studies.execution.sweep import run_sweep
from ringwear_par.studies.execution.team_store import TeamStore
from ringwear_par.studies.storage import blocks, results_file, shards
from ringwear_par.studies.storage.blocks import CASE, DamagedError
from ringwear_par.studies.storage.folder import SweepFolder
from ringwear_par.studies.storage.shards import read_shard

pytestmark = [pytest.mark.serial, pytest.mark.slow]
STUDY = """
[vary]
"wear.lower.k" = { log = [1e-8, 1e-6], count = 3 }
"upper.young" = { values = [5e4, 1e5] }
[design]
method = "grid"
"""


#: what says how many cases are drawn at once
DRAWS = ("_BUSY_SECONDS", "_LONGEST_SECONDS", "_LEAST_SECONDS")


def draw_one_by_one(patch):
    for name in DRAWS:
        patch.setattr(case_queue, name, 0.0)


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
    (path,) = (output / "shards").glob("*.blocks")
    return path


def parts(path):
    """The headers' words, the cases and the data of the blocks of a shard."""
    content, at, found = path.read_bytes(), 0, []
    while at < len(content):
        _, size, count, data, _ = blocks._HEAD.unpack(content[at : at + blocks._HEAD.size])
        ends = np.cumsum([at + blocks._HEAD.size, size, count * CASE.itemsize, data])
        words, cases, arrays = (content[a:b] for a, b in itertools.pairwise(ends.tolist()))
        cases = np.frombuffer(cases, dtype=CASE).copy()
        found.append([json.loads(words), cases, arrays])
        at = int(ends[-1])
    return found


def write_parts(path, found):
    """Write such blocks, with the checksums that these headers have."""
    content = b""
    for words, cases, arrays in found:
        header = json.dumps(words).encode() + cases.tobytes()
        numbers = len(header) - cases.nbytes, len(cases), len(arrays)
        checksum = blocks._checksum(numbers, header)
        content += blocks._HEAD.pack(blocks.MARKER, *numbers, checksum) + header + arrays
    path.write_bytes(content)


def blocks_of(path):
    return read_shard(path).blocks


@pytest.mark.parametrize("block", ["none", "first", "last"])
def test_a_sweep_killed_while_it_writes_a_block(output, swept, comm, told, block):
    """Its cases alone are computed again; see test_shards.py for any other byte."""
    study, reference, _ = swept
    before, shard = faults.done_before(output), shard_of(output)
    stored = blocks_of(shard)
    os.truncate(shard, {"none": 0, "first": stored[0].stop - 1, "last": stored[-1].stop - 1}[block])
    kept = faults.done_before(output)
    assert (0 < len(kept) < len(before)) == (block == "last")
    run_sweep(study, output, comm)
    assert not told()
    assert not faults.differences(output, reference)
    after = faults.seconds_by_id(output)
    assert {name: after[name] for name in kept} == kept


@pytest.mark.parametrize(
    ("file", "function", "call"),
    [
        ("shards.py", "add", 2),
        ("results_writer.py", "write_results", 1),  # merging
        ("pathlib.py", "replace", 3),  # it has, cases.csv has not
        ("folder.py", "forget_slices", 1),  # shards are gone, their folder is not
    ],
)
def test_a_sweep_killed_at_a_moment_of_note(tmp_path, swept, comm, file, function, call):
    """What had been computed by then is not computed again."""
    study, reference, _ = swept
    script = f"""
import os, signal, sys
from pathlib import Path
from mpi4py import MPI
from ringwear_par.studies.execution import case_queue
from ringwear_par.studies.execution.sweep import run_sweep

for name in {DRAWS}:  # one by one
    setattr(case_queue, name, 0.0)
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
    for half_written in (tmp_path / "out").glob(".*.tmp"):
        half_written.unlink()
    assert not faults.differences(tmp_path / "out", reference)
    after = faults.seconds_by_id(tmp_path / "out")
    assert all(after[identity] == seconds for identity, seconds in before.items())
    left = {path.name for path in (tmp_path / "out").rglob("*")}
    assert left == {path.name for path in reference.rglob("*")}


@pytest.mark.parametrize("seen_under_way", [False, True])
def test_shards_that_are_removed_under_a_sweep(tmp_path, swept, comm, monkeypatch, seen_under_way):
    study, reference, _ = swept
    output, store_one = tmp_path / "out", TeamStore.add
    stored = []

    def storing(self, columns, cases):
        columns = store_one(self, columns, cases)
        stored.extend(cases.ids)
        if len(stored) == 2:
            shutil.rmtree(output / "shards")
        return columns

    with monkeypatch.context() as patch:
        patch.setattr(TeamStore, "add", storing)
        draw_one_by_one(patch)
        patch.setattr(shards, "_SYNC_SECONDS", 0.0 if seen_under_way else 1e9)
        patch.setattr(merging, "_PATIENCE_SECONDS", 0.3)
        with pytest.raises(ComputationError) as trouble:
            run_sweep(study, output, comm)
    assert len(str(trouble.value).splitlines()) == 1
    if seen_under_way:
        assert len(stored) == 2
        assert "all_0000.blocks: was removed while it was written to; 0 of 6" in str(trouble.value)
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
    looks, scan = [], SweepFolder.scan
    monkeypatch.setattr(SweepFolder, "scan", lambda *a, **b: (looks.append(a), scan(*a, **b))[1])
    return looks


def test_a_shard_that_comes_to_light_late(output, swept, comm, monkeypatch):
    """As on a disk of the network: not there at the first look, and nothing is lost."""
    study, reference, _ = swept
    before = faults.done_before(output)
    looks, scan = [], SweepFolder.scan

    def late(self, *words, **more):
        looks.append(words)
        index, notes = scan(self, *words, **more)
        if len(looks) == 2:
            index = replace(index, entries=index.entries[:2])
        return index, notes

    monkeypatch.setattr(SweepFolder, "scan", late)
    run_sweep(study, output, comm)
    assert len(looks) == 3
    assert faults.seconds_by_id(output) == before
    assert not faults.differences(output, reference)


def test_damaged_files_are_kept_side_by_side(output, swept, comm, told):
    study, reference, _ = swept
    shard = shard_of(output)
    (output / "results.h5").write_bytes(b"")
    asides = ["results.damaged.h5", "1-1_0000.damaged", "1-1_0000.damaged2", "results.damaged2.h5"]
    shard.write_bytes(b"one" * 1000)
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
    contents = [b"", b"one" * 1000, b"two" * 1000, b"three"]
    assert [kept.pop(name) for name in asides] == contents
    assert not kept
    for path in output.rglob("*damaged*"):
        path.unlink()
    (output / "shards").rmdir()
    assert not faults.differences(output, reference)


def words(**changes):
    return lambda found, cases: found.update(changes)


def columns(**changes):
    return lambda found, cases: found["columns"].update(changes)


def entries(name, value):
    def change(found, cases):
        cases[name] = value

    return change


NONSENSE = [
    words(sizes=None),
    words(sizes={"element": -1}),
    words(kinds=[["1", 3, ""]]),
    columns(time=("often", 8, 0)),
    columns(unknown=("state", 8, 0)),
    columns(time=("state",)),
    entries("status", 7),
    entries("rows", -1),
    entries("kind", 1000),
]


def test_a_header_that_makes_no_sense_does_not_block_the_others(output):
    """Though its checksum is right."""
    shard = shard_of(output)
    whole = [set(block.cases["id"].tolist()) for block in blocks_of(shard)]
    assert len(whole) > 1
    content = shard.read_bytes()
    for change in NONSENSE:
        found = parts(shard)
        change(*found[0][:2])
        write_parts(shard, found)
        assert [set(block.cases["id"].tolist()) for block in blocks_of(shard)] == whole[1:]
        assert read_shard(shard).damaged
        shard.write_bytes(content)


@pytest.mark.parametrize("number", [0, 1])
def test_a_flipped_bit_of_a_header_costs_its_block_alone(output, swept, comm, told, number):
    """Its cases, and no others, are computed again, and the shard is kept as it was."""
    study, reference, _ = swept
    before, shard = faults.done_before(output), shard_of(output)
    lost = set(parts(shard)[number][1]["id"].astype(str))
    content = bytearray(shard.read_bytes())
    content[3 if number == 0 else blocks_of(shard)[number - 1].stop + 60] ^= 4
    shard.write_bytes(content)
    run_sweep(study, output, comm)
    aside = shard.with_suffix(".damaged")
    assert told() == [f"{shard}: some of it is damaged (kept in {aside.name}); its cases run again"]
    assert aside.read_bytes() == content
    shutil.rmtree(aside.parent)
    assert not faults.differences(output, reference)
    after = faults.seconds_by_id(output)
    assert {identity for identity in before if after[identity] != before[identity]} == lost


@pytest.mark.parametrize("what", ["texts", "numbers"])
def test_what_is_damaged_within_a_block_takes_the_block_along(
    output, swept, comm, told, looks, what
):
    """That is seen only when it is read; what is lost with it is not waited for."""
    study, reference, _ = swept
    before, shard = faults.done_before(output), shard_of(output)
    found = parts(shard)
    lost = set(found[0][1]["id"].astype(str))
    if what == "texts":
        packed = b"[[], [], []]"
        words, _, data = found[0]
        size = words["columns"]["toml"][1]
        words["columns"]["toml"] = "block", len(packed), zlib.crc32(packed)
        found[0][2] = data[:-size] + packed
        write_parts(shard, found)
    else:
        content = bytearray(shard.read_bytes())
        content[blocks_of(shard)[0].start + 100] ^= 1
        shard.write_bytes(content)
    with pytest.raises(ComputationError, match=f"{len(lost)} of 6 cases that have ended are not"):
        run_sweep(study, output, comm)
    aside = "1-1_0000.damaged"
    assert told() == [f"{shard}: some of it is damaged (kept in {aside}); its cases run again"]
    assert len(looks) == 3
    run_sweep(study, output, comm)
    shutil.rmtree(output / "shards")
    assert not faults.differences(output, reference)
    after = faults.seconds_by_id(output)
    assert {identity for identity in before if after[identity] != before[identity]} == lost


@pytest.fixture
def interrupted(tmp_path, swept, comm, stopped_after):
    """A folder whose first case was interrupted; the name of its checkpoint."""
    output = tmp_path / "out"
    with stopped_after(7), pytest.raises(ComputationError, match="stopped by SIGTERM"):
        run_sweep(swept[0], output, comm)
    (path,) = (output / "inflight").iterdir()
    return path


@pytest.mark.parametrize("kind", ["truncated", "no checkpoint", "other"])
def test_checkpoints_in_flight(interrupted, swept, comm, told, one_by_one, kind):
    (study, reference, _), output = swept, interrupted.parents[1]
    spoilt = interrupted
    if kind == "truncated":
        os.truncate(interrupted, interrupted.stat().st_size // 2)
    elif kind == "no checkpoint":
        with h5py.File(interrupted, "r+") as file:
            del file["checkpoint"]
    else:
        other = sorted(faults.seconds_by_id(reference).keys() - {interrupted.stem})[0]
        spoilt = interrupted.with_name(f"{other}.h5")
        shutil.copy(interrupted, spoilt)
    run_sweep(study, output, comm)
    (note,) = told()
    assert note.startswith(f"{spoilt}: ")
    assert note.endswith("; this case starts anew")
    assert ("is of another case than its name says" in note) == (kind == "other")
    assert not faults.differences(output, reference)


@pytest.mark.parametrize("version", [team_store.__version__, "99.0"])
def test_a_checkpoint_that_no_block_tells_of(
    interrupted, swept, comm, told, one_by_one, monkeypatch, version
):
    """As after a kill between a checkpoint and the next: its case continues from it."""
    study, reference, _ = swept
    output = interrupted.parents[1]
    (output / "results.h5").unlink()
    for module in (plan, team_store):
        monkeypatch.setattr(module, "__version__", version)
    before, recorder = [], single_cases.Recorder
    monkeypatch.setattr(
        single_cases, "Recorder",
        lambda cases, comm, start, **how: (
            before.append(start) or recorder(cases, comm, start, **how)
        ),
    )  # fmt: skip
    run_sweep(study, output, comm)
    continued = [start for start in before if start is not None]
    if version == "99.0":
        (note,) = told()
        assert note.startswith(f"{interrupted}: is of version ")
        assert note.endswith("; this case starts anew")
        assert not continued
    else:
        assert not told()
        assert [start.path for start in continued] == [interrupted]
        assert not faults.differences(output, reference)


def test_results_that_fail_only_when_they_are_read(swept, tmp_path, comm, told, looks, monkeypatch):
    """Then they are set aside, the rest is merged, and another sweep computes what was in them."""
    study, reference, _ = swept
    output = tmp_path / "out"
    shutil.copytree(reference, output)
    changed = tmp_path / "study.toml"
    shutil.copy(study.with_name("paper.toml"), tmp_path)
    text = study.read_text(encoding="utf-8").replace("[5e4, 1e5]", "[5e4, 1e5, 2e5]")
    changed.write_text(text, encoding="utf-8")

    def damaged(self, names):
        raise DamagedError(self.path)

    with monkeypatch.context() as patch:  # the index of cases is as it was
        patch.setattr(results_file.ResultsBlock, "read", damaged)
        with pytest.raises(ComputationError, match="6 of 9 cases that have ended are not stored"):
            run_sweep(changed, output, comm)
    assert len(looks) == 3
    (note,) = told()
    assert note.startswith(f"{output / 'results.h5'}: is damaged (kept as results.damaged.h5)")
    run_sweep(changed, output, comm)
    assert [row["status"] for row in faults.table(output)] == ["done"] * 9
