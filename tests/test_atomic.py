"""Files that appear whole, or not at all."""

import os

import pytest

from ringwear_par.atomic import atomic_write


def test_it_is_there_when_it_is_whole(tmp_path):
    path = tmp_path / "a.h5"
    path.write_text("old")
    with atomic_write(path) as temporary:
        temporary.write_text("new")
        assert path.read_text() == "old"
        # who looks for files by their ending, or for leftovers, finds it where it belongs
        assert list(tmp_path.glob("*.h5")) == [path]
        assert list(tmp_path.glob("*.tmp*")) == [temporary]
    assert path.read_text() == "new"
    assert list(tmp_path.iterdir()) == [path]


def test_nothing_is_left_of_an_error(tmp_path):
    path = tmp_path / "a.csv"

    def half(temporary):
        temporary.write_text("half")
        raise KeyError

    with pytest.raises(KeyError), atomic_write(path) as temporary:
        half(temporary)
    assert not list(tmp_path.iterdir())
    with pytest.raises(FileNotFoundError), atomic_write(path):
        pass  # nothing was written
    assert not list(tmp_path.iterdir())


def test_contents_are_on_the_disk_before_the_name(tmp_path, monkeypatch):
    path, seen = tmp_path / "a.csv", []
    monkeypatch.setattr(os, "fsync", lambda _: seen.append(path.exists()))
    with atomic_write(path) as temporary:
        temporary.write_text("new")
    assert seen == [False]
    assert path.exists()
