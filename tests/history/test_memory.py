"""What a case is said to need, against what it takes."""

import tracemalloc
from dataclasses import replace

import pytest
from parts import Mesh
from reference_cases import paper_case

import ringwear_par as rw
from ringwear_par.history.refusals import check_memory, memory_needed


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


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({}, r"mesh\.contact_elements = 64, time\.steps = 200"),
        ({"stress.points": [[20.01 + 0.01 * i, 15.0] for i in range(900)]}, "points: 900 of them"),
        ({"stress.grid": {"r": [28.0, 32.0], "z": [18.0, 19.9], "n": [300, 300]}}, r"300, 300"),
    ],
)
def test_what_takes_more_memory_than_there_is_is_named(keys, words, with_memory):
    case = rw.read_case("scripts/cases/paper.toml", keys)
    needed = memory_needed(case, 1)
    with_memory(needed / 0.89)
    check_memory(case, 1, "case.toml")
    with_memory(needed / 0.91)
    with pytest.raises(rw.InputError, match=words):
        check_memory(case, 1, "case.toml")
