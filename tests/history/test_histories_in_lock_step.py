"""Histories that step together: the numbers of each are those that it has alone, to 1e-9."""

import numpy as np
import pytest
from paths import CASES, PAPER

import ringwear_par as rw

BASE = {
    "mesh.contact_elements": 16, "mesh.grading": 1.0, "time.scheme": "adaptive", "time.end": 60.0,
}  # fmt: skip
FIXED = {"time.end": None, "time.steps": 8}
IMPLICIT = {**FIXED, "time.scheme": "implicit", "time.step": 2.0}
EXPLICIT = {**FIXED, "time.scheme": "explicit", "time.step": 0.05}
CROWN = [[float(r), float(20.0 + (r - 30.0) ** 2 / 40.0)] for r in np.linspace(28.5, 31.5, 13)]
CONES = {"lower.z": [0.0, 21.0], "lower.profile": [[20.0, 19.0], [40.0, 21.0]],
         "upper.z": [19.7, 40.0], "upper.profile": [[28.5, 19.85], [31.5, 20.15]]}  # fmt: skip
ARCHARD = {"wear.upper": {"law": "archard", "k": 1e-8}}
USER = """
import numpy as np

def rate(p, at):
    p0, k = at.parameters["p0"], at.parameters["k"]
    if np.any((p0 == 13.0) & (at.time > 5.0)):
        raise ValueError("no such material")
    return k * at.friction * at.speed * p
"""


def law(name, **numbers):
    return {"wear.lower": {"law": name, **numbers}}


def thresholds(*numbers):
    return [law("threshold", k=k, p0=p0) for k, p0 in numbers]


THREE = thresholds((1e-8, 10.0), (4e-8, 0.0), (2e-7, 40.0))
#: changes of all histories, and those of each
COMPANIES = {
    "two bodies": (ARCHARD, THREE),
    "power": (EXPLICIT, [law("power", k=1e-10, m=m) for m in (1.3, 1.5)]),
    "memory": (IMPLICIT, [law("running-in", k=k, k_start=3.0 * k, depth=1e-3) for k in
                          (1e-8, 1e-7)]),
    "distance": (EXPLICIT, [law("running-in", k=1e-8, k_start=3e-8, distance=x) for x in
                            (100.0, 300.0)]),
    "non-local": ({}, [law("non-local", k=k, p0=10.0, length=0.3) for k in (1e-8, 1e-7)]),
    "no wear": ({"wear.lower": None}, [{"load.pressure": p} for p in (20.0, 90.0)]),
    "forces in time": ({}, [{"load.pressure": [[0.0, p], [20.0, p], [21.0, x * p], [60.0, p]]}
                            for p, x in ((80.0, 0.2), (40.0, 1.5), (80.0, 0.0))]),
    "displacements": (
        {"load.control": "displacement", "load.pressure": None, "load.displacement": 0.1},
        [{"load.displacement": x} for x in
         (0.02, 0.05, [[0.0, 0.05], [30.0, 0.0], [50.0, 0.0], [60.0, 0.06]])],
    ),
    "speeds": ({}, [{"load.omega": x} for x in
                    (3.5, [[0.0, 0.0], [25.0, 4.0], [60.0, 1.0]], 0.5)]),
    "moduli": ({}, [{"lower.young": e, "upper.young": u} for e, u in
                    ((1e4, 1e5), (2e3, 2e5), (10240.123, 1e5), (1e4, 41234.56))]),
    "ends": ({}, [{"time.end": t, "time.tolerance": 1e-5 / t} for t in (1.0, 30.0, 200.0)]),
    "growing contact": ({"upper.profile": CROWN, **ARCHARD},
                        [{"load.pressure": p} for p in (1.6, 60.0, 300.0)]),
    "cones": ({**CONES, **IMPLICIT}, THREE),
    "times of output": ({}, [{**one, "output.times": t} for one, t in
                             zip(THREE, ([20.0], [7.0, 40.0], [60.0]), strict=True)]),
}  # fmt: skip


def check(cases):
    """Together, and two at a time, each has its own numbers."""
    for together in (rw.simulate_all(cases), rw.simulate_all(cases, batch=2)):
        for case, found in zip(cases, together, strict=True):
            alone = rw.simulate(case)
            assert np.array_equal(found.step, alone.step)
            for kind in ("histories", "profiles"):
                for name, exact in getattr(alone, kind).items():
                    size = np.abs(exact).max(initial=1e-6)
                    np.testing.assert_allclose(
                        getattr(found, kind)[name], exact, rtol=0.0, atol=1e-9 * size, err_msg=name
                    )


@pytest.mark.parametrize("name", COMPANIES)
def test_each_history_is_as_alone(name):
    common, own = COMPANIES[name]
    base = rw.read_case(PAPER, {**BASE, **law("threshold", k=2e-7, p0=10.0), **common})
    check([base.replace(changes) for changes in own])


def test_histories_that_wear_through_layers_are_as_alone():
    base = rw.read_case(
        CASES / "wear_through.toml", {"mesh.contact_elements": 16, "time.end": 60.0}
    )
    layer = "lower.layers[0]"
    check([
        base.replace({f"{layer}.thickness": t, f"{layer}.wear.k": k, f"{layer}.wear.p0": p0})
        for t, k, p0 in ((3e-3, 1e-8, 0.0), (3e-4, 4e-8, 60.0), (2e-4, 3e-8, 100.0))
    ])  # fmt: skip


def test_histories_that_fail_leave_the_others_as_alone(tmp_path):
    """By their law, which nobody can tell of several at once, or worn too far."""
    (tmp_path / "law.py").write_text(USER)
    file = str(tmp_path / "law.py")
    numbers = [{"k": k, "p0": p0} for k, p0 in ((1e-8, 0.0), (1e-8, 13.0), (3e-8, 20.0))]
    users = [law("user", file=file, parameters=each) for each in numbers]
    base = rw.read_case(PAPER, BASE)
    for changes, failed, words in (
        (users, 1, "no such material"),
        (thresholds((1e-8, 0.0), (1e-7, 5.0), (3e-2, 0.0)), 2, "worn off lower"),
    ):
        cases = [base.replace(one) for one in changes]
        results = rw.simulate_all(cases)
        assert isinstance(results[failed], rw.FailedResult)
        assert words in str(results[failed].error)
        check([case for number, case in enumerate(cases) if number != failed])
