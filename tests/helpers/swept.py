"""A small study, and what a sweep of it leaves."""

import csv

import h5py
import numpy as np
from paths import PAPER

CASE = PAPER.read_text()
CASE = CASE.replace("steps = 200", "steps = 20\n\n[mesh]\ncontact_elements = 16")
STUDY = """
[vary]
"wear.lower.k" = { log = [1e-8, 1e-6], count = 3 }
"upper.young" = { values = [5e4, 1e5] }
"upper.r" = { values = [[28.5, 31.5], [28, 32]] }
[design]
method = "grid"
"""


def write_study(folder, comm, text=STUDY, case=CASE):
    """Write a study beside its base case; return its path. Collective."""
    path = folder / "study.toml"
    if comm.rank == 0:
        (folder / "paper.toml").write_text(case)
        path.write_text('case = "paper.toml"\n' + text)
    comm.Barrier()
    return path


def table(folder):
    """Rows of cases.csv, in the order of the design."""
    with (folder / "cases.csv").open(newline="") as file:
        return sorted(csv.DictReader(file), key=lambda row: int(row["number"]))


def variables(folder):
    """Variables of results.h5, in the order of the design, but for the time taken."""
    with h5py.File(folder / "results.h5") as file:
        order = np.argsort(file["number"][:])
        of_cases = {n for n, v in file.items() if n == "case" or list(v.dims[0]) == ["case"]}
        return {
            name: file[name][()][order] if name in of_cases else file[name][()]
            for name in file
            if name != "seconds"
        }


def assert_same_sweeps(folder, other):
    """Two folders hold the same to the last bit, but for the time taken."""
    one, two = variables(folder), variables(other)
    assert one.keys() == two.keys()
    for name, values in one.items():
        assert np.array_equal(values, two[name], equal_nan=values.dtype.kind == "f"), name
    rows = [[{**row, "seconds": ""} for row in table(each)] for each in (folder, other)]
    assert rows[0] == rows[1]
