"""Full disks: a sentence, status 1, the file that was there, and nothing else."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import h5py
import killed_sweeps as faults
import numpy as np
import pytest
from commands import SHELL_ENVIRONMENT
from paths import CASES, HELPERS, PAPER
from stored import contents

from ringwear_par.elasticity.bem import assembly
from ringwear_par.results.execution import run as run_command
from ringwear_par.results.execution.run import run_case
from ringwear_par.results.storage.hdf5 import atomic_hdf5
from ringwear_par.results.storage.result_files import open_result, read_status
from ringwear_par.studies.execution.sweep import run_sweep

pytestmark = [pytest.mark.serial, pytest.mark.slow]
SMALL = ["mesh.contact_elements=16", "time.steps=20"]
WIDE = ["mesh.contact_elements=64", "time.steps=8"]
FULL = {"disk": "No space left on device", "limit": "File too large"}


ON_A_DISK_TOO = pytest.mark.parametrize("kind", ["disk", "limit"])


@pytest.fixture
def kind():
    """How room is limited: of all files together, by a small disk, or of each."""
    return "limit"


@pytest.fixture
def full(kind, tmp_path):
    """Function that runs a command with less or more room: see full_disk.py, which runs it."""
    folder = tmp_path / "small"
    folder.mkdir()
    if kind == "disk":
        mount = ["mount", "-t", "tmpfs", "-o", "size=64m", "tmpfs", str(folder)]
        if os.geteuid() or not shutil.which("mount"):
            pytest.skip("only root may mount a small disk")
        if subprocess.run(mount, capture_output=True, timeout=20, check=False).returncode:
            pytest.skip("mounting a small disk is not allowed here")

    def full(words, sizes, before=(), **more):
        told = {
            "folder": str(folder), "words": [str(w) for w in words], "sizes": sizes,
            "before": {name: str(path) for name, path in dict(before).items()},
            "keep": str(tmp_path / "kept"), **more,
        }  # fmt: skip
        found = subprocess.run(
            [sys.executable, HELPERS / "full_disk.py", kind], input=json.dumps(told), text=True,
            env=SHELL_ENVIRONMENT, capture_output=True, timeout=200, check=False,
        )  # fmt: skip
        assert found.returncode == 0, found.stderr
        # Open MPI's daemon beside a command started alone now and then has trouble of its own
        assert [line for line in found.stderr.splitlines() if "ORTE_ERROR_LOG" not in line] == []
        return [
            (size, *result) for size, result in zip(sizes, json.loads(found.stdout), strict=True)
        ]

    full.folder, full.kept, full.words = folder, tmp_path / "kept", FULL[kind]
    try:
        yield full
    finally:
        if kind == "disk":
            subprocess.run(["umount", "-l", str(folder)], timeout=20, check=True)


@pytest.fixture(scope="module")
def runs(tmp_path_factory, comm):
    """Results: of the paper's case, of one that is over soon, and with fields."""
    folder = tmp_path_factory.mktemp("runs")
    run_case(PAPER, folder / "whole.h5", SMALL, comm=comm)
    run_case(PAPER, folder / "old.h5", [SMALL[0], "time.steps=1"], comm=comm)
    run_case(PAPER, folder / "wide.h5", WIDE, comm=comm)
    run_case(CASES / "fields.toml", folder / "fields.h5", SMALL[:1], comm=comm)
    return folder


def sizes_for(size, count=7):
    """Sizes from a page to what is more than enough for a file of this size."""
    return [4096 * n for n in sorted({round(x) for x in np.geomspace(1, size / 2048 + 1, count)})]


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def check(full, results, name, old=None):
    """All or nothing, and a sentence if nothing; return the folders where all was written."""
    assert {status for _, status, *_ in results} == {0, 1}
    whole = []
    for size, status, said in results:
        left = full.kept / str(size)
        said = [line for line in said if not line.endswith("will be replaced")]
        if status == 0:
            whole.append(left)
            assert said == []
            assert name in names(left)
            continue
        assert not whole, "more room, and still not enough"
        assert len(said) == 1, said
        assert said[0].startswith(f"ringwear: {full.folder / name}: {full.words}")
        assert names(left) == ([name] if old else [])
        if old:
            assert (left / name).read_bytes() == old.read_bytes()
    return whole


@ON_A_DISK_TOO
def test_run(full, runs, kind):
    words = ["run", PAPER, "-o", full.folder / "run.h5", "--set", *SMALL]
    old = runs / "old.h5" if kind == "disk" else None
    sizes = sizes_for((runs / "whole.h5").stat().st_size)
    results = full(words, sizes, {"run.h5": old} if old else {})
    reference = contents(runs / "whole.h5")
    for left in check(full, results, "run.h5", old):
        found = contents(left / "run.h5")
        assert found.keys() == reference.keys()
        np.testing.assert_equal(found, reference)
    assert all("nothing of this run is stored" in said[-1] for _, status, said in results if status)


def test_run_with_checkpoints(full, runs):
    """It goes on without them, says so once, and what it could write is there."""
    words = ["run", PAPER, "-o", full.folder / "run.h5", "--set", *WIDE]
    size = (runs / "wide.h5").stat().st_size  # two are there at a time
    sizes = [int(share * size) // 4096 * 4096 for share in (0.1, 0.7, 0.9, 1.1, 1.6, 2.4)]
    reached = set()
    for size, status, said in full(words, sizes, checkpoint_seconds=0.0):
        left = full.kept / str(size)
        told = [line for line in said if "checkpoint not written, going on: " in line]
        assert len(told) <= 1, said
        if status == 0:
            assert read_status(left / "run.h5") == ("complete", 8)
            assert said == told
            continue
        assert said[:-1] == told
        assert said[-1].startswith(f"ringwear: {full.folder / 'run.h5'}: {full.words}")
        if "nothing of this run is stored" in said[-1]:
            assert told
            assert not names(left)
            continue
        assert names(left) == ["run.h5"]
        steps = read_status(left / "run.h5")[1]
        assert f"it holds the steps up to {steps}, and --restart goes on from there" in said[-1]
        assert open_result(left / "run.h5").checkpoint.progress.steps == steps
        reached.add(steps)
    assert reached
    assert status == 0


@pytest.mark.parametrize(
    "words",
    [
        ["plot", "fields.h5", "-o", "old.png", "--panels", "section"],
        ["export", "fields.h5", "-o", "old.vtkhdf"],
    ],
    ids=lambda words: words[3],
)
def test_plot_and_export(full, runs, tmp_path, words):
    command, source, option, name, *rest = words
    old = tmp_path / "before"
    old.write_bytes(b"precious" * 100)
    words = [command, runs / source, option, full.folder / name, *rest]
    (tmp_path / "sizes").mkdir()
    ((size, status, _),) = full(words, [60_000_000], {name: old})
    assert status == 0
    whole = full.kept / str(size) / name
    sizes = sizes_for(whole.stat().st_size, 4)
    for left in check(full, full(words, sizes, {name: old}), name, old):
        assert (left / name).stat().st_size == pytest.approx(whole.stat().st_size, rel=0.01)


@ON_A_DISK_TOO
def test_sweep(full, tmp_path, comm):
    """What is stored of it stays; with room, it ends as if nothing had been."""
    study = faults.write_study(tmp_path, count=2, steps=10, elements=(12, 14, 16))
    run_sweep(study, tmp_path / "reference", comm)
    size = (tmp_path / "reference" / "results.h5").stat().st_size
    words = ["sweep", study, "-o", full.folder / "out"]
    found = full(words, sizes_for(1.5 * size, 9), again=True)
    stored = set()
    for size, status, said, status_again, said_again in found:
        left = full.kept / str(size) / "out"
        assert not list(left.rglob("*.tmp*"))
        before = faults.done_before(left)
        if status:
            (told,) = said
            assert f"{len(before)} of 30 cases are stored, and the same command goes on" in told
            stored.add(len(before))
        again = full.kept / f"{size}_again" / "out"
        assert status_again == 0, said_again
        assert not faults.differences(again, tmp_path / "reference")
        after = faults.seconds_by_id(again)
        assert all(after[identity] == seconds for identity, seconds in before.items())
    assert len(stored) > 2
    assert status == 0


def test_files_of_many_sizes_fit_or_do_not(tmp_path):
    """Large variables, small ones and texts: wherever the disk ends, HDF5 survives it."""
    import resource

    path = tmp_path / "a.h5"

    def fill(file):
        for i in range(30):
            file[f"small_{i}"] = np.arange(30.0)
            file[f"text_{i}"] = ["x" * 500] * 40
            file[f"small_{i}"].attrs["meaning"] = "y" * 200
        chunked = file.create_dataset("chunked", (100, 1000), dtype=float, chunks=(10, 100))
        chunked[:50] = 1.0
        chunked[50:] = chunked[:50] + file["small_0"][1]

    def write(size):
        """Return the error with files of at most so many bytes, if there is one."""
        hard = resource.getrlimit(resource.RLIMIT_FSIZE)[1]
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
        try:
            with atomic_hdf5(path) as (file, check_disk):
                fill(file)
                assert file["chunked"][0, 0] == 1.0
                assert file["chunked"][-1, -1] == 2.0
                assert file["text_29"].asstr()[39] == "x" * 500
        except OSError as error:
            with pytest.raises(OSError, match=FULL["limit"]):
                check_disk()
            return error
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (hard, hard))

    for size in (*range(1, 40_000, 3999), *range(40_000, 1_500_000, 160_009)):
        error = write(size)
        assert (error.filename, error.strerror) == (str(path), FULL["limit"])
        assert not list(tmp_path.iterdir())
    assert write(3_000_000) is None
    with h5py.File(path) as file:
        assert np.array_equal(np.unique(file["chunked"]), [1.0, 2.0])
        assert file["text_0"].asstr()[0] == "x" * 500


def test_checkpoints_are_missed_once_a_cause(shared_path, comm, monkeypatch, caplog):
    from ringwear_par.results.execution import run as driver

    caplog.set_level("INFO")
    write, calls = driver.write_result, []

    def failing(*args):
        calls.append(1)
        if len(calls) in (2, 3, 4, 9):
            raise OSError(28, "No space left on device", "run.h5")
        if len(calls) in (5, 6):
            raise OSError(5, "Input/output error", "run.h5")
        write(*args)

    monkeypatch.setattr(driver, "write_result", failing)
    monkeypatch.setattr(run_command, "CHECKPOINT_SECONDS", 0.0)
    run_case(PAPER, shared_path / "run.h5", SMALL, comm=comm)
    missed = "checkpoint not written, going on: run.h5: "
    assert [m for m in caplog.messages if "checkpoint" in m] == [
        f"{missed}No space left on device", f"{missed}Input/output error",
        "checkpoints are written again", f"{missed}No space left on device",
        "checkpoints are written again",
    ]  # fmt: skip


def test_compiled_code_that_the_disk_does_not_take(comm, monkeypatch, caplog):
    """Every function fails once, after it was compiled, and never again."""
    attempts = []

    def compiled(*_):
        attempts.append(1)
        if len(attempts) < 4:
            raise OSError(28, "No space left on device")

    monkeypatch.setattr(assembly, "assemble", compiled)
    assembly.load_kernels(comm)
    assert len(attempts) == 4
    assert caplog.messages == ["compiled code is not kept, going on: No space left on device"]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full")
def test_standard_output_on_a_full_disk(tmp_path):
    words = [sys.executable, "-m", "ringwear_par", "info", "--schema"]
    with open("/dev/full", "w") as nowhere:
        result = subprocess.run(
            words, stdout=nowhere, stderr=subprocess.PIPE, text=True, env=SHELL_ENVIRONMENT,
            timeout=100, check=False,
        )  # fmt: skip
    assert result.returncode == 1
    assert result.stderr.startswith("ringwear: ")
    assert result.stderr.endswith("No space left on device\n")
