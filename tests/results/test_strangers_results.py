"""Result files of others: nothing in them is executed, and a damaged one is refused."""

import json

import h5py
import pytest
from parts import main
from paths import PAPER

import ringwear_par as rw

SMALL = ["--set", "mesh.contact_elements=8", "time.steps=3"]
LAW = "from pathlib import Path\nPath({!r}).touch()\ndef rate(p, at):\n    return 0.0 * p\n"


@pytest.fixture
def run(tmp_path):
    """A run of a small case."""
    path = tmp_path / "run.h5"
    assert main(["run", str(PAPER), "-o", str(path), *SMALL]) == 0
    return path


def test_a_law_that_only_a_result_file_names_is_not_run(run, tmp_path):
    law, marker = tmp_path / "trap.py", tmp_path / "has_run"
    law.write_text(LAW.format(str(marker)))
    with h5py.File(run, "r+") as file:
        before, after = file.attrs["case"].split("[wear.lower]\n")
        keys = f'law = "user"\nfile = {json.dumps(str(law))}\n'
        file.attrs["case"] = f"{before}[wear.lower]\n{keys}{after[after.index('[load]') :]}"
        file.attrs["status"] = "incomplete"
        file.attrs["user_laws"] = json.dumps({"lower": law.read_text()})
    assert main(["run", str(PAPER), "-o", str(run), *SMALL, "--restart"]) == 2
    assert main(["report", str(run), "-o", str(tmp_path / "a.html")]) == 0
    assert rw.open_result(run).summary()
    assert not marker.exists()


def test_a_flipped_bit_is_found(run):
    with h5py.File(run) as file:
        place = file["pressure"].id.get_chunk_info(0).byte_offset
    contents = bytearray(run.read_bytes())
    contents[place + 5] ^= 1
    run.write_bytes(contents)
    with pytest.raises(rw.InputError, match="damaged"):
        rw.open_result(run)


@pytest.mark.parametrize("how", ["cut", "text", "attribute", "variable"])
def test_what_is_no_result_file_is_refused(run, how):
    if how in ("cut", "text"):
        run.write_bytes(run.read_bytes()[:20_000] if how == "cut" else b"text")
    else:
        with h5py.File(run, "r+") as file:
            place, name = (file.attrs, "status") if how == "attribute" else (file, "time")
            del place[name]
    with pytest.raises(rw.InputError, match="is not a result file"):
        rw.open_result(run)
