"""What a case is said to need, against what it takes."""

import tracemalloc
from dataclasses import replace

import pytest
from parts import Mesh
from reference_cases import paper_case
from ringwear_par.history.refusals.cases import check_memory, memory_needed

import ringwear_par as rw


@pytest.mark.parametrize("n", [64, 128])
def test_memory_is_that_of_the_systems(comm, n):
    """All that NumPy takes is counted; PETSc's factors and answers are not seen here."""
    case = paper_case(Mesh(n))
    case = replace(case, time=replace(case.time, steps=1))
    rw.assemble(case, comm)  # what is loaded once
    tracemalloc.start()
    try:
        rw.assemble(case, comm)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert 0.4 <= peak / memory_needed(case, 1) <= 1.0


GRID = {"r": [28.0, 32.0], "z": [18.0, 19.9], "n": [300, 300]}
LIST = [[20.01 + 0.01 * i, 15.0] for i in range(900)]


@pytest.mark.parametrize("key", ["stress.grid.n", "stress.points"])
def test_points_of_stress_that_take_the_memory_are_named_with_those_allowed(key, with_memory):
    few = LIST[:1]
    stress = {"stress.points": LIST} if key == "stress.points" else {
        "stress.points": few, "stress.grid": GRID}  # fmt: skip
    case = rw.read_case("scripts/cases/paper.toml", stress)
    bare = replace(case.stress, points=case.stress.points[:1], grid=None)
    one, all_of_them = memory_needed(replace(case, stress=bare), 1), memory_needed(case, 1)
    with_memory((one + 0.4 * (all_of_them - one)) / 0.9)  # and so does two fifths of the points
    with pytest.raises(rw.InputError, match=key) as refused:
        check_memory(case, 1, "case.toml")
    allowed = int(str(refused.value).split("at most ")[1].split()[0])
    assert allowed == pytest.approx(1.0 + 0.4 * (case.stress.size - 1.0), abs=1.5)
    with_memory(0.5 * one)  # too little for the rest of the case
    with pytest.raises(rw.InputError, match=r"mesh\.contact_elements = 64"):
        check_memory(case, 1, "case.toml")
