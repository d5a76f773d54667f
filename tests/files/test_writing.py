"""Files that appear whole, or not at all."""

import errno
import os
import stat

import pytest

from ringwear_par.files.writing import atomic_write, check_writable


def test_it_is_there_when_it_is_whole(tmp_path):
    path = tmp_path / "a.h5"
    path.write_text("old")
    with atomic_write(path) as temporary, atomic_write(path) as other:
        assert temporary != other
        temporary.write_text("new")
        assert path.read_text() == "old"
        assert list(tmp_path.glob("*.h5")) == [path]
    assert path.read_text() == "new"
    assert list(tmp_path.iterdir()) == [path]
    assert stat.S_IMODE(path.stat().st_mode) & 0o600 == 0o600


def test_contents_are_on_the_disk_before_the_name(tmp_path, monkeypatch):
    path, seen = tmp_path / "a.csv", []
    monkeypatch.setattr(os, "fsync", lambda _: seen.append(path.exists()))
    with atomic_write(path) as temporary:
        temporary.write_text("new")
    assert seen == [False]
    assert path.exists()


<<<<<<< HEAD
def test_nothing_is_left_of_an_error(tmp_path):
    path = tmp_path / "a.csv"

    def half(temporary, error):
        temporary.write_text("half")
        raise error

    for error in (KeyError(), OSError(errno.ENOSPC, "No space left on device")):
        path.write_text("old")
        with pytest.raises(type(error)) as caught, atomic_write(path) as temporary:
            half(temporary, error)
        assert path.read_text() == "old"
        assert list(tmp_path.iterdir()) == [path]
    assert caught.value.filename == str(path)
    elsewhere = tmp_path / "missing" / "a.csv"
    with pytest.raises(FileNotFoundError) as missing, atomic_write(elsewhere):
        pass
    assert missing.value.filename == str(elsewhere)


def test_a_place_that_can_be_written_is_left_as_it_is(tmp_path):
    check_writable(tmp_path / "a.csv")
    assert not list(tmp_path.iterdir())
=======
def test_links_at_its_name_are_not_followed(tmp_path, monkeypatch):
    """Whoever may write to the folder: what is written goes to no other file."""
    path, victim, digits = tmp_path / "a.csv", tmp_path / "victim", "0123456789abcdef"
    victim.write_text("of another")
    monkeypatch.setattr(secrets, "token_hex", lambda _: digits)
    link = tmp_path / f"a.csv.tmp{digits}"
    link.symlink_to(victim)
    with pytest.raises(FileExistsError), atomic_write(path) as temporary:
        temporary.write_text("new")
    assert link.is_symlink()
    link.unlink()
    with atomic_write(path) as temporary:  # the link comes after the file
        link.unlink()
        link.symlink_to(victim)
        temporary.write_text("new")
    assert victim.read_text() == "of another"


def test_a_file_opens_from_the_moment_it_has_its_name(tmp_path, monkeypatch):
    path = tmp_path / "run.h5"
    rename = Path.replace
    seen = []

    def rename_and_read(temporary, target):
        remove_leftovers(tmp_path, path.name)  # another process, which leaves what is in use
        rename(temporary, target)
        with h5py.File(path, "r") as file:  # another process: its writer still holds the file open
            seen.append(int(file["a"][()]))
        return target

    monkeypatch.setattr(Path, "replace", rename_and_read)
    with atomic_hdf5(path) as file:
        file["a"] = 1
    assert seen == [1]


def test_names_differ_from_file_to_file(tmp_path):
    for _ in range(2):
        with atomic_write(tmp_path / "a.csv"), atomic_write(tmp_path / "a.csv"):
            first, second = tmp_path.glob("a.csv.tmp*")
            assert first != second
        assert str(os.getpid()) not in (first.name[9:], second.name[9:])


def test_what_killed_processes_have_left_goes(tmp_path):
    """The next writer of the file removes it; what is still written to stays."""
    path, other = tmp_path / "a.h5", tmp_path / "a.h5.tmp_of_mine"
    other.write_text("no left-over")
    program = """
import sys, time
from pathlib import Path
from ringwear_par.files.writing import atomic_write
with atomic_write(Path(sys.argv[1])) as temporary:
    temporary.write_text("half")
    print("begun", flush=True)
    time.sleep(100)
"""
    with subprocess.Popen(
        [sys.executable, "-c", program, str(path)], stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout.readline() == "begun\n"
        (left,) = tmp_path.glob("a.h5.tmp[0-9a-f]*")
        check_writable(path)
        assert left.exists()
        process.send_signal(signal.SIGKILL)
    check_writable(tmp_path / "b.h5")
    assert left.exists()
    check_writable(path)
    assert list(tmp_path.iterdir()) == [other]


def test_links_and_pipes_are_no_leftovers(tmp_path):
    """They do not keep the remover waiting, nor have another file removed."""
    victim, digits = tmp_path / "victim", "0123456789abcdef"
    victim.write_text("of another")
    (tmp_path / f"a.tmp{digits}").symlink_to(victim)
    os.mkfifo(tmp_path / f"b.tmp{digits}")
    remove_leftovers(tmp_path)
    assert len(list(tmp_path.iterdir())) == 3
>>>>>>> storage
