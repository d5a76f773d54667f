"""Folders keep what a command has written: no other command takes them for its own."""

import pytest

from ringwear_par.errors import InputError
from ringwear_par.files.folders import refuse_others


@pytest.mark.parametrize(
    ("name", "command", "refused"),
    [
        ("fit.json", "sweep", "ringwear fit"),
        ("fit.json", "measure", "ringwear fit"),
        ("progress", "predict", "ringwear fit"),
        ("cases.csv", "fit", "ringwear sweep"),
        ("design.json", "sweep", "ringwear fit"),
        ("shards/", "fit", ""),  # empty
        ("design.json", "fit", ""),
        ("cases.csv", "sweep", ""),
    ],
)
def test_outcomes_of_other_commands_are_not_replaced(tmp_path, name, command, refused):
    (tmp_path / name).mkdir() if name.endswith("/") else (tmp_path / name).write_text("")
    if not refused:
        refuse_others(tmp_path, command)
        return
    with pytest.raises(InputError, match=f"is the folder of {refused} .*must be another, or new"):
        refuse_others(tmp_path, command)
