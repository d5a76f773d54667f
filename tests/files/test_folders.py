"""Folders keep what a command has written: no other command takes them for its own."""

import pytest

import ringwear_par as rw
from ringwear_par.files.folders import refuse_others


@pytest.mark.parametrize(
    ("name", "owner", "other"),
    [
        ("fit.json", "fit", "sweep"),
        ("prediction.json", "predict", "fit"),
        ("cases.csv", "sweep", "fit"),
    ],
)
def test_outcomes_of_other_commands_are_not_replaced(tmp_path, name, owner, other):
    (tmp_path / name).write_text("")
    refuse_others(tmp_path, owner)
    with pytest.raises(rw.InputError, match=f"ringwear {owner}"):
        refuse_others(tmp_path, other)
