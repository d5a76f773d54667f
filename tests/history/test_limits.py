"""What a case is said to need, against what it takes."""

import tracemalloc
from dataclasses import replace

import pytest

from ringwear_par.elasticity.mesh import Mesh
from ringwear_par.history.limits import memory_needed
from ringwear_par.history.pairs import assemble
from ringwear_par.verification.paper import paper_case


@pytest.mark.parametrize("n", [64, 128])
def test_memory_is_that_of_the_systems(comm, n):
    """All that NumPy takes is counted, on whatever rank it is."""
    case = paper_case(Mesh(n))
    case = replace(case, time=replace(case.time, steps=1))
    assemble(case, comm, use_kept=False)  # what is loaded once
    tracemalloc.start()
    try:
        assemble(case, comm, use_kept=False)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert 0.85 <= comm.allreduce(peak) / memory_needed(case, comm.size) <= 1.0
