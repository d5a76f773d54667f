"""Scripts find what they import; what those that measure measure is there."""

from importlib import import_module

import benchmark
import benchmark_ensembles
import pytest
from mpi4py import MPI
from paths import ROOT

import ringwear_par as rw


@pytest.mark.parametrize("name", sorted(path.stem for path in (ROOT / "scripts").glob("*.py")))
def test_scripts_find_what_they_import(name):
    assert import_module(name).__doc__


def test_benchmark_fills_its_table():
    row = benchmark.measure(16, 1, MPI.COMM_SELF)
    assert tuple(row) == benchmark.COLUMNS
    assert all(value > 0.0 for value in row.values())
    assert row["contact_elements"] == 16
    assert row["ranks"] == 1
    assert row["ms_per_step"] == 5.0 * row["steps_200_s"]


@pytest.mark.parametrize("kind", benchmark_ensembles.KINDS)
def test_ensembles_are_measured_beside_a_bare_loop_that_finds_the_same(kind):
    assert min(benchmark_ensembles.measure(kind, 2, 8, 1)) > 0.0
    (case,) = benchmark_ensembles.cases_of("200 implicit steps", 1, 16)
    pair = rw.assemble(case, MPI.COMM_SELF)
    result = rw.simulate(case, MPI.COMM_SELF, pair=pair)
    penetration = benchmark_ensembles.bare_loop(pair, case)
    assert penetration == pytest.approx(result.histories["penetration"][-1], rel=0.05)


def test_sweeps_are_measured_from_the_command_to_their_files():
    rate, outside, size, memory = benchmark_ensembles.measure_sweep(
        {"mesh.contact_elements": 8, "time.steps": 2, "output.profiles": "last"}, 4, 1
    )
    assert 0.0 < rate < 4.0 / (4e-6 * outside)
    assert size > 8 * 16
    assert memory > 50.0
