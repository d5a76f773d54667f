"""Contact pairs that are kept on disk: the same bits, whatever is there and whoever else writes."""

import math
import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from commands import SHELL_ENVIRONMENT
from full_disk import resize
from mpi4py import MPI
from paths import ROOT
from reference_cases import paper_case

from ringwear_par.elasticity import pair_cache
from ringwear_par.elasticity.bem.solve import solved_on_one_rank
from ringwear_par.elasticity.mesh import Mesh
from ringwear_par.history.elastic import pairs
from ringwear_par.history.elastic.bodies import operator_key
from ringwear_par.petsc import PETSc

#: ranks share little here: rank 0 reads and writes
pytestmark = pytest.mark.serial
N = 8
PARTS = ("normal", "twist", "force_reaction", "torque_reaction", "slope")


@pytest.fixture
def folder(shared_path, monkeypatch):
    monkeypatch.setenv(pair_cache.VARIABLE, str(shared_path / "kept"))
    monkeypatch.setattr(pair_cache, "_unseen", math.inf)
    pair_cache._warn.cache_clear()
    return shared_path / "kept"


@pytest.fixture
def assembled(monkeypatch):
    """Numbers of contact elements of the pairs that were assembled."""
    told, assemble_pair = [], pairs.assemble_pair

    def assemble(*words):
        told.append(words[1].n)
        return assemble_pair(*words)

    monkeypatch.setattr(pairs, "assemble_pair", assemble)
    return told


def same(one, other):
    return one.key == other.key and all(
        np.array_equal(getattr(one, name), getattr(other, name)) for name in PARTS
    )


def the_file(folder):
    (path,) = folder.iterdir()
    return path


@pytest.mark.ranks
def test_what_is_kept_has_the_same_bits(folder, assembled, comm):
    case = paper_case(Mesh(N))
    new = pairs.assemble(case, comm, use_kept=False)
    comm.Barrier()
    assert not folder.exists()
    comm.Barrier()
    first, again = pairs.assemble(case, comm), pairs.assemble(case, comm)
    alone = pairs.assemble(case, MPI.COMM_SELF)
    assert same(new, first)
    assert same(new, again)
    assert same(new, alone)
    assert assembled == [N, N]
    assert first.cost.kernel_evaluations > 0
    assert again.cost.kernel_evaluations == 0


def test_other_shapes_are_others(folder, assembled, comm):
    case = paper_case(Mesh(N))
    lower = case.lower
    cases = [
        case,
        replace(case, mesh=Mesh(N, grading=2.6)),
        replace(case, mesh=Mesh(N, quadrature_tolerance=1e-6)),
        replace(case, lower=replace(lower, poisson=lower.poisson + 1e-16 * 2)),
        replace(case, upper=replace(case.upper, grip="platen")),
        replace(case, lower=replace(lower, r=(lower.r[0], lower.r[1] * (1 + 1e-15)))),
    ]
    for one in cases:
        pairs.assemble(one, comm)
    assert len(assembled) == len({operator_key(one) for one in cases}) == len(cases)
    for one in cases:  # moduli, loads and how elements follow the wear make no difference
        stiff = replace(one, lower=replace(one.lower, young=3e5), friction=0.2)
        pairs.assemble(replace(stiff, mesh=replace(one.mesh, geometry="updated")), comm)
    assert len(assembled) == len(cases)


def as_ours(path, content):
    return pair_cache._MAGIC + pair_cache._checksum(path.name, content) + content


def changed(where, value):
    """What is in a file that has its checksum, and one number that no pair has."""

    def content(path, content):
        numbers = np.frombuffer(content[START:]).reshape(2, N + 3, N).copy()
        numbers[where] = value
        return as_ours(path, numbers.tobytes())

    return content


#: bytes before the numbers
START = len(pair_cache._MAGIC) + 32
#: contents of a file, from those that it had
DAMAGED = {
    "flipped": lambda path, content: content[:500] + bytes([content[500] ^ 1]) + content[501:],
    "cut": lambda path, content: content[:-9],
    "text": lambda path, content: b"no pair",
    "stranger's": lambda path, content: as_ours(path, b"\x93NUMPY or whatever has a checksum"),
    "another pair's": lambda path, content: as_ours(path.with_stem("another"), content[START:]),
    "format": lambda path, content: content.replace(b"pair 3", b"pair 2", 1),
    "not finite": changed((0, 0, 0), np.nan),
    "sign": changed((0, 2, 2), -1.0),
    "twist": changed((1, N, 0), 0.0),
    "reciprocity": changed((0, 1, 6), 9.0),
    "equilibrium": changed((1, N + 1, 4), 1.0),
}


@pytest.mark.parametrize("how", DAMAGED)
def test_damaged_files_are_replaced(folder, assembled, comm, caplog, how):
    case = paper_case(Mesh(N))
    whole = pairs.assemble(case, comm)
    path = the_file(folder)
    content = path.read_bytes()
    path.write_bytes(DAMAGED[how](path, content))
    assert same(whole, pairs.assemble(case, comm))
    assert assembled == [N, N]
    assert the_file(folder).read_bytes() == content
    assert caplog.messages == [f"{path}: damaged; what it held is assembled anew"]


REASONS = {
    "of another user": "belongs to another user; must be yours alone to write to",
    "written by others": "other users may write to it; must be yours alone to write to",
}


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may give files away")
@pytest.mark.parametrize("how", REASONS)
def test_files_of_strangers_are_not_used(folder, assembled, comm, caplog, how):
    """Nor their numbers, which are a thousandth off."""
    case = paper_case(Mesh(N))
    whole = pairs.assemble(case, comm)
    path = the_file(folder)
    content = as_ours(path, (1.001 * np.frombuffer(path.read_bytes()[START:])).tobytes())
    path.write_bytes(content)
    path.chmod(0o666 if how == "written by others" else 0o600)
    if how == "of another user":
        os.chown(path, 12345, 12345)
    assert same(whole, pairs.assemble(case, comm))
    assert assembled == [N, N]
    assert caplog.messages == [f"{path}: {REASONS[how]}; what it held is assembled anew"]
    assert same(whole, pairs.assemble(case, comm))  # by now it is ours again
    assert assembled == [N, N]


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may give files away")
@pytest.mark.parametrize("how", ["written by others", "link"])
def test_folders_of_strangers_are_not_used(folder, assembled, comm, caplog, how):
    if how == "link":
        folder.with_name("real").mkdir(0o700)
        folder.symlink_to(folder.with_name("real"))
        os.chown(folder, 12345, 12345, follow_symlinks=False)
    else:
        folder.mkdir()
        folder.chmod(0o777)
    for _ in range(2):
        pairs.assemble(paper_case(Mesh(N)), comm)
    assert assembled == [N, N]
    assert not list(folder.iterdir())
    reason = REASONS["of another user" if how == "link" else how]
    assert caplog.messages == [f"assembled pairs are not kept, going on: {folder}: {reason}"]


def test_what_made_the_numbers_is_part_of_the_name(folder, assembled, comm, monkeypatch):
    case = paper_case(Mesh(N))
    pairs.assemble(case, comm)
    monkeypatch.setattr(pair_cache, "_surroundings", lambda: "another version of the assembly")
    pairs.assemble(case, comm)
    monkeypatch.setattr(pair_cache, "blas_threads", lambda: 77)
    pairs.assemble(case, comm)
    assert assembled == [N, N, N]


def test_options_for_petsc_ask_for_assembly(folder, assembled, comm):
    case, options = paper_case(Mesh(N)), PETSc.Options()
    pairs.assemble(case, comm)
    options["bem_ksp_type"] = "preonly"
    try:
        assert not solved_on_one_rank(10, 1)
        pairs.assemble(case, comm)
    finally:
        del options["bem_ksp_type"]
    assert assembled == [N, N]


@pytest.mark.ranks
def test_systems_that_ranks_share_are_not_kept(folder, assembled, comm, monkeypatch):
    from ringwear_par.elasticity.bem import solve

    monkeypatch.setattr(solve, "ONE_RANK_LIMIT", 50)
    case = paper_case(Mesh(N))
    for _ in range(2):
        pairs.assemble(case, comm)
    comm.Barrier()
    assert len(assembled) == (1 if comm.size == 1 else 2)
    assert folder.exists() == (comm.size == 1)


def test_what_is_used_stays_and_the_oldest_go(folder, assembled, comm, monkeypatch):
    cases = [paper_case(Mesh(N, grading=2.0 + 0.1 * i)) for i in range(4)]
    monkeypatch.setattr(pair_cache, "_UNSEEN", 0.0)
    monkeypatch.setattr(pair_cache, "LIMIT", 3 * 1700)
    for age, case in zip((300, 200, 100), cases, strict=False):
        before = set(folder.iterdir()) if folder.exists() else set()
        pairs.assemble(case, comm)
        (new,) = set(folder.iterdir()) - before
        assert 1400 < new.stat().st_size < 1700
        os.utime(new, (new.stat().st_mtime - age,) * 2)
    pairs.assemble(cases[0], comm)  # the oldest, and in use again
    pairs.assemble(cases[3], comm)
    assert pair_cache.size(folder)[0] == 3
    assert pair_cache.size(folder)[1] <= pair_cache.LIMIT
    assembled.clear()
    for i in (0, 2, 3):
        pairs.assemble(cases[i], comm)
    assert not assembled
    pairs.assemble(cases[1], comm)
    assert len(assembled) == 1


@pytest.mark.ranks
def test_a_folder_that_cannot_be(folder, comm, caplog):
    if comm.rank == 0:
        folder.write_text("a file")
    comm.Barrier()
    case = paper_case(Mesh(N))
    assert same(pairs.assemble(case, comm), pairs.assemble(case, comm))
    told = [m for m in caplog.messages if "not kept" in m]
    assert told == ([f"assembled pairs are not kept, going on: {folder}: Not a directory"]
                    if comm.rank == 0 else [])  # fmt: skip


@pytest.mark.skipif(os.geteuid() != 0, reason="mounts a small disk")
def test_a_full_disk(folder, comm, caplog):
    folder.mkdir(0o700)
    mount = ["mount", "-t", "tmpfs", "-o", "size=4096,mode=0700", "tmpfs", str(folder)]
    if subprocess.run(mount, check=False, timeout=20, capture_output=True).returncode:
        pytest.skip("may not mount")
    try:
        case = paper_case(Mesh(2 * N))
        assert same(pairs.assemble(case, comm), pairs.assemble(case, comm))
        assert not list(folder.iterdir())
        told = f"assembled pairs are not kept, going on: {folder}: No space left on device"
        assert caplog.messages == [told]
        resize(folder, 100_000)
        pairs.assemble(case, comm)
        assert pair_cache.size(folder)[0] == 1
    finally:
        subprocess.run(["umount", str(folder)], check=True, timeout=20)


def command(folder, *words, cwd):
    environment = {**SHELL_ENVIRONMENT, pair_cache.VARIABLE: str(folder)}
    return subprocess.Popen(
        [sys.executable, "-X", "importtime", "-m", "ringwear_par", *map(str, words)], cwd=cwd,
        env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


def test_many_processes_at_once_and_a_known_shape_needs_no_compiled_code(tmp_path):
    import ringwear_par as rw

    folder, case = tmp_path / "kept", ROOT / "scripts/cases/paper.toml"
    words = ["--set", f"mesh.contact_elements={N}", "time.steps=2"]
    started = [command(folder, "run", case, "-o", f"{i}.h5", *words, cwd=tmp_path) for i in "ab"]
    for process in started:
        told = process.communicate(timeout=100)[1]
        assert process.returncode == 0, told
    content = the_file(folder).read_bytes()
    for name, more, compiled in (("known", [], False), ("new", ["--no-cache"], True)):
        process = command(folder, "run", case, "-o", f"{name}.h5", *words, *more, cwd=tmp_path)
        told = process.communicate(timeout=100)[1]
        assert process.returncode == 0, told
        assert (" numba\n" in told) == compiled
    assert the_file(folder).read_bytes() == content
    results = [rw.open_result(tmp_path / f"{name}.h5") for name in ("a", "b", "known", "new")]
    for result in results[1:]:
        for name, values in result.histories.items():
            assert np.array_equal(values, results[0].histories[name]), name
        for name, values in result.profiles.items():
            assert np.array_equal(values, results[0].profiles[name]), name


def test_where_pairs_are_kept(monkeypatch, tmp_path, capsys):
    from ringwear_par.info import print_info

    monkeypatch.delenv(pair_cache.VARIABLE)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert pair_cache.folder() == tmp_path / "ringwear-par"
    monkeypatch.setenv("XDG_CACHE_HOME", "relative/folders/are/ignored")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert pair_cache.folder() == tmp_path / ".cache" / "ringwear-par"
    print_info(MPI.COMM_SELF)
    assert (
        f"assembled contact pairs: 0, 0 of 256 MB, in {pair_cache.folder()}"
        in capsys.readouterr().out
    )
    monkeypatch.setenv(pair_cache.VARIABLE, "")
    assert pair_cache.folder() is None
    print_info(MPI.COMM_SELF)
    assert "assembled contact pairs: not kept" in capsys.readouterr().out
