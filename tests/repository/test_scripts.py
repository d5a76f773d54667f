"""Scripts that measure: what they measure is there, on each rank by itself."""

from dataclasses import replace

import benchmark
import benchmark_ensembles
import follow_the_wear
import numpy as np
import pytest
import queue_at_scale
from mpi4py import MPI

import ringwear_par as rw
from ringwear_par.cases.case import Stepping
from ringwear_par.elasticity.mesh import Mesh
from ringwear_par.verification.histories import paper_case


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


def test_a_board_of_many_ranks_is_simulated():
    rng = np.random.default_rng(1)
    alone, work, questions = queue_at_scale.simulated(20_000, 1, rng)
    assert work > 0.999
    seconds, work, more = queue_at_scale.simulated(20_000, 16, rng)
    assert alone / 16 < seconds < alone / 8
    assert 0.7 < work < 1.0
    assert more > questions


def test_following_the_wear_is_compared_with_a_fixed_mesh():
    case = paper_case(Mesh(16), p0=(0.0, None), stepping=Stepping("implicit", 20.0, 10))
    fixed = follow_the_wear.history(case)
    updated = follow_the_wear.history(
        replace(case, mesh=Mesh(16, geometry="updated", geometry_tolerance=0.005))
    )
    assert fixed.assemblies == 0
    assert updated.assemblies >= 3
    assert fixed.pressure.shape == updated.pressure.shape == (11, 16)
    assert np.array_equal(updated.time, 20.0 * np.arange(11))
    assert 1e-6 < abs(updated.approach - fixed.approach)[-1] < 1e-4  # mm, of 20 um of wear
    assert 0.02 < fixed.wear[-1] < 0.03
    assert fixed.seconds > 0.0
    assert follow_the_wear.interior(case).sum() < 16
