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
