"""Scripts that measure: what they measure is there, on each rank by itself."""

from dataclasses import replace

import benchmark
import follow_the_wear
import numpy as np
from mpi4py import MPI

from ringwear_par.cases.case import Stepping
from ringwear_par.elasticity.mesh import Mesh
from ringwear_par.verification.paper import paper_case


def test_benchmark_fills_its_table():
    row = benchmark.measure(16, 1, MPI.COMM_SELF)
    assert tuple(row) == benchmark.COLUMNS
    assert all(value > 0.0 for value in row.values())
    assert row["contact_elements"] == 16
    assert row["ranks"] == 1
    assert row["ms_per_step"] == 5.0 * row["steps_200_s"]


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
