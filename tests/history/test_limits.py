"""What a case is said to need, against what it takes."""

import re
import tracemalloc
from dataclasses import replace

import pytest
from reference_cases import paper_case

import ringwear_par as rw
from ringwear_par.elasticity.bem import solve
from ringwear_par.elasticity.mesh import Mesh
from ringwear_par.history.elastic.pairs import assemble
from ringwear_par.history.refusals.cases import check_memory, memory_needed


@pytest.mark.parametrize("n", [64, 128])
def test_memory_is_that_of_the_systems(comm, monkeypatch, n):
    """All that NumPy takes is counted, on whatever rank it is, and PETSc's factors and answers."""
    case = paper_case(Mesh(n))
    case = replace(case, time=replace(case.time, steps=1))
    assemble(case, comm, use_kept=False)  # what is loaded once
    solve_system, peaks = solve._solve, []

    def measured(rows, rights, comm):
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.reset_peak()
        solution = solve_system(rows, rights, comm)
        peaks.append(tracemalloc.get_traced_memory()[1] + rows.nbytes + rights.nbytes)
        tracemalloc.reset_peak()
        return solution

    monkeypatch.setattr(solve, "_solve", measured)
    tracemalloc.start()
    try:
        assemble(case, comm, use_kept=False)
        peaks.append(tracemalloc.get_traced_memory()[1])
    finally:
        tracemalloc.stop()
    assert 0.85 <= comm.allreduce(max(peaks)) / memory_needed(case, comm.size) <= 1.0


GRID = {"r": [28.0, 32.0], "z": [18.0, 19.9], "n": [300, 300]}
LIST = [[20.01 + 0.01 * i, 15.0] for i in range(900)]


@pytest.mark.parametrize("key", ["stress.grid.n = [300, 300]", "stress.points: 900 of them"])
def test_points_of_stress_that_take_the_memory_are_named_with_those_allowed(key, with_memory):
    stress = {"stress.points": LIST if "points" in key else LIST[:1]}
    if "points" not in key:
        stress["stress.grid"] = GRID
    case = rw.read_case("scripts/cases/paper.toml", stress)
    size, bare = case.stress.size, replace(case.stress, points=case.stress.points[:1], grid=None)
    one, all_of_them = memory_needed(replace(case, stress=bare), 1), memory_needed(case, 1)
    with_memory((one + 0.4 * (all_of_them - one)) / 0.9)  # and so does two fifths of the points
    with pytest.raises(rw.InputError, match=r"^case\.toml: " + re.escape(key)) as refused:
        check_memory(case, 1, "case.toml")
    said = str(refused.value)
    allowed = int(re.search(r"must be at most (\d+) points$", said)[1])
    assert allowed == pytest.approx(1.0 + 0.4 * (size - 1.0), abs=1.5)
    with_memory(0.5 * one)  # too little for the rest of the case
    with pytest.raises(rw.InputError, match=r"mesh\.contact_elements = 64, time\.steps = 200, "):
        check_memory(case, 1, "case.toml")
