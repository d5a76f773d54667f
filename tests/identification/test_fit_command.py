"""``ringwear fit`` as users type it: what is refused, on all ranks together, writes nothing."""

import sys
from pathlib import Path

import numpy as np
import pytest
from laboratory import fit_tables, write_tests

from ringwear_par.cli import main
from ringwear_par.files.text import toml_value


@pytest.fixture
def ringwear(tmp_path, comm, monkeypatch, capfd):
    """Function that runs the command: its status here, and what all ranks say."""
    monkeypatch.chdir(tmp_path)

    def ringwear(*words):
        with monkeypatch.context() as patch:
            patch.setattr(sys, "stdout", sys.stdout)
            status = main(["fit", *words])
        return status, "".join(capfd.readouterr())

    return ringwear


@pytest.fixture
def write(tmp_path, comm):
    """Function that writes a fit file of one test, changed by another function."""
    experiments = write_tests(tmp_path, (60.0,))

    def written(change):
        tables = fit_tables(tmp_path, experiments, starts=1)
        change(tables)
        lines = (f"{key} = {toml_value(value)}\n" for key, value in tables.items())
        Path("fit.toml").write_text("".join(lines))

    return written


def test_a_fit_on_all_ranks(write, ringwear, comm):
    write(lambda tables: None)
    status, said = ringwear("fit.toml", "-o", "out")
    assert status == 0, said
    assert said.count("chi2 =") == 1
    assert Path("out/fit.json").is_file()


def test_what_no_reading_tells_is_refused_and_nothing_written(write, ringwear):
    mass = {"quantity": "mass.upper", "value": 0, "unit": "g", "density": 0.0078, "sd": 1}
    write(lambda t: t["experiment"][0]["data"].append(mass))
    said = "respond"
    before = np.array(sorted(p.name for p in Path().iterdir()))
    status, told = ringwear("fit.toml", "-o", "out")
    assert status == 2, told
    assert said in told
    assert told.count(said) == 1
    assert (np.array(sorted(p.name for p in Path().iterdir())) == before).all()
