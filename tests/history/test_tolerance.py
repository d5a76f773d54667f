"""Adaptive steps keep their tolerance over the whole history: named and random cases."""

import tomllib

import numpy as np
import pytest
import random_cases
from parts import results_of
from paths import CASES
from tracing import ALONE

import ringwear_par as rw

ADAPTIVE = [
    path.stem
    for path in sorted(CASES.glob("*.toml"))
    if tomllib.loads(path.read_text()).get("time", {}).get("scheme") == "adaptive"
]
#: other tolerances, mm, of contacts that grow too, and of cases whose files have fixed steps
OTHERS = [("crown", 1e-5), ("sphere", 1e-5), ("paper", 1e-6), ("chamfer", 1e-5), ("overlap", 1e-5)]


def depths(cases, tolerances):
    """Return the depths of both bodies after 5 %, 30 % and all of the time of each case."""
    cases = [
        case.replace({
            "time": {"scheme": "adaptive", "end": case.time.end, "tolerance": tolerance},
            "output": {"times": [0.05 * case.time.end, 0.3 * case.time.end]},
        })
        for case, tolerance in zip(cases, tolerances, strict=True)
    ]  # fmt: skip
    return [
        np.stack([result.profiles[f"wear_{body}"][1:] for body in ("lower", "upper")], axis=1)
        for result in results_of(cases, ALONE)
    ]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "tolerance"), [*((n, None) for n in ADAPTIVE), *OTHERS])
def test_wear_of_a_case_of_the_repository(name, tolerance):
    case = rw.read_case(CASES / f"{name}.toml", {"mesh.contact_elements": 16})
    tolerance = tolerance or case.time.tolerance
    found, exact = depths([case, case], [tolerance, tolerance / 100])
    assert exact[-1].max() > tolerance
    assert np.abs(found - exact).max() < 1.1 * tolerance


def drawn(seed, number):
    return rw.read_case(random_cases.random_case(np.random.default_rng((seed, number)))[0])


@pytest.mark.slow
def test_wear_of_random_cases_is_within_the_tolerance():
    """Of 95 % of them, and of none twice as far off."""
    cases = [case for case in (drawn(7, number) for number in range(24)) if case.time.adaptive]
    tolerances, shares = [case.time.tolerance for case in cases], []
    exact = depths(cases, [0.01 * tolerance for tolerance in tolerances])
    for one, other, tolerance in zip(depths(cases, tolerances), exact, tolerances, strict=True):
        shares.append(np.abs(one - other).max() / tolerance)
    assert len(shares) >= 12
    assert np.quantile(shares, 0.95) <= 1.0
    assert max(shares) < 2.0


@pytest.mark.parametrize("solver", ["tao", "block"])
def test_random_cases_keep_their_balances(solver):
    """Of every sort; by TAO contacts hold to 1e-8, in blocks to 1e-4 beside wear."""
    cases = [drawn(1, number) for number in range(20)]
    if solver == "tao":
        results = [rw.simulate(case, ALONE) for case in cases[:10]]
    else:
        results = results_of(cases, ALONE)
    for result in results:
        balances = result.balances
        assert balances["force"] <= 1e-8
        assert balances["energy"] <= 1e-10
        assert balances["residual"] <= (1e-7 if solver == "tao" else 1e-2)


def test_random_cases_are_of_every_sort():
    drawn = [random_cases.random_case(np.random.default_rng((1, n))) for n in range(200)]
    sorts = " ".join(sort for _, sort in drawn)
    for word in ("inside", "equal", "inner overlap", "outer overlap", "chamfer", "profile", "flat",
                 "threshold", "archard", "power", "table", "running-in", "non-local"):  # fmt: skip
        assert word in sorts
    assert {keys["time.scheme"] for keys, _ in drawn} == {"implicit", "adaptive"}
    assert sum("load.control" in keys for keys, _ in drawn) > 20
    assert sum(isinstance(keys["load.omega"], list) for keys, _ in drawn) > 20
