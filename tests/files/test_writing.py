"""Files that appear whole, or not at all."""

import errno

import pytest

from ringwear_par.files.writing import atomic_write


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
