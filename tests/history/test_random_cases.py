"""Random cases of every sort: all run, and keep their balances."""

import numpy as np
import pytest
import random_cases

import ringwear_par as rw

#: defects of force, volume, energy and the contact's KKT conditions
ALLOWED = {"force": 1e-10, "volume": 1e-10, "energy": 1e-10, "residual": 1e-9}


@pytest.mark.parametrize("number", range(24))
def test_a_random_case_keeps_its_balances(number):
    keys, _ = random_cases.random_case(np.random.default_rng((1, number)))
    balances = rw.simulate(rw.read_case(keys)).balances
    for name, allowed in ALLOWED.items():
        assert balances[name] <= allowed, name


def test_random_cases_are_of_every_sort():
    drawn = [random_cases.random_case(np.random.default_rng((1, n))) for n in range(200)]
    sorts = " ".join(sort for _, sort in drawn)
    for word in ("inside", "equal", "inner overlap", "outer overlap", "chamfer", "profile", "flat",
                 "threshold", "archard", "power", "table", "running-in", "non-local"):  # fmt: skip
        assert word in sorts
    assert {keys["time.scheme"] for keys, _ in drawn} == {"implicit", "adaptive"}
    assert sum("load.control" in keys for keys, _ in drawn) > 20
    assert sum(isinstance(keys["load.omega"], list) for keys, _ in drawn) > 20
