"""Every case file that users are given runs as it is, on few elements, and keeps its balances."""

import tomllib

import h5py
import pytest
from parts import run_case
from paths import CASES

#: the others in that folder are studies
RUNS = sorted(p for p in CASES.glob("*.toml") if "lower" in tomllib.loads(p.read_text()))


@pytest.mark.parametrize("path", RUNS, ids=lambda path: path.stem)
def test_a_case_runs_and_keeps_its_balances(path, tmp_path, comm):
    output = tmp_path / "run.h5"
    run_case(path, output, ["mesh.contact_elements=24"], comm=comm)
    with h5py.File(output) as file:
        force, torque, reaction, energy, residual = (
            file.attrs[f"balance_{name}"]
            for name in ("force", "torque", "reaction", "energy", "residual")
        )
        assert file.attrs["status"] == "complete"
        assert file["worn_volume_lower"][-1] + file["worn_volume_upper"][-1] > 0
    assert max(force, energy) <= 1e-10
    assert residual <= 1e-8
    assert max(torque, reaction) <= 0.02  # of the boundary elements, on so few of them
