"""Sweeps of sloping faces: histories are those of single runs, and doubts are flags."""

import h5py
import numpy as np
import pytest
from swept import CASE, table, variables, write_study

from ringwear_par.cases.files.reading import parse_case
from ringwear_par.elasticity.mesh import case_slopes
from ringwear_par.results.execution.run import run_case
from ringwear_par.results.variables import HISTORIES
from ringwear_par.studies.execution.sweep import sweep


def cones(lower, upper, bottom):
    """Rings of the same radii with these faces; ``bottom`` is the lowest point of the upper one."""
    text = CASE.replace("r = [20.0, 40.0]", f"r = [28.5, 31.5]\nprofile = {lower}", 1)
    before, after = text.split("[upper]")
    after = after.replace("z = [20.0, 40.0]", f"z = [{bottom}, 40.0]", 1)
    return f"{before}[upper]\nprofile = {upper}{after}"


#: of 16.7 degrees
MATCHED = "[[28.5, 19.1], [31.5, 20.0]]"
ABOVE, FLAT = "[[28.5, 20.0], [31.5, 20.9]]", "[[28.5, 20.0], [31.5, 20.0]]"
CONES = cones(MATCHED, MATCHED, 19.1).replace("steps = 20", "steps = 4")
STUDY = """
[vary]
"wear.lower.k" = { values = [1e-7, 3e-7] }
"upper.young" = { values = [5e4, 1e5] }
[design]
method = "grid"
"""


def test_a_sweep_of_cones_equals_single_runs(shared_path, comm):
    folder, run = shared_path / "out", shared_path / "run.h5"
    path = write_study(shared_path, comm, STUDY, CONES)
    summary = sweep(path, folder, comm)
    comm.Barrier()
    assert "unlike slopes" not in str(summary)
    found, rows = variables(folder), table(folder)
    assert [row["status"] for row in rows] == ["done"] * 4
    for i in range(4):
        if comm.rank == 0:
            (shared_path / "one.toml").write_text(found["case_toml"][i].decode())
        comm.Barrier()
        run_case(shared_path / "one.toml", run, [], comm=comm, overwrite=i > 0)
        comm.Barrier()
        with h5py.File(run) as file:
            for name in (*HISTORIES, "pressure", "wear_lower"):
                if name == "contact_iterations":
                    continue
                values = file[name][()]
                gap = 1e-12 * np.abs(values).max()
                assert found[name][i] == pytest.approx(values, rel=1e-12, abs=gap), name
        comm.Barrier()


def test_unlike_slopes_are_a_flag(shared_path, comm):
    """Of the cone over a flat face, and of no other."""
    text = cones(FLAT, ABOVE, 20.0).replace("steps = 20", "steps = 2")
    case = parse_case(text, "cone on flat")
    lower, upper = case_slopes(case.sections, case.line, case.mesh)
    assert not lower.any()
    assert np.abs(upper).min() > 0.29
    path = write_study(shared_path, comm, STUDY, text)
    summary = sweep(path, shared_path / "out", comm)
    comm.Barrier()
    assert all("unlike_slopes" in row["flags"] for row in table(shared_path / "out"))
    assert "unlike slopes" in str(summary)
